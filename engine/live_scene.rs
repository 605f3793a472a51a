//! A scene on the device, its agents moved by their trajectories.

use decouplegs_asset::{LoadedAgent, LoadedScene};
use decouplegs_render::{Agent, AssetId, AssetPool, RenderError, Renderer, ResidentWorld, Scene};

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
///     let statistics = renderer.render(live.with(&live.agents_at(time_s)), &cameras)?;
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
    agents: Vec<(AssetId, LoadedAgent)>,
}

impl LiveScene {
    /// Copies background and assets of `loaded` to the device of `renderer`.
    ///
    /// # Errors
    /// When the device has not the memory, or an asset cannot be drawn.
    pub fn new(renderer: &Renderer, loaded: &LoadedScene) -> Result<Self, RenderError> {
        let world = renderer.upload(&loaded.world)?;
        let mut pool = AssetPool::new(renderer.gpu())?;
        let assets = loaded.assets.iter().map(|asset| pool.add(asset)).collect::<Result<Vec<_>, _>>()?;
        let agents = loaded.agents.iter().map(|agent| (assets[agent.asset], agent.clone())).collect();
        Ok(Self { world, pool, agents })
    }

    /// All agents where they are at `time_s`.
    #[must_use]
    pub fn agents_at(&self, time_s: f64) -> Vec<Agent> {
        let agent = |(asset, agent): &(AssetId, LoadedAgent)| Agent {
            asset: *asset,
            world_from_agent: agent.trajectory.at(time_s),
            sh_frame: Some(agent.sh_frame),
            instance: agent.instance,
            relight: None,
        };
        self.agents.iter().map(agent).collect()
    }

    /// The background with `agents`, as [`Renderer::render`] takes it.
    #[must_use]
    pub fn with<'a>(&'a self, agents: &'a [Agent]) -> Scene<'a> {
        Scene::with_agents(&self.world, &self.pool, agents)
    }
}
