//! A live episode whose scenario is edited: each change begins it anew.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Result;
use decouplegs::episode::{
    LiveEpisode, ObservationRenderer, Site, cameras_of, chosen, chosen_lidars,
};
use decouplegs::explain::explain;
use decouplegs::logs::scenario_file::to_toml;
use decouplegs::planner::{Cameras, Timeouts};
use decouplegs::scene::{Scenario, Sensor};
use decouplegs::session::{Scene, Session};
use decouplegs_alpasim::egodriver::DriverOptions;
use decouplegs_alpasim::planner_name::PlannerName;
use glam::DVec2;
use serde_json::{Value, json};

use crate::edits::{COPY_GAP_M, save};
use crate::history::History;
use crate::lanes::Lanes;
use crate::played::Played;
use crate::protocol::{Edit, check_name};

/// Size of the images that planners see, unless a log or the user says otherwise, pixels: as in
/// `drive`.
const SEEN_PX: [u32; 2] = [320, 180];
/// Ending of the names of scenarios that were edited, so that no score is taken for that of the
/// original.
const EDITED: &str = "-edited";

/// Place of episodes, and its scene on the device.
#[derive(Clone)]
pub struct Place {
    /// Lanes, traffic's assets, obstacles.
    pub site: Arc<Site>,
    /// The scene.
    pub scene: Arc<Scene>,
}

/// Planner of a live episode, and what it is shown if it is a driver of AlpaSim.
#[derive(Clone)]
pub struct LivePlanner {
    /// The planner.
    pub name: PlannerName,
    /// Options for drivers.
    pub driver: DriverOptions,
}

/// Scenario, planner and place of a live episode.
pub struct ScenarioEditor {
    path: PathBuf,
    place: Place,
    planner: LivePlanner,
    size_px: Option<[u32; 2]>,
    history: History<Scenario>,
    /// Files that were written: they may be written again.
    saved: Vec<PathBuf>,
}

impl ScenarioEditor {
    /// `scenario`, from the file or the log at `path`, driven by `planner`, which sees images of
    /// `size_px`.
    pub fn new(
        path: &Path,
        place: Place,
        scenario: Scenario,
        planner: LivePlanner,
        size_px: Option<[u32; 2]>,
    ) -> Self {
        let scenario = Scenario {
            step_s: planner.name.step_s().unwrap_or(scenario.step_s),
            ..scenario
        };
        Self {
            path: path.to_owned(),
            place,
            planner,
            size_px,
            history: History::new(scenario),
            saved: Vec::new(),
        }
    }

