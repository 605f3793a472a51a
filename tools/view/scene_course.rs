//! Scene with its tracks, whose agents may be edited.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result};
use decouplegs::asset::{
    LoadedAgent, LoadedScene, SceneAgent, SceneFile, coded_asset, is_scene_file, read_map,
};
use decouplegs::explain::explain;
use decouplegs::scene::{Pose, Trajectory};
use decouplegs::session::{AgentInstance, Scene, Session};
use decouplegs_cli::scene_source::{DrawInput, absolute};
use glam::DVec3;
use serde_json::Value;

use crate::edits::Editor;
use crate::history::History;
use crate::lanes::Lanes;
use crate::protocol::Edit;

/// Lanes that are shown with a scene that has them beside it.
const LANES_FILE: &str = "lanes.json";

/// Scene, its lanes, and its edits.
pub struct SceneCourse {
    /// Scene as it is on the device.
    pub input: DrawInput,
    /// File that it was read from, as it is typed.
    typed_path: String,
    /// Agents that move, as they were edited.
    agents: Vec<LoadedAgent>,
    /// Places of compressed assets in the scene, by path.
    assets: AssetPlaces,
    /// None for splats and packages.
    editor: Option<Editor>,
    lanes: Option<Lanes>,
    /// Agent that is dragged, and its pose.
    dragged: Option<(String, Pose)>,
}

/// Agent with its box.
pub struct Boxed {
    /// Name of the agent.
    pub name: String,
    /// Instance id.
    pub instance: u16,
    /// Class, where it is known.
    pub class: Option<String>,
    /// Pose of the center of the box.
    pub pose: Pose,
    /// Length, width and height, meters.
    pub size_m: [f32; 3],
    /// Speed, meters per second.
    pub speed_mps: f64,
    /// True for plain splats, which stand still.
    pub fixed: bool,
    /// Asset of the scene that it shows; none for plain splats.
    pub asset: Option<usize>,
}

impl SceneCourse {
    /// `input`, which was read from `path`, with the lanes of `map` or those beside it.
    ///
    /// # Errors
    /// Returns an error if a file is at fault.
    pub fn new(input: DrawInput, path: &Path, map: Option<&Path>) -> Result<Self> {
        let editor = is_scene_file(path)
            .then(|| Editor::open(path))
            .transpose()?;
        let beside = path.with_file_name(LANES_FILE);
        let map = map.or(Some(beside.as_path()).filter(|lanes| editor.is_some() && lanes.exists()));
        let lanes = map.map(|map| read_map(map).context("the lanes are not usable"));
        Ok(Self {
            agents: input.loaded.agents.clone(),
            assets: (editor.as_ref()).map_or_else(AssetPlaces::default, |editor| {
                AssetPlaces::for_file(editor.file())
            }),
            input,
            typed_path: absolute(path),
            editor,
            lanes: lanes.transpose()?.map(Lanes::new),
            dragged: None,
        })
    }

    /// `input`, which was read from splats that a page sent as `name`: no folder is known.
    pub fn dropped(input: DrawInput, name: &str) -> Self {
        Self {
            agents: input.loaded.agents.clone(),
            assets: AssetPlaces::default(),
            input,
            // A command takes what begins with a dash for an option.
            typed_path: if name.starts_with('-') {
                format!("./{name}")
            } else {
                name.to_owned()
            },
            editor: None,
            lanes: None,
            dragged: None,
        }
    }

    /// File that it was read from, as it is typed in any folder; where a page sent it, in its own.
    pub fn typed_path(&self) -> String {
        self.typed_path.clone()
    }

    /// True if agents are not those of the file.
    pub fn is_edited(&self) -> bool {
        self.edit_facts()["undo"].is_string()
    }

    /// Width and height that the camera called `name` has by itself, pixels.
    pub fn own_size_px(&self, name: &str) -> Option<[u32; 2]> {
        let mut cameras = self.input.cameras.iter();
        let camera = cameras.find(|camera| camera.name == name)?;
        Some([camera.intrinsics.width_px, camera.intrinsics.height_px])
    }

    /// Trajectories of the ego and the agents that move.
    pub fn trajectories(&self) -> impl Iterator<Item = &Trajectory> {
        let agents = self.agents.iter().map(|agent| &agent.trajectory);
        agents.chain([&self.input.loaded.ego])
    }

