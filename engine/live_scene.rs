//! A scene on the device, its agents moved by their trajectories.

use decouplegs_asset::{LoadedAgent, LoadedScene};
use decouplegs_render::{Agent, AssetId, AssetPool, RenderError, Renderer, ResidentWorld, Scene};
use decouplegs_scene::light::Lighting;
use decouplegs_scene::{ContactShadow, Pose, ShFrame};

/// A loaded scene on the device: what a loop of frames needs of it.
///
/// ```no_run
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use std::path::Path;
///
/// use decouplegs::LiveScene;
/// use decouplegs::asset::open_scene;
/// use decouplegs::gpu::{DeviceOptions, Gpu};
/// use decouplegs::render::{RenderOptions, Renderer};
///
/// let gpu = Gpu::open(&DeviceOptions::default())?;
/// let mut renderer = Renderer::new(&gpu, RenderOptions::default());
/// let loaded = open_scene(Path::new("street/scene.toml"), 0.0)?;
/// let live = LiveScene::new(&renderer, &loaded)?;
/// for step in 0..100 {
///     let time_s = 0.033 * f64::from(step);
///     let cameras = loaded.rig.at(&loaded.ego.at(time_s));
///     let statistics = renderer.render(live.with(&live.at(time_s)), &cameras)?;
///     println!("{:?} {:?}", statistics.gpu_time, statistics.orders);
///     let pictures = renderer.read_pictures()?;
/// }
/// # Ok(())
/// # }
/// ```
pub struct LiveScene {
    /// The background.
    pub world: ResidentWorld,
    /// The agents' assets.
    pub pool: AssetPool,
    agents: Vec<LiveAgent>,
    lighting: Option<Lighting>,
}

/// An agent of the scene file.
struct LiveAgent {
    asset: AssetId,
    dims_m: [f32; 3],
    agent: LoadedAgent,
}

/// All that moves in a scene, at one instant.
#[derive(Clone, Debug, Default)]
pub struct Moment {
    /// The agents, in the light of where they stand.
    pub agents: Vec<Agent>,
    /// The contact shadows that they throw.
    pub shadows: Vec<ContactShadow>,
    /// Agents about whose place the background tells nothing: they keep the light that their assets were captured in.
    pub unlit: usize,
}

impl LiveScene {
    /// Copies background and assets of `loaded` to the device of `renderer`, and sums up its light where agents drive.
    ///
    /// # Errors
    /// When the device has not the memory, or an asset cannot be drawn.
    pub fn new(renderer: &Renderer, loaded: &LoadedScene) -> Result<Self, RenderError> {
        let world = renderer.upload(&loaded.world)?;
        let mut pool = AssetPool::new(renderer.gpu())?;
        let assets = loaded.assets.iter().map(|asset| pool.add(asset)).collect::<Result<Vec<_>, _>>()?;
        let live = |agent: &LoadedAgent| LiveAgent {
            asset: assets[agent.asset],
            dims_m: loaded.assets[agent.asset].dims_m,
            agent: agent.clone(),
        };
        let agents = loaded.agents.iter().map(live).collect();
        Ok(Self { world, pool, agents, lighting: loaded.lighting() })
    }

    /// All agents where they are at `time_s`, in the light of the scene.
    #[must_use]
    pub fn at(&self, time_s: f64) -> Moment {
        self.posed(|agent| agent.trajectory.at(time_s))
    }

    /// All agents where `pose_of` puts them, world coordinates, in the light of the scene.
    #[must_use]
    pub fn posed(&self, pose_of: impl Fn(&LoadedAgent) -> Pose) -> Moment {
        let placed = |live: &LiveAgent| (pose_of(&live.agent), live.dims_m, live.agent.sh_frame);
        let placed: Vec<(Pose, [f32; 3], ShFrame)> = self.agents.iter().map(placed).collect();
        let lit = self.lighting.as_ref().map(|lighting| lighting.of_agents(&placed));
        let agent = |(index, live): (usize, &LiveAgent)| Agent {
            sh_frame: Some(live.agent.sh_frame),
            relight: lit.as_ref().and_then(|lit| lit[index].relight),
            ..Agent::new(live.asset, placed[index].0, live.agent.instance)
        };
        Moment {
            agents: self.agents.iter().enumerate().map(agent).collect(),
            shadows: lit.iter().flatten().filter_map(|lit| lit.shadow).collect(),
            unlit: lit.iter().flatten().filter(|lit| !lit.known).count(),
        }
    }

    /// The background with what moves, as [`Renderer::render`] takes it.
    #[must_use]
    pub fn with<'a>(&'a self, moment: &'a Moment) -> Scene<'a> {
        Scene { shadows: &moment.shadows, ..Scene::with_agents(&self.world, &self.pool, &moment.agents) }
    }
}
