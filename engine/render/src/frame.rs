//! The frame: [`record_frame`] and its parts record the stages in the order they run.

use decouplegs_gpu::Recorder;

use crate::frame_buffers::{FrameBuffers, FrameShape};
use crate::kept_lists::{Kept, ListSource};
use crate::kernels::{FrameStages, ImageStages};
use crate::keys::KeyDecision;
use crate::options::RenderOptions;
use crate::output::OutputBuffers;
use crate::slot::FrameInFlight;
use crate::stages::{
    AgentCounts, Blend, Counted, FrameData, HostWritten, KeptKeys, ListedSplats, PostProcessInputs,
    Project, ProjectAgents, ProjectInputs, Records, SeenAgents, Segments, Target,
};
use crate::submitted::FrameContents;

/// Inputs of a frame beside the buffers that the host wrote, which are in its slot.
#[derive(Clone, Copy)]
pub(crate) struct FrameInput<'a> {
    pub contents: &'a FrameContents,
    pub keys: &'a KeyDecision,
    pub lists: ListSource,
    pub options: &'a RenderOptions,
}

/// Records the agents' part of a frame, which needs nothing of the frame before it: their shadows
/// on the background, their colors in their light, and what of them is visible.
pub(crate) fn record_agents(
    recorder: &mut Recorder,
    stages: &FrameStages,
    slot: &FrameInFlight,
    contents: &FrameContents,
) {
    let shadow_count = contents.shadow_count;
    if let Some(shadows) = stages.shadows.as_ref().filter(|_| shadow_count > 0) {
        recorder.stage("shadows", |r| {
            slot.copy_shadows(r, shadow_count);
            shadows.record(r, &contents.gpu_scene, &slot.shadows, shadow_count);
        });
    }
    let (Some(agents), Some(list)) = (&stages.agents, &contents.agents) else {
        return;
    };
    let (pool, counts, relights) = (&list.pool, list.counts, &contents.relights);
    if let Some(relight) = agents.relight.as_ref().filter(|_| relights.count > 0) {
        recorder.stage("relight", |r| {
            slot.relit.copy(r, relights);
            relight.record(r, pool, slot.relit.work(relights), &slot.relit.colors);
        });
    }
    recorder.stage("agents", |r| {
        slot.copy_agents(r, counts, contents.view.lenses.len());
        agents.cull.record(r, pool, slot.agents(), counts);
        let AgentCounts {
            cameras, clusters, ..
        } = counts;
        stages.common.scan.record(
            r,
            &slot.agents().visible.counts,
            &slot.agents().offsets,
            cameras * clusters,
        );
    });
}

/// Records the frame that draws `input` for the cameras in `slot`.
pub(crate) fn record_frame(
    recorder: &mut Recorder,
    stages: &FrameStages,
    frame: &FrameBuffers,
    slot: &FrameInFlight,
    input: FrameInput<'_>,
) {
    let (written, counted) = begin_buffers(frame, slot, input);
    recorder.stage("begin", |r| stages.common.begin.record(r, written, counted));
    if let Some(key_splats) = stages
        .common
        .key_splats
        .as_ref()
        .filter(|_| !input.keys.find.is_empty())
    {
        recorder.stage("key splats", |r| {
            for &wanted in &input.keys.find {
                let gpu_scene = &input.contents.gpu_scene;
                key_splats.record(r, gpu_scene, &frame.cameras, wanted, &input.keys.kept);
            }
        });
    }
    if input.lists != ListSource::Kept {
        record_background(recorder, stages, frame, slot, input);
    }
    if let Some(agents) = &stages.agents {
        recorder.stage("project agents", |r| {
            project_agents(r, &agents.project, frame, slot, input);
        });
    }
    record_lists(recorder, stages, frame, slot, input);
    record_images(recorder, stages, frame, slot, input);
    recorder.stage("end", |r| {
        r.copy(&frame.counters.required, 0, &slot.found_required, 0, 1);
    });
}

