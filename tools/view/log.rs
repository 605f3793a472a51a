//! Log of an episode: its moments, its score, and what it says of images.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result};
use decouplegs::asset::{LoadedScene, read_episode_log, read_light_transfer};
use decouplegs::drive::score::{EpisodeScore, times_to_collision};
use decouplegs::episode::{Appearance, Moment, Moments, Site, moments, reading_hash};
use decouplegs::scene::episode::Episode;
use decouplegs::scene::{Camera, Lane, Rig};
use decouplegs::session::{Session, SessionScene};
use glam::{DVec2, DVec3};
use serde_json::{Value, json};

/// Times of a log are matched to this, seconds: far below its steps.
const SAME_S: f64 = 1e-6;
/// Lanes farther from the ego's way than this are left out, meters.
const LANES_WITHIN_M: f64 = 150.0;

/// Files that a log is shown from.
#[derive(clap::Args)]
pub struct LogArguments {
    /// With a log: folder that its scenario's files are relative to (default: the log's)
    #[arg(long, value_name = "DIR")]
    base: Option<PathBuf>,
    /// With a log: light transfer for the cars, as given to the run
    #[arg(long, value_name = "FILE")]
    light: Option<PathBuf>,
}

impl LogArguments {
    /// True if one of them was given.
    pub fn is_given(&self) -> bool {
        self.base.is_some() || self.light.is_some()
    }
}

/// Log with the place that it belongs to.
pub struct OpenLog {
    episode: Episode,
    /// Place of the episode.
    pub site: Arc<Site>,
}

impl OpenLog {
    /// Reads the log at `path` and makes its place.
    ///
    /// # Errors
    /// Returns an error if a file is at fault.
    pub fn open(path: &Path, arguments: &LogArguments) -> Result<Self> {
        let episode = read_episode_log(path)?;
        let base = (arguments.base.as_deref().or(path.parent())).unwrap_or(Path::new(""));
        let light = arguments.light.as_deref().map(read_light_transfer);
        let appearance = Appearance {
            transfer: light.transpose()?.map(|file| file.transfer),
        };
        let site = Site::open(&episode.head.scenario.place, base, Some(&appearance))
            .context("the place of the log is not usable")?;
        Ok(Self {
            episode,
            site: Arc::new(site),
        })
    }

    /// Copies the place to the device and finds the moments.
    ///
    /// # Errors
    /// Returns an error if the device has not the memory, or the log does not fit the place.
    pub fn play(self, session: &Session) -> Result<(Played, Arc<SessionScene>)> {
        let Self { episode, site } = self;
        let scene = site.add_to(session)?;
        let Moments { moments, departs_s } = moments(&episode, &site, &scene)?;
        let mut rig = Rig::from_iter(site.loaded.rig.cameras().cloned());
        if let Some(drawn_by) = &episode.head.drawn_by {
            let logged = &episode.head.planner.cameras;
            for camera in rig.cameras_mut().filter(|c| logged.contains(&c.name)) {
                let k = &mut camera.intrinsics;
                *k = k.resized(drawn_by.width_px, drawn_by.height_px);
            }
        }
        let played = Played {
            episode,
            site,
            rig,
            moments,
            departs_s,
        };
        Ok((played, scene))
    }
}

/// Episode of a log at all its moments.
pub struct Played {
    episode: Episode,
    site: Arc<Site>,
    /// Cameras, those of the log in its size.
    rig: Rig,
    moments: Vec<Moment>,
    departs_s: Option<f64>,
}

impl Played {
    /// First and last time, seconds.
    pub fn span_s(&self) -> [f64; 2] {
        let time_s = |moment: Option<&Moment>| moment.map_or(0.0, |moment| moment.time_s);
        [time_s(self.moments.first()), time_s(self.moments.last())]
    }

    /// Scene of the place.
    pub fn loaded(&self) -> &LoadedScene {
        &self.site.loaded
    }

    /// Duration of a step of the planner, seconds.
    pub fn step_s(&self) -> f64 {
        self.episode.head.scenario.step_s
    }

    fn index_at(&self, time_s: f64) -> usize {
        let later = (self.moments).partition_point(|moment| moment.time_s <= time_s + SAME_S);
        later.saturating_sub(1)
    }

    /// The last moment until `time_s`.
    pub fn at(&self, time_s: f64) -> &Moment {
        &self.moments[self.index_at(time_s)]
    }

