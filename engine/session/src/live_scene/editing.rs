//! A scene edited while it is shown: the next frame shows it as it is then.

use decouplegs_asset::scene_file::places_along;
use decouplegs_asset::{EditError, LoadedAgent};
use decouplegs_render::RenderError;
use decouplegs_scene::{CodedCloud, ShFrame, Trajectory};
use thiserror::Error;

use super::{LiveAsset, LiveScene};

/// Reason why a scene on the device could not be edited. It is as it was.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum LiveEditError {
    /// Error that a scene file would report too.
    #[error(transparent)]
    Edit(#[from] EditError),
    /// The agent is splats of the world, which stay on the device as they were loaded.
    #[error(
        "agent {name:?} is of plain splats, which are part of the world once it is loaded; edit the scene file and load it again, \
         or compress the agent's asset"
    )]
    PlainSplats {
        /// The agent that was to be edited.
        name: String,
    },
    /// The scene has no such asset.
    #[error(
        "agent {name:?} cannot show asset {asset}: the scene has {count}, counted from 0; add it first"
    )]
    NoAsset {
        /// The agent that was to show it.
        name: String,
        /// The asset asked for.
        asset: usize,
        /// Assets that there are.
        count: usize,
    },
}

impl LiveScene {
    /// The agents that can be edited, in the order in which equal depths are drawn.
    #[must_use]
    pub fn agents(&self) -> &[LoadedAgent] {
        &self.agents
    }

    /// Names of the agents that are splats of the world.
    pub(crate) fn plain_agents(&self) -> impl Iterator<Item = &str> {
        self.plain_agents.iter().map(|(name, _)| name.as_str())
    }

    /// Copies another asset to the device; returns its number, by which agents are told to show it.
    ///
    /// # Errors
    /// Returns an error if the device has not the memory, or the asset cannot be drawn.
    pub fn add_asset(&mut self, asset: &CodedCloud) -> Result<usize, RenderError> {
        let id = self.pool.add(asset)?;
        self.assets.push(LiveAsset {
            id,
            dims_m: asset.dims_m,
            sh_frame: asset.sh_frame,
        });
        Ok(self.assets.len() - 1)
    }

    /// Adds an agent behind all others, and sums up the light along its way. Its instance id, which
    /// is returned, is one above the highest in use, or the lowest free one where that is the
    /// highest there is. `sh_frame` says how the asset's colors are meant; `None`: as the asset
    /// says.
    ///
    /// # Errors
    /// Returns an error if the name is empty or taken, there is no such asset, or there are as many
    /// agents as ids.
    pub fn add_agent(
        &mut self,
        name: &str,
        asset: usize,
        sh_frame: Option<ShFrame>,
        trajectory: Trajectory,
    ) -> Result<u16, LiveEditError> {
        if name.is_empty() {
            return Err(EditError::NoName.into());
        }
        if self.names().any(|other| other == name) {
            return Err(EditError::NameTaken {
                name: name.to_owned(),
            }
            .into());
        }
        let sh_frame = sh_frame.unwrap_or(self.asset_for(name, asset)?.sh_frame);
        let instance = self.free_instance(name)?;
        self.bake_light(places_along(&trajectory, self.light_step_m));
        self.agents.push(LoadedAgent {
            name: name.to_owned(),
            asset,
            instance,
            sh_frame,
            trajectory,
        });
        Ok(instance)
    }

    /// Takes the agent called `name` out. The others keep their instance ids, and its asset stays
    /// on the device.
    ///
    /// # Errors
    /// Returns an error if there is no such agent, or it is of plain splats.
    pub fn remove_agent(&mut self, name: &str) -> Result<LoadedAgent, LiveEditError> {
        let place = self.place_of(name)?;
        Ok(self.agents.remove(place))
    }

    /// Lets the agent called `name` follow `trajectory`, world coordinates, and sums up the light
    /// along it. `decouplegs_asset::scene_file::editing` moves trajectories.
    ///
    /// # Errors
    /// Returns an error if there is no such agent, or it is of plain splats.
    pub fn set_trajectory(
        &mut self,
        name: &str,
        trajectory: Trajectory,
    ) -> Result<(), LiveEditError> {
        let place = self.place_of(name)?;
        self.bake_light(places_along(&trajectory, self.light_step_m));
        self.agents[place].trajectory = trajectory;
        Ok(())
    }

    /// Lets the agent called `name` show another asset, whose colors are meant as it says itself.
    /// Its pose stays.
    ///
    /// # Errors
    /// Returns an error if there is no such agent or asset, or the agent is of plain splats.
    pub fn swap_asset(&mut self, name: &str, asset: usize) -> Result<(), LiveEditError> {
        let place = self.place_of(name)?;
        let sh_frame = self.asset_for(name, asset)?.sh_frame;
        self.agents[place] = LoadedAgent {
            asset,
            sh_frame,
            ..self.agents[place].clone()
        };
        Ok(())
    }

    fn names(&self) -> impl Iterator<Item = &str> {
        self.agents
            .iter()
            .map(|agent| agent.name.as_str())
            .chain(self.plain_agents())
    }

    fn place_of(&self, name: &str) -> Result<usize, LiveEditError> {
        if self.plain_agents.iter().any(|(plain, _)| plain == name) {
            return Err(LiveEditError::PlainSplats {
                name: name.to_owned(),
            });
        }
        let place = self.agents.iter().position(|agent| agent.name == name);
        place.ok_or_else(|| EditError::no_agent(name, self.names()).into())
    }

    fn asset_for(&self, name: &str, asset: usize) -> Result<&LiveAsset, LiveEditError> {
        let count = self.assets.len();
        self.assets
            .get(asset)
            .ok_or_else(|| LiveEditError::NoAsset {
                name: name.to_owned(),
                asset,
                count,
            })
    }

    fn free_instance(&self, name: &str) -> Result<u16, LiveEditError> {
        let moving = self.agents.iter().map(|agent| agent.instance);
        let mut taken: Vec<u16> = moving
            .chain(self.plain_agents.iter().map(|(_, instance)| *instance))
            .collect();
        taken.sort_unstable();
        let above = taken.last().map_or(Some(1), |last| last.checked_add(1));
        // Ids in use are sorted and differ: the first that is not its place is above a gap.
        let gap = || {
            (1..=u16::MAX)
                .zip(&taken)
                .find_map(|(id, taken)| (id != *taken).then_some(id))
        };
        let full = || EditError::TooMany {
            name: name.to_owned(),
            max: usize::from(u16::MAX),
        };
        Ok(above.or_else(gap).ok_or_else(full)?)
    }
}
