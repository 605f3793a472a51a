//! Sweeps on the device: what is recorded of them, and what comes back.

use std::ops::Range;
use std::sync::Arc;

use bytemuck::Pod;
use decouplegs_gpu::{Buffer, DeviceKind, GpuError, QueueRole, Recorder, StageTime, Ticket};
use decouplegs_scene::Lidar;
use rayon::prelude::*;

use super::{ATTEMPTS_MAX, ENTRIES_MAX_IN_SOFTWARE, Grid, LidarRenderer, TracedSweep, Written};
use crate::RenderError;
use crate::agents::{AgentList, FrameSplats};
use crate::asset_pool::AssetPool;
use crate::capacity::Capacity;
use crate::layout::View;
use crate::stages::{
    AgentBuffers, FrameCounters, LidarAgents, LidarBuffers, LidarPass, LidarRoom, LidarVariant,
    Records, TileSortBuffers,
};

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

/// Copies a buffer of the host into the memory of `kept`, on all threads: most of a copy of this
/// size into new memory is the system's handing out of it.
fn read<T: Pod + Send + Sync>(values: &Buffer<T>, kept: &mut Vec<T>) {
    let values = values.as_host(values.len());
    values.par_iter().copied().collect_into_vec(kept);
}

/// A sweep that is being traced.
pub(super) struct SweepInput<'a> {
    pub splats: FrameSplats<'a>,
    pub lidar: &'a Lidar,
    pub grid: Arc<Grid>,
    pub view: View,
    pub agents: Option<AgentList>,
    pub variant: LidarVariant,
    pub written: Written,
}

/// A sweep on the device.
pub(super) struct SweepInFlight<'a> {
    pub input: SweepInput<'a>,
    pub capacity: Capacity,
    pub room: LidarRoom,
    pub buffers: LidarBuffers,
    pub tickets: Vec<Ticket>,
}

impl LidarRenderer {
    /// Submits a sweep with room for lists of `capacity`.
    pub(super) fn submit_in<'a>(
        &mut self,
        input: SweepInput<'a>,
        capacity: Capacity,
    ) -> Result<SweepInFlight<'a>, RenderError> {
        let clusters = input.splats.background.finest_clusters;
        let (beams, echoes) = (input.grid.beams.len(), input.variant.echoes);
        let room = LidarRoom::new(capacity, clusters, &input.view, beams, echoes);
        let buffers = self.buffers_of(&room)?;
        let tickets = self.submit(&input, &buffers)?;
        Ok(SweepInFlight {
            input,
            capacity,
            room,
            buffers,
            tickets,
        })
    }

    /// Waits for a sweep, and traces it again with more room until its lists fit. The memory of
    /// `kept` is used again.
    pub(super) fn finish(
        &mut self,
        mut flight: SweepInFlight<'_>,
        kept: Option<TracedSweep>,
    ) -> Result<TracedSweep, RenderError> {
        for attempt in 1.. {
            let times = SweepTimes::from_tickets(&flight.tickets)?;
            let required = flight.buffers.found_required.read_host()[0];
            if flight.capacity.holds(&required) {
                let (mut states, mut echoes) =
                    kept.map_or_else(Default::default, |sweep| (sweep.states, sweep.echoes));
                let found = &flight.buffers;
                read(&found.found_states, &mut states);
                match flight.input.variant.echoes {
                    true => read(&found.found_echoes, &mut echoes),
                    false => echoes.clear(),
                }
                self.capacity = Some(match self.capacity {
                    Some(others) => others.max(flight.capacity),
                    None => flight.capacity,
                });
                let traced = TracedSweep {
                    lidar: flight.input.lidar.clone(),
                    beams: flight.input.grid.beams.clone(),
                    states,
                    echoes,
                    required,
                    gpu_time_ns: times.gpu_time_ns,
                    stages: times.stages,
                };
                self.keep(flight);
                return Ok(traced);
            }
            if attempt == ATTEMPTS_MAX {
                break;
            }
            let capacity = flight.capacity.grown_to(&required, 0.25);
            flight = self.submit_in(flight.input, capacity)?;
        }
        Err(RenderError::Unsettled {
            attempts: ATTEMPTS_MAX,
            required: format!("{:?}", flight.capacity),
        })
    }

    /// Waits for a sweep that nobody wants any more.
    pub(super) fn abandon(&mut self, flight: SweepInFlight<'_>) {
        let mut tickets = flight.tickets.iter();
        // Its error adds nothing to the one that is told.
        if tickets.all(|ticket| ticket.wait().is_ok()) {
            self.keep(flight);
        }
    }

    /// Keeps the buffers of a sweep that is done, for later ones.
    fn keep(&mut self, flight: SweepInFlight<'_>) {
        self.buffers.push((flight.room, flight.buffers));
        self.written.push(flight.input.written);
    }

    /// A recorder for a part of a sweep.
    fn recorder(&self) -> Recorder {
        let recorder = self.gpu.record(QueueRole::Main);
        match self.stages_timed {
            true => recorder.time_stages(),
            false => recorder,
        }
    }

    /// Submits the sweep. Without room nothing is walked. Lists are walked in one dispatch with
    /// them, but on a software device, where their lengths have to be known before: they are waited
    /// for there.
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
        tickets.push(self.gpu.submit(recorder, &self.added(input))?);
        Ok(tickets)
    }

    /// Records the sorted lists of coarse and fine tiles, and the copy of what they needed.
    fn list(&self, recorder: &mut Recorder, input: &SweepInput<'_>, buffers: &LidarBuffers) {
        let (Some((scan, tile_sort, list_lidar)), Some(stages)) =
            (&self.common, self.stages_of(input.variant))
        else {
            unreachable!("build was called")
        };
        let written = &input.written;
        let (background, sectors) = (input.splats.background, &written.sectors);
        let lists = sectors.count * background.finest_clusters;
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
            let project = &stages.background;
            project.record(r, LidarPass::Mark, background, sectors, buffers);
            scan.record(r, &buffers.visible.counts, &buffers.offsets, lists);
            project.record(r, LidarPass::Write, background, sectors, buffers);
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
            static_clusters: background.finest_clusters,
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
        let Some(stages) = self.stages_of(input.variant) else {
            unreachable!("build was called")
        };
        let range_min_m = input.lidar.model.range_m[0] as f32;
        recorder.stage("trace lidar", |r| {
            for entries in windows {
                let (sectors, trace) = (&input.written.sectors, &stages.trace);
                trace.record(r, sectors, buffers, entries.clone(), range_min_m);
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

    /// Uploads of assets that the sweep has to wait for.
    fn added<'a>(&self, input: &'a SweepInput<'_>) -> Vec<&'a Ticket> {
        let pools = input.splats.pool.into_iter();
        pools.filter_map(AssetPool::last_upload).collect()
    }
}

/// Empties what is counted.
fn empty_counts(recorder: &mut Recorder, buffers: &LidarBuffers, bins: u32) {
    let FrameCounters {
        required,
        arguments,
    } = &buffers.counters;
    recorder.fill(required, 0, required.byte_len(), 0);
    recorder.fill(arguments, 0, arguments.byte_len(), 0);
    let slab_bytes = TileSortBuffers::slab_bytes(bins);
    recorder.fill(&buffers.lists.slab_counts, 0, slab_bytes, 0);
}
