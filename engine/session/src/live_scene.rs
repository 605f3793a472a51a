//! A scene on the device, its agents moved by their trajectories.

use std::collections::HashSet;

use decouplegs_asset::{Layer, LoadedAgent, LoadedScene};
use decouplegs_render::{
    Agent, AssetId, AssetPool, FrameAgents, FrameSplats, RenderError, Renderer, ResidentSplats,
};
use decouplegs_scene::light::Lighting;
use decouplegs_scene::{CodedCloud, Motion, Pose, ShFrame};
use glam::DVec3;

/// A loaded scene on the device: what a loop of frames needs of it.
///
/// ```no_run
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use std::path::Path;
///
/// use decouplegs_session::LiveScene;
/// use decouplegs_asset::open_scene;
/// use decouplegs_gpu::{DeviceOptions, Gpu};
/// use decouplegs_render::{RenderOptions, Renderer};
///
/// let gpu = Gpu::open(&DeviceOptions::default())?;
/// let mut renderer = Renderer::new(&gpu, RenderOptions::default());
/// let loaded = open_scene(Path::new("street/scene.toml"), 0.0)?;
/// let live = LiveScene::new(&renderer, &loaded)?;
/// for step in 0..100 {
///     let time_s = 0.033 * f64::from(step);
///     let cameras = loaded.rig.driving(&loaded.ego, time_s);
///     let statistics = renderer.render(live.with(&live.at(time_s)), &cameras)?;
///     println!("{:?} {:?}", statistics.gpu_time, statistics.keys);
///     let images = renderer.read_images()?;
/// }
/// # Ok(())
/// # }
/// ```
pub struct LiveScene {
    /// The background.
    pub background: ResidentSplats,
    /// The agents' assets.
    pub pool: AssetPool,
    assets: Vec<LiveAsset>,
    agents: Vec<LoadedAgent>,
    /// Names of agents that are splats of the world.
    plain_agents: Vec<String>,
    lighting: Option<Lighting>,
}

/// An asset on the device.
#[derive(Clone, Copy)]
struct LiveAsset {
    id: AssetId,
    dims_m: [f32; 3],
    sh_frame: ShFrame,
}

/// Agent instance: an asset and a pose in a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AgentInstance {
    /// Index of its asset in [`LoadedScene::assets`].
    pub asset: usize,
    /// Pose, world coordinates.
    pub pose: Pose,
    /// Motion, which rolling shutters show.
    pub motion: Motion,
    /// Frame of the asset's colors; `None`: as the asset says.
    pub sh_frame: Option<ShFrame>,
    /// Instance id, above zero.
    pub instance: u16,
    /// True if it shines by itself: it keeps its colors in any light and throws no shadow.
    pub shines: bool,
}

impl AgentInstance {
    /// `agent` at `time_s` of its trajectory.
    #[must_use]
    pub fn from_agent(agent: &LoadedAgent, time_s: f64) -> Self {
        Self {
            asset: agent.asset,
            pose: agent.trajectory.at(time_s),
            motion: agent.trajectory.motion_at(time_s),
            sh_frame: Some(agent.sh_frame),
            instance: agent.instance,
            shines: false,
        }
    }
}

impl LiveScene {
    /// Copies background and assets of `loaded` to the device of `renderer`, and sums up its light
    /// where agents drive.
    ///
    /// # Errors
    /// Returns an error if the device has not the memory, or an asset cannot be drawn.
    pub fn new(renderer: &Renderer, loaded: &LoadedScene) -> Result<Self, RenderError> {
        Self::layer(renderer, loaded, Layer::All)
    }

    /// [`LiveScene::new`], of what belongs to `layer`: all, the background without agents and their
    /// shadows, or the agents over nothing, in the light of the background.
    ///
    /// Agents alone still have shadows in their [`FrameAgents`]: these lie on agents of plain
    /// splats, as in the full image.
    ///
    /// # Errors
    /// Returns an error if the device has not the memory, or an asset cannot be drawn.
    pub fn layer(
        renderer: &Renderer,
        loaded: &LoadedScene,
        layer: Layer,
    ) -> Result<Self, RenderError> {
        let mut live = Self {
            background: renderer.upload(&loaded.standing(layer))?,
            pool: AssetPool::new(renderer.gpu())?,
            assets: Vec::new(),
            agents: Vec::new(),
            plain_agents: Vec::new(),
            lighting: None,
        };
        if layer != Layer::Background {
            for asset in &loaded.assets {
                live.add_asset(asset)?;
            }
            let moving: HashSet<&str> = loaded.agents.iter().map(|agent| &*agent.name).collect();
            let names = loaded.agent_labels.iter().map(|label| &label.name);
            let plain = names.filter(|name| !moving.contains(name.as_str()));
            live.plain_agents = plain.cloned().collect();
            live.agents.clone_from(&loaded.agents);
            live.lighting = loaded.lighting();
        }
        Ok(live)
    }

