//! Episode at all its moments: from a log, or driven while it is shown.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use decouplegs::asset::LoadedScene;
use decouplegs::drive::score::{EpisodeScore, quantities};
use decouplegs::episode::{EpisodeError, LiveEpisode, Moment, Moments, Site, reading_hash};
use decouplegs::explain::explain;
use decouplegs::logs::episode_log;
use decouplegs::scene::episode::{Episode, EpisodeTick};
use decouplegs::scene::{Camera, Plan, Rig};
use decouplegs::session::Scene;
use glam::DVec2;
use serde_json::{Value, json};

use crate::edits;
use crate::lanes::Lanes;
use crate::series;

/// Times of a log are matched to this, seconds: far below its steps.
const SAME_S: f64 = 1e-6;

/// Deceleration of hard braking: a passenger notices it (ISO 15622 limits cruise control to 3.5).
const HARD_BRAKING_MPS2: f64 = 3.5;

/// Image of a log.
pub struct LoggedImage {
    /// Width and height, pixels.
    size_px: [u32; 2],
    /// Hash of its bytes.
    hash: u128,
}

impl LoggedImage {
    /// True if `rgba` has its hash; `None` where `rgba` has another size.
    pub fn is(&self, size_px: [u32; 2], rgba: &[u8]) -> Option<bool> {
        (size_px == self.size_px).then(|| reading_hash(rgba) == self.hash)
    }
}

enum Driven {
    Logged(Box<Episode>),
    Live(Box<LiveEpisode>),
    /// Live episode that is lent for a step: its record until then.
    Lent(Box<Episode>),
}

/// Numbers of episodes that were opened or begun.
static NUMBERS: AtomicU64 = AtomicU64::new(0);

/// Episode at all its moments.
pub struct Played {
    number: u64,
    driven: Driven,
    site: Arc<Site>,
    lanes: Lanes,
    /// Cameras, those of the log in its size.
    rig: Rig,
    moments: Moments,
    /// Plans beside the chosen one, of each step of a live episode.
    alternatives: Vec<Vec<Plan>>,
}

impl Played {
    /// Moments of `episode`, which was driven in `site`, whose copy on the device is `scene`.
    ///
    /// # Errors
    /// Returns an error if the log does not fit the site.
    pub fn logged(
        episode: Episode,
        site: Arc<Site>,
        scene: &Arc<Scene>,
    ) -> Result<Self, EpisodeError> {
        let moments = Moments::from_episode(&episode, &site, scene)?;
        Ok(Self::new(Driven::Logged(Box::new(episode)), site, moments))
    }

    /// Start of an episode that goes on with [`Played::drive_on`].
    ///
    /// # Errors
    /// Returns an error if the scenario does not fit the site.
    pub fn live(
        episode: LiveEpisode,
        site: Arc<Site>,
        scene: &Arc<Scene>,
    ) -> Result<Self, EpisodeError> {
        let scenario = &episode.episode().head.scenario;
        let moments = Moments::begin(scenario, &site, scene)?;
        Ok(Self::new(Driven::Live(Box::new(episode)), site, moments))
    }

    fn new(driven: Driven, site: Arc<Site>, moments: Moments) -> Self {
        let mut played = Self {
            number: NUMBERS.fetch_add(1, Ordering::Relaxed),
            driven,
            rig: Rig::from_iter(site.loaded.rig.cameras().cloned()),
            lanes: Lanes::new(site.lanes.clone()),
            site,
            moments,
            alternatives: Vec::new(),
        };
        let head = &played.episode().head;
        if let Some(drawn_by) = head.drawn_by.clone() {
            let logged = head.planner.cameras.clone();
            let cameras = played.rig.cameras_mut();
            for camera in cameras.filter(|camera| logged.contains(&camera.name)) {
                camera.intrinsics = drawn_by.intrinsics(&camera.intrinsics);
            }
        }
        played
    }

    /// Record of the episode, as far as it was driven.
    pub fn episode(&self) -> &Episode {
        match &self.driven {
            Driven::Logged(episode) | Driven::Lent(episode) => episode,
            Driven::Live(live) => live.episode(),
        }
    }

    /// True while more steps can be driven.
    pub fn goes_on(&self) -> bool {
        match &self.driven {
            Driven::Logged(_) => false,
            Driven::Live(live) => !live.is_over(),
            Driven::Lent(_) => true,
        }
    }

