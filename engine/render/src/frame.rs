//! The frame: one function that lists the stages in the order they run.

use decouplegs_gpu::{Buffer, Recorder};

use crate::frame_buffers::{AllSplats, FrameBuffers, FrameShape};
use crate::kernels::{FrameStages, OrderStages};
use crate::layout::CAMERAS_MAX;
use crate::orders::{OrderDecision, OrderPath};
use crate::resident::ResidentWorld;
use crate::slot::FrameSlot;
use crate::stages::{AgentCounts, Arguments, Measured, Pairs, Partials, Ranked, SortInput};

/// All of a depth key: see `depth_key.glsl`.
const DEPTH_KEY_BITS: u32 = 32;

/// What a frame draws, beside the agents, which are in its slot.
#[derive(Clone, Copy)]
pub(crate) struct FrameInput<'a> {
    pub world: &'a ResidentWorld,
    pub orders: &'a OrderDecision,
    pub ranks: &'a Buffer<u32>,
    pub agents: Option<AgentCounts>,
}

/// Records the agents' part of a frame, which needs nothing of the frame before it: their shadows on `world`, their colours in
/// their light, and what of them is visible.
pub(crate) fn record_agents(
    recorder: &mut Recorder,
    stages: &FrameStages<'_>,
    slot: &FrameSlot,
    world: &ResidentWorld,
    counts: Option<AgentCounts>,
) {
    if let Some(shadows) = stages.shadows.filter(|_| slot.shadow_count > 0) {
        recorder.stage("shadows", |r| {
            slot.copy_shadows(r);
            shadows.record(r, world, &slot.shadows, slot.shadow_count);
        });
    }
    let (Some(agents), Some(pool), Some(counts)) = (stages.agents, slot.pool(), counts) else { return };
    if let Some(relight) = agents.relight.as_ref().filter(|_| slot.relit.to_make.0 > 0) {
        recorder.stage("relight", |r| {
            let (count, groups) = slot.relit.to_make;
            slot.relit.copy(r);
            relight.record(r, pool, &slot.relit.records, count, groups, &slot.relit.colours);
        });
    }
    recorder.stage("agents", |r| {
        slot.copy_agents(r, counts);
        agents.cull.record(r, pool, &slot.agents, counts);
        let AgentCounts { cameras, chunks, .. } = counts;
        stages.common.scan.record(r, &slot.agents.visible.counts, &slot.agents.firsts, cameras * chunks);
    });
}

/// Records the frame that draws `input` for the cameras in `slot`.
pub(crate) fn record_frame(
    recorder: &mut Recorder,
    stages: &FrameStages<'_>,
    frame: &FrameBuffers,
    slot: &FrameSlot,
    input: FrameInput<'_>,
) {
    record_begin(recorder, frame, slot, input);
    if let (Some((camera, set)), Some(orders)) = (input.orders.find, stages.orders) {
        recorder.stage("find order", |r| find_order(r, stages, orders, frame, input, camera, set));
    }
    record_projection(recorder, stages, frame, slot, input);
    let sorted = record_order(recorder, stages, frame, slot, input);
    record_pictures(recorder, stages, frame, slot, input, sorted);
}

/// Hands over what the host wrote, and empties what is counted.
fn record_begin(recorder: &mut Recorder, frame: &FrameBuffers, slot: &FrameSlot, input: FrameInput<'_>) {
    let (control, plan) = (&frame.control, &frame.order_plan);
    let ranked = input.orders.is_ranked();
    recorder.stage("begin", |r| {
        let cameras = frame.shape.cameras;
        r.copy(&slot.staged_cameras, 0, &frame.cameras, 0, cameras);
        slot.copy_lenses(r, &frame.lenses);
        r.copy(&slot.staged_orders, 0, &plan.view_orders, 0, cameras);
        let Partials { transmittances, unfinished, .. } = &frame.partials;
        let emptied = [
            (control.needs.binding(), control.needs.byte_len()),
            (control.arguments.binding(), control.arguments.byte_len()),
            (control.pair_segment.binding(), control.pair_segment.byte_len()),
            (plan.inversions.binding(), plan.inversions.byte_len()),
            (control.order_error.binding(), control.order_error.byte_len()),
            (slot.pictures.contributions.binding(), slot.pictures.contributions.byte_len()),
            (transmittances.binding(), transmittances.byte_len()),
            (unfinished.binding(), unfinished.byte_len()),
        ];
        for (buffer, bytes) in emptied {
            r.fill(buffer, 0, bytes, 0);
        }
        if ranked {
            r.fill(frame.rank_lists.words.binding(), 0, frame.rank_lists.words.byte_len(), 0);
        }
        if input.agents.is_none() {
            r.fill(slot.agents.firsts.binding(), 0, 4, 0);
        }
    });
}

