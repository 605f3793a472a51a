//! Sweeps of LiDARs: the same splats as in images, met by exact rays.
//!
//! A sweep is cut into sectors of azimuth. Each is a view of the same scene, with a pose, an order
//! of splats and lists of coarse tiles of its own; a tile is 64 x 32 beams. Lists may hold splats
//! that no beam meets, but lack none that one meets. Ranges and weights come from the exact ray of
//! each beam, at its own time: only the order of splats is that of the middle of the sector.

mod sectors;
mod traced;

use std::ops::Range;
use std::sync::Arc;

use bytemuck::Pod;
use decouplegs_gpu::{Buffer, DeviceKind, Gpu, GpuError, QueueRole, Recorder, StageTime, Ticket};
use decouplegs_scene::lidar::{Beam, LidarCells, ReturnMode};
use decouplegs_scene::{Lidar, LidarModel, Rules};
use rayon::prelude::*;

use crate::RenderError;
use crate::agents::{AgentList, Scene};
use crate::capacity::Capacity;
use crate::layout::{BeamEchoes, BeamState, CAMERAS_MAX, CLUSTER_SPLATS, RequiredCounts, View};
use crate::staged_agents::StagedAgents;
use crate::stages::{
    AgentBuffers, LidarAgents, LidarBuffers, LidarPass, LidarRoom, LidarVariant, ListLidar,
    ProjectLidar, ProjectLidarAgents, Records, Scan, SectorBuffers, SectorTables, TileSort,
    TileSortBuffers, TraceLidar, beam_lanes,
};

pub use sectors::{SectorPlan, Sectors};
pub use traced::TracedSweep;

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
    plan: SectorPlan,
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
    common: Option<(Scan, TileSort, ListLidar)>,
    grids: Vec<Arc<Grid>>,
    capacity: Option<Capacity>,
    /// Buffers of earlier sweeps, the last ones last.
    buffers: Vec<(LidarRoom, LidarBuffers)>,
    /// Buffers that the host writes; `None` before the first sweep.
    written: Option<Written>,
    stages_timed: bool,
}

/// Buffers that the host writes for a sweep.
struct Written {
    sectors: SectorBuffers,
    agents: StagedAgents,
}

/// Results of a walk, by beam.
struct Walked {
    states: Vec<BeamState>,
    echoes: Vec<BeamEchoes>,
}

/// Time on the device that a sweep took.
struct SweepTimes {
    gpu_time_ns: u64,
    /// Empty unless stages are timed.
    stages: Vec<StageTime>,
}

impl SweepTimes {
    /// Times of submissions, one after the other.
    fn from_tickets(tickets: &[Ticket]) -> Result<Self, GpuError> {
        let mut times = Self {
            gpu_time_ns: 0,
            stages: Vec::new(),
        };
        for ticket in tickets {
            times.gpu_time_ns += ticket.gpu_time_ns()?;
            times.stages.extend(ticket.stage_times()?);
        }
        Ok(times)
    }
}

/// Values of a buffer of the host, copied on all threads: most of a copy of this size is the
/// system's handing out of memory.
fn read<T: Pod + Send + Sync>(values: &Buffer<T>) -> Vec<T> {
    values.as_host(values.len()).par_iter().copied().collect()
}

