//! The frame: one function that lists the stages in the order they run.

use decouplegs_gpu::{Buffer, Recorder};

use crate::frame_buffers::{FrameBuffers, FrameShape};
use crate::kernels::FrameStages;
use crate::keys::KeyDecision;
use crate::resident::GpuScene;
use crate::slot::FrameInFlight;
use crate::stages::{AgentCounts, KeptKeys, PartialResults, Records, TileSortBuffers};

/// Inputs of a frame beside the agents, which are in its slot.
#[derive(Clone, Copy)]
pub(crate) struct FrameInput<'a> {
    pub world: &'a GpuScene,
    pub keys: &'a KeyDecision,
    /// The persistent key buffer.
    pub kept_keys: &'a Buffer<u32>,
    pub agents: Option<AgentCounts>,
}

/// Records the agents' part of a frame, which needs nothing of the frame before it: their shadows
/// on `world`, their colors in their light, and what of them is visible.
pub(crate) fn record_agents(
    recorder: &mut Recorder,
    stages: &FrameStages<'_>,
    slot: &FrameInFlight,
    world: &GpuScene,
    counts: Option<AgentCounts>,
) {
    if let Some(shadows) = stages.shadows.filter(|_| slot.shadow_count > 0) {
        recorder.stage("shadows", |r| {
            slot.copy_shadows(r);
            shadows.record(r, world, &slot.shadows, slot.shadow_count);
        });
    }
    let (Some(agents), Some(pool), Some(counts)) = (stages.agents, slot.pool(), counts) else {
        return;
    };
    if let Some(relight) = agents.relight.as_ref().filter(|_| slot.relit.to_make.0 > 0) {
        recorder.stage("relight", |r| {
            let (count, groups) = slot.relit.to_make;
            slot.relit.copy(r);
            relight.record(
                r,
                pool,
                &slot.relit.records,
                count,
                groups,
                &slot.relit.colors,
            );
        });
    }
    recorder.stage("agents", |r| {
        slot.copy_agents(r, counts);
        agents.cull.record(r, pool, &slot.agents, counts);
        let AgentCounts {
            cameras, clusters, ..
        } = counts;
        stages.common.scan.record(
            r,
            &slot.agents.visible.counts,
            &slot.agents.offsets,
            cameras * clusters,
        );
    });
}

/// Records the frame that draws `input` for the cameras in `slot`.
pub(crate) fn record_frame(
    recorder: &mut Recorder,
    stages: &FrameStages<'_>,
    frame: &FrameBuffers,
    slot: &FrameInFlight,
    input: FrameInput<'_>,
) {
    record_begin(recorder, frame, slot, input);
    if let Some(key_splats) = stages
        .common
        .key_splats
        .as_ref()
        .filter(|_| !input.keys.find.is_empty())
    {
        recorder.stage("key splats", |r| {
            for &camera_and_set in &input.keys.find {
                key_splats.record(
                    r,
                    input.world,
                    &frame.cameras,
                    camera_and_set,
                    input.kept_keys,
                );
            }
        });
    }
    record_projection(recorder, stages, frame, slot, input);
    let records = Records {
        cameras: &frame.cameras,
        camera_count: frame.shape.cameras,
        projected: &frame.projected,
        static_offsets: &frame.offsets,
        static_clusters: frame.shape.clusters,
        moving_offsets: &slot.agents.offsets,
        moving_clusters: input.agents.map_or(0, |counts| counts.clusters),
    };
    stages.common.tile_sort.record(
        recorder,
        &frame.counters,
        records,
        &frame.tile_sort,
        frame.shape.bins,
    );
    record_images(recorder, stages, frame, slot, input);
}

/// Hands over what the host wrote, and empties what is counted.
fn record_begin(
    recorder: &mut Recorder,
    frame: &FrameBuffers,
    slot: &FrameInFlight,
    input: FrameInput<'_>,
) {
    let counters = &frame.counters;
    recorder.stage("begin", |r| {
        let cameras = frame.shape.cameras;
        r.copy(&slot.staged_cameras, 0, &frame.cameras, 0, cameras);
        slot.copy_lenses(r, &frame.lenses);
        r.copy(&slot.staged_key_sets, 0, &frame.key_sets, 0, cameras);
        let PartialResults {
            transmittances,
            unfinished,
            ..
        } = &frame.partials;
        let emptied = [
            (counters.required.binding(), counters.required.byte_len()),
            (counters.arguments.binding(), counters.arguments.byte_len()),
            (
                frame.tile_sort.slab_counts.binding(),
                TileSortBuffers::slab_bytes(frame.shape.bins),
            ),
            (
                slot.images.contributions.binding(),
                slot.images.contributions.byte_len(),
            ),
            (transmittances.binding(), transmittances.byte_len()),
            (unfinished.binding(), unfinished.byte_len()),
        ];
        for (buffer, bytes) in emptied {
            r.fill(buffer, 0, bytes, 0);
        }
        if input.agents.is_none() {
            r.fill(slot.agents.offsets.binding(), 0, 4, 0);
        }
    });
}