/// Sorts all splats of the background along the direction of `camera` and keeps their ranks as set `set`.
fn find_order(
    r: &mut Recorder,
    stages: &FrameStages<'_>,
    orders: &OrderStages,
    frame: &FrameBuffers,
    input: FrameInput<'_>,
    camera: usize,
    set: usize,
) {
    orders.ranks.record_keys(r, input.world, &frame.cameras, camera, &frame.sort);
    let AllSplats { segment, blocks, .. } = &frame.all_splats[0];
    let all = SortInput { segments: segment, segment_count: 1, arguments: blocks.binding(), arguments_offset: 0, first: 0 };
    let sorted = stages.common.sort.record(r, &frame.sort, all, DEPTH_KEY_BITS);
    orders.ranks.record_ranks(r, &frame.sort.values[sorted], input.world.splats, input.ranks, set);
}

/// From splats to records: those of the background, then those of agents.
fn record_projection(
    recorder: &mut Recorder,
    stages: &FrameStages<'_>,
    frame: &FrameBuffers,
    slot: &FrameSlot,
    input: FrameInput<'_>,
) {
    let FrameShape { cameras: camera_count, chunks, .. } = frame.shape;
    let (world, cameras, lenses) = (input.world, &frame.cameras, &frame.lenses);
    let ranked = Ranked { view_orders: &frame.order_plan.view_orders, ranks: input.ranks, lists: &frame.rank_lists };
    let background = stages.background;
    recorder.stage("cull", |r| background.cull.record(r, world, cameras, lenses, camera_count, &frame.visible, &ranked));
    recorder.stage("scan", |r| {
        stages.common.scan.record(r, &frame.visible.counts, &frame.firsts, camera_count * chunks);
        if let Some(orders) = stages.orders.filter(|_| input.orders.is_ranked()) {
            orders.ranks.record_counts(r, &stages.common.scan, &frame.rank_lists, camera_count * chunks);
        }
    });
    recorder.stage("project", |r| {
        let (visible, firsts) = (&frame.visible, &frame.firsts);
        let (projected, sort, shadows) = (&frame.projected, &frame.sort, &slot.shadows);
        let project = &background.project;
        project.record(
            r,
            world,
            cameras,
            lenses,
            camera_count,
            visible,
            firsts,
            projected,
            sort,
            &ranked,
            shadows,
            slot.shadow_count,
        );
    });
    if let (Some(counts), Some(agents), Some(pool)) = (input.agents, stages.agents, slot.pool()) {
        recorder.stage("project agents", |r| {
            let lists = camera_count * chunks;
            let (relit, projected, sort) = (&slot.relit.colours, &frame.projected, &frame.sort);
            agents.project.record(r, pool, &slot.agents, relit, counts, &frame.firsts, lists, projected, sort);
        });
    }
}

/// Brings records into front-to-back order; returns which pair of the sort's buffers holds it.
fn record_order(
    recorder: &mut Recorder,
    stages: &FrameStages<'_>,
    frame: &FrameBuffers,
    slot: &FrameSlot,
    input: FrameInput<'_>,
) -> usize {
    let (plan, control, sort) = (&frame.order_plan, &frame.control, &frame.sort);
    let FrameShape { cameras, chunks, capacity, .. } = frame.shape;
    let repaired = input.orders.has(OrderPath::Repaired);
    if let Some(orders) = stages.orders.filter(|_| repaired || input.orders.has(OrderPath::Stale)) {
        recorder.stage("repair order", |r| {
            let lists = frame.static_lists();
            if repaired {
                orders.repair.record_repair(r, lists, plan, sort, input.orders.repair_reach);
            }
            orders.repair.record_check(r, lists, plan, sort);
        });
    }
    let moving_chunks = input.agents.map_or(0, |counts| counts.chunks);
    recorder.stage("plan order", |r| {
        let firsts = &slot.agents.firsts;
        stages.common.plan_order.record(
            r,
            cameras,
            &frame.firsts,
            chunks,
            firsts,
            moving_chunks,
            capacity.records,
            plan,
            control,
        );
    });
    if input.agents.is_some() || input.orders.sorts() {
        recorder.stage("sort by depth", |r| {
            if let Some(orders) = stages.orders.filter(|_| repaired) {
                orders.repair.record_restore(r, cameras, plan, sort, control);
            }
            let records = SortInput {
                segments: &plan.segments,
                segment_count: 2 * cameras,
                arguments: control.arguments.binding(),
                arguments_offset: Arguments::SortRecords.byte_offset(),
                first: 0,
            };
            let sorted = stages.common.sort.record(r, sort, records, DEPTH_KEY_BITS);
            assert!(sorted == 0, "lists that need no sort stand in the first buffers, and so must the sorted ones");
        });
    }
    let Some(agents) = stages.agents.filter(|_| input.agents.is_some()) else { return 0 };
    recorder.stage("merge", |r| {
        agents.merge.record(r, cameras, plan, &sort.keys[0], &sort.values[0], &sort.values[1], control);
    });
    1
}

