//! A set of agents over a scene.

use std::sync::Arc;

use decouplegs_render::{FrameAgents, FrameSplats};
use decouplegs_scene::{Motion, Pose, ShFrame};

use super::{Scene, SessionError};
use crate::AgentInstance;

/// Agents have ids from 1 to this.
const AGENTS_MAX: usize = u16::MAX as usize;

/// Names that an error lists.
const NAMES_LISTED: usize = 8;

/// An agent of a world.
#[derive(Clone, Debug, PartialEq)]
pub struct WorldAgent {
    /// Unique in the world.
    pub name: String,
    /// Asset and pose.
    pub placed: AgentInstance,
    /// False where the scene file says that it is absent: it is in no image and throws no shadow.
    pub present: bool,
}

/// A set of agents over a scene, which other worlds may be over as well: the background is shared,
/// the agents are not.
#[derive(Clone)]
pub struct World {
    scene: Arc<Scene>,
    agents: Vec<WorldAgent>,
    /// World that it is a view of, until its agents change.
    shared: Option<SharedAgents>,
}

/// Agents of several views of one world, and the one that a view leaves out.
#[derive(Clone)]
pub(super) struct SharedAgents {
    /// Agents that images show, in their order.
    pub all: Arc<[AgentInstance]>,
    /// Instance id of the agent that is left out.
    pub without: u16,
}

impl World {
    /// The agents of the scene file, where they are at time 0.
    #[must_use]
    pub fn new(scene: &Arc<Scene>) -> Self {
        let agent = |agent: &decouplegs_asset::LoadedAgent| WorldAgent {
            name: agent.name.clone(),
            placed: AgentInstance::from_agent(agent, 0.0),
            present: agent.present.includes(0.0),
        };
        Self {
            agents: scene.agents().iter().map(agent).collect(),
            scene: scene.clone(),
            shared: None,
        }
    }

    /// The background alone.
    #[must_use]
    pub fn empty(scene: &Arc<Scene>) -> Self {
        Self {
            agents: Vec::new(),
            scene: scene.clone(),
            shared: None,
        }
    }

    /// The same agents over `scene`, which shows what this world's scene shows, on another device.
    ///
    /// # Errors
    /// Returns an error if `scene` lacks an asset that an agent shows.
    pub fn over(&self, scene: &Arc<Scene>) -> Result<Self, SessionError> {
        let count = scene.asset_count();
        let assets = self.agents.iter().map(|agent| agent.placed.asset);
        if let Some(asset) = assets.into_iter().find(|asset| *asset >= count) {
            return Err(SessionError::NoAsset { asset, count });
        }
        Ok(Self {
            agents: self.agents.clone(),
            scene: scene.clone(),
            shared: None,
        })
    }

    /// The scene that it is over.
    #[must_use]
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// Agents, in the order in which equal depths are rendered, those that are absent included.
    #[must_use]
    pub fn agents(&self) -> &[WorldAgent] {
        &self.agents
    }

    /// Agents that images show and the shadows that they throw, in the light of the scene.
    #[must_use]
    pub fn frame_agents(&self) -> FrameAgents {
        self.scene.lit(&self.present_agents().collect::<Vec<_>>())
    }