    /// Lends the episode for a step, if it goes on and is not lent already, with its number.
    pub fn lend(&mut self) -> Option<(u64, Box<LiveEpisode>)> {
        let record = match &self.driven {
            Driven::Live(live) if !live.is_over() => live.episode().clone(),
            _ => return None,
        };
        match std::mem::replace(&mut self.driven, Driven::Lent(Box::new(record))) {
            Driven::Live(live) => Some((self.number, live)),
            Driven::Logged(_) | Driven::Lent(_) => None,
        }
    }

    /// Takes back what was lent, if `number` is its own: with one more step if `has_step`.
    ///
    /// # Errors
    /// Returns an error if the step does not fit the place.
    pub fn take_back(
        &mut self,
        number: u64,
        live: Box<LiveEpisode>,
        has_step: bool,
    ) -> Result<(), EpisodeError> {
        if number != self.number {
            return Ok(());
        }
        let step = live.episode().steps.last().filter(|_| has_step);
        let added = step.map_or(Ok(()), |step| self.moments.add(step));
        if has_step {
            self.alternatives.push(live.alternatives().to_vec());
        }
        self.driven = Driven::Live(live);
        added
    }

    /// Drives one more step, if the episode goes on.
    ///
    /// # Errors
    /// Returns an error if the device fails.
    pub fn drive_on(&mut self) -> Result<(), EpisodeError> {
        if let Driven::Live(live) = &mut self.driven
            && let Some(step) = live.step()?
        {
            self.moments.add(step)?;
            self.alternatives.push(live.alternatives().to_vec());
        }
        Ok(())
    }

    /// Writes the log of the episode, which has ended, to `path`, where no file is.
    ///
    /// # Errors
    /// A sentence.
    pub fn save(&self, path: &Path) -> Result<String, String> {
        if self.goes_on() {
            return Err(
                "the episode goes on: a log is that of a whole one. Play it to its end".into(),
            );
        }
        let bytes = episode_log::encode(self.episode()).map_err(|error| explain(&error))?;
        edits::save(path.to_owned(), &mut Vec::new(), &bytes)
    }

    /// First and last time, seconds.
    pub fn span_s(&self) -> [f64; 2] {
        let time_s = |moment: Option<&Moment>| moment.map_or(0.0, |moment| moment.time_s);
        let moments = self.moments.as_slice();
        [time_s(moments.first()), time_s(moments.last())]
    }

    /// Scene of the place.
    pub fn loaded(&self) -> &LoadedScene {
        &self.site.loaded
    }

    /// Duration of a step of the planner, seconds.
    pub fn step_s(&self) -> f64 {
        self.episode().head.scenario.step_s
    }

    fn index_at(&self, time_s: f64) -> usize {
        let moments = self.moments.as_slice();
        let later = moments.partition_point(|moment| moment.time_s <= time_s + SAME_S);
        later.saturating_sub(1)
    }

    /// The last moment until `time_s`.
    pub fn at(&self, time_s: f64) -> &Moment {
        &self.moments.as_slice()[self.index_at(time_s)]
    }

    /// Cameras of the ego at `moment`.
    pub fn cameras(&self, moment: &Moment) -> Vec<Camera> {
        self.rig.moving_at(&moment.ego, &moment.motion)
    }

    /// The image that the log has of `camera` at `time_s`, if it has one.
    pub fn logged_image(&self, time_s: f64, camera: &str) -> Option<LoggedImage> {
        let episode = self.episode();
        let drawn_by = episode.head.drawn_by.as_ref()?;
        let step = &episode.steps[self.at(time_s).step? as usize];
        let mut readings = step.readings.iter();
        let reading = readings.find(|reading| reading.sensor == camera)?;
        Some(LoggedImage {
            size_px: [drawn_by.width_px, drawn_by.height_px],
            hash: reading.hash,
        })
    }

    /// Points of the plan that the ego follows at `time_s`, and of each other plan that its planner
    /// considered in a live episode; world coordinates on the ground.
    pub fn plans(&self, time_s: f64) -> (Vec<[f64; 3]>, Vec<Vec<[f64; 3]>>) {
        let episode = self.episode();
        let until = &self.moments.as_slice()[..=self.index_at(time_s)];
        let begin = until.iter().rev().find_map(|m| Some((m.step? as usize, m)));
        let Some((step, from)) = begin else {
            return Default::default();
        };
        let down_m = 0.5 * episode.head.scenario.ego.size.height_m;
        let on_ground = |plan: &Plan| {
            let points = plan.points().iter().map(|point| point.position_m);
            let points = [DVec2::ZERO].into_iter().chain(points);
            points
                .map(|at_m| from.ego.rotation * at_m.extend(-down_m) + from.ego.translation)
                .map(|at_m| at_m.to_array())
                .collect()
        };
        let others = self.alternatives.get(step).into_iter().flatten();
        let others = others.map(on_ground).collect();
        (on_ground(&episode.steps[step].plan), others)
    }

