//! From a scene file to a world.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use decouplegs_scene::{AgentPlacement, Pose, Rig, SplatCloud, Trajectory, World};

use super::SceneFile;
use crate::{AssetError, read_splats};

/// A scene at one moment, ready to be drawn.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadedScene {
    /// Background and agents, as they stand at the moment asked for. Each asset's splats are in spatial order.
    pub world: World,
    /// The ego vehicle's cameras; none for a splat file.
    pub rig: Rig,
    /// Where the ego vehicle is when, world coordinates.
    pub ego: Trajectory,
    /// Names of the agents; the instance id of agent `i` is `i + 1`.
    pub agent_names: Vec<String>,
}

impl SceneFile {
    /// Loads background and agents, whose paths are relative to `directory`, with the agents where they are at `time_s`.
    ///
    /// # Errors
    /// [`AssetError`] of the file at fault, or when there are more agents than ids.
    pub fn load(&self, directory: &Path, time_s: f64) -> Result<LoadedScene, AssetError> {
        let mut world = World {
            origin: self.origin,
            sky: self.sky,
            rules: self.rules,
            ..World::of(read_in_spatial_order(&directory.join(&self.background))?)
        };
        // Many agents may show one asset: it is read once.
        let mut assets: Vec<SplatCloud> = Vec::new();
        let mut asset_of_path: HashMap<PathBuf, usize> = HashMap::new();
        for agent in &self.agents {
            let path = directory.join(&agent.asset);
            let asset = match asset_of_path.get(&path) {
                Some(&asset) => asset,
                None => {
                    assets.push(read_in_spatial_order(&path)?);
                    asset_of_path.insert(path, assets.len() - 1);
                    assets.len() - 1
                }
            };
            let placement = AgentPlacement {
                name: agent.name.clone(),
                asset,
                world_from_agent: agent.trajectory.at(time_s),
                sh_frame: agent.sh_frame,
            };
            world.bake_agent(&assets[asset], &placement).map_err(AssetError::Placement)?;
        }
        let ego = self.ego.clone().unwrap_or_else(|| Trajectory::standing(Pose { translation: self.origin, ..Pose::IDENTITY }));
        let agent_names = self.agents.iter().map(|agent| agent.name.clone()).collect();
        Ok(LoadedScene { world, rig: self.rig.clone(), ego, agent_names })
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
    Ok(LoadedScene {
        world: World::of(read_in_spatial_order(path)?),
        rig: Rig::default(),
        ego: Trajectory::standing(Pose::IDENTITY),
        agent_names: Vec::new(),
    })
}

/// Neighbours in memory are neighbours in space, so that runs of splats can be culled together.
fn read_in_spatial_order(path: &Path) -> Result<SplatCloud, AssetError> {
    let cloud = read_splats(path)?;
    Ok(cloud.select(&cloud.spatial_order()))
}