    /// Agents that move and are present at `time_s`.
    pub fn agents_at(&self, time_s: f64) -> Vec<(String, AgentInstance)> {
        let present = self
            .agents
            .iter()
            .filter(|agent| agent.present.includes(time_s));
        let placed = present.map(|agent| {
            let mut placed = AgentInstance::from_agent(agent, time_s);
            if let Some((_, pose)) = self
                .dragged
                .as_ref()
                .filter(|(name, _)| *name == agent.name)
            {
                placed.pose = *pose;
            }
            (agent.name.clone(), placed)
        });
        placed.collect()
    }

    /// All agents at `time_s` with their boxes; those of plain splats where they are drawn.
    pub fn boxes_at(&self, time_s: f64) -> Vec<Boxed> {
        let loaded = &self.input.loaded;
        let moving = self
            .agents_at(time_s)
            .into_iter()
            .map(|(name, placed)| Boxed {
                class: self.class_of(&name),
                name,
                instance: placed.instance,
                pose: placed.pose,
                size_m: loaded.assets[placed.asset].dims_m,
                speed_mps: placed.motion.velocity_mps.length(),
                fixed: false,
                asset: Some(placed.asset),
            });
        let fixed = loaded.plain_agents.iter().map(|agent| {
            let label = &loaded.agent_labels[usize::from(agent.instance) - 1];
            let dragged = self
                .dragged
                .as_ref()
                .filter(|(name, _)| *name == label.name);
            Boxed {
                name: label.name.clone(),
                class: label.class.clone(),
                instance: agent.instance,
                pose: dragged.map_or(agent.pose, |(_, pose)| *pose),
                size_m: agent.dims_m,
                speed_mps: 0.0,
                fixed: true,
                asset: None,
            }
        });
        moving.chain(fixed).collect()
    }

    fn class_of(&self, name: &str) -> Option<String> {
        if let Some(editor) = &self.editor {
            return editor.file().agent(name).ok()?.class.clone();
        }
        let mut labels = self.input.loaded.agent_labels.iter();
        labels.find(|label| label.name == name)?.class.clone()
    }

    /// Undo, redo and assets, as JSON; null where nothing can be edited.
    pub fn edit_facts(&self) -> Value {
        (self.editor.as_ref()).map_or(Value::Null, Editor::facts)
    }

    /// Lanes about the agents and the ego, as lines.
    pub fn lane_lines(&self) -> Vec<Vec<[f64; 3]>> {
        let Some(lanes) = &self.lanes else {
            return Vec::new();
        };
        let poses = self
            .trajectories()
            .flat_map(|trajectory| trajectory.poses());
        let fixed = self.input.loaded.plain_agents.iter();
        let fixed = fixed.map(|agent| agent.pose.translation);
        lanes.lines_about(poses.map(|timed| timed.pose.translation).chain(fixed))
    }

    /// Makes `edit` at `time_s`. Returns a sentence for the user, and the scene on the device where
    /// that changed.
    ///
    /// # Errors
    /// A sentence. Nothing is changed then.
    pub fn edit(
        &mut self,
        edit: &Edit,
        time_s: f64,
        session: &Session,
    ) -> Result<(Option<String>, Option<Arc<Scene>>), String> {
        let editor = self.editor.as_mut().ok_or(NOT_EDITABLE)?;
        let before = editor.history();
        let said = editor.apply(edit, time_s)?;
        if matches!(edit, Edit::Save { .. }) {
            return Ok((said, None));
        }
        Ok((said, self.follow(before, session)?))
    }

