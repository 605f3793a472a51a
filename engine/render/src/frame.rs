//! The frame: one function that lists the stages in the order they run, and the buffers they pass to each other.

use decouplegs_gpu::{Buffer, Gpu, GpuError, Recorder, Residence};

use crate::capacity::{Capacity, SortShape};
use crate::kernels::{FrameStages, OrderStages};
use crate::layout::{CAMERAS_MAX, CameraRecord, SortSegment};
use crate::orders::{OrderDecision, OrderPath};
use crate::output::Outputs;
use crate::resident::ResidentWorld;
use crate::slot::FrameSlot;
use crate::stages::{
    AgentCounts, Arguments, Control, Measured, OrderPlan, PURPOSE, Pairs, Partials, Plan, Projected, RankLists, Ranked,
    SortInput, SortScratch, StaticLists, Visible,
};

/// All of a depth key: see `depth_key.glsl`.
const DEPTH_KEY_BITS: u32 = 32;

/// What the size of a frame's buffers depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct FrameShape {
    pub capacity: Capacity,
    pub cameras: usize,
    /// Splats of the background.
    pub splats: usize,
    /// Its chunks.
    pub chunks: usize,
    pub bins: u32,
    /// Whether orders are kept.
    pub ranked: bool,
}

impl FrameShape {
    /// Whether buffers of this shape serve a frame of shape `other`.
    pub fn covers(&self, other: &Self) -> bool {
        self.capacity == other.capacity && self.with(other) == *self
    }

    /// The smallest shape, with the capacity of `other`, that covers both.
    pub fn with(&self, other: &Self) -> Self {
        Self {
            capacity: other.capacity,
            cameras: self.cameras.max(other.cameras),
            splats: self.splats.max(other.splats),
            chunks: self.chunks.max(other.chunks),
            bins: self.bins.max(other.bins),
            ranked: self.ranked || other.ranked,
        }
    }
}

/// All splats of a background, as the radix sort takes them.
struct AllSplats {
    splats: usize,
    segment: Buffer<SortSegment>,
    /// The workgroups that the sort needs for them.
    blocks: Buffer<[u32; 3]>,
}

impl AllSplats {
    fn new(gpu: &Gpu, splats: usize, sort: SortShape) -> Result<Self, GpuError> {
        let all = SortSegment { first: 0, count: splats as u32, first_block: 0 };
        let blocks = crate::capacity::groups_for(splats.div_ceil(sort.block() as usize));
        let segment = gpu.upload("all_splats", PURPOSE, &[all])?;
        Ok(Self { splats, segment, blocks: gpu.upload("all_splat_blocks", PURPOSE, &[blocks])? })
    }
}

/// Backgrounds that frames may take turns with before they wait for a small upload.
const WORLDS_REMEMBERED: usize = 16;

/// The buffers of a frame that only the device sees: frames in flight share them, as they run one after the other.
pub(crate) struct FrameBuffers {
    /// What they are made for: as many cameras, splats and so on at most, so that frames that take turns share them.
    room: FrameShape,
    /// The frame that is recorded.
    pub shape: FrameShape,
    control: Control,
    cameras: Buffer<CameraRecord>,
    visible: Visible,
    firsts: Buffer<u32>,
    rank_lists: RankLists,
    order_plan: OrderPlan,
    /// All splats of a background, by their number: that of the frame is the first.
    all_splats: Vec<AllSplats>,
    projected: Projected,
    /// First records by depth, then pairs by macro tile.
    sort: SortScratch,
    pair_counts: Buffer<u32>,
    range_firsts: Buffer<u32>,
    plan: Plan,
    partials: Partials,
}

impl FrameBuffers {
    pub fn new(gpu: &Gpu, shape: FrameShape, outputs: &Outputs, sort: SortShape) -> Result<Self, GpuError> {
        let FrameShape { capacity, cameras, splats, chunks, bins, ranked } = shape;
        let device = Residence::Device;
        let keys = capacity.records.max(capacity.pairs).max(if ranked { splats } else { 0 });
        Ok(Self {
            room: shape,
            shape,
            control: Control::new(gpu)?,
            cameras: gpu.buffer("cameras", PURPOSE, cameras, device)?,
            visible: Visible::new(gpu, cameras, chunks)?,
            firsts: gpu.buffer("firsts", PURPOSE, cameras * chunks + 1, device)?,
            rank_lists: if ranked { RankLists::new(gpu, cameras, chunks)? } else { RankLists::new(gpu, 0, 0)? },
            order_plan: OrderPlan::new(gpu)?,
            all_splats: vec![AllSplats::new(gpu, splats, sort)?],
            projected: Projected::new(gpu, capacity.records)?,
            sort: SortScratch::new(gpu, sort, keys)?,
            pair_counts: gpu.buffer("pair_counts", PURPOSE, capacity.pair_blocks(), device)?,
            range_firsts: gpu.buffer("range_firsts", PURPOSE, bins as usize + 1, device)?,
            plan: Plan::new(gpu, &capacity, bins)?,
            partials: Partials::new(gpu, capacity.partials, outputs)?,
        })
    }

    /// Makes them those of a frame of `shape`, which they cover.
    pub fn set(&mut self, gpu: &Gpu, shape: FrameShape, sort: SortShape) -> Result<(), GpuError> {
        match self.all_splats.iter().position(|all| all.splats == shape.splats) {
            Some(place) => self.all_splats.swap(0, place),
            None => {
                self.all_splats.truncate(WORLDS_REMEMBERED - 1);
                self.all_splats.insert(0, AllSplats::new(gpu, shape.splats, sort)?);
            }
        }
        self.shape = shape;
        Ok(())
    }

    /// What they are made for.
    pub fn room(&self) -> &FrameShape {
        &self.room
    }

    fn static_lists(&self) -> StaticLists<'_> {
        StaticLists {
            camera_count: self.shape.cameras,
            chunk_count: self.shape.chunks,
            firsts: &self.firsts,
            records_max: self.shape.capacity.records,
        }
    }
}

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
        r.copy(&slot.staged_orders, 0, &plan.view_orders, 0, cameras);
        let transmittances = &frame.partials.transmittances;
        let emptied = [
            (control.needs.binding(), control.needs.byte_len()),
            (control.arguments.binding(), control.arguments.byte_len()),
            (control.pair_segment.binding(), control.pair_segment.byte_len()),
            (plan.inversions.binding(), plan.inversions.byte_len()),
            (control.order_error.binding(), control.order_error.byte_len()),
            (slot.pictures.contributions.binding(), slot.pictures.contributions.byte_len()),
            (transmittances.binding(), transmittances.byte_len()),
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
    let (world, cameras) = (input.world, &frame.cameras);
    let ranked = Ranked { view_orders: &frame.order_plan.view_orders, ranks: input.ranks, lists: &frame.rank_lists };
    let background = stages.background;
    recorder.stage("cull", |r| background.cull.record(r, world, cameras, camera_count, &frame.visible, &ranked));
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
        project.record(r, world, cameras, camera_count, visible, firsts, projected, sort, &ranked, shadows, slot.shadow_count);
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
