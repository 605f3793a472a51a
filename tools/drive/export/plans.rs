//! Plans of a planner along an episode that another one drove: for planners that learn from it.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;
use std::sync::Arc;

use anyhow::Result;
use decouplegs::asset::write_atomically;
use decouplegs::episode::open_loop::{Images, plans};
use decouplegs::episode::{EpisodeError, Site};
use decouplegs::planner::{
    EpisodeInfo, Observation, ObservationRequest, Planner, PlannerError, observation_json,
};
use decouplegs::scene::episode::Episode;
use decouplegs::scene::{Plan, Rig};
use serde_json::json;

/// Name of the file.
const FILE: &str = "plans.jsonl";

/// A planner, and a line for each of its plans.
struct Watched {
    planner: Box<dyn Planner>,
    lines: String,
}

impl Planner for Watched {
    fn name(&self) -> String {
        self.planner.name()
    }

    fn sees(&self) -> ObservationRequest {
        self.planner.sees()
    }

    fn begin(&mut self, info: &EpisodeInfo) -> Result<(), PlannerError> {
        self.planner.begin(info)
    }

    fn plan(&mut self, observation: &Observation) -> Result<Plan, PlannerError> {
        let plan = self.planner.plan(observation)?;
        let points = plan.points().iter();
        let points = points.map(|point| [point.time_s, point.position_m.x, point.position_m.y]);
        let told = observation_json(&Observation {
            readings: &[],
            localization: None,
            privileged: None,
            ..*observation
        });
        let line = json!({
            "step": told["step"], "time_s": told["time_s"], "ego": told["ego"], "guidance": told["guidance"],
            "points": points.collect::<Vec<_>>(),
        });
        writeln!(self.lines, "{line}").expect("a text can be written to");
        Ok(plan)
    }
}

/// Writes the plans of `planner` along `episode` in `site` into `folder`, and returns words on
/// what was written.
pub fn write(
    episode: &Episode,
    site: &Arc<Site>,
    planner: Box<dyn Planner>,
    folder: &Path,
) -> Result<String> {
    let mut watched = Watched {
        planner,
        lines: String::new(),
    };
    let none = |_| Ok::<_, EpisodeError>(Images::new());
    let answers = plans(episode, site, &Rig::default(), &mut watched, none)?;
    write_atomically(&folder.join(FILE), |file| {
        file.write_all(watched.lines.as_bytes())
    })?;
    Ok(format!(
        "plans of {} at {} of {} steps",
        watched.name(),
        answers.iter().flatten().count(),
        answers.len()
    ))
}