/// From ordered records to pictures.
fn record_pictures(
    recorder: &mut Recorder,
    stages: &FrameStages<'_>,
    frame: &FrameBuffers,
    slot: &FrameSlot,
    input: FrameInput<'_>,
    ordered: usize,
) {
    let FrameShape { capacity, cameras: camera_count, bins, .. } = frame.shape;
    let (control, cameras, stages) = (&frame.control, &frame.cameras, stages.common);
    // The order is in one pair of the sort's buffers; the other is free again, for the pairs.
    let (order, free) = (&frame.sort.values[ordered], 1 - ordered);
    recorder.stage("emit pairs", |r| {
        let pairs = Pairs { bins: &frame.sort.keys[free], records: &frame.sort.values[free] };
        let (lists, projected) = (&frame.order_plan.lists, &frame.projected);
        stages.count_pairs.record(r, control, order, projected, &frame.pair_counts);
        stages.emit_pairs.record(r, control, cameras, camera_count, lists, order, projected, &frame.pair_counts, &pairs);
    });
    let mut binned = 0;
    recorder.stage("sort by tile", |r| {
        let pairs = SortInput {
            segments: &control.pair_segment,
            segment_count: 1,
            arguments: control.arguments.binding(),
            arguments_offset: Arguments::SortPairs.byte_offset(),
            first: free,
        };
        binned = stages.sort.record(r, &frame.sort, pairs, bits_for(bins));
    });
    recorder.stage("plan", |r| {
        stages.find_ranges.record(r, control, &frame.sort.keys[binned], &frame.range_firsts, bins);
        stages.plan_segments.record(r, control, &frame.range_firsts, bins, &capacity, &frame.plan);
    });
    let (plan, partials, pictures, sky) = (&frame.plan, &frame.partials, &slot.pictures, input.world.sky);
    recorder.stage("blend", |r| {
        let (records, projected) = (&frame.sort.values[binned], &frame.projected);
        let all = Measured::ALL;
        stages.blend.record(r, control, cameras, camera_count, sky, plan, records, projected, partials, pictures, all);
    });
    if let Some(probe) = stages.order_probe.as_ref().filter(|_| input.orders.has(OrderPath::Stale)) {
        recorder.stage("measure order", |r| {
            let (records, projected) = (&frame.sort.values[binned], &frame.projected);
            let measured = input.orders.measured;
            probe.record(r, control, cameras, camera_count, sky, plan, records, projected, partials, pictures, measured);
        });
    }
    recorder.stage("composite", |r| {
        stages.composite.record(r, control, cameras, camera_count, sky, plan, partials, pictures);
        r.copy(&control.needs, 0, &slot.found_needs, 0, 1);
        r.copy(&frame.order_plan.inversions, 0, &slot.found_inversions, 0, CAMERAS_MAX);
        r.copy(&control.order_error, 0, &slot.found_order_error, 0, 1);
    });
    if let Some(finish) = &stages.finish {
        recorder.stage("finish", |r| {
            let (records, projected) = (&frame.sort.values[binned], &frame.projected);
            let all = Measured::ALL;
            finish.record(r, control, cameras, camera_count, sky, plan, records, projected, partials, pictures, all);
        });
    }
}

/// Bits that tell `count` values apart, at least one.
fn bits_for(count: u32) -> u32 {
    (u32::BITS - count.saturating_sub(1).leading_zeros()).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_tell_all_values_apart() {
        assert_eq!([1, 2, 3, 256, 257, 65_536].map(bits_for), [1, 1, 2, 8, 9, 16]);
    }
}
