//! A scene on the device.

use std::collections::{HashMap, HashSet};
use std::path::Path;
use std::sync::{PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

use decouplegs_asset::{Layer, LoadedAgent, LoadedScene, read_coded};
use decouplegs_gpu::Gpu;
use decouplegs_render::{
    Agent, AssetId, AssetPool, FrameAgents, FrameSplats, RenderError, Renderer, ResidentSplats,
};
use decouplegs_scene::light::Lighting;
use decouplegs_scene::{
    Camera, CodedCloud, Framing, Motion, Pose, Rig, Rules, ShFrame, Trajectory,
};
use glam::DVec3;

use super::SessionError;

/// Probes of light that a scene keeps at most, about 110 bytes each: agents that are sent anywhere
/// at all must not fill the memory. Light elsewhere is summed up anew in every frame.
const PROBES_MAX: usize = 1 << 18;

/// A scene on the device. It stays there as long as it is held.
pub struct Scene {
    gpu: Gpu,
    background: ResidentSplats,
    rules: Rules,
    rig: Rig,
    ego: Trajectory,
    agents: Vec<LoadedAgent>,
    /// Indices in `agents`.
    agent_by_name: HashMap<String, usize>,
    /// Names of agents of plain splats, which are part of the background.
    plain_agents: Vec<String>,
    /// Sphere that shows all; `None` where the rig has cameras, or no splat can be seen.
    framing: Option<Framing>,
    /// The direction that is mostly up in its file.
    usual_up: DVec3,
    resources: RwLock<AgentResources>,
}

/// Assets and light of the agents of a scene. More of both may come while worlds are drawn.
pub(crate) struct AgentResources {
    pub pool: AssetPool,
    assets: Vec<ResidentAsset>,
    lighting: Option<Lighting>,
}

/// An asset on the device.
struct ResidentAsset {
    id: AssetId,
    dims_m: [f32; 3],
    sh_frame: ShFrame,
}

impl AgentResources {
    /// Copies an asset to the device. Returns its number.
    fn add(&mut self, asset: &CodedCloud) -> Result<usize, RenderError> {
        self.assets.push(ResidentAsset {
            id: self.pool.add(asset)?,
            dims_m: asset.dims_m,
            sh_frame: asset.sh_frame,
        });
        Ok(self.assets.len() - 1)
    }

    /// True if the light around `positions` is computed, or cannot be: the scene has none, or
    /// [`PROBES_MAX`] probes are kept already.
    fn has_light_at(&self, positions: &[DVec3]) -> bool {
        let Some(lighting) = &self.lighting else {
            return true;
        };
        let is_baked = |position: &DVec3| lighting.field.is_baked(*position);
        lighting.field.size().0 >= PROBES_MAX || positions.iter().all(is_baked)
    }
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

impl Scene {
    /// Copies what belongs to `layer` of `loaded` to the device of `renderer`, and sums up its
    /// light where agents drive. `usual_up` is the direction that is mostly up in its file.
    ///
    /// # Errors
    /// Returns an error if the device has not the memory, or an asset cannot be drawn.
    pub(crate) fn new(
        renderer: &Renderer,
        loaded: &LoadedScene,
        layer: Layer,
        usual_up: DVec3,
    ) -> Result<Self, RenderError> {
        let background = renderer.upload(&loaded.standing(layer))?;
        let mut resources = AgentResources {
            pool: AssetPool::new(renderer.gpu())?,
            assets: Vec::new(),
            lighting: None,
        };
        let (mut agents, mut plain_agents) = (Vec::new(), Vec::new());
        if layer != Layer::Background {
            for asset in &loaded.assets {
                resources.add(asset)?;
            }
            resources.lighting = loaded.lighting();
            agents.clone_from(&loaded.agents);
            let moving: HashSet<&str> = loaded.agents.iter().map(|agent| &*agent.name).collect();
            let names = loaded.agent_labels.iter().map(|label| &label.name);
            let plain = names.filter(|name| !moving.contains(name.as_str()));
            plain_agents.extend(plain.cloned());
        }
        let index_by_name = |(index, agent): (usize, &LoadedAgent)| (agent.name.clone(), index);
        // Who drives a rig frames nothing, and need not wait for it.
        let framing = match loaded.rig.cameras().next() {
            Some(_) => None,
            None => Framing::from_splats(&loaded.splat_scene.splats, loaded.splat_scene.origin),
        };
        Ok(Self {
            gpu: renderer.gpu().clone(),
            background,
            rules: loaded.splat_scene.rules,
            rig: loaded.rig.clone(),
            ego: loaded.ego.clone(),
            agent_by_name: agents.iter().enumerate().map(index_by_name).collect(),
            agents,
            plain_agents,
            framing,
            usual_up,
            resources: RwLock::new(resources),
        })
    }

    /// Bakes the light probes around `positions`, world coordinates, so that frames with agents
    /// there need not wait for them.
    pub fn bake_light(&self, positions: impl IntoIterator<Item = DVec3>) {
        if let Some(lighting) = &mut self.resources_mut().lighting {
            lighting.field.bake(positions);
        }
    }

    /// The rules of image formation that the scene file names.
    #[must_use]
    pub fn rules(&self) -> Rules {
        self.rules
    }

    /// The ego vehicle's cameras; none for a splat file.
    #[must_use]
    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    /// A camera that shows all splats of a scene without cameras: of the middle 90 % of them on
    /// each axis. It is a pinhole called "framed", whose image is of `size_px`, width and height.
    /// It stands towards `direction`, with `up` up in the image. What is not given is as `render`
    /// has it: -y is up for splat files, z for scenes, and the camera looks down a little. `None`
    /// where the rig has cameras, no splat can be seen, a size is 0, or the directions span no
    /// frame.
    #[must_use]
    pub fn frame(
        &self,
        size_px: [u32; 2],
        direction: Option<DVec3>,
        up: Option<DVec3>,
    ) -> Option<Camera> {
        let up = up.map_or(Some(self.usual_up), DVec3::try_normalize)?;
        let direction = direction.unwrap_or_else(|| Framing::direction_above(up, 0.0));
        let camera = self.framing?.camera("framed", size_px, direction, up)?;
        camera.intrinsics.check().is_ok().then_some(camera)
    }

    /// Trajectory of the ego vehicle from the scene file.
    #[must_use]
    pub fn ego(&self) -> &Trajectory {
        &self.ego
    }

    /// The agents of the scene file that can be moved, with which a [`super::World`] begins.
    #[must_use]
    pub fn agents(&self) -> &[LoadedAgent] {
        &self.agents
    }

    /// The agents of plain splats, which stand where they are.
    #[must_use]
    pub fn plain_agents(&self) -> &[String] {
        &self.plain_agents
    }

    /// The agent of the scene file called `name`.
    pub(crate) fn agent(&self, name: &str) -> Option<&LoadedAgent> {
        self.agent_by_name
            .get(name)
            .map(|&index| &self.agents[index])
    }

    /// True if it is on the device `gpu`.
    pub(crate) fn is_on(&self, gpu: &Gpu) -> bool {
        self.gpu.is(gpu)
    }

    /// Assets that agents may show.
    #[must_use]
    pub fn asset_count(&self) -> usize {
        self.resources().assets.len()
    }

    /// Length, width and height of an asset's box, meters, whose center is the asset's origin.
    ///
    /// # Errors
    /// Returns an error if there is no such asset.
    pub fn asset_dims_m(&self, asset: usize) -> Result<[f32; 3], SessionError> {
        let assets = &self.resources().assets;
        let found = assets.get(asset).map(|asset| asset.dims_m);
        found.ok_or(SessionError::NoAsset {
            asset,
            count: assets.len(),
        })
    }

    /// Copies another compressed asset (`.safetensors`) to the device, for all worlds over this
    /// scene; returns its number.
    ///
    /// # Errors
    /// Returns an error if the file is missing or wrong, or the device has not the memory.
    pub fn add_asset(&self, path: &Path) -> Result<usize, SessionError> {
        let asset = read_coded(path)?;
        Ok(self.resources_mut().add(&asset.cloud)?)
    }

    /// True if images of `cameras` are post-processed.
    pub(crate) fn is_post_processed(&self, cameras: &[Camera]) -> bool {
        self.background.is_post_processed(cameras)
    }

    /// Splats of the background.
    #[must_use]
    pub fn background_splats(&self) -> usize {
        self.background.splats
    }

    /// The background on the device.
    #[must_use]
    pub fn background(&self) -> &ResidentSplats {
        &self.background
    }

    /// Sums up the light about `positions`, so that frames find it ready.
    pub(crate) fn ready_light(&self, positions: &[DVec3]) {
        if !self.resources().has_light_at(positions) {
            self.bake_light(positions.iter().copied());
        }
    }

    /// Any agents anywhere, in the light of the scene, and the shadows that they throw. Agents
    /// about whose surroundings the background tells nothing are unlit.
    ///
    /// # Panics
    /// Panics if an asset is not one of the scene's.
    pub(crate) fn lit(&self, placed: &[AgentInstance]) -> FrameAgents {
        let mut frame = self.unlit(placed);
        let resources = self.resources();
        let Some(lighting) = &resources.lighting else {
            return frame;
        };
        let matt = placed.iter().filter(|placed| !placed.shines);
        let matt = matt.map(|placed| {
            let asset = &resources.assets[placed.asset];
            let sh_frame = placed.sh_frame.unwrap_or(asset.sh_frame);
            (placed.pose, asset.dims_m, sh_frame)
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
    pub(crate) fn unlit(&self, placed: &[AgentInstance]) -> FrameAgents {
        let resources = self.resources();
        let agent = |placed: &AgentInstance| {
            let asset = resources.assets[placed.asset].id;
            Agent {
                sh_frame: placed.sh_frame,
                motion: placed.motion,
                ..Agent::new(asset, placed.pose, placed.instance)
            }
        };
        FrameAgents::new(placed.iter().map(agent).collect::<Vec<_>>())
    }

    /// Lends the background and `agents` to `draw`, as a [`Renderer`] or a
    /// [`decouplegs_render::LidarRenderer`] takes them: for programs that drive these by
    /// themselves. Assets can be added, and light baked, when it has returned.
    pub fn lend<T>(&self, agents: &FrameAgents, draw: impl FnOnce(FrameSplats<'_>) -> T) -> T {
        let pool = &self.resources().pool;
        draw(FrameSplats::with_agents(&self.background, pool, agents))
    }

    pub(crate) fn resources(&self) -> RwLockReadGuard<'_, AgentResources> {
        self.resources
            .read()
            .unwrap_or_else(PoisonError::into_inner)
    }

    fn resources_mut(&self) -> RwLockWriteGuard<'_, AgentResources> {
        self.resources
            .write()
            .unwrap_or_else(PoisonError::into_inner)
    }
}
