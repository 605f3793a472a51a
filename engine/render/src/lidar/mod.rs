//! Sweeps of LiDARs: the same splats as in images, met by exact rays.
//!
//! A sweep is cut into sectors of azimuth. Each is a view of the same scene, with a pose, an order
//! of splats and lists of coarse tiles of its own; a tile is 64 x 32 beams. Lists may hold splats
//! that no beam meets, but lack none that one meets. Ranges and weights come from the exact ray of
//! each beam, at its own time: only the order of splats is that of the middle of the sector.

mod sectors;

use std::sync::Arc;

use decouplegs_gpu::{DeviceKind, Gpu, GpuError, QueueRole, Recorder, Ticket};
use decouplegs_scene::lidar::{Beam, Echo, LidarCells, LidarReturn, ReturnMode, ReturnOptions};
use decouplegs_scene::{Lidar, LidarModel, LidarSweep, Rules, random};

use crate::RenderError;
use crate::agents::{AgentList, Scene};
use crate::capacity::Capacity;
use crate::layout::{BeamEchoes, BeamState, CAMERAS_MAX, CLUSTER_SPLATS, RequiredCounts, View};
use crate::stages::{
    AgentBuffers, LidarAgents, LidarBuffers, LidarPass, LidarRoom, LidarVariant, ProjectLidar,
    ProjectLidarAgents, Records, Scan, SectorBuffers, TileSort, TileSortBuffers, TraceLidar,
};

pub use sectors::Sectors;

/// Sweeps that may outgrow their buffers in a row.
const ATTEMPTS_MAX: u32 = 6;

/// Entries of a list that a software device walks in one dispatch: llvmpipe ends all loops of a
/// thread after 65,535 rounds in total, silently.
const ENTRIES_MAX_IN_SOFTWARE: u32 = 50_000;

/// Options of a renderer of sweeps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LidarOptions {
    /// Rules, of which the upper bound of alpha, antialiasing and the dilation of LiDARs count.
    pub rules: Rules,
    /// Sectors of a sweep, at most 32.
    pub sectors: usize,
}

impl Default for LidarOptions {
    fn default() -> Self {
        Self {
            rules: Rules::DEFAULT,
            sectors: 8,
        }
    }
}

/// Kernels of one variant.
struct LidarStages {
    variant: LidarVariant,
    background: ProjectLidar,
    agents: ProjectLidarAgents,
    trace: TraceLidar,
}

/// Beams of a model, and the grid that they are in.
struct Grid {
    model: Arc<LidarModel>,
    beams: Arc<[Beam]>,
    cells: LidarCells,
}

/// Models whose grids a renderer keeps.
const GRIDS_MAX: usize = 16;

/// Sizes of sweeps whose buffers a renderer keeps.
const ROOMS_MAX: usize = 4;

/// Traces the sweeps of LiDARs on one device. Buffers of lists are sized by the sweep before and
/// kept for others of the same size, and the beams of models are made once.
pub struct LidarRenderer {
    gpu: Gpu,
    options: LidarOptions,
    stages: Vec<LidarStages>,
    common: Option<(Scan, TileSort)>,
    grids: Vec<Arc<Grid>>,
    capacity: Option<Capacity>,
    /// Buffers of earlier sweeps, the last ones last.
    buffers: Vec<(LidarRoom, LidarBuffers)>,
}

/// States of the beams of a sweep.
#[derive(Clone, Debug)]
pub struct TracedSweep {
    /// Sensor, and its poses during the sweep.
    pub lidar: Lidar,
    /// Beams, in the order of [`LidarModel::beams`].
    pub beams: Arc<[Beam]>,
    /// State of each beam.
    pub states: Vec<BeamState>,
    /// Echoes of each beam; empty unless they were asked for.
    pub echoes: Vec<BeamEchoes>,
    /// Counts of the lists.
    pub required: RequiredCounts,
    /// Time on the device, nanoseconds.
    pub gpu_time_ns: u64,
}

