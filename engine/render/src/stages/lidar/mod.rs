//! Stages of a LiDAR's sweep: splats that its beams may meet, and the beams themselves.

mod trace;

pub use trace::{ListLidar, TraceLidar, beam_lanes};

use decouplegs_gpu::{Buffer, Gpu, GpuError, Kernel, MemoryKind, Recorder};
use decouplegs_scene::Rules;

use super::{
    AgentBuffers, AgentCounts, FrameCounters, PURPOSE, Projected, RecordContents, Staged,
    TileSortBuffers, Visible,
};
use crate::asset_pool::PoolBuffers;
use crate::capacity::{Capacity, groups_for};
use crate::interfaces::{project_lidar, project_lidar_agents};
use crate::layout::{
    BeamEchoes, BeamRecord, BeamState, CAMERAS_MAX, CameraRecord, FINE_TILES, FiringRecord,
    RequiredCounts, SectorRecord, View,
};
use crate::resident_splats::ResidentSplats;
use crate::storage::Storage;

/// Specialization of the kernels, beside the rules.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LidarVariant {
    /// True if splats of the background belong to instances.
    pub instances: bool,
    /// True if the sensor or agents move during the sweep.
    pub moving: bool,
    /// Standard deviation that is added to splats across the direction to their means, radians.
    pub dilation_rad: f32,
    /// True if echoes are found, for dual returns.
    pub echoes: bool,
    /// Storage of the splats of the background.
    pub storage: Storage,
    /// Lanes of a subgroup that share a beam: [`beam_lanes`].
    pub beam_lanes: u32,
}

/// Sectors of a sweep on the device.
pub struct SectorBuffers {
    /// Number of sectors.
    pub count: usize,
    /// Coarse tiles of all sectors.
    pub bins: u32,
    /// Axes, grids and positions of the sectors.
    pub cameras: Staged<CameraRecord>,
    /// Motion of the sectors, and the offsets of their bounds.
    pub sectors: Staged<SectorRecord>,
    /// Lowest and highest azimuth of the beams of each column, as `around` in `lidar.glsl` orders
    /// them.
    pub column_bounds: Staged<[f32; 2]>,
    /// Lowest and highest slope of the beams of each row.
    pub row_bounds: Staged<[f32; 2]>,
    /// Beams by cell.
    pub beams: Staged<BeamRecord>,
    /// Positions of the sensor by time of firing.
    pub firings: Staged<FiringRecord>,
}

impl SectorBuffers {
    /// No sectors yet.
    ///
    /// # Errors
    /// Returns an error if the device is out of memory.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            count: 0,
            bins: 0,
            cameras: Staged::new(gpu, "lidar_cameras")?,
            sectors: Staged::new(gpu, "sectors")?,
            column_bounds: Staged::new(gpu, "column_bounds")?,
            row_bounds: Staged::new(gpu, "row_bounds")?,
            beams: Staged::new(gpu, "beams")?,
            firings: Staged::new(gpu, "firings")?,
        })
    }

    /// Writes the tables of a sweep. Submitted work that reads those before must be done.
    ///
    /// # Errors
    /// Returns an error if the device is out of memory.
    pub fn set(&mut self, gpu: &Gpu, view: &View, tables: &SectorTables) -> Result<(), GpuError> {
        (self.count, self.bins) = (view.cameras.len(), view.bins);
        self.cameras.set(gpu, &view.cameras)?;
        self.sectors.set(gpu, &tables.sectors)?;
        self.column_bounds.set(gpu, &tables.column_bounds)?;
        self.row_bounds.set(gpu, &tables.row_bounds)?;
        self.beams.set(gpu, &tables.beams)?;
        self.firings.set(gpu, &tables.firings)
    }

    /// Records the copies of the tables to the device.
    pub fn copy(&self, recorder: &mut Recorder) {
        self.cameras.copy(recorder);
        self.sectors.copy(recorder);
        self.column_bounds.copy(recorder);
        self.row_bounds.copy(recorder);
        self.beams.copy(recorder);
        self.firings.copy(recorder);
    }
}

/// Tables of a sweep that the kernels read.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SectorTables {
    /// Motion of each sector, and offsets of its bounds.
    pub sectors: Vec<SectorRecord>,
    /// Bounds of columns of all sectors.
    pub column_bounds: Vec<[f32; 2]>,
    /// Bounds of rows of all sectors.
    pub row_bounds: Vec<[f32; 2]>,
    /// Beams by cell, row by row in each sector.
    pub beams: Vec<BeamRecord>,
    /// Positions of the sensor.
    pub firings: Vec<FiringRecord>,
}

