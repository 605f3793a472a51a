//! The closed loop: the ego's cameras are drawn, a planner answers with a trajectory, the ego
//! follows it, traffic answers, and again.
//!
//! This is the only place that joins what moves with what draws. [`Site`] is where it happens,
//! [`Simulation`] what moves, [`ObservationRenderer`] what is seen, and [`drive`] goes round the
//! loop; [`Rollout`] is for those who go round it themselves. Everything that happens is in an
//! [`Episode`], from which [`replay`] makes it again, bit by bit.

mod egos_renderer;
mod live;
mod moments;
mod observation_renderer;
pub mod open_loop;
mod overlapped;
mod replay;
mod rollout;
mod simulation;
mod site;
mod together;

use std::sync::Arc;
use std::time::{Duration, Instant};

use decouplegs_asset::AssetError;
use decouplegs_scene::episode::{
    Episode, EpisodeEnd, EpisodeHead, EpisodeStep, EpisodeTick, PlannerRecord,
};
use decouplegs_scene::{Plan, Rig, Scenario};
use decouplegs_session::SessionError;

use crate::planner::agents::{AgentDriver, AgentsInfo};
use crate::planner::{Cameras, EpisodeInfo, Observation, Planner, PlannerError, Reading};
use overlapped::Overlapped;

pub use egos_renderer::EgosRenderer;
pub use live::LiveEpisode;
pub use moments::{Moment, Moments};
pub use observation_renderer::{
    ObservationRenderer, camera_named, chosen, chosen_lidars, reading_hash,
};
pub use replay::{Replayed, replay, replay_egos};
pub use rollout::{Answer, EpisodeMetadata, Rollout};
pub use simulation::{EgoView, Simulation};
pub use site::{Appearance, Site, SiteError, rig_of};
pub use together::{EgosObserver, drive_egos};

