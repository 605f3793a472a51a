//! The frame: one function that lists the stages in the order they run, and the buffers they pass to each other.

use decouplegs_gpu::{Buffer, Gpu, GpuError, Recorder, Residence};
use decouplegs_scene::{EarlyStop, Rules};

use crate::capacity::{Capacity, SortShape};
use crate::layout::{CameraRecord, Needs, View};
use crate::output::{OutputBuffers, Outputs};
use crate::resident::ResidentWorld;
use crate::stages::{
    Blend, CompositeSegments, Control, CountPairs, Cull, EmitPairs, FindRanges, PURPOSE, Pairs, Partials, Plan, PlanSegments,
    Project, ProjectVariant, Projected, RadixSort, Scan, SortCount, SortInput, SortScratch, Visible,
};

/// Longer segments are no segments.
const SEGMENT_PAIRS_MAX: u32 = 1 << 24;

/// All of a depth key: see `depth_key.glsl`.
const DEPTH_KEY_BITS: u32 = 32;

/// The kernels of a frame, built once for a set of rules and outputs and a kind of world.
pub(crate) struct Stages {
    cull: Cull,
    scan: Scan,
    project: Project,
    sort: RadixSort,
    count_pairs: CountPairs,
    emit_pairs: EmitPairs,
    find_ranges: FindRanges,
    plan_segments: PlanSegments,
    blend: Blend,
    composite: CompositeSegments,
}

impl Stages {
    pub(crate) fn new(
        gpu: &Gpu,
        rules: &Rules,
        outputs: &Outputs,
        variant: ProjectVariant,
        segment_pairs: u32,
        sort: SortShape,
    ) -> Result<Self, GpuError> {
        // Whether a pixel stops before a splat depends on all splats before it: such lists are not cut.
        let whole = rules.stop == EarlyStop::Exclusive || segment_pairs > SEGMENT_PAIRS_MAX;
        let segment_pairs = if whole { u32::MAX } else { segment_pairs.max(1) };
        Ok(Self {
            cull: Cull::new(gpu, rules)?,
            scan: Scan::new(gpu, sort.block())?,
            project: Project::new(gpu, rules, variant)?,
            sort: RadixSort::new(gpu, sort)?,
            count_pairs: CountPairs::new(gpu)?,
            emit_pairs: EmitPairs::new(gpu, sort.block())?,
            find_ranges: FindRanges::new(gpu)?,
            plan_segments: PlanSegments::new(gpu, segment_pairs)?,
            blend: Blend::new(gpu, rules, outputs)?,
            composite: CompositeSegments::new(gpu, outputs)?,
        })
    }
}

/// What the size of a frame's buffers depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct FrameShape {
    pub capacity: Capacity,
    pub cameras: usize,
    pub chunks: usize,
    pub bins: u32,
    pub pixels: usize,
}

/// The buffers of a frame.
pub(crate) struct FrameBuffers {
    pub shape: FrameShape,
    control: Control,
    staged_cameras: Buffer<CameraRecord>,
    cameras: Buffer<CameraRecord>,
    visible: Visible,
    firsts: Buffer<u32>,
    projected: Projected,
    /// First records by depth, then pairs by macro tile.
    sort: SortScratch,
    pair_counts: Buffer<u32>,
    range_firsts: Buffer<u32>,
    plan: Plan,
    partials: Partials,
    pub pictures: OutputBuffers,
    pub found_needs: Buffer<Needs>,
}

impl FrameBuffers {
    pub(crate) fn new(gpu: &Gpu, shape: FrameShape, outputs: &Outputs, sort: SortShape) -> Result<Self, GpuError> {
        let FrameShape { capacity, cameras, chunks, bins, pixels } = shape;
        let device = Residence::Device;
        Ok(Self {
            shape,
            control: Control::new(gpu)?,
            staged_cameras: gpu.buffer("staged_cameras", PURPOSE, cameras, Residence::Upload)?,
            cameras: gpu.buffer("cameras", PURPOSE, cameras, device)?,
            visible: Visible::new(gpu, cameras, chunks)?,
            firsts: gpu.buffer("firsts", PURPOSE, cameras * chunks, device)?,
            projected: Projected::new(gpu, capacity.records)?,
            sort: SortScratch::new(gpu, sort, capacity.records.max(capacity.pairs))?,
            pair_counts: gpu.buffer("pair_counts", PURPOSE, capacity.pair_blocks(), device)?,
            range_firsts: gpu.buffer("range_firsts", PURPOSE, bins as usize + 1, device)?,
            plan: Plan::new(gpu, &capacity, bins)?,
            partials: Partials::new(gpu, capacity.partials, outputs)?,
            pictures: OutputBuffers::new(gpu, pixels, outputs)?,
            found_needs: gpu.buffer("found_needs", PURPOSE, 1, Residence::Readback)?,
        })
    }