impl TracedSweep {
    /// Returns of the sweep: a beam has one if splats took enough of it and the range is one that
    /// the sensor reports. Noise, where the model has some, is added last, and depends on the seed
    /// and the beam alone.
    ///
    /// # Panics
    /// Panics if the mode is [`ReturnMode::Dual`], and the sweep was traced for another one.
    #[must_use]
    pub fn returns(&self, options: &ReturnOptions) -> LidarSweep {
        let model = &self.lidar.model;
        let noise_m = |beam: usize| match model.range_noise_m {
            0.0 => 0.0,
            deviation_m => (deviation_m * normal(options.seed, beam as u64)) as f32,
        };
        let [least_m, greatest_m] = model.range_m.map(|range| range as f32);
        let is_dual = options.mode == ReturnMode::Dual;
        assert!(
            !is_dual || self.echoes.len() == self.states.len(),
            "dual returns of a sweep that was traced without echoes"
        );
        let found = |(beam, state): (usize, &BeamState)| {
            let of_state = || {
                let (range_m, instance) = state.range(options.mode)?;
                let weight = 1.0 - state.transmittance;
                let intensity = state.intensity();
                let echo = Echo {
                    weight,
                    range_m,
                    intensity,
                    instance,
                };
                (weight >= options.opacity_min).then_some(echo)
            };
            let echoes = match is_dual {
                true => self.echoes[beam].found(),
                false => [of_state(), None],
            };
            let reports = |echo: &Echo| (least_m..=greatest_m).contains(&echo.range_m);
            let echoes = echoes.map(|echo| echo.filter(reports));
            let count = echoes.iter().flatten().count() as u8;
            echoes
                .into_iter()
                .flatten()
                .zip(1..)
                .map(move |(echo, number)| LidarReturn {
                    beam: beam as u32,
                    range_m: echo.range_m + noise_m(beam),
                    intensity: echo.intensity,
                    instance: echo.instance,
                    number,
                    count,
                })
        };
        LidarSweep {
            lidar: self.lidar.clone(),
            beams: self.beams.clone(),
            returns: self.states.iter().enumerate().flat_map(found).collect(),
        }
    }
}

/// A normally distributed number of mean 0 and variance 1 (Box and Muller, 1958).
fn normal(seed: u64, index: u64) -> f64 {
    let mut state = random::mix(seed ^ random::mix(index));
    let [first, second] = std::array::from_fn(|_| random::unit(random::next(&mut state)));
    (-2.0 * (1.0 - first).ln()).sqrt() * (std::f64::consts::TAU * second).cos()
}

/// Results of a walk, by cell.
struct Walked {
    states: Vec<BeamState>,
    echoes: Vec<BeamEchoes>,
}

/// `values` of cells, sorted by the beams of the cells.
fn by_beam<T: Copy + Default>(values: &[T], beam_of_cell: &[u32], beams: usize) -> Vec<T> {
    let mut sorted = vec![T::default(); beams];
    for (value, &beam) in values.iter().zip(beam_of_cell) {
        if let Some(of_beam) = sorted.get_mut(beam as usize) {
            *of_beam = *value;
        }
    }
    sorted
}

/// A sweep that is being traced.
struct SweepInput<'a> {
    scene: Scene<'a>,
    view: View,
    sectors: SectorBuffers,
    agents: Option<(AgentList, AgentBuffers)>,
    variant: LidarVariant,
    range_min_m: f32,
}

impl LidarRenderer {
    /// A renderer on `gpu`. Kernels are built when they are needed first.
    #[must_use]
    pub fn new(gpu: &Gpu, options: LidarOptions) -> Self {
        Self {
            gpu: gpu.clone(),
            options,
            stages: Vec::new(),
            common: None,
            grids: Vec::new(),
            capacity: None,
            buffers: Vec::new(),
        }
    }

    /// Options of the renderer.
    #[must_use]
    pub fn options(&self) -> &LidarOptions {
        &self.options
    }

