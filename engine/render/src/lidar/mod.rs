//! Sweeps of LiDARs: the same splats as in images, met by exact rays.
//!
//! A sweep is cut into sectors of azimuth. Each is a view of the same scene, with a pose, an order
//! of splats and lists of coarse tiles of its own; a tile is 64 x 32 beams. Lists may hold splats
//! that no beam meets, but lack none that one meets. Ranges and weights come from the exact ray of
//! each beam, at its own time: only the order of splats is that of the middle of the sector.

mod flight;
mod sectors;
mod traced;

use std::collections::VecDeque;
use std::sync::Arc;

use crate::RenderError;
use crate::agents::staged_agents::StagedAgents;
use crate::agents::{AgentList, FrameSplats};
use crate::capacity::Capacity;
use crate::layout::{BeamRecord, CAMERAS_MAX, CLUSTER_SPLATS, View};
use crate::stages::{
    LidarBuffers, LidarRoom, LidarVariant, ListLidar, ProjectLidar, ProjectLidarAgents, Scan,
    SectorBuffers, TileSort, TraceLidar, beam_lanes,
};
use decouplegs_gpu::{Gpu, GpuError};
use decouplegs_scene::lidar::{Beam, LidarCells, ReturnMode};
use decouplegs_scene::{Lidar, LidarModel, Rules};

use flight::{SweepInFlight, SweepInput};
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

/// Sweeps that are on the device at a time: one is traced while the host prepares the next.
const SWEEPS_IN_FLIGHT: usize = 2;

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
    /// Buffers that the host writes, for each sweep in flight. Those of sweeps that are done.
    written: Vec<Written>,
    stages_timed: bool,
}

/// A sweep to trace.
#[derive(Clone, Copy)]
pub struct LidarView<'a> {
    /// Splats that it meets. Agents stand where they are at the start of the sweep.
    pub splats: FrameSplats<'a>,
    /// LiDAR, and its motion during the sweep.
    pub lidar: &'a Lidar,
    /// Returns that can be made of the sweep; with [`ReturnMode::Dual`], those of every mode.
    pub mode: ReturnMode,
}

