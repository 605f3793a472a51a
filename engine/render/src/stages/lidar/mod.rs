//! Stages of a LiDAR's sweep: splats that its beams may meet, and the beams themselves.

mod trace;

pub use trace::{ListLidar, TraceLidar, beam_lanes};

use bytemuck::bytes_of;
use decouplegs_gpu::{Buffer, Constant, Gpu, GpuError, Kernel, MemoryKind, Recorder};
use decouplegs_scene::Rules;

use super::{
    AgentBuffers, AgentCounts, FrameCounters, PURPOSE, Projected, RecordContents, Staged,
    TileSortBuffers, Visible, kernel, push_constants,
};
use crate::asset_pool::PoolBuffers;
use crate::capacity::{Capacity, groups_for};
use crate::layout::{
    BeamEchoes, BeamRecord, BeamState, CAMERAS_MAX, CameraRecord, FINE_TILES, FiringRecord,
    RequiredCounts, SectorRecord, View,
};
use crate::resident::GpuScene;
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

impl LidarVariant {
    fn constants(self, rules: &Rules, write: bool) -> [(&'static str, Constant); 4] {
        [
            ("ANTIALIAS", Constant::Bool(rules.antialias)),
            ("WRITE", Constant::Bool(write)),
            ("DILATION_RAD", Constant::F32(self.dilation_rad)),
            ("MOVING", Constant::Bool(self.moving)),
        ]
    }
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

push_constants! {
    struct ProjectPush {
        splat_count: u32,
        camera_count: u32,
        cluster_count: u32,
        records_max: u32,
    }
}

/// `project_lidar.comp`.
pub struct ProjectLidar {
    mark: Kernel,
    write: Kernel,
}

impl ProjectLidar {
    /// The stage for the given rules and sweeps.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(gpu: &Gpu, rules: &Rules, variant: LidarVariant) -> Result<Self, GpuError> {
        let build = |write| {
            let [a, b, c, d] = variant.constants(rules, write);
            let instances = ("INSTANCES", Constant::Bool(variant.instances));
            let shader = &decouplegs_shaders::PROJECT_LIDAR;
            let storage = variant.storage.constant();
            kernel::<ProjectPush>(gpu, shader, &[a, b, c, d, instances, storage])
        };
        Ok(Self {
            mark: build(false)?,
            write: build(true)?,
        })
    }

    /// Records a run over `gpu_scene`.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        pass: LidarPass,
        gpu_scene: &GpuScene,
        sectors: &SectorBuffers,
        buffers: &LidarBuffers,
    ) {
        let push = ProjectPush {
            splat_count: gpu_scene.splats as u32,
            camera_count: sectors.count as u32,
            cluster_count: gpu_scene.finest_clusters as u32,
            records_max: buffers.projected.room() as u32,
        };
        let bound = [
            ("cameras", sectors.cameras.binding()),
            ("means_m", gpu_scene.means.binding()),
            ("shapes", gpu_scene.shapes.binding()),
            ("rotations", gpu_scene.rotations.binding()),
            ("visible_words", buffers.visible.words.binding()),
            ("visible_counts", buffers.visible.counts.binding()),
            ("offsets", buffers.offsets.binding()),
            ("clusters", gpu_scene.clusters.binding()),
            ("sh_dc", gpu_scene.sh_dc.binding()),
            ("instances", gpu_scene.instances.binding()),
            ("footprints", buffers.projected.footprints.binding()),
            ("looks", buffers.looks.binding()),
            ("keys", buffers.projected.keys.binding()),
            ("lidar_shapes", buffers.shapes.binding()),
            ("sectors", sectors.sectors.binding()),
            ("column_bounds", sectors.column_bounds.binding()),
            ("row_bounds", sectors.row_bounds.binding()),
        ];
        let kernel = match pass {
            LidarPass::Mark => &self.mark,
            LidarPass::Write => &self.write,
        };
        let groups = groups_for(gpu_scene.finest_clusters);
        recorder.dispatch(kernel, &bound, bytes_of(&push), groups);
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

push_constants! {
    struct AgentsPush {
        agent_count: u32,
        camera_count: u32,
        cluster_count: u32,
        records_max: u32,
        static_lists: u32,
    }
}

/// `project_lidar_agents.comp`.
pub struct ProjectLidarAgents {
    mark: Kernel,
    write: Kernel,
}

impl ProjectLidarAgents {
    /// The stage for the given rules and sweeps.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(gpu: &Gpu, rules: &Rules, variant: LidarVariant) -> Result<Self, GpuError> {
        let build = |write| {
            let constants = variant.constants(rules, write);
            let shader = &decouplegs_shaders::PROJECT_LIDAR_AGENTS;
            kernel::<AgentsPush>(gpu, shader, &constants)
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
        let push = AgentsPush {
            agent_count: counts.agents as u32,
            camera_count: counts.cameras as u32,
            cluster_count: counts.clusters as u32,
            records_max: buffers.projected.room() as u32,
            static_lists: static_lists as u32,
        };
        let bound = [
            ("agents", agents.agents.binding()),
            ("agent_cameras", agents.cameras.binding()),
            ("coded_splats", pool.splats.binding()),
            ("coded_shapes", pool.shapes.binding()),
            ("visible_words", agents.visible.words.binding()),
            ("visible_counts", agents.visible.counts.binding()),
            ("offsets", agents.offsets.binding()),
            ("asset_clusters", pool.clusters.binding()),
            ("coded_dc", pool.color_dc.binding()),
            ("static_offsets", buffers.offsets.binding()),
            ("footprints", buffers.projected.footprints.binding()),
            ("looks", buffers.looks.binding()),
            ("keys", buffers.projected.keys.binding()),
            ("lidar_shapes", buffers.shapes.binding()),
            ("sectors", sectors.sectors.binding()),
            ("column_bounds", sectors.column_bounds.binding()),
            ("row_bounds", sectors.row_bounds.binding()),
        ];
        let kernel = match pass {
            LidarPass::Mark => &self.mark,
            LidarPass::Write => &self.write,
        };
        recorder.dispatch(kernel, &bound, bytes_of(&push), groups_for(counts.clusters));
    }
}