/// Sizes of the buffers of a sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LidarRoom {
    /// Room for lists.
    pub capacity: Capacity,
    /// Clusters of the background.
    pub clusters: usize,
    /// Sectors of the sweep.
    pub sectors: usize,
    /// Coarse tiles of all sectors.
    pub bins: u32,
    /// Beams of the sensor.
    pub beams: usize,
    /// True if echoes are found.
    pub echoes: bool,
}

impl LidarRoom {
    /// Room for lists of `capacity` over a background of `clusters`, and for `beams` in the sectors
    /// of `view`.
    #[must_use]
    pub fn new(
        capacity: Capacity,
        clusters: usize,
        view: &View,
        beams: usize,
        echoes: bool,
    ) -> Self {
        Self {
            capacity,
            clusters,
            sectors: view.cameras.len(),
            bins: view.bins,
            beams,
            echoes,
        }
    }
}

/// Buffers that a sweep writes on the way to the states of beams.
pub struct LidarBuffers {
    /// Counts of the sweep.
    pub counters: FrameCounters,
    /// Visible splats of the background.
    pub visible: Visible,
    /// Visible splats before each `[sector][cluster]`, and their total.
    pub offsets: Buffer<u32>,
    /// Cells and directions of records, and their distance keys.
    pub projected: Projected,
    /// Log2 of the opacity, intensity and instance of each record.
    pub looks: Buffer<[f32; 3]>,
    /// Three vectors per record: the inverse factor of the covariance, and the velocity.
    pub shapes: Buffer<[f32; 4]>,
    /// Sorted lists of coarse tiles.
    pub lists: TileSortBuffers,
    /// Fine tiles that their records reach, a word of 32 pairs per fine tile.
    pub tile_words: Buffer<u32>,
    /// States of beams.
    pub states: Buffer<BeamState>,
    /// Echoes of beams, where they are found.
    pub echoes: Buffer<BeamEchoes>,
    /// Counts of the sweep on the host.
    pub found_required: Buffer<RequiredCounts>,
    /// States on the host.
    pub found_states: Buffer<BeamState>,
    /// Echoes on the host.
    pub found_echoes: Buffer<BeamEchoes>,
    /// Offsets of the records of agents where there are none.
    pub no_agents: Buffer<u32>,
}

impl LidarBuffers {
    /// Buffers of the sizes of `room`.
    ///
    /// # Errors
    /// Returns an error if the device is out of memory.
    pub fn new(gpu: &Gpu, room: &LidarRoom) -> Result<Self, GpuError> {
        let LidarRoom {
            capacity,
            clusters,
            sectors,
            bins,
            beams,
            echoes,
        } = *room;
        let beams_of_echoes = if echoes { beams } else { 1 };
        let (device, host) = (MemoryKind::Device, MemoryKind::Readback);
        Ok(Self {
            counters: FrameCounters::new(gpu)?,
            visible: Visible::new(gpu, sectors, clusters)?,
            offsets: gpu.buffer("offsets", PURPOSE, sectors * clusters + 1, device)?,
            projected: Projected::new(
                gpu,
                capacity.records,
                capacity.pairs,
                RecordContents::default(),
            )?,
            looks: gpu.buffer("looks", PURPOSE, capacity.records, device)?,
            shapes: gpu.buffer("lidar_shapes", PURPOSE, 3 * capacity.records, device)?,
            lists: TileSortBuffers::new(gpu, &capacity, bins)?,
            tile_words: gpu.buffer(
                "tile_words",
                PURPOSE,
                FINE_TILES * (capacity.pairs.div_ceil(32) + bins as usize),
                device,
            )?,
            states: gpu.buffer("beam_states", PURPOSE, beams, device)?,
            echoes: gpu.buffer("beam_echoes", PURPOSE, beams_of_echoes, device)?,
            found_required: gpu.buffer("found_required", PURPOSE, 1, host)?,
            found_states: gpu.buffer("found_states", PURPOSE, beams, host)?,
            found_echoes: gpu.buffer("found_echoes", PURPOSE, beams_of_echoes, host)?,
            no_agents: gpu.upload("agent_offsets", PURPOSE, &[0u32; CAMERAS_MAX + 1])?,
        })
    }
}

/// Run of a projection for a LiDAR.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LidarPass {
    /// Sets and counts the bits of visible splats.
    Mark,
    /// Writes a record for each bit.
    Write,
}

/// `project_lidar.comp`.
pub struct ProjectLidar {
    mark: Kernel<project_lidar::Module>,
    write: Kernel<project_lidar::Module>,
}

