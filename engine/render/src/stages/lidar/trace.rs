//! Lists of fine tiles, and the beams that walk them.

use std::ops::Range;

use bytemuck::bytes_of;
use decouplegs_gpu::{Constant, DeviceKind, Gpu, GpuError, Kernel, Recorder};
use decouplegs_scene::Rules;

use super::{LidarBuffers, LidarVariant, SectorBuffers};
use crate::capacity::groups_for;
use crate::layout::FINE_TILES;
use crate::stages::{kernel, push_constants};

/// Beams up to which four lanes share a beam. A device is full with them, and then two are faster
/// (`benches/README.md`).
const BEAMS_OF_FOUR_LANES: usize = 250_000;

/// Lanes of a subgroup that share each of `beams` beams on the device. The result does not depend
/// on them.
#[must_use]
pub fn beam_lanes(gpu: &Gpu, beams: usize) -> u32 {
    match gpu.info().kind {
        DeviceKind::Cpu => 1,
        _ if beams <= BEAMS_OF_FOUR_LANES => 4,
        _ => 2,
    }
}

push_constants! {
    struct ListPush {
        camera_count: u32,
        bin_count: u32,
        records_max: u32,
        pairs_max: u32,
    }
}

/// Workgroups of the list of a coarse tile; `LIST_GROUPS` in the kernel.
const LIST_GROUPS: usize = 32;

/// `list_lidar.comp`.
pub struct ListLidar {
    kernel: Kernel,
}

impl ListLidar {
    /// The stage.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        let constants = [("LANES", Constant::U32(gpu.limits().subgroup_size))];
        let shader = &decouplegs_shaders::LIST_LIDAR;
        Ok(Self {
            kernel: kernel::<ListPush>(gpu, shader, &constants)?,
        })
    }

    /// Records the lists of fine tiles, of the sorted lists of all coarse tiles. The buffer of
    /// pairs then has records and their cells.
    pub fn record(&self, recorder: &mut Recorder, sectors: &SectorBuffers, buffers: &LidarBuffers) {
        let push = ListPush {
            camera_count: sectors.count as u32,
            bin_count: sectors.bins,
            records_max: buffers.projected.room() as u32,
            pairs_max: buffers.lists.pairs.len() as u32,
        };
        let bound = [
            ("cameras", sectors.cameras.binding()),
            ("tile_lists", buffers.lists.tile_lists.binding()),
            ("sorted_records", buffers.lists.sorted_records.binding()),
            ("footprints", buffers.projected.footprints.binding()),
            ("tile_words", buffers.tile_words.binding()),
            ("pairs", buffers.lists.pairs.binding()),
            ("required", buffers.counters.required.binding()),
        ];
        let groups = groups_for(sectors.bins as usize * LIST_GROUPS);
        recorder.dispatch(&self.kernel, &bound, bytes_of(&push), groups);
    }
}

push_constants! {
    struct TracePush {
        camera_count: u32,
        bin_count: u32,
        first_entry: u32,
        entries_max: u32,
        range_min_m: f32,
        records_max: u32,
        pairs_max: u32,
    }
}

/// `trace_lidar.comp`.
pub struct TraceLidar {
    kernel: Kernel,
    beam_lanes: usize,
}

impl TraceLidar {
    /// The stage for the given rules.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(gpu: &Gpu, rules: &Rules, variant: LidarVariant) -> Result<Self, GpuError> {
        let constants = [
            ("LANES", Constant::U32(gpu.limits().subgroup_size)),
            ("BEAM_LANES", Constant::U32(variant.beam_lanes)),
            ("ALPHA_MAX", Constant::F32(rules.alpha_max as f32)),
            ("MOVING", Constant::Bool(variant.moving)),
            ("ECHOES", Constant::Bool(variant.echoes)),
        ];
        let shader = &decouplegs_shaders::TRACE_LIDAR;
        Ok(Self {
            kernel: kernel::<TracePush>(gpu, shader, &constants)?,
            beam_lanes: variant.beam_lanes as usize,
        })
    }

    /// Records the walk over `entries` of all lists, whose fine tiles [`ListLidar`] has listed.
    /// Splats nearer than `range_min_m` are passed through.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        sectors: &SectorBuffers,
        buffers: &LidarBuffers,
        entries: Range<u32>,
        range_min_m: f32,
    ) {
        let push = TracePush {
            camera_count: sectors.count as u32,
            bin_count: sectors.bins,
            first_entry: entries.start,
            entries_max: entries.end - entries.start,
            range_min_m,
            records_max: buffers.projected.room() as u32,
            pairs_max: buffers.lists.pairs.len() as u32,
        };
        let bound = [
            ("cameras", sectors.cameras.binding()),
            ("tile_lists", buffers.lists.tile_lists.binding()),
            ("pairs", buffers.lists.pairs.binding()),
            ("footprints", buffers.projected.footprints.binding()),
            ("looks", buffers.looks.binding()),
            ("lidar_shapes", buffers.shapes.binding()),
            ("beams", sectors.beams.binding()),
            ("firings", sectors.firings.binding()),
            ("states", buffers.states.binding()),
            ("echoes", buffers.echoes.binding()),
            ("tile_words", buffers.tile_words.binding()),
            ("required", buffers.counters.required.binding()),
        ];
        let groups = groups_for(sectors.bins as usize * FINE_TILES * self.beam_lanes);
        recorder.dispatch(&self.kernel, &bound, bytes_of(&push), groups);
    }
}
