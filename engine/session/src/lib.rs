//! Many scenes, many worlds and many views on one device: how other programs use the engine.
//!
//! A [`Session`] owns the device and the scenes that were opened on it: each background and each
//! asset is there once, however many show it. A [`World`] is a set of agents over one of these
//! scenes, and costs a few hundred bytes. A [`BatchRenderer`] draws any number of worlds for any
//! cameras in as few submissions as there are 32 cameras; several batch renderers may work on
//! several threads.
//!
//! ```no_run
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use decouplegs_session::{HostImages, Session, SessionOptions, World, WorldView};
//! use decouplegs_scene::Pose;
//!
//! let session = Session::open(&SessionOptions::default())?;
//! let scene = session.open_scene("street/scene.toml".as_ref())?;
//! let mut renderer = session.batch_renderer();
//! let mut worlds = [World::new(&scene), World::new(&scene)];
//! let mut images = HostImages::default();
//! for step in 0..100 {
//!     let time_s = 0.1 * f64::from(step);
//!     worlds[0].set_time(time_s);
//!     let translation = glam::DVec3::new(0.2 * f64::from(step), 3.5, 0.0);
//!     let pose = Pose { translation, ..Pose::IDENTITY };
//!     worlds[1].move_to("car_001", pose)?;
//!     let cameras = scene.rig().driving(scene.ego(), time_s);
//!     let views = worlds.each_ref().map(|world| WorldView { world, cameras: &cameras });
//!     let drawn = renderer.draw(&views, &mut images)?;
//!     println!("{:?}, first pixel {:?}", drawn[0].gpu_time, &images.rgba(0, 0)[..4]);
//! }
//! # Ok(())
//! # }
//! ```

#![forbid(unsafe_code)]

mod batch;
mod batch_renderer;
mod live_scene;
mod movable_scene;
mod png;
mod rig_renderer;
mod world;

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard, Weak};

use decouplegs_asset::{
    AssetError, Layer, LoadedAgent, LoadedScene, open_scene, read_coded, usual_up,
};
use decouplegs_gpu::{DeviceOptions, Gpu, GpuError};
use decouplegs_render::rendered_image::ImageError;
use decouplegs_render::{ColorFormat, Outputs, RenderError, RenderOptions, Renderer};
use decouplegs_scene::{Camera, Framing, Rig, Rules, Trajectory};
use glam::DVec3;

pub use batch_renderer::{BatchRenderer, HostImages, WorldView};
pub use decouplegs_render::{TracedSweep, hash_bytes};
pub use live_scene::{AgentInstance, LiveScene};
pub use movable_scene::{measure_movable_scene, open_movable_scene};
pub use png::save_png;
pub use rig_renderer::{RigRenderer, RigSweep};
pub use world::{World, WorldAgent};

/// Probes of light that a scene keeps at most, about 110 bytes each: agents that are sent anywhere
/// at all must not fill the memory. Light elsewhere is summed up anew in every frame.
const PROBES_MAX: usize = 1 << 18;

/// Reason why a session could not serve a request.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// The device failed.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// A file cannot be read.
    #[error(transparent)]
    Asset(#[from] AssetError),
    /// A frame, or an upload.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// No such agent in the world.
    #[error("the world has no agent {name:?}: it has {there}")]
    NoAgent {
        /// The name asked for.
        name: String,
        /// Some names of the agents that the world has.
        there: String,
    },
    /// No such asset in the scene.
    #[error("the scene has no asset {asset}: it has {count}, counted from 0")]
    NoAsset {
        /// The number asked for.
        asset: usize,
        /// Assets that there are.
        count: usize,
    },
    /// An agent of plain splats cannot be moved.
    #[error(
        "agent {name:?} is of plain splats, which are part of the background: compress its asset (decouplegs compress) to move it"
    )]
    PlainSplats {
        /// The agent.
        name: String,
    },
    /// More agents than instance ids.
    #[error("a world has at most {max} agents")]
    TooManyAgents {
        /// Largest number allowed.
        max: usize,
    },
    /// Bytes were asked of a batch renderer that draws floats.
    #[error(
        "the batch renderer stores floats: open the session with ColorFormat::U8 to read bytes"
    )]
    NotBytes,
    /// A world of another session, whose scenes are not on this device.
    #[error(
        "view {view} shows a world of another session: draw it with a batch renderer of its own"
    )]
    OtherSession {
        /// Index of the view.
        view: usize,
    },
    /// A view has no cameras.
    #[error("a view without cameras was asked for: give each at least one")]
    NoCameras,
    /// An image cannot be encoded.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// Images were asked for, and nothing was submitted.
    #[error("nothing was submitted that is not finished: call submit first")]
    NothingSubmitted,
    /// A call that submits and finishes, beside submissions that are not finished.
    #[error("{submissions} submissions are not finished: finish them first, or go on with submit")]
    Unfinished {
        /// Submissions that wait.
        submissions: usize,
    },
}