    /// The agents that can be moved, in the order in which equal depths are drawn.
    #[must_use]
    pub fn agents(&self) -> &[LoadedAgent] {
        &self.agents
    }

    /// Names of the agents that are splats of the world.
    pub(crate) fn plain_agents(&self) -> &[String] {
        &self.plain_agents
    }

    /// Copies another asset to the device. Returns its number.
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

    /// Sums up the light about `positions`, where agents may come that no trajectory of the scene
    /// file leads to.
    pub fn bake_light(&mut self, positions: impl IntoIterator<Item = DVec3>) {
        if let Some(lighting) = &mut self.lighting {
            lighting.field.bake(positions);
        }
    }

    /// True if the light around `positions` is computed, or cannot be: the scene has none, or
    /// `probes_max` probes are kept already.
    #[must_use]
    pub fn has_light_at(&self, positions: &[DVec3], probes_max: usize) -> bool {
        let Some(lighting) = &self.lighting else {
            return true;
        };
        lighting.field.size().0 >= probes_max
            || positions
                .iter()
                .all(|position| lighting.field.is_baked(*position))
    }

    /// Assets that agents may show.
    #[must_use]
    pub fn asset_count(&self) -> usize {
        self.assets.len()
    }

    /// Length, width and height of an asset's box, meters; `None` where there is no such asset.
    #[must_use]
    pub fn asset_dims_m(&self, asset: usize) -> Option<[f32; 3]> {
        self.assets.get(asset).map(|asset| asset.dims_m)
    }

    /// The agents that are present at `time_s`, where they are then, in the light of the scene.
    #[must_use]
    pub fn at(&self, time_s: f64) -> FrameAgents {
        let agents = self.agents.iter();
        let present = agents.filter_map(|agent| {
            let present = agent.present.includes(time_s);
            present.then(|| AgentInstance::from_agent(agent, time_s))
        });
        self.lit(&present.collect::<Vec<_>>())
    }

    /// Any agents anywhere, in the light of the scene, and the shadows that they throw. Agents
    /// about whose surroundings the background tells nothing keep the light of
    /// [`LiveScene::unlit`].
    ///
    /// # Panics
    /// Panics if an asset is not one of the scene's.
    #[must_use]
    pub fn lit(&self, placed: &[AgentInstance]) -> FrameAgents {
        let mut frame = self.unlit(placed);
        let Some(lighting) = &self.lighting else {
            return frame;
        };
        let matt = placed.iter().filter(|placed| !placed.shines);
        let matt = matt.map(|placed| {
            let dims_m = self.assets[placed.asset].dims_m;
            (placed.pose, dims_m, self.sh_frame_of(placed))
        });
        let lit = lighting.of_agents(&matt.collect::<Vec<_>>());
        let agents = frame.agents.iter_mut().zip(placed);
        let matt = agents.filter(|(_, placed)| !placed.shines);
        for ((agent, _), lit) in matt.zip(lit) {
            (agent.relight, agent.shading) = (lit.relight, lit.shading);
            frame.shadows.extend(lit.shadows);
        }
        frame
    }

    /// Any agents anywhere, in the light that their assets were captured in.
    ///
    /// # Panics
    /// Panics if an asset is not one of the scene's.
    #[must_use]
    pub fn unlit(&self, placed: &[AgentInstance]) -> FrameAgents {
        let agent = |placed: &AgentInstance| Agent {
            sh_frame: Some(self.sh_frame_of(placed)),
            motion: placed.motion,
            ..Agent::new(self.assets[placed.asset].id, placed.pose, placed.instance)
        };
        FrameAgents::new(placed.iter().map(agent).collect::<Vec<_>>())
    }

    fn sh_frame_of(&self, placed: &AgentInstance) -> ShFrame {
        let asset = &self.assets[placed.asset];
        placed.sh_frame.unwrap_or(asset.sh_frame)
    }

    /// The background with `agents`, as [`Renderer::render`] takes it.
    #[must_use]
    pub fn with<'a>(&'a self, agents: &'a FrameAgents) -> FrameSplats<'a> {
        FrameSplats::with_agents(&self.background, &self.pool, agents)
    }
}