/// Buffers that the host writes for a sweep.
struct Written {
    sectors: SectorBuffers,
    agents: StagedAgents,
    /// Memory of the records of beams, which is used again.
    records: Vec<BeamRecord>,
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
            written: Vec::new(),
            stages_timed: false,
        }
    }

    /// Times every stage of the sweeps from here on. Stages that are timed do not overlap.
    pub fn time_stages(&mut self, timed: bool) {
        self.stages_timed = timed;
    }

    /// Options of the renderer.
    #[must_use]
    pub fn options(&self) -> &LidarOptions {
        &self.options
    }

    /// Traces one sweep of `lidar` through `splats`, whose agents stand where they are at the start
    /// of the sweep, and waits for it. Returns by `mode` can be made of it; with
    /// [`ReturnMode::Dual`], by every mode.
    ///
    /// # Errors
    /// Returns an error if the model, a pose or a motion makes no sense, or the device has not the
    /// memory or was lost.
    pub fn trace<'a>(
        &mut self,
        splats: impl Into<FrameSplats<'a>>,
        lidar: &Lidar,
        mode: ReturnMode,
    ) -> Result<TracedSweep, RenderError> {
        let splats = splats.into();
        let mut traced = Vec::new();
        self.trace_all(
            &[LidarView {
                splats,
                lidar,
                mode,
            }],
            &mut traced,
        )?;
        Ok(traced.pop().expect("a sweep was asked for"))
    }

    /// Traces sweeps, and waits for all of them. The device traces one while the host prepares the
    /// next. `traced` becomes the sweeps in the order of `views`; memory that it holds is used
    /// again.
    ///
    /// # Errors
    /// Returns the errors of [`LidarRenderer::trace`]; `traced` is empty then.
    pub fn trace_all(
        &mut self,
        views: &[LidarView<'_>],
        traced: &mut Vec<TracedSweep>,
    ) -> Result<(), RenderError> {
        let mut kept = std::mem::take(traced).into_iter();
        let mut in_flight = VecDeque::new();
        let mut finish = |renderer: &mut Self, flight| {
            traced.push(renderer.finish(flight, kept.next())?);
            Ok(())
        };
        let mut ended = views.iter().try_for_each(|view| {
            if in_flight.len() == SWEEPS_IN_FLIGHT
                && let Some(oldest) = in_flight.pop_front()
            {
                finish(self, oldest)?;
            }
            in_flight.push_back(self.start(view)?);
            Ok(())
        });
        while let Some(oldest) = in_flight.pop_front() {
            match ended {
                Ok(()) => ended = finish(self, oldest),
                // The error of the first one is told.
                Err(_) => self.abandon(oldest),
            }
        }
        if ended.is_err() {
            traced.clear();
        }
        ended
    }

    /// Prepares a sweep, and submits it.
    fn start<'a>(&mut self, view: &LidarView<'a>) -> Result<SweepInFlight<'a>, RenderError> {
        let LidarView {
            mut splats,
            lidar,
            mode,
        } = *view;
        splats.background = splats.background.for_lidar();
        let of_lidar = |reason| RenderError::Lidar {
            name: lidar.name.clone(),
            reason,
        };
        lidar.model.check().map_err(of_lidar)?;
        lidar.motion.check().map_err(of_lidar)?;
        for agent in &splats.agents.agents {
            let instance = agent.instance;
            let of_agent = |reason| RenderError::AgentMotion { instance, reason };
            agent.motion.check().map_err(of_agent)?;
        }
        let grid = self.grid_of(&lidar.model);
        let mut written = self.written()?;
        let records = std::mem::take(&mut written.records);
        let cut = Sectors::new(lidar, &grid.cells, &grid.plan, records);
        let origin = splats.background.origin;
        let from_origin = |camera: &decouplegs_scene::Camera| {
            (camera.world_from_camera.translation - origin).length()
        };
        let distance_max_m =
            splats.distance_max_m()? + cut.cameras.iter().map(from_origin).fold(0.0, f64::max);
        let view = View::new(&cut.cameras, origin, distance_max_m).map_err(RenderError::View)?;
        let agents = AgentList::of_sweep(&splats, &cut.cameras, &cut.times_s, &view)?;
        let agents_move = || {
            let mut agents = splats.agents.agents.iter();
            agents.any(|agent| !agent.motion.is_rest())
        };
        let variant = LidarVariant {
            instances: splats.background.has_instances,
            moving: !lidar.motion.is_rest() || agents_move(),
            dilation_rad: self.options.rules.lidar_dilation_rad as f32,
            echoes: mode == ReturnMode::Dual,
            storage: splats.background.storage,
            beam_lanes: beam_lanes(&self.gpu, grid.beams.len()),
        };
        written.sectors.set(&self.gpu, &view, &cut.tables)?;
        if let Some(list) = &agents {
            written.agents.fit(&self.gpu, list.counts)?;
            written.agents.write(list);
        }
        written.records = cut.tables.beams;
        self.build(variant)?;
        let input = SweepInput {
            splats,
            lidar,
            grid,
            view,
            agents,
            variant,
            written,
        };
        let count = splats.background.finest_clusters * CLUSTER_SPLATS
            + input.agents.as_ref().map_or(0, |list| list.splats);
        let capacity = match self.capacity {
            Some(capacity) => capacity,
            None => Capacity::guess(count, input.view.cameras.len()),
        };
        self.submit_in(input, capacity)
    }

    /// Buffers of a sweep before that is done, or new ones.
    fn written(&mut self) -> Result<Written, GpuError> {
        match self.written.pop() {
            Some(written) => Ok(written),
            None => Ok(Written {
                sectors: SectorBuffers::new(&self.gpu)?,
                agents: StagedAgents::new(&self.gpu)?,
                records: Vec::new(),
            }),
        }
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

    fn stages_of(&self, variant: LidarVariant) -> Option<&LidarStages> {
        self.stages.iter().find(|built| built.variant == variant)
    }
}