/// From splats to records: those of the background, then those of agents.
fn record_projection(
    recorder: &mut Recorder,
    stages: &FrameStages<'_>,
    frame: &FrameBuffers,
    slot: &FrameInFlight,
    input: FrameInput<'_>,
) {
    let FrameShape {
        cameras: camera_count,
        clusters,
        ..
    } = frame.shape;
    let (world, cameras, lenses) = (input.world, &frame.cameras, &frame.lenses);
    let background = stages.background;
    recorder.stage("cull", |r| {
        background
            .cull
            .record(r, world, cameras, lenses, camera_count, &frame.visible);
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
        let (visible, offsets, projected, shadows) = (
            &frame.visible,
            &frame.offsets,
            &frame.projected,
            &slot.shadows,
        );
        let kept = KeptKeys {
            sets: &frame.key_sets,
            keys: input.kept_keys,
        };
        let project = &background.project;
        project.record(
            r,
            world,
            cameras,
            lenses,
            camera_count,
            visible,
            offsets,
            projected,
            kept,
            shadows,
            slot.shadow_count,
        );
    });
    if let (Some(counts), Some(agents), Some(pool)) = (input.agents, stages.agents, slot.pool()) {
        recorder.stage("project agents", |r| {
            let lists = camera_count * clusters;
            agents.project.record(
                r,
                pool,
                &slot.agents,
                &slot.relit.colors,
                counts,
                &frame.offsets,
                lists,
                &frame.projected,
            );
        });
    }
}

/// From sorted lists to images.
fn record_images(
    recorder: &mut Recorder,
    stages: &FrameStages<'_>,
    frame: &FrameBuffers,
    slot: &FrameInFlight,
    input: FrameInput<'_>,
) {
    let FrameShape {
        capacity,
        cameras: camera_count,
        bins,
        ..
    } = frame.shape;
    let (counters, cameras) = (&frame.counters, &frame.cameras);
    let (plan, partials, sky) = (&frame.plan, &frame.partials, input.world.sky);
    // Post-processing writes the images of what is blended.
    let blended = stages
        .post_process
        .map(|_| slot.images.with_color_in(&frame.blended));
    let images = blended.as_ref().unwrap_or(&slot.images);
    let (records, projected) = (&frame.tile_sort.sorted_records, &frame.projected);
    recorder.stage("plan", |r| {
        stages.common.plan_segments.record(
            r,
            counters,
            &frame.tile_sort.tile_lists,
            bins,
            &capacity,
            plan,
        );
    });
    recorder.stage("blend", |r| {
        stages.images.blend.record(
            r,
            counters,
            cameras,
            camera_count,
            sky,
            plan,
            records,
            projected,
            partials,
            images,
        );
    });
    recorder.stage("composite", |r| {
        stages.images.composite.record(
            r,
            counters,
            cameras,
            camera_count,
            sky,
            plan,
            partials,
            images,
        );
        r.copy(&counters.required, 0, &slot.found_required, 0, 1);
    });
    if let Some(finish) = &stages.images.finish {
        recorder.stage("finish", |r| {
            finish.record(
                r,
                counters,
                cameras,
                camera_count,
                sky,
                plan,
                records,
                projected,
                partials,
                images,
            );
        });
    }
    if let Some(post_process) = stages.post_process {
        let sky = input.world.sky_map.as_ref();
        recorder.stage("post-process", |r| {
            r.copy(
                &slot.staged_photometry,
                0,
                &frame.photometry,
                0,
                camera_count,
            );
            post_process.record(
                r,
                (cameras, &frame.photometry),
                &slot.processed,
                sky,
                &frame.blended,
                &slot.images,
            );
        });
    }
}