/// Records the sort of records to lists of coarse tiles: of all of them, or of those of agents,
/// whose lists are merged with the kept ones of the background.
fn record_lists(
    recorder: &mut Recorder,
    stages: &FrameStages,
    frame: &FrameBuffers,
    slot: &FrameInFlight,
    input: FrameInput<'_>,
) {
    let (counters, bins) = (&frame.counters, frame.shape.bins);
    let all = Records {
        cameras: &frame.cameras,
        camera_count: frame.shape.cameras,
        projected: &frame.projected,
        static_offsets: &frame.offsets,
        static_clusters: frame.shape.clusters,
        moving_offsets: &slot.agents().offsets,
        moving_clusters: input.contents.agent_counts().clusters,
        moving_only: false,
        other_keys: &frame.projected.keys,
    };
    let (sort, own) = (&stages.common.tile_sort, &frame.tile_sort);
    let (Some(merge), Some(Kept { buffers, .. })) =
        (&stages.common.merge_lists, frame.kept_lists.kept())
    else {
        sort.record(recorder, counters, all, own, bins);
        return;
    };
    let all = Records {
        other_keys: &buffers.other_keys,
        ..all
    };
    if input.lists == ListSource::Found {
        let background = Records {
            moving_clusters: 0,
            ..all
        };
        sort.record(
            recorder,
            counters,
            background,
            &buffers.kept_sort(own),
            bins,
        );
        recorder.stage("keep lists", |r| {
            r.copy(&counters.required, 0, &buffers.kept_required, 0, 1);
            let (written, counted) = begin_buffers(frame, slot, input);
            stages.common.begin.record_lists(r, written, counted);
        });
    }
    let agents = Records {
        moving_only: true,
        ..all
    };
    sort.record(recorder, counters, agents, own, bins);
    recorder.stage("merge", |r| {
        let moving = own.lists_of(bins);
        merge.record_plan(r, counters, moving, buffers, slot.drawn_alone());
        merge.record(r, counters, own, &frame.projected, buffers);
    });
}

/// Buffers with which a frame begins: what the host wrote, and what is counted.
fn begin_buffers<'a>(
    frame: &'a FrameBuffers,
    slot: &'a FrameInFlight,
    input: FrameInput<'_>,
) -> (HostWritten<'a>, Counted<'a>) {
    let written = HostWritten {
        from: slot.staged(),
        to: FrameData {
            cameras: &frame.cameras,
            lenses: &frame.lenses,
            key_sets: &frame.key_sets,
        },
        cameras: frame.shape.cameras,
        lenses: input.contents.view.lenses.len(),
    };
    let counted = Counted {
        counters: &frame.counters,
        slab_counts: &frame.tile_sort.slab_counts,
        bins: frame.shape.bins,
        contributions: &slot.images.contributions,
        agent_offsets: &slot.agents().offsets,
        agents: input.contents.agents.is_some(),
        partials: &frame.partials,
    };
    (written, counted)
}

/// Records culling and projection of the background.
fn record_background(
    recorder: &mut Recorder,
    stages: &FrameStages,
    frame: &FrameBuffers,
    slot: &FrameInFlight,
    input: FrameInput<'_>,
) {
    let FrameShape {
        cameras: camera_count,
        clusters,
        ..
    } = frame.shape;
    let background = &stages.background;
    recorder.stage("cull", |r| {
        let cull = &background.cull;
        cull.record(r, &input.contents.gpu_scene, frame.views(), &frame.visible);
    });
    recorder.stage("scan", |r| {
        stages.common.scan.record(
            r,
            &frame.visible.counts,
            &frame.offsets,
            camera_count * clusters,
        );
    });
    recorder.stage("project", |r| {
        project_background(r, &background.project, frame, slot, input);
    });
}