impl SessionError {
    /// The fault of the device, if that is what it is.
    #[must_use]
    pub fn gpu(&self) -> Option<&GpuError> {
        match self {
            Self::Gpu(error) | Self::Render(RenderError::Gpu(error)) => Some(error),
            _ => None,
        }
    }
}

/// Options of a session.
#[derive(Clone, Debug)]
pub struct SessionOptions {
    /// Device, and its use.
    pub device: DeviceOptions,
    /// Options of the renderers. [`RenderOptions::rules`] is not used: see
    /// [`SessionOptions::rules`].
    pub render: RenderOptions,
    /// The rules that all scenes are drawn by. None: each by its own, as its scene file says.
    pub rules: Option<Rules>,
    /// True if light is baked, and kept, wherever agents come: fast for agents that are sent
    /// anywhere. False: light is interpolated where the scene or [`Scene::bake_light`] baked
    /// it, and summed up exactly elsewhere, so that no image depends on what was drawn before.
    pub bakes_light_on_demand: bool,
}

impl Default for SessionOptions {
    /// The best device, images in bytes, room to spare for cameras that leap, and lists that are
    /// kept while cameras stand.
    fn default() -> Self {
        let outputs = Outputs {
            color: ColorFormat::U8,
            ..Outputs::default()
        };
        let render = RenderOptions {
            outputs,
            spare: 0.5,
            keep_lists: true,
            ..RenderOptions::default()
        };
        Self {
            device: DeviceOptions::default(),
            render,
            rules: None,
            bakes_light_on_demand: true,
        }
    }
}

/// A device and the scenes on it. Share it by reference or in an [`Arc`]; all its methods may be
/// called from any thread.
pub struct Session {
    gpu: Gpu,
    options: SessionOptions,
    /// Scenes in use, by path.
    scenes: Mutex<BTreeMap<PathBuf, Weak<Scene>>>,
}

/// A scene on the device. It stays there as long as it is held.
pub struct Scene {
    gpu: Gpu,
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
    live: RwLock<LiveScene>,
}

impl Session {
    /// Opens the device.
    ///
    /// # Errors
    /// [`SessionError::Gpu`]: no device, or none that can do the work.
    pub fn open(options: &SessionOptions) -> Result<Self, SessionError> {
        Ok(Self::on(&Gpu::open(&options.device)?, options))
    }

    /// A session on a device that is open already, which [`SessionOptions::device`] is not asked
    /// for: to look at what it can do first.
    #[must_use]
    pub fn on(gpu: &Gpu, options: &SessionOptions) -> Self {
        Self {
            gpu: gpu.clone(),
            options: options.clone(),
            scenes: Mutex::default(),
        }
    }

    /// The device.
    #[must_use]
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// Options that it was opened with.
    #[must_use]
    pub fn options(&self) -> &SessionOptions {
        &self.options
    }

    /// The scene of a scene file or splat file, loaded unless it is loaded already.
    ///
    /// # Errors
    /// Returns an error if a file is missing or wrong, or the device has not the memory.
    pub fn open_scene(&self, path: &Path) -> Result<Arc<Scene>, SessionError> {
        let key = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        if let Some(scene) = self.held(&key) {
            return Ok(scene);
        }
        // Loaded without the lock, so that frames of other scenes go on; the loser of a race drops
        // its copy and takes the other.
        let loaded = open_scene(path, 0.0)?;
        let scene = self.add(&loaded, Layer::All, usual_up(path))?;
        let mut scenes = self.scenes.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(other) = scenes.get(&key).and_then(Weak::upgrade) {
            return Ok(other);
        }
        scenes.retain(|_, scene| scene.strong_count() > 0);
        scenes.insert(key, Arc::downgrade(&scene));
        Ok(scene)
    }

    fn held(&self, key: &Path) -> Option<Arc<Scene>> {
        self.scenes
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .get(key)
            .and_then(Weak::upgrade)
    }