    /// Lends what images show to `draw`, as [`Scene::lend`] does.
    pub fn lend<T>(&self, draw: impl FnOnce(FrameSplats<'_>) -> T) -> T {
        self.scene.lend(&self.frame_agents(), draw)
    }

    /// Agents that images show.
    pub(super) fn present_agents(&self) -> impl Iterator<Item = AgentInstance> {
        let present = self.agents.iter().filter(|agent| agent.present);
        present.map(|agent| agent.placed)
    }

    /// Views of this world, one for each of `instances`, without the agent of that id: cameras on
    /// an agent do not see it. In one frame of such views, an agent that several show is lit and
    /// kept on the device once.
    #[must_use]
    pub fn without_each(&self, instances: &[u16]) -> Vec<Self> {
        let all: Arc<[AgentInstance]> = self.present_agents().collect();
        let view = |&without: &u16| {
            let others = self.agents.iter();
            let others = others.filter(|agent| agent.placed.instance != without);
            Self {
                scene: self.scene.clone(),
                agents: others.cloned().collect(),
                shared: Some(SharedAgents {
                    all: all.clone(),
                    without,
                }),
            }
        };
        instances.iter().map(view).collect()
    }

    /// World that it is a view of, if its agents did not change since.
    pub(super) fn shared(&self) -> Option<&SharedAgents> {
        self.shared.as_ref()
    }

    /// Puts the agents of the scene file that are still here where their trajectories have them at
    /// `time_s`. Those that the scene file has not at that time are absent until another time is
    /// set, or they are moved or placed.
    pub fn set_time(&mut self, time_s: f64) {
        self.shared = None;
        for agent in &mut self.agents {
            if let Some(loaded) = self.scene.agent(&agent.name) {
                agent.placed.pose = loaded.trajectory.at(time_s);
                agent.placed.motion = loaded.trajectory.motion_at(time_s);
                agent.present = loaded.present.includes(time_s);
            }
        }
    }

    /// Moves an agent, which is present from now on and stands still; world coordinates of its
    /// origin, the center of its box.
    ///
    /// # Errors
    /// Returns an error if there is none of that name, or it is part of the background.
    pub fn move_to(&mut self, name: &str, pose: Pose) -> Result<(), SessionError> {
        let index = self.index_of(name)?;
        self.shared = None;
        let agent = &mut self.agents[index];
        (agent.placed.pose, agent.placed.motion) = (pose, Motion::REST);
        agent.present = true;
        Ok(())
    }

    /// Sets the motion of an agent, which rolling shutters show, until it is moved or placed or
    /// another time is set.
    ///
    /// # Errors
    /// Returns an error if there is none of that name, or it is part of the background.
    pub fn set_motion(&mut self, name: &str, motion: Motion) -> Result<(), SessionError> {
        let index = self.index_of(name)?;
        self.shared = None;
        self.agents[index].placed.motion = motion;
        Ok(())
    }

    /// Adds an agent that shows `asset`, or lets the one of that name show it. `sh_frame` says how
    /// the asset's colors are meant; `None`: as the asset says. Returns its instance id.
    ///
    /// # Errors
    /// Returns an error if there is no such asset, the name is that of an agent of plain splats, or
    /// there are as many agents as ids.
    pub fn place(
        &mut self,
        name: &str,
        asset: usize,
        pose: Pose,
        sh_frame: Option<ShFrame>,
    ) -> Result<u16, SessionError> {
        self.scene.asset_dims_m(asset)?;
        self.shared = None;
        match self.index_of(name) {
            Ok(index) => {
                let agent = &mut self.agents[index];
                let instance = agent.placed.instance;
                agent.placed = AgentInstance {
                    asset,
                    pose,
                    motion: Motion::REST,
                    sh_frame,
                    instance,
                    shines: false,
                };
                agent.present = true;
                return Ok(instance);
            }
            Err(SessionError::NoAgent { .. }) => {}
            Err(error) => return Err(error),
        }
        let instance = self.free_instance()?;
        self.agents.push(WorldAgent {
            name: name.to_owned(),
            placed: AgentInstance {
                asset,
                pose,
                motion: Motion::REST,
                sh_frame,
                instance,
                shines: false,
            },
            present: true,
        });
        Ok(instance)
    }

    /// Replaces the agents: names, assets and poses. Names have to differ.
    ///
    /// # Errors
    /// Returns an error if there is no such asset, or there are more agents than ids; nothing is
    /// changed then.
    pub fn set_agents(
        &mut self,
        agents: impl IntoIterator<Item = (String, AgentInstance)>,
    ) -> Result<(), SessionError> {
        let agents: Vec<WorldAgent> = agents
            .into_iter()
            .map(|(name, placed)| WorldAgent {
                name,
                placed,
                present: true,
            })
            .collect();
        if agents.len() > AGENTS_MAX {
            return Err(SessionError::TooManyAgents { max: AGENTS_MAX });
        }
        let count = self.scene.asset_count();
        if let Some(agent) = agents.iter().find(|agent| agent.placed.asset >= count) {
            return Err(SessionError::NoAsset {
                asset: agent.placed.asset,
                count,
            });
        }
        self.shared = None;
        self.agents = agents;
        Ok(())
    }

    /// Takes an agent out.
    ///
    /// # Errors
    /// Returns an error if there is none of that name, or it is part of the background.
    pub fn remove(&mut self, name: &str) -> Result<WorldAgent, SessionError> {
        let index = self.index_of(name)?;
        self.shared = None;
        Ok(self.agents.remove(index))
    }

    fn index_of(&self, name: &str) -> Result<usize, SessionError> {
        if let Some(index) = self.agents.iter().position(|agent| agent.name == name) {
            return Ok(index);
        }
        if self.scene.plain_agents().iter().any(|plain| plain == name) {
            return Err(SessionError::PlainSplats {
                name: name.to_owned(),
            });
        }
        let mut there: Vec<&str> = self
            .agents
            .iter()
            .take(NAMES_LISTED)
            .map(|agent| agent.name.as_str())
            .collect();
        if self.agents.len() > NAMES_LISTED {
            there.push("and more");
        }
        let there = if there.is_empty() {
            "none".to_owned()
        } else {
            there.join(", ")
        };
        Err(SessionError::NoAgent {
            name: name.to_owned(),
            there,
        })
    }

    /// One above the highest in use, of this world or of the background; the lowest free one where
    /// that is the highest there is.
    fn free_instance(&self) -> Result<u16, SessionError> {
        let background = self.scene.agents().len() + self.scene.plain_agents().len();
        let mut taken: Vec<u16> = self
            .agents
            .iter()
            .map(|agent| agent.placed.instance)
            .collect();
        taken.sort_unstable();
        let above = taken
            .last()
            .copied()
            .unwrap_or(0)
            .max(background as u16)
            .checked_add(1);
        let gap = || {
            (1..=u16::MAX)
                .skip(background)
                .find(|id| taken.binary_search(id).is_err())
        };
        above
            .or_else(gap)
            .ok_or(SessionError::TooManyAgents { max: AGENTS_MAX })
    }
}
