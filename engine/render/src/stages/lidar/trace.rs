//! Lists of fine tiles, and the beams that walk them.

use std::ops::Range;

use decouplegs_gpu::{DeviceKind, Gpu, GpuError, Kernel, Recorder};
use decouplegs_scene::Rules;

use super::{LidarBuffers, LidarVariant, SectorBuffers};
use crate::capacity::groups_for;
use crate::interfaces::{list_lidar, trace_lidar};
use crate::layout::FINE_TILES;

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

/// Workgroups of the list of a coarse tile; `LIST_GROUPS` in the kernel.
const LIST_GROUPS: usize = 32;

/// `list_lidar.comp`.
pub struct ListLidar {
    kernel: Kernel<list_lidar::Module>,
}

impl ListLidar {
    /// The stage.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        let constants = list_lidar::Constants {
            lanes: gpu.limits().subgroup_size,
        };
        Ok(Self {
            kernel: gpu.kernel(&constants)?,
        })
    }

    /// Records the lists of fine tiles, of the sorted lists of all coarse tiles. The buffer of
    /// pairs then has records and their cells.
    pub fn record(&self, recorder: &mut Recorder, sectors: &SectorBuffers, buffers: &LidarBuffers) {
        let push = list_lidar::Push {
            camera_count: sectors.count as u32,
            bin_count: sectors.bins,
            records_max: buffers.projected.room() as u32,
            pairs_max: buffers.lists.pairs.len() as u32,
        };
        let bindings = list_lidar::Bindings {
            cameras: sectors.cameras.bound(),
            tile_lists: buffers.lists.tile_lists.bound(),
            sorted_records: buffers.lists.sorted_records.bound(),
            footprints: buffers.projected.footprints.bound(),
            tile_words: buffers.tile_words.bound(),
            pairs: buffers.lists.pairs.bound(),
            required: buffers.counters.required.bound(),
        };
        let groups = groups_for(sectors.bins as usize * LIST_GROUPS);
        recorder.dispatch(&self.kernel, bindings, push, groups);
    }
}

/// `trace_lidar.comp`.
pub struct TraceLidar {
    kernel: Kernel<trace_lidar::Module>,
    beam_lanes: usize,
}

impl TraceLidar {
    /// The stage for the given rules.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(gpu: &Gpu, rules: &Rules, variant: LidarVariant) -> Result<Self, GpuError> {
        let constants = trace_lidar::Constants {
            lanes: gpu.limits().subgroup_size,
            beam_lanes: variant.beam_lanes,
            alpha_max: rules.alpha_max as f32,
            moving: variant.moving,
            echoes: variant.echoes,
        };
        Ok(Self {
            kernel: gpu.kernel(&constants)?,
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
        let push = trace_lidar::Push {
            camera_count: sectors.count as u32,
            bin_count: sectors.bins,
            first_entry: entries.start,
            entries_max: entries.end - entries.start,
            range_min_m,
            records_max: buffers.projected.room() as u32,
            pairs_max: buffers.lists.pairs.len() as u32,
        };
        let bindings = trace_lidar::Bindings {
            cameras: sectors.cameras.bound(),
            tile_lists: buffers.lists.tile_lists.bound(),
            pairs: buffers.lists.pairs.bound(),
            footprints: buffers.projected.footprints.bound(),
            looks: buffers.looks.bound(),
            lidar_shapes: buffers.shapes.bound(),
            beams: sectors.beams.bound(),
            firings: sectors.firings.bound(),
            states: buffers.states.bound(),
            echoes: buffers.echoes.bound(),
            tile_words: buffers.tile_words.bound(),
            required: buffers.counters.required.bound(),
        };
        let groups = groups_for(sectors.bins as usize * FINE_TILES * self.beam_lanes);
        recorder.dispatch(&self.kernel, bindings, push, groups);
    }
}