    /// Traces one sweep of `lidar` through `scene`, whose agents stand where they are at the start
    /// of the sweep, and waits for it. Returns by `mode` can be made of it; with
    /// [`ReturnMode::Dual`], by every mode.
    ///
    /// # Errors
    /// Returns an error if the model, a pose or a motion makes no sense, or the device has not the
    /// memory or was lost.
    pub fn trace<'a>(
        &mut self,
        scene: impl Into<Scene<'a>>,
        lidar: &Lidar,
        mode: ReturnMode,
    ) -> Result<TracedSweep, RenderError> {
        let scene = scene.into();
        let of_lidar = |reason| RenderError::Lidar {
            name: lidar.name.clone(),
            reason,
        };
        lidar.model.check().map_err(of_lidar)?;
        lidar.motion.check().map_err(of_lidar)?;
        for agent in scene.agents.iter().flat_map(|(_, agents)| agents.iter()) {
            let instance = agent.instance;
            let of_agent = |reason| RenderError::AgentMotion { instance, reason };
            agent.motion.check().map_err(of_agent)?;
        }
        let grid = self.grid_of(&lidar.model);
        let count = self.options.sectors.clamp(1, CAMERAS_MAX);
        let cut = Sectors::new(lidar, &grid.beams, &grid.cells, count);
        let origin = scene.world.origin;
        let from_origin = |camera: &decouplegs_scene::Camera| {
            (camera.world_from_camera.translation - origin).length()
        };
        let reach_m = scene.reach_m()? + cut.cameras.iter().map(from_origin).fold(0.0, f64::max);
        let view = View::new(&cut.cameras, origin, reach_m).map_err(RenderError::View)?;
        let list = AgentList::of_sweep(&scene, &cut.cameras, &cut.times_s, &view)?;
        let agents_move = || {
            let mut agents = scene.agents.iter().flat_map(|(_, agents)| agents.iter());
            agents.any(|agent| !agent.motion.is_rest())
        };
        let variant = LidarVariant {
            instances: scene.world.has_instances,
            moving: !lidar.motion.is_rest() || agents_move(),
            dilation_rad: self.options.rules.lidar_dilation_rad as f32,
            echoes: mode == ReturnMode::Dual,
            storage: scene.world.storage,
        };
        let input = SweepInput {
            sectors: SectorBuffers::upload(&self.gpu, &view, &cut.tables)?,
            agents: list.map(|list| self.agents_on_device(list)).transpose()?,
            variant,
            range_min_m: lidar.model.range_m[0] as f32,
            scene,
            view,
        };
        let (walked, required, gpu_time_ns) = self.run(&input)?;
        let beams = grid.beams.len();
        let states = by_beam(&walked.states, &cut.beam_of_cell, beams);
        let echoes = match input.variant.echoes {
            true => by_beam(&walked.echoes, &cut.beam_of_cell, beams),
            false => Vec::new(),
        };
        Ok(TracedSweep {
            lidar: lidar.clone(),
            beams: grid.beams.clone(),
            states,
            echoes,
            required,
            gpu_time_ns,
        })
    }

    /// Beams and grid of `model`, kept from sweep to sweep.
    fn grid_of(&mut self, model: &Arc<LidarModel>) -> Arc<Grid> {
        let mut kept = self.grids.iter();
        if let Some(grid) = kept.find(|grid| Arc::ptr_eq(&grid.model, model)) {
            return grid.clone();
        }
        let grid = Arc::new(Grid {
            model: model.clone(),
            beams: model.beams().into(),
            cells: model.cells(),
        });
        if self.grids.len() >= GRIDS_MAX {
            self.grids.remove(0);
        }
        self.grids.push(grid.clone());
        grid
    }

    /// Copies the agents to the device.
    fn agents_on_device(&self, list: AgentList) -> Result<(AgentList, AgentBuffers), RenderError> {
        let counts = list.counts;
        let buffers = AgentBuffers::new(&self.gpu, counts.agents, counts.clusters, counts.cameras)?;
        self.gpu.write(&buffers.agents, 0, &list.records)?;
        self.gpu.write(&buffers.cameras, 0, &list.cameras)?;
        Ok((list, buffers))
    }

    /// Builds the kernels that are not there yet.
    fn build(&mut self, variant: LidarVariant) -> Result<(), RenderError> {
        let (gpu, rules) = (&self.gpu, &self.options.rules);
        if self.common.is_none() {
            self.common = Some((Scan::new(gpu)?, TileSort::for_lidar(gpu)?));
        }
        if !self.stages.iter().any(|built| built.variant == variant) {
            self.stages.push(LidarStages {
                variant,
                background: ProjectLidar::new(gpu, rules, variant)?,
                agents: ProjectLidarAgents::new(gpu, rules, variant)?,
                trace: TraceLidar::new(gpu, rules, variant)?,
            });
        }
        Ok(())
    }

    /// Makes the lists, with as much room as they need, and walks them.
    fn run(
        &mut self,
        input: &SweepInput<'_>,
    ) -> Result<(Walked, RequiredCounts, u64), RenderError> {
        self.build(input.variant)?;
        let splats = input.scene.world.finest_clusters * CLUSTER_SPLATS
            + input.agents.as_ref().map_or(0, |(list, _)| list.splats);
        let clusters = input.scene.world.finest_clusters;
        let mut capacity = match self.capacity {
            Some(capacity) => capacity,
            None => Capacity::guess(splats, input.view.cameras.len()),
        };
        for _ in 0..ATTEMPTS_MAX {
            let room = LidarRoom::new(capacity, clusters, &input.view, input.variant.echoes);
            let buffers = self.buffers_of(&room)?;
            let (listed, required) = self.list(input, &buffers)?;
            if capacity.holds(&required) {
                self.capacity = Some(capacity);
                let (walked, walk) = self.walk(input, &buffers, &required)?;
                self.buffers.push((room, buffers));
                return Ok((
                    walked,
                    required,
                    listed.gpu_time_ns()? + walk.gpu_time_ns()?,
                ));
            }
            capacity = capacity.grown_to(&required, 0.25);
        }
        Err(RenderError::Unsettled {
            attempts: ATTEMPTS_MAX,
            required: format!("{capacity:?}"),
        })
    }

    /// Buffers of `room`: those of an earlier sweep, or new ones in the place of the oldest.
    fn buffers_of(&mut self, room: &LidarRoom) -> Result<LidarBuffers, GpuError> {
        if let Some(index) = self.buffers.iter().position(|(kept, _)| kept == room) {
            return Ok(self.buffers.remove(index).1);
        }
        // Lists only grow: smaller ones are not asked for again.
        self.buffers
            .retain(|(kept, _)| kept.capacity == room.capacity);
        if self.buffers.len() >= ROOMS_MAX {
            self.buffers.remove(0);
        }
        LidarBuffers::new(&self.gpu, room)
    }

    /// Makes the sorted lists of coarse tiles; returns what they needed.
    fn list(
        &self,
        input: &SweepInput<'_>,
        buffers: &LidarBuffers,
    ) -> Result<(Ticket, RequiredCounts), RenderError> {
        let (Some((scan, tile_sort)), Some(stages)) = (&self.common, self.stages_of(input.variant))
        else {
            unreachable!("build was called")
        };
        let (world, sectors) = (input.scene.world, &input.sectors);
        let lists = sectors.count * world.finest_clusters;
        let agents = input.agents.as_ref().map(|(list, agents)| LidarAgents {
            pool: &list.pool,
            agents,
            counts: list.counts,
            static_lists: lists,
        });
        let mut recorder = self.gpu.record(QueueRole::Main);
        recorder.stage("begin", |r| empty_counts(r, buffers, sectors.bins));
        recorder.stage("project lidar", |r| {
            let background = &stages.background;
            background.record(r, LidarPass::Mark, world, sectors, buffers);
            scan.record(r, &buffers.visible.counts, &buffers.offsets, lists);
            background.record(r, LidarPass::Write, world, sectors, buffers);
        });
        if let Some(agents) = &agents {
            recorder.stage("project lidar agents", |r| {
                let AgentBuffers {
                    visible, offsets, ..
                } = agents.agents;
                let count = sectors.count * agents.counts.clusters;
                stages
                    .agents
                    .record(r, LidarPass::Mark, agents, sectors, buffers);
                scan.record(r, &visible.counts, offsets, count);
                stages
                    .agents
                    .record(r, LidarPass::Write, agents, sectors, buffers);
            });
        }
        let records = Records {
            cameras: &sectors.cameras,
            camera_count: sectors.count,
            projected: &buffers.projected,
            static_offsets: &buffers.offsets,
            static_clusters: world.finest_clusters,
            moving_offsets: agents.map_or(&buffers.no_agents, |agents| &agents.agents.offsets),
            moving_clusters: agents.map_or(0, |agents| agents.counts.clusters),
        };
        let counters = &buffers.counters;
        tile_sort.record(
            &mut recorder,
            counters,
            records,
            &buffers.lists,
            sectors.bins,
        );
        recorder.copy(&counters.required, 0, &buffers.found_required, 0, 1);
        let ticket = self.gpu.submit(recorder, &self.added(input))?;
        ticket.wait()?;
        Ok((ticket, buffers.found_required.read_host()[0]))
    }

    /// Walks the lists; returns what the beam of each cell found.
    fn walk(
        &self,
        input: &SweepInput<'_>,
        buffers: &LidarBuffers,
        required: &RequiredCounts,
    ) -> Result<(Walked, Ticket), RenderError> {
        let Some(stages) = self.stages_of(input.variant) else {
            unreachable!("build was called")
        };
        let entries_max = match self.gpu.info().kind {
            DeviceKind::Cpu => ENTRIES_MAX_IN_SOFTWARE,
            _ => u32::MAX,
        };
        let mut recorder = self.gpu.record(QueueRole::Main);
        recorder.stage("trace lidar", |r| {
            for window in 0..required.longest.div_ceil(entries_max).max(1) {
                let first = window * entries_max;
                let entries = first..first.saturating_add(entries_max);
                let (sectors, trace) = (&input.sectors, &stages.trace);
                trace.record(r, sectors, buffers, entries, input.range_min_m);
            }
        });
        let cells = buffers.states.len();
        recorder.copy(&buffers.states, 0, &buffers.found_states, 0, cells);
        if input.variant.echoes {
            recorder.copy(&buffers.echoes, 0, &buffers.found_echoes, 0, cells);
        }
        let ticket = self.gpu.submit(recorder, &[])?;
        ticket.wait()?;
        let walked = Walked {
            states: buffers.found_states.read_host(),
            echoes: match input.variant.echoes {
                true => buffers.found_echoes.read_host(),
                false => Vec::new(),
            },
        };
        Ok((walked, ticket))
    }

    fn stages_of(&self, variant: LidarVariant) -> Option<&LidarStages> {
        self.stages.iter().find(|built| built.variant == variant)
    }

    /// Uploads of assets that the sweep has to wait for.
    fn added<'a>(&self, input: &'a SweepInput<'_>) -> Vec<&'a Ticket> {
        let agents = input.scene.agents.iter();
        agents.filter_map(|(pool, _)| pool.last_upload()).collect()
    }
}

/// Empties what is counted.
fn empty_counts(recorder: &mut Recorder, buffers: &LidarBuffers, bins: u32) {
    let (counters, slabs) = (&buffers.counters, &buffers.lists.slab_counts);
    let emptied = [
        (counters.required.binding(), counters.required.byte_len()),
        (counters.arguments.binding(), counters.arguments.byte_len()),
        (slabs.binding(), TileSortBuffers::slab_bytes(bins)),
    ];
    for (buffer, bytes) in emptied {
        recorder.fill(buffer, 0, bytes, 0);
    }
}