impl ProjectLidar {
    /// The stage for the given rules and sweeps.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(gpu: &Gpu, rules: &Rules, variant: LidarVariant) -> Result<Self, GpuError> {
        let build = |write| {
            gpu.kernel(&project_lidar::Constants {
                antialias: rules.antialias,
                write,
                instances: variant.instances,
                dilation_rad: variant.dilation_rad,
                moving: variant.moving,
                compact: variant.storage == Storage::Compact,
            })
        };
        Ok(Self {
            mark: build(false)?,
            write: build(true)?,
        })
    }

    /// Records a run over `background`.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        pass: LidarPass,
        background: &ResidentSplats,
        sectors: &SectorBuffers,
        buffers: &LidarBuffers,
    ) {
        let push = project_lidar::Push {
            splat_count: background.splats as u32,
            camera_count: sectors.count as u32,
            cluster_count: background.finest_clusters as u32,
            records_max: buffers.projected.room() as u32,
        };
        let bindings = project_lidar::Bindings {
            cameras: sectors.cameras.bound(),
            means_m: background.means.bound(),
            shapes: background.shapes.bound(),
            rotations: background.rotations.bound(),
            visible_words: buffers.visible.words.bound(),
            visible_counts: buffers.visible.counts.bound(),
            offsets: buffers.offsets.bound(),
            clusters: background.clusters.bound(),
            sh_dc: background.sh_dc.bound(),
            instances: background.instances.bound(),
            footprints: buffers.projected.footprints.bound(),
            looks: buffers.looks.bound(),
            keys: buffers.projected.keys.bound(),
            lidar_shapes: buffers.shapes.bound(),
            sectors: sectors.sectors.bound(),
            column_bounds: sectors.column_bounds.bound(),
            row_bounds: sectors.row_bounds.bound(),
        };
        let kernel = match pass {
            LidarPass::Mark => &self.mark,
            LidarPass::Write => &self.write,
        };
        let groups = groups_for(background.finest_clusters);
        recorder.dispatch(kernel, bindings, push, groups);
    }
}

/// Agents of a sweep.
#[derive(Clone, Copy)]
pub struct LidarAgents<'a> {
    /// Assets of the agents.
    pub pool: &'a PoolBuffers,
    /// The agents, and the sectors as each of them has them.
    pub agents: &'a AgentBuffers,
    /// Counts of them.
    pub counts: AgentCounts,
    /// Lists of the background: sectors times clusters.
    pub static_lists: usize,
}

/// `project_lidar_agents.comp`.
pub struct ProjectLidarAgents {
    mark: Kernel<project_lidar_agents::Module>,
    write: Kernel<project_lidar_agents::Module>,
}

impl ProjectLidarAgents {
    /// The stage for the given rules and sweeps.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(gpu: &Gpu, rules: &Rules, variant: LidarVariant) -> Result<Self, GpuError> {
        let build = |write| {
            gpu.kernel(&project_lidar_agents::Constants {
                antialias: rules.antialias,
                write,
                dilation_rad: variant.dilation_rad,
                moving: variant.moving,
            })
        };
        Ok(Self {
            mark: build(false)?,
            write: build(true)?,
        })
    }

    /// Records a run over `agents`, whose records come behind those of the background.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        pass: LidarPass,
        agents: &LidarAgents<'_>,
        sectors: &SectorBuffers,
        buffers: &LidarBuffers,
    ) {
        let LidarAgents {
            pool,
            agents,
            counts,
            static_lists,
        } = *agents;
        let push = project_lidar_agents::Push {
            agent_count: counts.agents as u32,
            camera_count: counts.cameras as u32,
            cluster_count: counts.clusters as u32,
            records_max: buffers.projected.room() as u32,
            static_lists: static_lists as u32,
        };
        let bindings = project_lidar_agents::Bindings {
            agents: agents.agents.bound(),
            agent_cameras: agents.cameras.bound(),
            coded_splats: pool.splats.bound(),
            coded_shapes: pool.shapes.bound().cast(),
            visible_words: agents.visible.words.bound(),
            visible_counts: agents.visible.counts.bound(),
            offsets: agents.offsets.bound(),
            asset_clusters: pool.clusters.bound(),
            coded_dc: pool.color_dc.bound(),
            static_offsets: buffers.offsets.bound(),
            footprints: buffers.projected.footprints.bound(),
            looks: buffers.looks.bound(),
            keys: buffers.projected.keys.bound(),
            lidar_shapes: buffers.shapes.bound(),
            sectors: sectors.sectors.bound(),
            column_bounds: sectors.column_bounds.bound(),
            row_bounds: sectors.row_bounds.bound(),
        };
        let kernel = match pass {
            LidarPass::Mark => &self.mark,
            LidarPass::Write => &self.write,
        };
        recorder.dispatch(kernel, bindings, push, groups_for(counts.clusters));
    }
}