    /// Cameras of the ego at `moment`.
    pub fn cameras(&self, moment: &Moment) -> Vec<Camera> {
        self.rig.moving_at(&moment.ego, &moment.motion)
    }

    /// True if `rgba` has the hash that the log has for `camera` at `time_s`; `None` where the log
    /// has no image of this size then.
    pub fn is_logged(
        &self,
        time_s: f64,
        camera: &str,
        size_px: [u32; 2],
        rgba: &[u8],
    ) -> Option<bool> {
        let drawn_by = self.episode.head.drawn_by.as_ref()?;
        let step = &self.episode.steps[self.at(time_s).step? as usize];
        let mut readings = step.readings.iter();
        let reading = readings.find(|reading| reading.sensor == camera)?;
        (size_px == [drawn_by.width_px, drawn_by.height_px])
            .then(|| reading_hash(rgba) == reading.hash)
    }

    /// Points of the plan that the ego follows at `time_s`, world coordinates on the ground.
    pub fn plan(&self, time_s: f64) -> Vec<[f64; 3]> {
        let until = &self.moments[..=self.index_at(time_s)];
        let begin = until.iter().rev().find_map(|m| Some((m.step? as usize, m)));
        let Some((step, from)) = begin else {
            return Vec::new();
        };
        let down_m = 0.5 * self.episode.head.scenario.ego.size.height_m;
        let points = self.episode.steps[step].plan.points().iter();
        let points = [DVec2::ZERO]
            .into_iter()
            .chain(points.map(|p| p.position_m));
        points
            .map(|at_m| from.ego.rotation * at_m.extend(-down_m) + from.ego.translation)
            .map(|at_m| at_m.to_array())
            .collect()
    }

    /// Kind of the agent called `name`.
    pub fn class_of(&self, name: &str) -> Option<String> {
        let head = &self.episode.head;
        let mut agents = (0..head.agent_sizes.len()).map(|index| head.scenario.agent(index));
        let (_, kind, _) = agents.find(|agent| agent.0 == name)?;
        Some(kind.name().to_owned())
    }

    /// Score, infractions, curves over time and lanes, as JSON.
    pub fn facts(&self) -> Value {
        let head = &self.episode.head;
        let score = EpisodeScore::of(&self.episode);
        let events: Vec<Value> = (score.infractions.iter())
            .map(|infraction| {
                json!({
                    "time_s": infraction.time_s,
                    "text": infraction.describe(head),
                    "factor": infraction.factor(),
                })
            })
            .collect();
        let speeds = self.episode.instants().map(|tick| tick.ego.speed_mps);
        let times: Vec<(f64, Option<f64>)> = (times_to_collision(&self.episode).into_iter())
            .map(|(time_s, closest)| (time_s, closest.map(|closest| closest.ttc_s)))
            .collect();
        json!({
            "scenario": head.scenario.name,
            "planner": head.planner.name,
            "departs_s": self.departs_s,
            "score": {
                "driving_score": score.driving_score,
                "route_completion": score.route_completion,
                "success": score.success,
                "min_ttc_s": score.min_ttc_s(),
            },
            "events": events,
            "speed_mps": speeds.collect::<Vec<f64>>(),
            "time_to_collision_s": times,
            "lanes": self.lanes(),
        })
    }

    /// Borders of the lanes about the ego's way, or middles where a lane has none.
    fn lanes(&self) -> Vec<Vec<[f64; 3]>> {
        let way = || self.moments.iter().map(|moment| moment.ego.translation);
        let low = way().fold(DVec3::MAX, DVec3::min) - LANES_WITHIN_M;
        let high = way().fold(DVec3::MIN, DVec3::max) + LANES_WITHIN_M;
        let near = |at: &DVec3| at.cmpge(low).all() && at.cmple(high).all();
        let lines = |lane: &Lane| -> Vec<Vec<DVec3>> {
            let borders = [&lane.left, &lane.right].into_iter();
            let borders: Vec<_> = borders.filter(|line| !line.is_empty()).cloned().collect();
            match borders.is_empty() {
                true => vec![lane.centerline.clone()],
                false => borders,
            }
        };
        let round = |m: f64| (100.0 * m).round() / 100.0;
        (self.site.lanes.lanes.iter())
            .flat_map(lines)
            .filter(|line| line.iter().any(near))
            .map(|line| line.iter().map(|at| at.to_array().map(round)).collect())
            .collect()
    }
}