    /// Hands the cameras to the next frame. The one before must be done.
    pub(crate) fn set_cameras(&self, view: &View) {
        self.staged_cameras.write_host(0, &view.cameras);
    }
}

/// Records the frame that draws `world` for the cameras in `frame`.
pub(crate) fn record_frame(recorder: &mut Recorder, stages: &Stages, world: &ResidentWorld, frame: &FrameBuffers) {
    let FrameShape { capacity, cameras: camera_count, chunks, bins, .. } = frame.shape;
    let (control, cameras) = (&frame.control, &frame.cameras);

    recorder.stage("begin", |r| {
        r.copy(&frame.staged_cameras, 0, cameras, 0, camera_count);
        r.fill(control.needs.binding(), 0, control.needs.byte_len(), 0);
        let transmittances = &frame.partials.transmittances;
        r.fill(transmittances.binding(), 0, transmittances.byte_len(), 0);
        r.fill(control.arguments.binding(), 0, control.arguments.byte_len(), 0);
    });
    recorder.stage("cull", |r| stages.cull.record(r, world, cameras, camera_count, &frame.visible));
    recorder.stage("scan", |r| {
        stages.scan.record(r, &frame.visible.counts, &frame.firsts, camera_count * chunks, capacity.records, control);
    });
    recorder.stage("project", |r| {
        let keys = &frame.sort.keys[0];
        stages.project.record(r, world, cameras, camera_count, &frame.visible, &frame.firsts, &frame.projected, keys);
    });
    let mut sorted = 0;
    recorder.stage("sort by depth", |r| {
        let input = SortInput { count: SortCount::Records, max: capacity.records, first: 0, index_values: true };
        sorted = stages.sort.record(r, &frame.sort, control, input, DEPTH_KEY_BITS);
    });
    // The order is one pair of the sort's buffers; the other is free again, for the pairs.
    let (order, free) = (&frame.sort.values[sorted], 1 - sorted);
    recorder.stage("emit pairs", |r| {
        let pairs = Pairs { bins: &frame.sort.keys[free], records: &frame.sort.values[free] };
        let (firsts, projected) = (&frame.firsts, &frame.projected);
        stages.count_pairs.record(r, control, order, projected, &frame.pair_counts);
        stages.emit_pairs.record(r, control, cameras, camera_count, chunks, firsts, order, projected, &frame.pair_counts, &pairs);
    });
    let mut binned = 0;
    recorder.stage("sort by tile", |r| {
        let input = SortInput { count: SortCount::Pairs, max: frame.sort.keys[free].len(), first: free, index_values: false };
        binned = stages.sort.record(r, &frame.sort, control, input, bits_for(bins));
    });
    recorder.stage("plan", |r| {
        stages.find_ranges.record(r, control, &frame.sort.keys[binned], &frame.range_firsts, bins);
        stages.plan_segments.record(r, control, &frame.range_firsts, bins, &capacity, &frame.plan);
    });
    let (plan, partials, pictures) = (&frame.plan, &frame.partials, &frame.pictures);
    recorder.stage("blend", |r| {
        let records = &frame.sort.values[binned];
        let projected = &frame.projected;
        stages.blend.record(r, control, cameras, camera_count, world.sky, plan, records, projected, partials, pictures);
    });
    recorder.stage("composite", |r| {
        stages.composite.record(r, control, cameras, camera_count, world.sky, plan, partials, pictures);
        r.copy(&control.needs, 0, &frame.found_needs, 0, 1);
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