    /// A scene that was loaded or generated by the caller, copied to the device.
    ///
    /// # Errors
    /// Returns an error if the device has not the memory, or an asset cannot be drawn.
    pub fn add_scene(&self, loaded: &LoadedScene) -> Result<Arc<Scene>, SessionError> {
        self.add_layer(loaded, Layer::All)
    }

    /// [`Session::add_scene`], of what belongs to `layer`: all, the background without agents and
    /// their shadows, or the agents over nothing, in the light of the background.
    ///
    /// # Errors
    /// Returns the errors of [`Session::add_scene`].
    pub fn add_layer(
        &self,
        loaded: &LoadedScene,
        layer: Layer,
    ) -> Result<Arc<Scene>, SessionError> {
        self.add(loaded, layer, DVec3::Z)
    }

    fn add(
        &self,
        loaded: &LoadedScene,
        layer: Layer,
        usual_up: DVec3,
    ) -> Result<Arc<Scene>, SessionError> {
        let renderer = Renderer::new(&self.gpu, self.options.render);
        let live = LiveScene::layer(&renderer, loaded, layer)?;
        let agents = live.agents().to_vec();
        let agent_by_name: HashMap<String, usize> = agents
            .iter()
            .enumerate()
            .map(|(index, agent)| (agent.name.clone(), index))
            .collect();
        // Who drives a rig frames nothing, and need not wait for it.
        let has_cameras = loaded.rig.cameras().next().is_some();
        let splats = &loaded.splat_scene;
        let framing = if has_cameras {
            None
        } else {
            Framing::from_splats(&splats.splats, splats.origin)
        };
        Ok(Arc::new(Scene {
            framing,
            usual_up,
            gpu: self.gpu.clone(),
            rules: loaded.splat_scene.rules,
            rig: loaded.rig.clone(),
            ego: loaded.ego.clone(),
            plain_agents: live.plain_agents().to_vec(),
            agents,
            agent_by_name,
            live: RwLock::new(live),
        }))
    }

    /// A renderer of worlds of this session, as [`SessionOptions::render`] says.
    #[must_use]
    pub fn batch_renderer(&self) -> BatchRenderer {
        BatchRenderer::new(&self.gpu, &self.options)
    }
}

impl Scene {
    /// Bakes the light probes around `positions`, world coordinates, so that frames with agents
    /// there need not wait for them.
    pub fn bake_light(&self, positions: impl IntoIterator<Item = DVec3>) {
        self.live_mut().bake_light(positions);
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

    /// The agents of the scene file that can be moved, with which a [`World`] begins.
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
        self.live().asset_count()
    }

    /// Length, width and height of an asset's box, meters, whose center is the asset's origin.
    ///
    /// # Errors
    /// Returns an error if there is no such asset.
    pub fn asset_dims_m(&self, asset: usize) -> Result<[f32; 3], SessionError> {
        let live = self.live();
        live.asset_dims_m(asset).ok_or(SessionError::NoAsset {
            asset,
            count: live.asset_count(),
        })
    }

    /// Copies another compressed asset (`.safetensors`) to the device, for all worlds over this
    /// scene; returns its number.
    ///
    /// # Errors
    /// Returns an error if the file is missing or wrong, or the device has not the memory.
    pub fn add_asset(&self, path: &Path) -> Result<usize, SessionError> {
        let asset = read_coded(path)?;
        Ok(self.live_mut().add_asset(&asset.cloud)?)
    }

    /// True if images of `cameras` are post-processed.
    pub(crate) fn is_post_processed(&self, cameras: &[Camera]) -> bool {
        self.live().background.is_post_processed(cameras)
    }

    /// Splats of the background.
    #[must_use]
    pub fn background_splats(&self) -> usize {
        self.live().background.splats
    }

    /// Sums up the light about `positions`, so that frames find it ready.
    pub(crate) fn ready_light(&self, positions: &[DVec3]) {
        if !self.live().has_light_at(positions, PROBES_MAX) {
            self.live_mut().bake_light(positions.iter().copied());
        }
    }

    pub(crate) fn live(&self) -> RwLockReadGuard<'_, LiveScene> {
        self.live.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn live_mut(&self) -> RwLockWriteGuard<'_, LiveScene> {
        self.live.write().unwrap_or_else(PoisonError::into_inner)
    }
}