/// A sweep that is being traced.
struct SweepInput<'a> {
    scene: Scene<'a>,
    beams: usize,
    view: View,
    agents: Option<AgentList>,
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
            written: None,
            stages_timed: false,
        }
    }

    /// Times every stage of the sweeps from here on. Stages that are timed do not overlap.
    pub fn time_stages(&mut self, timed: bool) {
        self.stages_timed = timed;
    }

    /// A recorder for a part of a sweep.
    fn recorder(&self) -> Recorder {
        let recorder = self.gpu.record(QueueRole::Main);
        match self.stages_timed {
            true => recorder.time_stages(),
            false => recorder,
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
        let mut scene = scene.into();
        scene.gpu_scene = scene.gpu_scene.for_lidar();
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
        let cut = Sectors::new(lidar, &grid.beams, &grid.cells, &grid.plan);
        let origin = scene.gpu_scene.origin;
        let from_origin = |camera: &decouplegs_scene::Camera| {
            (camera.world_from_camera.translation - origin).length()
        };
        let distance_max_m =
            scene.distance_max_m()? + cut.cameras.iter().map(from_origin).fold(0.0, f64::max);
        let view = View::new(&cut.cameras, origin, distance_max_m).map_err(RenderError::View)?;
        let list = AgentList::of_sweep(&scene, &cut.cameras, &cut.times_s, &view)?;
        let agents_move = || {
            let mut agents = scene.agents.iter().flat_map(|(_, agents)| agents.iter());
            agents.any(|agent| !agent.motion.is_rest())
        };
        let variant = LidarVariant {
            instances: scene.gpu_scene.has_instances,
            moving: !lidar.motion.is_rest() || agents_move(),
            dilation_rad: self.options.rules.lidar_dilation_rad as f32,
            echoes: mode == ReturnMode::Dual,
            storage: scene.gpu_scene.storage,
            beam_lanes: beam_lanes(&self.gpu, grid.beams.len()),
        };
        self.write(&view, &cut.tables, list.as_ref())?;
        let input = SweepInput {
            beams: grid.beams.len(),
            agents: list,
            variant,
            range_min_m: lidar.model.range_m[0] as f32,
            scene,
            view,
        };
        let (walked, required, times) = self.run(&input)?;
        Ok(TracedSweep {
            lidar: lidar.clone(),
            beams: grid.beams.clone(),
            states: walked.states,
            echoes: walked.echoes,
            required,
            gpu_time_ns: times.gpu_time_ns,
            stages: times.stages,
        })
    }

    /// Beams and grid of `model`, kept from sweep to sweep.
    fn grid_of(&mut self, model: &Arc<LidarModel>) -> Arc<Grid> {
        let mut kept = self.grids.iter();
        if let Some(grid) = kept.find(|grid| Arc::ptr_eq(&grid.model, model)) {
            return grid.clone();
        }
        let (beams, cells) = (model.beams(), model.cells());
        let count = self.options.sectors.clamp(1, CAMERAS_MAX);
        let grid = Arc::new(Grid {
            model: model.clone(),
            plan: SectorPlan::new(&beams, &cells, count),
            beams: beams.into(),
            cells,
        });
        if self.grids.len() >= GRIDS_MAX {
            self.grids.remove(0);
        }
        self.grids.push(grid.clone());
        grid
    }

    /// Writes what the kernels are given of a sweep. The sweep before is done.
    fn write(
        &mut self,
        view: &View,
        tables: &SectorTables,
        list: Option<&AgentList>,
    ) -> Result<(), RenderError> {
        if self.written.is_none() {
            self.written = Some(Written {
                sectors: SectorBuffers::new(&self.gpu)?,
                agents: StagedAgents::new(&self.gpu)?,
            });
        }
        let Some(Written { sectors, agents }) = &mut self.written else {
            unreachable!("made above")
        };
        sectors.set(&self.gpu, view, tables)?;
        if let Some(list) = list {
            agents.fit(&self.gpu, list.counts)?;
            agents.write(list);
        }
        Ok(())
    }

    /// Builds the kernels that are not there yet.
    fn build(&mut self, variant: LidarVariant) -> Result<(), RenderError> {
        let (gpu, rules) = (&self.gpu, &self.options.rules);
        if self.common.is_none() {
            let lists = TileSort::for_lidar(gpu)?;
            self.common = Some((Scan::new(gpu)?, lists, ListLidar::new(gpu)?));
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
    ) -> Result<(Walked, RequiredCounts, SweepTimes), RenderError> {
        self.build(input.variant)?;
        let splats = input.scene.gpu_scene.finest_clusters * CLUSTER_SPLATS
            + input.agents.as_ref().map_or(0, |list| list.splats);
        let clusters = input.scene.gpu_scene.finest_clusters;
        let mut capacity = match self.capacity {
            Some(capacity) => capacity,
            None => Capacity::guess(splats, input.view.cameras.len()),
        };
        for _ in 0..ATTEMPTS_MAX {
            let echoes = input.variant.echoes;
            let room = LidarRoom::new(capacity, clusters, &input.view, input.beams, echoes);
            let buffers = self.buffers_of(&room)?;
            let tickets = self.submit(input, &buffers)?;
            let times = SweepTimes::from_tickets(&tickets)?;
            let required = buffers.found_required.read_host()[0];
            if capacity.holds(&required) {
                self.capacity = Some(capacity);
                let walked = Walked {
                    states: read(&buffers.found_states),
                    echoes: match echoes {
                        true => read(&buffers.found_echoes),
                        false => Vec::new(),
                    },
                };
                self.buffers.push((room, buffers));
                return Ok((walked, required, times));
            }
            capacity = capacity.grown_to(&required, 0.25);
        }
        Err(RenderError::Unsettled {
            attempts: ATTEMPTS_MAX,
            required: format!("{capacity:?}"),
        })
    }

    /// Submits the sweep and waits for it. Without room nothing is walked. Lists are walked in one
    /// dispatch with them, but on a software device, where their lengths have to be known before.
    fn submit(
        &self,
        input: &SweepInput<'_>,
        buffers: &LidarBuffers,
    ) -> Result<Vec<Ticket>, RenderError> {
        let mut recorder = self.recorder();
        self.list(&mut recorder, input, buffers);
        let mut tickets = Vec::new();
        let mut window = u32::MAX;
        let mut longest = 1;
        if self.gpu.info().kind == DeviceKind::Cpu {
            tickets.push(self.gpu.submit(recorder, &self.added(input))?);
            tickets[0].wait()?;
            longest = buffers.found_required.read_host()[0].longest;
            window = ENTRIES_MAX_IN_SOFTWARE;
            recorder = self.recorder();
        }
        let windows: Vec<Range<u32>> = (0..longest.max(1))
            .step_by(window as usize)
            .map(|first| first..first.saturating_add(window))
            .collect();
        self.walk(&mut recorder, input, buffers, &windows);
        let walked = self.gpu.submit(recorder, &self.added(input))?;
        walked.wait()?;
        tickets.push(walked);
        Ok(tickets)
    }

    /// Buffers of `room`: those of an earlier sweep, or new ones in place of the oldest.
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

    /// Records the sorted lists of coarse and fine tiles, and the copy of what they needed.
    fn list(&self, recorder: &mut Recorder, input: &SweepInput<'_>, buffers: &LidarBuffers) {
        let (Some((scan, tile_sort, list_lidar)), Some(stages), Some(written)) =
            (&self.common, self.stages_of(input.variant), &self.written)
        else {
            unreachable!("build and write were called")
        };
        let (gpu_scene, sectors) = (input.scene.gpu_scene, &written.sectors);
        let lists = sectors.count * gpu_scene.finest_clusters;
        let agents = input.agents.as_ref().map(|list| LidarAgents {
            pool: &list.pool,
            agents: &written.agents.buffers,
            counts: list.counts,
            static_lists: lists,
        });
        recorder.stage("begin", |r| {
            sectors.copy(r);
            if let Some(list) = &input.agents {
                written.agents.copy(r, list.counts);
            }
            empty_counts(r, buffers, sectors.bins);
        });
        recorder.stage("project lidar", |r| {
            let background = &stages.background;
            background.record(r, LidarPass::Mark, gpu_scene, sectors, buffers);
            scan.record(r, &buffers.visible.counts, &buffers.offsets, lists);
            background.record(r, LidarPass::Write, gpu_scene, sectors, buffers);
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
            cameras: sectors.cameras.device(),
            camera_count: sectors.count,
            projected: &buffers.projected,
            static_offsets: &buffers.offsets,
            static_clusters: gpu_scene.finest_clusters,
            moving_offsets: agents.map_or(&buffers.no_agents, |agents| &agents.agents.offsets),
            moving_clusters: agents.map_or(0, |agents| agents.counts.clusters),
            moving_only: false,
            other_keys: &buffers.projected.keys,
        };
        let counters = &buffers.counters;
        tile_sort.record(recorder, counters, records, &buffers.lists, sectors.bins);
        recorder.stage("list lidar", |r| list_lidar.record(r, sectors, buffers));
        recorder.copy(&counters.required, 0, &buffers.found_required, 0, 1);
    }

    /// Records the walk over `windows` of the lists, and the copies of what beams found.
    fn walk(
        &self,
        recorder: &mut Recorder,
        input: &SweepInput<'_>,
        buffers: &LidarBuffers,
        windows: &[Range<u32>],
    ) {
        let (Some(stages), Some(written)) = (self.stages_of(input.variant), &self.written) else {
            unreachable!("build and write were called")
        };
        recorder.stage("trace lidar", |r| {
            for entries in windows {
                let (sectors, trace) = (&written.sectors, &stages.trace);
                trace.record(r, sectors, buffers, entries.clone(), input.range_min_m);
            }
        });
        let beams = buffers.states.len();
        recorder.stage("copy lidar", |r| {
            r.copy(&buffers.states, 0, &buffers.found_states, 0, beams);
            if input.variant.echoes {
                r.copy(&buffers.echoes, 0, &buffers.found_echoes, 0, beams);
            }
        });
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
