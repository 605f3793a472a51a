//! A scene on the device, and images of it. All use of the renderer is in this file.

use std::collections::HashMap;

use decouplegs::asset::LoadedScene;
use decouplegs::gpu::{Gpu, GpuError};
use decouplegs::render::{ColorFormat, ImageBytes, Outputs, RenderError, RenderOptions, Renderer};
use decouplegs::scene::{Camera, Pose};
use decouplegs::{AgentInstance, LiveScene};
use glam::DVec3;
use tonic::Status;

use crate::render_request::{PlacedObject, RenderRequest};

/// Probes of light that are kept for one scene, wherever clients put objects: a square kilometer of
/// them.
const PROBES_MAX: usize = 1 << 20;

/// A scene that can be drawn.
pub struct SceneRenderer {
    renderer: Renderer,
    live: LiveScene,
    /// World coordinates of the local frame's origin.
    origin: DVec3,
    /// Assets of the scene's agents, by name; their poses come with each request.
    agents: HashMap<String, AgentInstance>,
}

/// Results beside the images.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Drawn {
    /// Objects that were asked for and that the scene has not.
    pub unknown: Vec<String>,
}

impl SceneRenderer {
    /// `loaded` on the device.
    ///
    /// # Errors
    /// Returns an error if the device has not the memory, or an asset cannot be drawn.
    pub fn new(gpu: &Gpu, loaded: &LoadedScene) -> Result<Self, RenderError> {
        let options = RenderOptions {
            rules: loaded.world.rules,
            outputs: Outputs {
                color: ColorFormat::U8,
                ..Outputs::default()
            },
            ..RenderOptions::default()
        };
        let renderer = Renderer::new(gpu, options);
        let live = LiveScene::new(&renderer, loaded)?;
        let placed = |instance, asset, sh_frame| AgentInstance {
            asset,
            pose: Pose::IDENTITY,
            sh_frame: Some(sh_frame),
            instance,
        };
        let agents = loaded.agents.iter();
        let agents = agents
            .map(|agent| {
                (
                    agent.name.clone(),
                    placed(agent.instance, agent.asset, agent.sh_frame),
                )
            })
            .collect();
        Ok(Self {
            renderer,
            live,
            origin: loaded.world.origin,
            agents,
        })
    }

    /// Draws what `requests` see, all of them in one submission, into `images`. They see the same
    /// objects at the same places.
    ///
    /// # Errors
    /// Returns an error if a camera cannot make an image, the device has not the memory or was
    /// lost.
    pub fn draw(
        &mut self,
        requests: &[RenderRequest],
        images: &mut ImageBytes,
    ) -> Result<Drawn, RenderError> {
        let objects = requests.first().map_or(&[][..], |request| &request.objects);
        let mut drawn = Drawn::default();
        let mut placed = Vec::with_capacity(objects.len());
        for PlacedObject { track_id, pose } in objects {
            match self.agents.get(track_id) {
                Some(agent) => placed.push(AgentInstance {
                    pose: self.in_world(pose),
                    ..*agent
                }),
                None => drawn.unknown.push(track_id.clone()),
            }
        }
        let places: Vec<_> = placed.iter().map(|agent| agent.pose.translation).collect();
        if !self.live.has_light_at(&places, PROBES_MAX) {
            self.live.bake_light(places);
        }
        let moment = self.live.placed(&placed);
        let cameras: Vec<Camera> = requests
            .iter()
            .enumerate()
            .map(|(index, request)| self.camera(index, request))
            .collect();
        self.renderer.render(self.live.with(&moment), &cameras)?;
        self.renderer.read_bytes(images)?;
        Ok(drawn)
    }

    fn camera(&self, index: usize, request: &RenderRequest) -> Camera {
        let world_from_camera = self.in_world(&request.local_from_camera);
        Camera {
            name: index.to_string(),
            intrinsics: request.intrinsics,
            world_from_camera,
        }
    }

    fn in_world(&self, pose: &Pose) -> Pose {
        Pose {
            translation: pose.translation + self.origin,
            ..*pose
        }
    }
}

/// gRPC status of `error` for a client.
pub fn status_of(error: &RenderError) -> Status {
    match error {
        RenderError::View(reason) => Status::invalid_argument(reason),
        RenderError::Gpu(GpuError::OutOfMemory { .. } | GpuError::BufferTooLarge { .. }) => {
            Status::resource_exhausted(error.to_string())
        }
        RenderError::Gpu(GpuError::DeviceLost { .. } | GpuError::Hang { .. }) => {
            Status::unavailable(error.to_string())
        }
        _ => Status::internal(error.to_string()),
    }
}

/// True if the device is lost for good.
pub fn is_lost(error: &RenderError) -> bool {
    matches!(
        error,
        RenderError::Gpu(GpuError::DeviceLost { .. } | GpuError::Hang { .. })
    )
}