    /// Kind of the agent called `name`.
    pub fn class_of(&self, name: &str) -> Option<String> {
        let head = &self.episode().head;
        let mut agents = (0..head.agent_sizes.len()).map(|index| head.scenario.agent(index));
        let (_, kind, _) = agents.find(|agent| agent.0 == name)?;
        Some(kind.name().to_owned())
    }

    /// Score, infractions and curves over time, as JSON.
    pub fn facts(&self) -> Value {
        let episode = self.episode();
        let head = &episode.head;
        let score = EpisodeScore::new(episode);
        let infractions = score.infractions.iter().map(|infraction| {
            json!({
                "time_s": infraction.time_s,
                "text": infraction.describe(head),
                "factor": infraction.factor(),
            })
        });
        let brakings = hard_brakings(episode.instants());
        let brakings = brakings.map(|time_s| json!({"time_s": time_s, "text": "hard braking"}));
        let events: Vec<Value> = infractions.chain(brakings).collect();
        let speeds = episode.instants().map(|tick| tick.ego.speed_mps);
        let quantities = quantities(episode, &score);
        let known = quantities
            .iter()
            .find(|one| one.key == "time_to_collision_s");
        let times: Vec<(f64, Option<f64>)> = (episode.instants().enumerate())
            .map(|(index, tick)| (tick.time_s, known.and_then(|times| times.values[index])))
            .collect();
        json!({
            "scenario": head.scenario.name,
            "planner": head.planner.name,
            "departs_s": self.moments.departs_s(),
            "is_live": !matches!(self.driven, Driven::Logged(_)),
            "goes_on": self.goes_on(),
            "score": {
                "driving_score": score.driving_score,
                "route_completion": score.route_completion,
                "success": score.success,
                "min_ttc_s": score.min_ttc_s(),
            },
            "events": events,
            "speed_mps": speeds.collect::<Vec<f64>>(),
            "time_to_collision_s": times,
            "series": series::facts(&quantities),
        })
    }

    /// Lanes of the place.
    pub fn lanes(&self) -> &Lanes {
        &self.lanes
    }

    /// Lanes about the ego's way, as lines.
    pub fn lane_lines(&self) -> Vec<Vec<[f64; 3]>> {
        let way = self.moments.as_slice().iter();
        let way = way.map(|moment| moment.ego.translation);
        let z_m = way.clone().next().map_or(0.0, |start| start.z);
        let route = self.episode().head.route_m.iter();
        let route = route.map(|at| at.extend(z_m));
        self.lanes.lines_about(way.chain(route))
    }

    /// Time of the first moment at which the ego or an agent is elsewhere than in `other`, seconds;
    /// `None` where the two are the same as far as both were driven.
    pub fn parts_from(&self, other: &Self) -> Option<f64> {
        let mut pairs = self.episode().instants().zip(other.episode().instants());
        let differs = |(a, b): &(&EpisodeTick, &EpisodeTick)| a != b;
        pairs.find(differs).map(|(tick, _)| tick.time_s)
    }
}

/// Times at which the ego begins to brake hard, seconds.
fn hard_brakings<'a>(ticks: impl Iterator<Item = &'a EpisodeTick>) -> impl Iterator<Item = f64> {
    let mut brakes = false;
    ticks.filter_map(move |tick| {
        // It ends well below its beginning, so that one braking is one event.
        let least_mps2 = HARD_BRAKING_MPS2 * if brakes { 0.5 } else { 1.0 };
        let before = std::mem::replace(&mut brakes, tick.ego.acceleration_mps2 <= -least_mps2);
        (brakes && !before).then_some(tick.time_s)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs::scene::VehicleState;

    #[test]
    fn one_braking_is_one_event() {
        let ticks: Vec<EpisodeTick> = [0.0, -2.0, -4.0, -3.0, -5.0, 0.0, -6.0]
            .into_iter()
            .enumerate()
            .map(|(index, acceleration_mps2)| EpisodeTick {
                time_s: index as f64,
                ego: VehicleState {
                    position_m: DVec2::ZERO,
                    yaw_rad: 0.0,
                    speed_mps: 10.0,
                    acceleration_mps2,
                },
                steer_rad: 0.0,
                on_road: true,
                lanes: None,
                road: None,
                agents: Vec::new(),
            })
            .collect();
        let found: Vec<f64> = hard_brakings(ticks.iter()).collect();
        assert_eq!(found, [2.0, 6.0]);
    }
}
