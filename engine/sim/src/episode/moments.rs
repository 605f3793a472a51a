//! Worlds of an episode at all its moments, from its log.

use std::sync::Arc;

use decouplegs_scene::episode::Episode;
use decouplegs_scene::{Motion, Pose};
use decouplegs_session::{SessionError, SessionScene, World};

use super::replay::check_version;
use super::{EpisodeError, Simulation, Site};

/// World of an episode at a moment.
#[derive(Clone)]
pub struct Moment {
    /// Time since the start of the episode, seconds.
    pub time_s: f64,
    /// Step that begins at this moment; `None` between steps and at the end.
    pub step: Option<u32>,
    /// Agents, lamps and signs.
    pub world: World,
    /// Pose of the middle of the ego's box, world coordinates.
    pub ego: Pose,
    /// Motion of the ego.
    pub motion: Motion,
}

/// Moments of an episode.
pub struct Moments {
    /// The start, and the end of each sub-step, in the order of time.
    pub moments: Vec<Moment>,
    /// Time of the first moment at which a vehicle is not where the log says, seconds; `None` where
    /// all move as in the log, to the last bit.
    pub departs_s: Option<f64>,
}

/// Moments of `episode` in `site`, whose copy on the device is `scene`.
///
/// Vehicles at rendered steps stand as they stood when the log was written: a vehicle remembers the
/// ground of the last moment that was rendered.
///
/// # Errors
/// Returns an error if the log is of another version or does not fit `site`, or if `scene` has not
/// the agents' assets.
pub fn moments(
    episode: &Episode,
    site: &Arc<Site>,
    scene: &Arc<SessionScene>,
) -> Result<Moments, EpisodeError> {
    check_version(episode)?;
    let scenario = &episode.head.scenario;
    let drawn_by = episode.head.drawn_by.as_ref();
    let every = drawn_by.map_or(1, |drawn_by| drawn_by.every.max(1));
    let mut drawn = Shown::new(Simulation::new(scenario, site)?, scene);
    let mut between = Shown::new(Simulation::new(scenario, site)?, scene);
    let mut departs_s = (drawn.simulation.instant() != episode.start).then_some(0.0);
    let mut moments = vec![between.moment()?];
    for step in &episode.steps {
        let Some(last) = moments.last_mut() else {
            break;
        };
        if step.step.is_multiple_of(every) {
            *last = drawn.moment()?;
        }
        last.step = Some(step.step);
        let instants = drawn.simulation.advance(&step.plan);
        if departs_s.is_none() && instants != step.instants {
            let pairs = instants.iter().zip(&step.instants);
            let first = pairs.into_iter().find(|(now, logged)| now != logged);
            departs_s = Some(first.map_or(last.time_s, |(now, _)| now.time_s));
        }
        let mut failed = None;
        let world = &mut between.world;
        between
            .simulation
            .advance_with(&step.plan, |simulation| match moment(simulation, world) {
                Ok(moment) => moments.push(moment),
                Err(error) => failed = Some(error),
            });
        if let Some(error) = failed {
            return Err(error.into());
        }
    }
    Ok(Moments { moments, departs_s })
}

/// A simulation, and the world that it is shown in.
struct Shown {
    simulation: Simulation,
    world: World,
}

impl Shown {
    fn new(simulation: Simulation, scene: &Arc<SessionScene>) -> Self {
        Self {
            simulation,
            world: World::empty(scene),
        }
    }

    fn moment(&mut self) -> Result<Moment, SessionError> {
        moment(&mut self.simulation, &mut self.world)
    }
}

fn moment(simulation: &mut Simulation, world: &mut World) -> Result<Moment, SessionError> {
    let (ego, motion) = simulation.show(world)?;
    Ok(Moment {
        time_s: simulation.time_s(),
        step: None,
        world: world.clone(),
        ego,
        motion,
    })
}
