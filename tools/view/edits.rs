//! Agents of a scene file moved, turned, added and removed, with undo.

use std::cell::OnceCell;
use std::io::Write;
use std::path::{Path, PathBuf};

use decouplegs::asset::scene_file::editing::{delayed, passing, shifted};
use decouplegs::asset::{Replaces, SceneAgent, SceneFile, write_in_folder};
use decouplegs::explain::explain;
use decouplegs::footing::{Footing, dims_of};
use decouplegs::scene::{Pose, Presence};
use decouplegs_cli::progress;
use glam::{DQuat, DVec3};
use serde_json::{Value, json};

use crate::history::History;
use crate::protocol::{Edit, check_name};

/// Room between an agent and its copy behind it, meters.
pub const COPY_GAP_M: f64 = 2.0;
/// Longest shift in time, seconds, and sideways, meters.
const SHIFT_MAX: f64 = 1e4;

/// Scene file that is edited.
pub struct Editor {
    path: PathBuf,
    history: History<SceneFile>,
    /// Assets that the file named when it was opened.
    assets: Vec<PathBuf>,
    /// Files that were written: they may be written again.
    saved: Vec<PathBuf>,
    /// Ground below the agents; none where the background tells of none.
    footing: OnceCell<Option<Footing>>,
}

impl Editor {
    /// The scene file at `path`.
    ///
    /// # Errors
    /// Returns an error if the file is at fault.
    pub fn open(path: &Path) -> anyhow::Result<Self> {
        let file = SceneFile::read(path)?;
        let mut assets: Vec<PathBuf> = Vec::new();
        for agent in &file.agents {
            if !assets.contains(&agent.asset) {
                assets.push(agent.asset.clone());
            }
        }
        Ok(Self {
            path: path.to_owned(),
            history: History::new(file),
            assets,
            saved: Vec::new(),
            footing: OnceCell::new(),
        })
    }

    /// The scene as it is now.
    pub fn file(&self) -> &SceneFile {
        self.history.state()
    }

    /// State to go back to with [`Editor::restore`].
    pub fn history(&self) -> History<SceneFile> {
        self.history.clone()
    }

    /// Goes back to `history`.
    pub fn restore(&mut self, history: History<SceneFile>) {
        self.history = history;
    }

    /// Folder that its paths are relative to.
    pub fn folder(&self) -> &Path {
        self.path.parent().unwrap_or(Path::new(""))
    }

    /// Undo and redo in words, assets to swap to, and the name that [`Edit::Save`] may use, as
    /// JSON.
    pub fn facts(&self) -> Value {
        let stem = self.path.file_stem().unwrap_or_default().to_string_lossy();
        let mut facts = self.history.facts();
        facts["assets"] = json!(self.assets);
        facts["file"] = format!("{stem}-edited.toml").into();
        facts
    }

    /// Makes `edit`, at the time `time_s` of the scene. Returns a sentence for the user, where
    /// there is something to say.
    ///
    /// # Errors
    /// A sentence. Nothing is changed then.
    pub fn apply(&mut self, edit: &Edit, time_s: f64) -> Result<Option<String>, String> {
        let mut file = self.file().clone();
        let change = match edit {
            Edit::Turn { agent, by_rad } => {
                finite("by_rad", *by_rad)?;
                let pose = self.agent(agent)?.trajectory.at(time_s);
                let yaw_rad = pose.heading_rad() + by_rad;
                self.place(&mut file, agent, time_s, pose.translation, yaw_rad)?;
                format!("turn {agent}")
            }
            Edit::Shift {
                agent,
                later_s,
                forward_m,
                left_m,
            } => {
                finite("later_s", *later_s)?;
                finite("forward_m", *forward_m)?;
                finite("left_m", *left_m)?;
                self.shift(&mut file, agent, *later_s, [*forward_m, *left_m])?;
                format!("shift {agent}")
            }
            Edit::Remove { agent } => {
                file.remove_agent(agent)
                    .map_err(|error| error.to_string())?;
                format!("remove {agent}")
            }
            Edit::Duplicate { agent } => {
                let name = self.duplicate(&mut file, agent)?;
                self.history.commit(file, format!("duplicate {agent}"));
                return Ok(Some(format!("{name} stands behind {agent}")));
            }
            Edit::Swap { agent, asset } => {
                let known = (self.assets.iter()).find(|known| known.as_os_str() == asset.as_str());
                let known = known.ok_or_else(|| format!("the scene has no asset {asset:?}"))?;
                self.swap(&mut file, agent, known)?;
                format!("show {agent} as {asset}")
            }
            Edit::Undo => return self.history.undo().map(|()| None),
            Edit::Redo => return self.history.redo().map(|()| None),
            Edit::Save { file } => return self.save(file).map(Some),
        };
        self.history.commit(file, change);
        Ok(None)
    }

    /// Moves the agent called `name` so that it is at `position_m`, its nose towards `yaw_rad`, at
    /// `time_s`, with its wheels on the ground.
    ///
    /// # Errors
    /// A sentence. Nothing is changed then.
    pub fn move_to(
        &mut self,
        name: &str,
        time_s: f64,
        position_m: DVec3,
        yaw_rad: f64,
    ) -> Result<(), String> {
        let mut file = self.file().clone();
        self.place(&mut file, name, time_s, position_m, yaw_rad)?;
        self.history.commit(file, format!("move {name}"));
        Ok(())
    }

