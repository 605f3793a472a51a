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
mod movable_scene;
mod png;
mod rig_renderer;
mod scene;
mod world;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError, Weak};

use decouplegs_asset::{AssetError, Layer, LoadedScene, open_scene, usual_up};
use decouplegs_gpu::{DeviceOptions, Gpu, GpuError};
use decouplegs_render::rendered_image::ImageError;
use decouplegs_render::{ColorFormat, Outputs, RenderError, RenderOptions, Renderer};
use decouplegs_scene::Rules;
use glam::DVec3;

pub use batch_renderer::{BatchRenderer, HostImages, WorldView};
pub use decouplegs_render::{TracedSweep, hash_bytes};
pub use movable_scene::{measure_movable_scene, open_movable_scene};
pub use png::save_png;
pub use rig_renderer::{RigRenderer, RigSweep};
pub use scene::{AgentInstance, Scene};
pub use world::{World, WorldAgent};

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

impl From<RenderOptions> for SessionOptions {
    /// A session whose renderers draw as `render` says, all else as by default.
    fn from(render: RenderOptions) -> Self {
        Self {
            render,
            ..Self::default()
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
    /// their shadows, or the agents over nothing, in the light of the background. Agents over
    /// nothing still throw shadows: these lie on agents of plain splats, as in the full image.
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
        let scene = Scene::new(&renderer, loaded, layer, usual_up)?;
        Ok(Arc::new(scene))
    }

    /// A renderer of worlds of this session, as [`SessionOptions::render`] says.
    #[must_use]
    pub fn batch_renderer(&self) -> BatchRenderer {
        BatchRenderer::new(&self.gpu, &self.options)
    }
}
