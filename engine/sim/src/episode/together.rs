//! The closed loop of several egos in one world: all plan on the state of the same moment.

use std::sync::Arc;
use std::time::Instant;

use decouplegs_scene::episode::{Episode, EpisodeEnd, EpisodeStep};
use decouplegs_scene::{Rig, Scenario};

use super::egos_renderer::EgosRenderer;
use super::rollout::Answer;
use super::{
    Driven, EpisodeError, EpisodeMetadata, Rollout, Site, StepTime, agents_failed, ask, command,
    episode_info, laps, metadata_for,
};
use crate::planner::Planner;
use crate::planner::agents::{AgentDriver, AgentsInfo};

/// Observer of an episode of several egos while it runs.
pub trait EgosObserver {
    /// Called before the first step, with the episode at its start.
    ///
    /// # Errors
    /// Ends the episode and the run.
    fn begin(&mut self, _episode: &Episode) -> Result<(), EpisodeError> {
        Ok(())
    }

    /// Called after each step for each ego that drove in it, in the order of the scenario, with the
    /// readings that its plan was made from.
    ///
    /// # Errors
    /// Ends the episode and the run.
    fn step(
        &mut self,
        _ego: usize,
        _step: &EpisodeStep,
        _readings: &[crate::planner::Reading],
    ) -> Result<(), EpisodeError> {
        Ok(())
    }

    /// Called when an ego has ended, after its last step.
    ///
    /// # Errors
    /// Ends the episode and the run.
    fn end(&mut self, _ego: usize, _end: &EpisodeEnd) -> Result<(), EpisodeError> {
        Ok(())
    }
}

/// An observer that ignores everything.
impl EgosObserver for () {}

/// Drives all egos of `scenario` in `site`, each with its own of `planners`, in the order of the
/// scenario. Agents are driven by `agents`, if there is such a driver.
///
/// An ego that has ended leaves the road; the episode is over when all have ended.
///
/// # Errors
/// Returns an error if the scenario does not fit the site or has another number of egos, the device
/// or the driver of agents fails, or the observer cannot go on. A planner that fails ends the drive
/// of its ego with its reason, which is no error.
pub fn drive_egos(
    scenario: &Scenario,
    site: &Arc<Site>,
    mut renderer: Option<&mut EgosRenderer>,
    (planners, mut agents): (&mut [&mut dyn Planner], Option<&mut dyn AgentDriver>),
    observer: &mut dyn EgosObserver,
) -> Result<Driven, EpisodeError> {
    let none = Rig::default();
    let metadata = planners.iter().enumerate().map(|(ego, planner)| {
        let rig = renderer.as_deref().map_or(&none, |all| all.rig(ego));
        EpisodeMetadata {
            agent_driver: agents.as_deref().map(AgentDriver::name),
            drawn_by: renderer.as_deref().and_then(|all| all.drawn_by(ego)),
            ..metadata_for(rig, &**planner)
        }
    });
    let metadata = metadata.collect();
    let mut rollout = Rollout::with_egos(scenario, site, metadata)?;
    observer.begin(rollout.episode())?;
    let mut ends = Ends::default();
    for (ego, planner) in planners.iter_mut().enumerate() {
        let rig = renderer.as_deref().map(|all| all.rig(ego));
        let info = episode_info(&rollout.simulation().view(ego), rig);
        if let Err(error) = planner.begin(&info) {
            rollout.fail(ego, error.to_string());
        }
    }
    if let Some(agents) = agents.as_deref_mut() {
        let info = AgentsInfo::new(scenario, &site.lanes);
        let begun = agents.begin(&info);
        begun.map_err(|error| agents_failed(&rollout, error.to_string()))?;
    }
    let mut times = Vec::new();
    ends.tell(&rollout, observer)?;
    while !rollout.is_over() {
        let since = Instant::now();
        if let Some(agents) = agents.as_deref_mut() {
            command(&mut rollout, agents)?;
        }
        let commanded = since.elapsed();
        let mut time = one_step(&mut rollout, renderer.as_deref_mut(), planners, observer)?;
        ends.tell(&rollout, observer)?;
        time.advance += commanded;
        times.push(time);
    }
    Ok(Driven {
        episode: rollout.into_episode(),
        times,
    })
}

/// Egos whose end has been told, by their number.
#[derive(Default)]
struct Ends(Vec<usize>);

impl Ends {
    /// Tells `observer` of the egos that have ended since.
    fn tell(
        &mut self,
        rollout: &Rollout,
        observer: &mut dyn EgosObserver,
    ) -> Result<(), EpisodeError> {
        let simulation = rollout.simulation();
        for ego in 0..simulation.ego_count() {
            let end = simulation.view(ego).end();
            if let Some(end) = end.filter(|_| !self.0.contains(&ego)) {
                self.0.push(ego);
                observer.end(ego, end)?;
            }
        }
        Ok(())
    }
}

/// One step of the loop: draw all rigs, ask all planners, advance. Its times.
fn one_step(
    rollout: &mut Rollout,
    mut renderer: Option<&mut EgosRenderer>,
    planners: &mut [&mut dyn Planner],
    observer: &mut dyn EgosObserver,
) -> Result<StepTime, EpisodeError> {
    let mut time = StepTime::default();
    let mut lap = laps();
    if let Some(renderer) = renderer.as_deref_mut() {
        renderer.draw(rollout.simulation(), rollout.next_step())?;
        time.device = renderer.device_time();
    }
    time.draw = lap();
    let renderer = renderer.as_deref();
    let answers = answers(rollout, renderer, planners);
    time.plan = lap();
    for (ego, answer) in answers.iter().enumerate() {
        if let Some(Err(reason)) = answer {
            rollout.fail(ego, reason.clone());
        }
    }
    let answers = answers.into_iter().map(|answer| answer?.ok()).collect();
    let number = rollout.next_step();
    rollout.step_egos(answers);
    time.advance = lap();
    for (ego, episode) in rollout.episode().egos().enumerate() {
        if let Some(step) = episode.steps.get(number as usize) {
            let readings = renderer.map(|all| all.readings(ego)).unwrap_or_default();
            observer.step(ego, step, &readings)?;
        }
    }
    time.observer = lap();
    Ok(time)
}

/// Answers of all planners for the next step, or reasons of failures; `None` for egos that have
/// ended. Each planner has a thread of its own.
fn answers(
    rollout: &Rollout,
    renderer: Option<&EgosRenderer>,
    planners: &mut [&mut dyn Planner],
) -> Vec<Option<Result<Answer, String>>> {
    let answer = |(ego, planner): (usize, &mut &mut dyn Planner)| {
        let readings = renderer.map(|all| all.readings(ego)).unwrap_or_default();
        let plan = ask(rollout, ego, &mut **planner, &readings);
        let plan = plan.map_err(|error| error.to_string())?;
        Ok(Answer {
            plan,
            readings: renderer.map(|all| all.hashes(ego)).unwrap_or_default(),
            warm_up: planner.is_warming_up(),
        })
    };
    std::thread::scope(|scope| {
        let asked: Vec<_> = planners
            .iter_mut()
            .enumerate()
            .map(|asked| {
                let drives = rollout.simulation().view(asked.0).end().is_none();
                drives.then(|| scope.spawn(move || answer(asked)))
            })
            .collect();
        let joined = asked
            .into_iter()
            .map(|thread| thread.map(|thread| thread.join().expect("a planner does not panic")));
        joined.collect()
    })
}