/// Records the projection of the background.
fn project_background(
    recorder: &mut Recorder,
    project: &Project,
    frame: &FrameBuffers,
    slot: &FrameInFlight,
    input: FrameInput<'_>,
) {
    let inputs = ProjectInputs {
        visible: &frame.visible,
        offsets: &frame.offsets,
        kept: KeptKeys {
            sets: &frame.key_sets,
            keys: &input.keys.kept,
        },
        shadows: &slot.shadows,
        shadow_count: input.contents.shadow_count,
        flow_interval_s: input.options.flow_interval_s as f32,
    };
    project.record(
        recorder,
        &input.contents.gpu_scene,
        frame.views(),
        inputs,
        &frame.projected,
    );
}

/// Records the projection of the agents, if there are some.
fn project_agents(
    recorder: &mut Recorder,
    project: &ProjectAgents,
    frame: &FrameBuffers,
    slot: &FrameInFlight,
    input: FrameInput<'_>,
) {
    let Some(list) = &input.contents.agents else {
        return;
    };
    let agents = SeenAgents {
        pool: &list.pool,
        buffers: slot.agents(),
        relit: &slot.relit.colors,
        counts: list.counts,
        fog: input.contents.gpu_scene.fog.as_ref(),
        flow_interval_s: input.options.flow_interval_s as f32,
    };
    let static_lists = frame.shape.cameras * frame.shape.clusters;
    project.record(
        recorder,
        agents,
        &frame.offsets,
        static_lists,
        &frame.projected,
    );
}

/// Blends sorted lists to images.
fn record_images(
    recorder: &mut Recorder,
    stages: &FrameStages,
    frame: &FrameBuffers,
    slot: &FrameInFlight,
    input: FrameInput<'_>,
) {
    let FrameShape {
        capacity,
        cameras: camera_count,
        ..
    } = frame.shape;
    let counters = &frame.counters;
    // Post-processing writes the images of what is blended.
    let blended = stages
        .post_process
        .as_ref()
        .map(|_| slot.images.with_color_in(&frame.blended));
    let images = blended.as_ref().unwrap_or(&slot.images);
    recorder.stage("plan", |r| {
        stages
            .common
            .plan_segments
            .record(r, counters, frame.lists().0, &capacity, &frame.plan);
    });
    let gpu_scene = &input.contents.gpu_scene;
    blend_images(recorder, &stages.images, frame, images, gpu_scene.sky);
    if let Some(post_process) = &stages.post_process {
        recorder.stage("post-process", |r| {
            r.copy(
                &slot.staged_photometry,
                0,
                &frame.photometry,
                0,
                camera_count,
            );
            let inputs = PostProcessInputs {
                cameras: &frame.cameras,
                photometry: &frame.photometry,
                views: &input.contents.processed,
                sky: gpu_scene.sky_map.as_ref(),
            };
            post_process.record(r, inputs, &frame.blended, &slot.images);
        });
    }
}

/// Records the blending of the planned segments over `sky` into `images`.
fn blend_images(
    recorder: &mut Recorder,
    stages: &ImageStages,
    frame: &FrameBuffers,
    images: &OutputBuffers,
    sky: [f32; 3],
) {
    let (views, target) = (frame.views(), Target { images, sky });
    let splats = ListedSplats {
        records: frame.lists().1,
        projected: &frame.projected,
    };
    let segments = Segments {
        counters: &frame.counters,
        plan: &frame.plan,
        partials: &frame.partials,
    };
    let blend = |r: &mut Recorder, blend: &Blend| {
        blend.record(r, views, splats, segments, target);
    };
    recorder.stage("blend", |r| blend(r, &stages.blend));
    recorder.stage("composite", |r| {
        let composite = &stages.composite;
        composite.record(r, views, &frame.projected, segments, target);
    });
    if let Some(finish) = &stages.finish {
        recorder.stage("finish", |r| blend(r, finish));
    }
    if let Some(finish_medians) = &stages.finish_medians {
        recorder.stage("medians", |r| blend(r, finish_medians));
    }
}