    /// Moves the agent called `name` by `by_m`, or to the middle of the lane there unless `free`.
    /// As long as it is not `done`, only its box and, where it can be moved, its image follow.
    ///
    /// # Errors
    /// A sentence. Nothing is changed then.
    pub fn drag(
        &mut self,
        name: &str,
        (by_m, free, done): (DVec3, bool, bool),
        time_s: f64,
        session: &Session,
    ) -> Result<Option<Arc<Scene>>, String> {
        let editor = self.editor.as_mut().ok_or(NOT_EDITABLE)?;
        let agent = editor
            .file()
            .agent(name)
            .map_err(|error| error.to_string())?;
        let pose = agent.trajectory.at(time_s);
        let mut position_m = pose.translation + by_m;
        let mut yaw_rad = pose.heading_rad();
        let lanes = self.lanes.as_ref().filter(|_| !free);
        if let Some((at, heading_rad)) =
            lanes.and_then(|lanes| lanes.snapped(position_m.truncate()))
        {
            (position_m.x, position_m.y, yaw_rad) = (at.x, at.y, heading_rad);
        }
        if !done {
            let pose = editor.pose_at(name, time_s, position_m, yaw_rad)?;
            self.dragged = Some((name.to_owned(), pose));
            return Ok(None);
        }
        self.dragged = None;
        let before = editor.history();
        editor.move_to(name, time_s, position_m, yaw_rad)?;
        self.follow(before, session)
    }

    /// Forgets where an agent is dragged to.
    pub fn end_drag(&mut self) {
        self.dragged = None;
    }

    /// Pose of an agent at `time_s`, before it is dragged.
    pub fn pose_of(&self, name: &str, time_s: f64) -> Option<Pose> {
        let editor = self.editor.as_ref()?;
        let agent = editor.file().agent(name).ok()?;
        Some(agent.trajectory.at(time_s))
    }

    /// Brings agents, and the device where it must, to the state of the editor. On an error the
    /// editor goes back to `before`.
    fn follow(
        &mut self,
        before: History<SceneFile>,
        session: &Session,
    ) -> Result<Option<Arc<Scene>>, String> {
        let Some(editor) = self.editor.as_mut() else {
            return Ok(None);
        };
        let file = editor.file();
        let is_lit = self.input.loaded.light.is_some();
        if !is_lit
            && plain(before.state()) == plain(file)
            && let Some(agents) = self.assets.agents(file, &self.input.loaded)
        {
            self.agents = agents;
            return Ok(None);
        }
        // Plain splats are part of the background, and light is baked along tracks.
        let loaded = file.load(editor.folder(), self.input.time_s);
        let copied = loaded.map_err(anyhow::Error::from).and_then(|loaded| {
            let changed = self.input.changed(loaded);
            Ok((session.add_scene(&changed.loaded)?, changed))
        });
        match copied {
            Ok((on_device, changed)) => {
                self.assets = AssetPlaces::for_file(file);
                self.agents = changed.loaded.agents.clone();
                self.input = changed;
                Ok(Some(on_device))
            }
            Err(error) => {
                editor.restore(before);
                Err(explain(error.as_ref()))
            }
        }
    }
}

const NOT_EDITABLE: &str = "only agents of scene files (.toml) can be edited";

/// Agents of plain splats, and their places in the file.
fn plain(file: &SceneFile) -> Vec<(usize, &SceneAgent)> {
    let agents = file.agents.iter().enumerate();
    let plain = agents.filter(|(_, agent)| !coded_asset::has_extension(&agent.asset));
    plain.collect()
}

/// Places of the compressed assets of a loaded scene, by path.
#[derive(Default)]
struct AssetPlaces(HashMap<PathBuf, usize>);

impl AssetPlaces {
    /// Places of the assets of `file` once it is loaded.
    fn for_file(file: &SceneFile) -> Self {
        let mut places = HashMap::new();
        for SceneAgent { asset, .. } in &file.agents {
            if coded_asset::has_extension(asset) && !places.contains_key(asset) {
                places.insert(asset.clone(), places.len());
            }
        }
        Self(places)
    }

    /// Agents of `file` that move; `None` where `loaded` has not all their assets.
    fn agents(&self, file: &SceneFile, loaded: &LoadedScene) -> Option<Vec<LoadedAgent>> {
        let agents = file.agents.iter().zip(1..=u16::MAX);
        let coded = agents.filter(|(agent, _)| coded_asset::has_extension(&agent.asset));
        let placed = coded.map(|(agent, instance)| {
            let asset = *self.0.get(&agent.asset)?;
            Some(LoadedAgent {
                name: agent.name.clone(),
                asset,
                instance,
                sh_frame: agent.sh_frame.unwrap_or(loaded.assets[asset].sh_frame),
                trajectory: agent.trajectory.clone(),
                present: agent.present.clone(),
            })
        });
        placed.collect()
    }
}