/// Reason why an episode could not be driven: a fault of the run, not of the planner.
#[derive(Debug, thiserror::Error)]
pub enum EpisodeError {
    /// The scenario does not fit its place.
    #[error("scenario {scenario}: {reason}")]
    Unfit {
        /// Name of the scenario.
        scenario: String,
        /// Reason, a sentence.
        reason: String,
    },
    /// The images cannot be drawn.
    #[error("the cameras cannot be drawn")]
    Render(#[from] SessionError),
    /// The log cannot be written.
    #[error(transparent)]
    Log(#[from] AssetError),
    /// The program that drives agents failed: the planner is not at fault.
    #[error("the agents were not driven at {time_s:.1} s: {reason}")]
    Agents {
        /// Time since the start, seconds.
        time_s: f64,
        /// Reason, a sentence.
        reason: String,
    },
}

/// Observer of an episode while it runs: a log, or a writer of images.
pub trait EpisodeObserver {
    /// Called before the first step.
    ///
    /// # Errors
    /// Ends the episode and the run.
    fn begin(&mut self, _head: &EpisodeHead, _start: &EpisodeTick) -> Result<(), EpisodeError> {
        Ok(())
    }

    /// False if it never uses readings. It may be given none then.
    fn uses_readings(&self) -> bool {
        true
    }

    /// Called after each step, with the readings that its plan was made from.
    ///
    /// # Errors
    /// Ends the episode and the run.
    fn step(&mut self, step: &EpisodeStep, readings: &[Reading]) -> Result<(), EpisodeError>;

    /// Called after the last step.
    ///
    /// # Errors
    /// Ends the run.
    fn end(&mut self, _end: &EpisodeEnd) -> Result<(), EpisodeError> {
        Ok(())
    }
}

/// An observer that ignores everything.
impl EpisodeObserver for () {
    fn uses_readings(&self) -> bool {
        false
    }

    fn step(&mut self, _step: &EpisodeStep, _readings: &[Reading]) -> Result<(), EpisodeError> {
        Ok(())
    }
}

/// Wall-clock durations of one step.
#[derive(Clone, Copy, Debug, Default)]
pub struct StepTime {
    /// Poses, light, the frame on the device, its images back on the host, and sweeps of LiDARs.
    /// With a planner that uses none of them ([`Planner::uses_readings`]), what the step waited
    /// for.
    pub draw: Duration,
    /// Time of the device for the images, a part of [`StepTime::draw`] where that has all of it.
    pub device: Duration,
    /// Time of the planner.
    pub plan: Duration,
    /// Waiting for the hashes of the images, which are made while the planner plans.
    pub hash: Duration,
    /// Motion of ego and traffic, and the time of the program that drives agents.
    pub advance: Duration,
    /// The observer: logs and image files.
    pub observer: Duration,
}

impl StepTime {
    /// All time but that of the planner.
    #[must_use]
    pub fn simulator(&self) -> Duration {
        self.draw + self.hash + self.advance + self.observer
    }
}

/// An episode that was driven, and what its steps took.
pub struct Driven {
    /// Record of the episode.
    pub episode: Episode,
    /// Duration of each step.
    pub times: Vec<StepTime>,
}

/// Drives `scenario` in `site` with `planner`, which sees the images of `renderer`.
///
/// # Errors
/// Returns an error if the scenario does not fit the site, the device fails, or the observer cannot
/// go on. A planner that fails ends the episode with its reason, which is no error.
pub fn drive(
    scenario: &Scenario,
    site: &Arc<Site>,
    renderer: Option<&mut ObservationRenderer>,
    planner: &mut dyn Planner,
    observer: &mut dyn EpisodeObserver,
) -> Result<Driven, EpisodeError> {
    drive_among(scenario, site, renderer, (planner, None), observer)
}

/// Drives like [`drive`], among agents that a driver of agents drives, if there is one.
///
/// # Errors
/// Returns the errors of [`drive`], and one if the driver of agents fails.
pub fn drive_among(
    scenario: &Scenario,
    site: &Arc<Site>,
    mut renderer: Option<&mut ObservationRenderer>,
    (planner, mut agents): (&mut dyn Planner, Option<&mut dyn AgentDriver>),
    observer: &mut dyn EpisodeObserver,
) -> Result<Driven, EpisodeError> {
    let metadata = EpisodeMetadata {
        agent_driver: agents.as_deref().map(AgentDriver::name),
        ..metadata_of(renderer.as_deref(), planner)
    };
    let mut rollout = Rollout::new(scenario, site, metadata)?;
    observer.begin(&rollout.episode().head, &rollout.episode().start)?;
    introduce(&mut rollout, planner, renderer.as_deref());
    if let Some(agents) = agents.as_deref_mut() {
        let info = AgentsInfo::new(scenario, &site.lanes);
        let begun = agents.begin(&info);
        begun.map_err(|error| agents_failed(&rollout, error.to_string()))?;
    }
    let mut times: Vec<StepTime> = Vec::new();
    let uses_readings = planner.uses_readings();
    let unused =
        renderer.take_if(|renderer| !uses_readings && renderer.rig().lidars().next().is_none());
    let is_watched = observer.uses_readings();
    let mut ahead = unused.map(|renderer| Overlapped::new(renderer, is_watched));
    while rollout.end().is_none() {
        let since = Instant::now();
        if let Some(agents) = agents.as_deref_mut() {
            command(&mut rollout, agents)?;
        }
        let commanded = since.elapsed();
        let mut time = match &mut ahead {
            Some(ahead) => {
                let time = ahead.step(&mut rollout, planner, observer)?;
                if let Some(before) = times.last_mut() {
                    before.device = ahead.device_time();
                }
                time
            }
            None => one_step(&mut rollout, renderer.as_deref_mut(), planner, observer)?,
        };
        time.advance += commanded;
        times.push(time);
    }
    if let Some(ahead) = &mut ahead {
        let taken = ahead.finish(&mut rollout, observer)?;
        if let Some(last) = times.last_mut() {
            last.draw += taken;
            last.device = ahead.device_time();
        }
    }
    let episode = rollout.into_episode();
    observer.end(&episode.end)?;
    Ok(Driven { episode, times })
}

/// Asks a driver of agents for the commands of the next step.
fn command(rollout: &mut Rollout, agents: &mut dyn AgentDriver) -> Result<(), EpisodeError> {
    let observation = rollout.simulation().agents_observation(rollout.next_step());
    let commands = agents.commands(&observation);
    let commands = commands.map_err(|error| agents_failed(rollout, error.to_string()))?;
    let set = rollout.command(commands);
    set.map_err(|error| agents_failed(rollout, format!("{}: {error}", agents.name())))
}

fn agents_failed(rollout: &Rollout, reason: String) -> EpisodeError {
    EpisodeError::Agents {
        time_s: rollout.simulation().time_s(),
        reason,
    }
}

/// `scenario` at its start, for a log that names `planner` and `renderer`.
fn begun(
    scenario: &Scenario,
    site: &Arc<Site>,
    renderer: Option<&ObservationRenderer>,
    planner: &dyn Planner,
) -> Result<Rollout, EpisodeError> {
    Rollout::new(scenario, site, metadata_of(renderer, planner))
}

/// Tells `planner` what it will drive. One that fails ends the episode.
fn introduce(
    rollout: &mut Rollout,
    planner: &mut dyn Planner,
    renderer: Option<&ObservationRenderer>,
) {
    let rig = renderer.map(ObservationRenderer::rig);
    let info = episode_info(&rollout.simulation().view(0), rig);
    if let Err(error) = planner.begin(&info) {
        rollout.fail(0, error.to_string());
    }
}

/// One step of the loop: draw, observe, plan, advance. Its times; an error where the planner
/// failed.
fn one_step(
    rollout: &mut Rollout,
    mut renderer: Option<&mut ObservationRenderer>,
    planner: &mut dyn Planner,
    observer: &mut dyn EpisodeObserver,
) -> Result<StepTime, EpisodeError> {
    let number = rollout.next_step();
    let mut time = StepTime::default();
    let mut lap = laps();
    if let Some(renderer) = renderer.as_deref_mut() {
        renderer.draw(rollout.simulation(), number)?;
        time.device = renderer.device_time();
    }
    time.draw = lap();
    let renderer = renderer.as_deref();
    let readings = renderer
        .map(ObservationRenderer::readings)
        .unwrap_or_default();
    let (answer, readings_hashed) = std::thread::scope(|scope| {
        let hashes = scope.spawn(|| {
            renderer
                .map(ObservationRenderer::hashes)
                .unwrap_or_default()
        });
        let answer = ask(rollout, 0, planner, &readings);
        time.plan = lap();
        (answer, hashes.join().expect("hashing does not panic"))
    });
    time.hash = lap();
    let plan = match answer {
        Ok(plan) => plan,
        Err(error) => {
            rollout.fail(0, error.to_string());
            return Ok(time);
        }
    };
    let step = rollout.step(plan, readings_hashed, planner.is_warming_up());
    time.advance = lap();
    observer.step(step, &readings)?;
    time.observer = lap();
    Ok(time)
}

/// A clock that tells the time since it was asked before, or made.
fn laps() -> impl FnMut() -> Duration {
    let mut since = Instant::now();
    move || {
        let now = Instant::now();
        let taken = now - since;
        since = now;
        taken
    }
}

/// The plan of `planner` for the next step of ego `ego`, made from `readings`.
fn ask(
    rollout: &Rollout,
    ego: usize,
    planner: &mut dyn Planner,
    readings: &[Reading],
) -> Result<Plan, PlannerError> {
    let view = rollout.simulation().view(ego);
    let sees = planner.sees();
    let privileged = sees.privileged.then(|| view.privileged());
    let localization = sees.localization.then(|| {
        let episode = rollout.episode().ego(ego);
        let driven = episode.steps.last().map(|step| step.instants.as_slice());
        view.localization(driven.unwrap_or(std::slice::from_ref(&episode.start)))
    });
    planner.plan(&Observation {
        step: rollout.next_step(),
        time_s: view.simulation().time_s(),
        readings,
        ego: view.motion(),
        guidance: view.guidance(),
        localization: localization.as_ref(),
        privileged: privileged.as_ref(),
    })
}

fn metadata_of(renderer: Option<&ObservationRenderer>, planner: &dyn Planner) -> EpisodeMetadata {
    let rig = renderer.map(|renderer| renderer.rig().clone());
    EpisodeMetadata {
        drawn_by: renderer.and_then(ObservationRenderer::drawn_by),
        ..metadata_for(&rig.unwrap_or_default(), planner)
    }
}

/// Metadata of an ego with the sensors of `rig`, without what draws them.
fn metadata_for(rig: &Rig, planner: &dyn Planner) -> EpisodeMetadata {
    let cameras = rig.cameras().map(|camera| camera.name.clone()).collect();
    let lidars = rig.lidars().map(|lidar| lidar.name.clone()).collect();
    let planner = PlannerRecord {
        name: planner.name(),
        cameras,
        lidars,
        localization: planner.sees().localization,
        privileged: planner.sees().privileged,
    };
    EpisodeMetadata {
        planner,
        agent_driver: None,
        drawn_by: None,
    }
}

fn episode_info(view: &EgoView<'_>, rig: Option<&Rig>) -> EpisodeInfo {
    let scenario = view.simulation().scenario();
    EpisodeInfo {
        scenario: scenario.name.clone(),
        seed: scenario.seed,
        step_s: scenario.step_s,
        ego_size: view.task().size,
        rear_axle_to_middle_m: view.ego().rear_axle_to_middle_m(),
        sensors: rig.map(|rig| rig.sensors.clone()).unwrap_or_default(),
    }
}

/// The cameras that have to be drawn for `planner` in an episode where images are made.
#[must_use]
pub fn cameras_of(planner: &dyn Planner, at_least: Cameras) -> Cameras {
    match planner.sees().cameras {
        Cameras::None => at_least,
        wanted => wanted,
    }
}
