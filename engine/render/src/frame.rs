//! The frame: [`record_frame`] records the stages in the order they run. What a stage returns, the
//! stages behind it take.

use decouplegs_gpu::Recorder;

use crate::frame_buffers::FrameBuffers;
use crate::kept_lists::{Kept, ListSource};
use crate::kernels::{BackgroundStages, FrameStages, ImageStages};
use crate::keys::KeyDecision;
use crate::options::RenderOptions;
use crate::slot::FrameInFlight;
use crate::stages::{
    AgentCounts, Counted, FrameData, HostWritten, KeptKeys, ListedSplats, PostProcessInputs,
    ProjectInputs, Records, SeenAgents, Segments, SortedLists, Target, Views,
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
            shadows.record(r, &contents.background, &slot.shadows, shadow_count);
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
        let visible = agents.cull.record(r, pool, slot.agents(), counts);
        let AgentCounts {
            cameras, clusters, ..
        } = counts;
        let (offsets, lists) = (&slot.agents().offsets, cameras * clusters);
        stages
            .common
            .scan
            .record(r, &visible.counts, offsets, lists);
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
    let (r, common) = (recorder, &stages.common);
    let FrameInput { contents, keys, .. } = input;
    let (background, counters) = (&contents.background, &frame.counters);
    let lists = frame.shape.cameras * frame.shape.clusters;

    let (written, counted) = begin_buffers(frame, slot, input);
    let views = r.stage("begin", |r| common.begin.record(r, written, counted));
    if let Some(key_splats) = (common.key_splats.as_ref()).filter(|_| !keys.find.is_empty()) {
        r.stage("key splats", |r| {
            for &wanted in &keys.find {
                key_splats.record(r, background, views.cameras, wanted, &keys.kept);
            }
        });
    }

    // With kept lists, records of the background are those of an earlier frame.
    let (mut offsets, mut projected) = (&frame.offsets, &frame.projected);
    if input.lists != ListSource::Kept {
        let BackgroundStages { cull, project } = &stages.background;
        let visible = r.stage("cull", |r| {
            cull.record(r, background, views, &frame.visible)
        });
        offsets = r.stage("scan", |r| {
            common
                .scan
                .record(r, &visible.counts, &frame.offsets, lists)
        });
        let inputs = ProjectInputs {
            visible,
            offsets,
            kept: KeptKeys {
                sets: &frame.key_sets,
                keys: &keys.kept,
            },
            shadows: &slot.shadows,
            shadow_count: contents.shadow_count,
            flow_interval_s: input.options.flow_interval_s as f32,
        };
        projected = r.stage("project", |r| {
            project.record(r, background, views, inputs, &frame.projected)
        });
    }
    if let Some(agents) = &stages.agents {
        projected = r.stage("project agents", |r| match seen_agents(slot, input) {
            Some(seen) => agents.project.record(r, seen, offsets, lists, projected),
            None => projected,
        });
    }

    let records = Records {
        cameras: views.cameras,
        camera_count: views.count,
        projected,
        static_offsets: offsets,
        static_clusters: frame.shape.clusters,
        moving_offsets: &slot.agents().offsets,
        moving_clusters: contents.agent_counts().clusters,
        moving_only: false,
        other_keys: &projected.keys,
    };
    let sorted = record_lists(r, stages, frame, slot, input, records);
    let capacity = &frame.shape.capacity;
    let plan = r.stage("plan", |r| {
        let plan_segments = &common.plan_segments;
        plan_segments.record(r, counters, sorted.lists, capacity, &frame.plan)
    });
    let planned = Planned {
        views,
        splats: ListedSplats {
            records: sorted.records,
            projected,
        },
        segments: Segments {
            counters,
            plan,
            partials: &frame.partials,
        },
    };
    record_images(r, stages, frame, slot, contents, planned);
    r.stage("end", |r| {
        r.copy(&counters.required, 0, &slot.found_required, 0, 1);
    });
}

/// Splats in sorted lists, and the segments of the lists that are blended.
#[derive(Clone, Copy)]
struct Planned<'a> {
    views: Views<'a>,
    splats: ListedSplats<'a>,
    segments: Segments<'a>,
}

