//! From a scene file to a world and its agents.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use decouplegs_scene::{CodedCloud, Pose, Rig, ShFrame, SplatCloud, Trajectory, World};

use super::{SceneAgent, SceneFile};
use crate::{AssetError, coded_asset, read_coded, read_splats};

/// A scene, ready to be drawn: what stands still at one moment, and what is moved from frame to frame.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadedScene {
    /// Background, and the agents whose assets are plain splat files as they stand at the moment asked for. Each plain
    /// file's splats are in spatial order.
    pub world: World,
    /// Compressed assets (`.safetensors`), each file once.
    pub assets: Vec<CodedCloud>,
    /// The agents that show them, in the order of the scene file.
    pub agents: Vec<LoadedAgent>,
    /// The ego vehicle's cameras; none for a splat file.
    pub rig: Rig,
    /// Where the ego vehicle is when, world coordinates.
    pub ego: Trajectory,
    /// Names of all agents of both kinds; the instance id of agent `i` is `i + 1`.
    pub agent_names: Vec<String>,
}

/// An agent that shows a compressed asset.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadedAgent {
    /// Names the agent; unique in the scene.
    pub name: String,
    /// Which of [`LoadedScene::assets`] it shows.
    pub asset: usize,
    /// Its instance id, from 1: its place among all agents of the scene file.
    pub instance: u16,
    /// How the asset's colours are meant.
    pub sh_frame: ShFrame,
    /// Where it is when, world coordinates.
    pub trajectory: Trajectory,
}

impl LoadedScene {
    /// A scene of background only, without cameras.
    fn of_world(world: World) -> Self {
        Self {
            world,
            assets: Vec::new(),
            agents: Vec::new(),
            rig: Rig::default(),
            ego: Trajectory::standing(Pose::IDENTITY),
            agent_names: Vec::new(),
        }
    }

    /// The uncompressed twin: [`LoadedScene::world`] with the finest level of every agent added where it is at `time_s`, in
    /// order. What was in the world already stays as it stands.
    #[must_use]
    pub fn baked(&self, time_s: f64) -> World {
        let mut world = self.world.clone();
        let decoded: Vec<SplatCloud> = self.assets.iter().map(|asset| asset.decoded(0)).collect();
        for agent in &self.agents {
            world.bake_instance(&decoded[agent.asset], &agent.trajectory.at(time_s), agent.sh_frame, agent.instance);
        }
        world
    }
}

impl SceneFile {
    /// Loads background and agents, whose paths are relative to `directory`. Agents of plain splat files stand where they
    /// are at `time_s`.
    ///
    /// # Errors
    /// [`AssetError`] of the file at fault, or when there are more agents than ids.
    pub fn load(&self, directory: &Path, time_s: f64) -> Result<LoadedScene, AssetError> {
        let background = read_in_spatial_order(&directory.join(&self.background))?;
        let mut scene =
            LoadedScene::of_world(World { origin: self.origin, sky: self.sky, rules: self.rules, ..World::of(background) });
        let mut loader = AgentLoader { directory, time_s, plain: HashMap::new(), coded: HashMap::new() };
        for (index, agent) in self.agents.iter().enumerate() {
            let instance = u16::try_from(index + 1).map_err(|_| {
                AssetError::Placement(format!("agent {}: more than {} agents in one world", agent.name, u16::MAX))
            })?;
            loader.add(&mut scene, agent, instance)?;
        }
        scene.rig = self.rig.clone();
        let standing = || Trajectory::standing(Pose { translation: self.origin, ..Pose::IDENTITY });
        scene.ego = self.ego.clone().unwrap_or_else(standing);
        scene.agent_names = self.agents.iter().map(|agent| agent.name.clone()).collect();
        Ok(scene)
    }
}

/// Adds agents to a scene. Many may show one asset: it is read once.
struct AgentLoader<'a> {
    directory: &'a Path,
    time_s: f64,
    plain: HashMap<PathBuf, SplatCloud>,
    /// Places in [`LoadedScene::assets`].
    coded: HashMap<PathBuf, usize>,
}

impl AgentLoader<'_> {
    fn add(&mut self, scene: &mut LoadedScene, agent: &SceneAgent, instance: u16) -> Result<(), AssetError> {
        let path = self.directory.join(&agent.asset);
        if !coded_asset::has_extension(&path) {
            if !self.plain.contains_key(&path) {
                self.plain.insert(path.clone(), read_in_spatial_order(&path)?);
            }
            let pose = agent.trajectory.at(self.time_s);
            scene.world.bake_instance(&self.plain[&path], &pose, agent.sh_frame.unwrap_or_default(), instance);
            return Ok(());
        }
        let asset = match self.coded.get(&path) {
            Some(&asset) => asset,
            None => {
                scene.assets.push(read_coded(&path)?.cloud);
                self.coded.insert(path, scene.assets.len() - 1);
                scene.assets.len() - 1
            }
        };
        scene.agents.push(LoadedAgent {
            name: agent.name.clone(),
            asset,
            instance,
            sh_frame: agent.sh_frame.unwrap_or(scene.assets[asset].sh_frame),
            trajectory: agent.trajectory.clone(),
        });
        Ok(())
    }
}

/// Opens what a user calls a scene: a scene file (`.toml`), loaded as at `time_s`, or a splat file, which becomes a world
/// of background only, its origin at zero, without cameras.
///
/// # Errors
/// [`AssetError`] of the file at fault.
pub fn open_scene(path: &Path, time_s: f64) -> Result<LoadedScene, AssetError> {
    if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("toml")) {
        let directory = path.parent().unwrap_or(Path::new(""));
        return SceneFile::read(path)?.load(directory, time_s);
    }
    Ok(LoadedScene::of_world(World::of(read_in_spatial_order(path)?)))
}

/// Neighbours in memory are neighbours in space, so that runs of splats can be culled together.
fn read_in_spatial_order(path: &Path) -> Result<SplatCloud, AssetError> {
    let cloud = read_splats(path)?;
    Ok(cloud.select(&cloud.spatial_order()))
}