    /// Pose that [`Editor::move_to`] would give the agent.
    ///
    /// # Errors
    /// A sentence.
    pub fn pose_at(
        &self,
        name: &str,
        time_s: f64,
        position_m: DVec3,
        yaw_rad: f64,
    ) -> Result<Pose, String> {
        let mut alone = SceneFile {
            agents: vec![self.agent(name)?.clone()],
            ..SceneFile::of_background(&self.file().background)
        };
        self.place(&mut alone, name, time_s, position_m, yaw_rad)?;
        Ok(alone.agents[0].trajectory.at(time_s))
    }

    fn agent(&self, name: &str) -> Result<&SceneAgent, String> {
        self.file().agent(name).map_err(|error| error.to_string())
    }

    fn place(
        &self,
        file: &mut SceneFile,
        name: &str,
        time_s: f64,
        position_m: DVec3,
        yaw_rad: f64,
    ) -> Result<(), String> {
        let trajectory = &self.agent(name)?.trajectory;
        let moved = passing(trajectory, time_s, position_m, yaw_rad);
        let moved = moved.map_err(|error| format!("{name} cannot be moved: {error}"))?;
        let set = file.set_trajectory(name, moved);
        set.map_err(|error| error.to_string())?;
        self.ground(file, name)
    }

    fn shift(
        &self,
        file: &mut SceneFile,
        name: &str,
        later_s: f64,
        [forward_m, left_m]: [f64; 2],
    ) -> Result<(), String> {
        let agent = self.agent(name)?;
        let by = Pose::new(DQuat::IDENTITY, DVec3::new(forward_m, left_m, 0.0));
        let moved = delayed(&agent.trajectory, later_s).and_then(|late| shifted(&late, &by));
        let moved = moved.map_err(|error| format!("{name} cannot be shifted: {error}"))?;
        let intervals = agent.present.intervals_s().iter();
        let present = Presence::new(intervals.map(|ends| ends.map(|s| s + later_s)).collect());
        let present = present.map_err(|error| format!("{name} cannot be shifted: {error}"))?;
        let set =
            (file.set_trajectory(name, moved)).and_then(|()| file.set_presence(name, present));
        set.map_err(|error| error.to_string())?;
        match [forward_m, left_m] == [0.0; 2] {
            true => Ok(()),
            false => self.ground(file, name),
        }
    }

    fn duplicate(&self, file: &mut SceneFile, name: &str) -> Result<String, String> {
        let original = self.agent(name)?;
        let mut copy = original.clone();
        let free = (1..).map(|number| match number {
            1 => format!("{name} copy"),
            number => format!("{name} copy {number}"),
        });
        let mut free = free.filter(|name| file.agent(name).is_err());
        copy.name = free.next().unwrap_or_default();
        let [length_m, ..] = self.dims_m(&original.asset)?;
        let behind = DVec3::new(-length_m - COPY_GAP_M, 0.0, 0.0);
        let moved = shifted(&original.trajectory, &Pose::new(DQuat::IDENTITY, behind));
        copy.trajectory = moved.map_err(|error| format!("{name} cannot be copied: {error}"))?;
        let name = copy.name.clone();
        file.add_agent(copy).map_err(|error| error.to_string())?;
        self.ground(file, &name)?;
        Ok(name)
    }

    fn swap(&self, file: &mut SceneFile, name: &str, asset: &Path) -> Result<(), String> {
        file.swap_asset(name, asset)
            .map_err(|error| error.to_string())?;
        self.ground(file, name)
    }

    /// Puts the wheels of an agent on the ground all along its track, where there is ground.
    fn ground(&self, file: &mut SceneFile, name: &str) -> Result<(), String> {
        let footing = self.footing.get_or_init(|| {
            let background = self.folder().join(&self.file().background);
            let reading = progress::spinner(format!("reading {}", background.display()));
            let footing = Footing::open(self.file(), self.folder()).ok();
            reading.finish_and_clear();
            footing
        });
        let Some(footing) = footing else {
            return Ok(());
        };
        let agent = file.agent(name).map_err(|error| error.to_string())?;
        let set = footing.under(&agent.trajectory, self.dims_m(&agent.asset)?);
        let set = set.map_err(|error| format!("{name} cannot be set on the ground: {error}"))?;
        let set = file.set_trajectory(name, set.trajectory);
        set.map_err(|error| error.to_string())
    }

    fn dims_m(&self, asset: &Path) -> Result<[f64; 3], String> {
        dims_of(&self.folder().join(asset)).map_err(|error| explain(&error))
    }

    fn save(&mut self, name: &str) -> Result<String, String> {
        check_name(name, ".toml")?;
        let path = self.folder().join(name);
        let text = self.file().to_toml().map_err(|error| error.to_string())?;
        save(path, &mut self.saved, text.as_bytes())
    }
}

/// Writes `text` to `path`, through no link, and loses nothing: no file is there, or one of `own`,
/// which `path` is then one of.
///
/// # Errors
/// A sentence.
pub fn save(path: PathBuf, own: &mut Vec<PathBuf>, text: &[u8]) -> Result<String, String> {
    let is_own = own.contains(&path);
    let replaces = match is_own {
        true => Replaces::Anything,
        false => Replaces::Nothing,
    };
    let written = write_in_folder(&path, replaces, |file| file.write_all(text));
    written.map_err(|error| explain(&error))?;
    let said = match is_own {
        true => format!(
            "saved as {}, in place of what was saved before",
            path.display()
        ),
        false => format!("saved as {}", path.display()),
    };
    if !is_own {
        own.push(path);
    }
    Ok(said)
}

fn finite(what: &str, value: f64) -> Result<(), String> {
    match value.abs() <= SHIFT_MAX {
        true => Ok(()),
        false => Err(format!(
            "{what}: expected -{SHIFT_MAX} to {SHIFT_MAX}, found {value}"
        )),
    }
}