/// Records the sort of `records` to lists of coarse tiles: of all of them, or of those of agents,
/// whose lists are merged with the kept ones of the background. Returns what is to be blended.
fn record_lists<'a>(
    recorder: &mut Recorder,
    stages: &FrameStages,
    frame: &'a FrameBuffers,
    slot: &FrameInFlight,
    input: FrameInput<'_>,
    records: Records<'_>,
) -> SortedLists<'a> {
    let (counters, bins) = (&frame.counters, frame.shape.bins);
    let (sort, own) = (&stages.common.tile_sort, &frame.tile_sort);
    let (Some(merge), Some(Kept { buffers, .. })) =
        (&stages.common.merge_lists, frame.kept_lists.kept())
    else {
        return sort.record(recorder, counters, records, own, bins);
    };
    let all = Records {
        other_keys: &buffers.other_keys,
        ..records
    };
    if input.lists == ListSource::Found {
        let background = Records {
            moving_clusters: 0,
            ..all
        };
        let kept = buffers.kept_sort(own);
        sort.record(recorder, counters, background, &kept, bins);
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
    let moving = sort.record(recorder, counters, agents, own, bins);
    recorder.stage("merge", |r| {
        merge.record_plan(r, counters, moving.lists, buffers, slot.drawn_alone());
        merge.record(r, counters, moving, all.projected, buffers)
    })
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

/// Agents of the frame that are projected; `None` where no camera may see one.
fn seen_agents<'a>(slot: &'a FrameInFlight, input: FrameInput<'a>) -> Option<SeenAgents<'a>> {
    let list = input.contents.agents.as_ref()?;
    Some(SeenAgents {
        pool: &list.pool,
        buffers: slot.agents(),
        relit: &slot.relit.colors,
        counts: list.counts,
        fog: input.contents.background.fog.as_ref(),
        flow_interval_s: input.options.flow_interval_s as f32,
    })
}

/// Records the blending of what is `planned` to the images in `slot`.
fn record_images(
    recorder: &mut Recorder,
    stages: &FrameStages,
    frame: &FrameBuffers,
    slot: &FrameInFlight,
    contents: &FrameContents,
    planned: Planned<'_>,
) {
    // Post-processing writes the images of what is blended.
    let blended = stages
        .post_process
        .as_ref()
        .map(|_| slot.images.with_color_in(&frame.blended));
    let target = Target {
        images: blended.as_ref().unwrap_or(&slot.images),
        sky: contents.background.sky,
    };
    blend_images(recorder, &stages.images, planned, target);
    let Some(post_process) = &stages.post_process else {
        return;
    };
    recorder.stage("post-process", |r| {
        let (photometry, count) = (&frame.photometry, frame.shape.cameras);
        r.copy(&slot.staged_photometry, 0, photometry, 0, count);
        let inputs = PostProcessInputs {
            cameras: planned.views.cameras,
            photometry,
            views: &contents.processed,
            sky: contents.background.sky_map.as_ref(),
        };
        post_process.record(r, inputs, &target.images.images_f32, &slot.images);
    });
}

/// Records the blending of what is `planned` to `target`.
fn blend_images(
    recorder: &mut Recorder,
    stages: &ImageStages,
    planned: Planned<'_>,
    target: Target<'_>,
) {
    let (
        r,
        ImageStages {
            blend, composite, ..
        },
    ) = (recorder, stages);
    let Planned {
        views,
        splats,
        segments,
    } = planned;
    let partial = r.stage("blend", |r| {
        blend.record(r, views, splats, segments, target)
    });
    let unfinished = r.stage("composite", |r| {
        composite.record(r, views, splats.projected, partial, target)
    });
    if let Some(finish) = &stages.finish {
        r.stage("finish", |r| {
            finish.record(r, views, splats, unfinished, target)
        });
    }
    if let Some(finish) = &stages.finish_medians {
        r.stage("medians", |r| {
            finish.record(r, views, splats, unfinished, target)
        });
    }
}