    /// Scene of the place.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.place.scene
    }

    /// Title for people.
    pub fn title(&self) -> String {
        format!("{} by {}", self.history.state().name, self.planner.name)
    }

    /// The episode at its start.
    ///
    /// # Errors
    /// Returns an error if the planner cannot be opened, or the scenario does not fit the place.
    pub fn begin(&self, session: &Session) -> Result<Played> {
        let site = &self.place.site;
        let LivePlanner { name, driver } = &self.planner;
        let planner = name.open(Timeouts::default(), driver)?;
        let all = &site.loaded.rig;
        let cameras = cameras_of(planner.as_ref(), Cameras::Front);
        let mut rig = chosen(all, &cameras, Some(self.size_px.unwrap_or(SEEN_PX)))?;
        let lidars = chosen_lidars(all, planner.sees().lidars, &[])?;
        rig.sensors.extend(lidars.into_iter().map(Sensor::Lidar));
        let scene = &self.place.scene;
        let renderer = ObservationRenderer::new(session.batch_renderer(), scene, rig, 1);
        let renderer = name.fit(renderer, driver)?;
        let live = LiveEpisode::begin(self.history.state(), site, planner, renderer)?;
        Ok(Played::live(live, site.clone(), scene)?)
    }

    /// Undo, redo, and the name that [`Edit::Save`] may use, as JSON.
    pub fn facts(&self) -> Value {
        let mut facts = self.history.facts();
        facts["assets"] = json!([]);
        facts["on_lanes"] = true.into();
        let name = &self.history.state().name;
        let stem = name.strip_suffix(EDITED).unwrap_or(name);
        facts["file"] = format!("{stem}{EDITED}.toml").into();
        facts
    }

    /// Makes `edit`. Returns a sentence for the user, where there is something to say, and the
    /// episode that begins anew, where something was changed.
    ///
    /// # Errors
    /// A sentence. Nothing is changed then.
    pub fn apply(
        &mut self,
        edit: &Edit,
        session: &Session,
    ) -> Result<(Option<String>, Option<Played>), String> {
        if let Edit::Save { file } = edit {
            return Ok((Some(self.save(file)?), None));
        }
        let before = self.history.clone();
        let said = self.change(edit)?;
        Ok((said, Some(self.begin_or(before, session)?)))
    }

    /// Lets the vehicle called `name` start on the lane at `at_m`.
    ///
    /// # Errors
    /// A sentence. Nothing is changed then.
    pub fn move_to(
        &mut self,
        name: &str,
        at_m: DVec2,
        lanes: &Lanes,
        session: &Session,
    ) -> Result<Played, String> {
        let on_lane = lanes.lane_at(at_m);
        let (lane, along_m) = on_lane.ok_or("there is no lane: vehicles start on lanes")?;
        let before = self.history.clone();
        let mut scenario = self.history.state().clone();
        let agent = vehicle(&mut scenario, name)?;
        (agent.lane, agent.at_m) = (lane.to_owned(), along_m);
        self.commit(scenario, format!("move {name}"));
        self.begin_or(before, session)
    }

    fn begin_or(&mut self, before: History<Scenario>, session: &Session) -> Result<Played, String> {
        self.begin(session).map_err(|error| {
            self.history = before;
            explain(error.as_ref())
        })
    }

    fn commit(&mut self, mut scenario: Scenario, change: String) {
        if !scenario.name.ends_with(EDITED) {
            scenario.name.push_str(EDITED);
        }
        self.history.commit(scenario, change);
    }

    fn change(&mut self, edit: &Edit) -> Result<Option<String>, String> {
        let mut scenario = self.history.state().clone();
        match edit {
            Edit::Undo => self.history.undo().map(|()| None),
            Edit::Redo => self.history.redo().map(|()| None),
            Edit::Remove { agent: name } => {
                let before = scenario.agent_count();
                scenario.agents.retain(|agent| agent.name != *name);
                scenario.pedestrians.retain(|walker| walker.name != *name);
                if scenario.agent_count() == before {
                    return Err(format!("the scenario has no road user {name:?}"));
                }
                self.commit(scenario, format!("remove {name}"));
                Ok(None)
            }
            Edit::Duplicate { agent: name } => {
                let mut copy = vehicle(&mut scenario, name)?.clone();
                let names: Vec<String> = (scenario.agents.iter().map(|a| &a.name))
                    .chain(scenario.pedestrians.iter().map(|walker| &walker.name))
                    .cloned()
                    .collect();
                let mut free = (1..).map(|number| format!("{name}_copy{number}"));
                let free = free.find(|name| !names.contains(name));
                copy.name = free.unwrap_or_default();
                copy.at_m -= copy.size.length_m + COPY_GAP_M;
                let said = format!("{} starts behind {name}", copy.name);
                scenario.agents.push(copy);
                self.commit(scenario, format!("duplicate {name}"));
                Ok(Some(said))
            }
            Edit::Shift {
                agent: name,
                forward_m,
                left_m: 0.0,
                later_s: 0.0,
            } if forward_m.abs() < 1e4 => {
                vehicle(&mut scenario, name)?.at_m += forward_m;
                self.commit(scenario, format!("shift {name}"));
                Ok(None)
            }
            _ => Err("vehicles of a scenario start along their lanes: drag them, or move them forward and back".into()),
        }
    }

    fn save(&mut self, file: &str) -> Result<String, String> {
        check_name(file, ".toml")?;
        let path = self.path.with_file_name(file);
        let text = to_toml(self.history.state()).map_err(|error| explain(&error))?;
        save(path, &mut self.saved, text.as_bytes())
    }
}

fn vehicle<'a>(
    scenario: &'a mut Scenario,
    name: &str,
) -> Result<&'a mut decouplegs::scene::scenario::TrafficAgent, String> {
    let mut agents = scenario.agents.iter_mut();
    let agent = agents.find(|agent| agent.name == name);
    agent.ok_or_else(|| {
        format!("the scenario has no vehicle {name:?}: pedestrians, lamps and signs are edited in its file")
    })
}
