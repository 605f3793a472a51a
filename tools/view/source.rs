//! Scene that the viewer shows, at every time.

use std::sync::Arc;

use decouplegs::scene::{Camera, Intrinsics, Pose};
use decouplegs::session::{Session, SessionError, SessionScene, World};
use decouplegs_cli::scene_source::Scene;
use glam::{DQuat, DVec3};
use serde_json::{Value, json};

use crate::protocol::{CameraRequest, Pane, Pinhole};

/// Step of the clock over a scene, seconds: that of nuScenes' LiDARs and of most simulators.
const STEP_S: f64 = 0.1;
/// A scene may have trajectories of days; more steps than this are not counted.
const STEPS_MAX: f64 = 1e6;

/// A scene, and its copy on the device.
pub struct Source {
    scene: Scene,
    on_device: Arc<SessionScene>,
    world: World,
    /// The scene without agents.
    background: World,
    /// First and last time, seconds.
    span_s: [f64; 2],
}

impl Source {
    /// Copies `scene` to the device.
    ///
    /// # Errors
    /// Returns an error if the device has not the memory.
    pub fn new(scene: Scene, session: &Session) -> Result<Self, SessionError> {
        let on_device = session.add_scene(&scene.loaded)?;
        let (world, background) = (World::new(&on_device), World::empty(&on_device));
        let agents = scene.loaded.agents.iter().map(|agent| &agent.trajectory);
        let ends = agents
            .chain([&scene.loaded.ego])
            .filter(|trajectory| trajectory.poses().len() > 1)
            .map(|trajectory| trajectory.end_s());
        let end_s = ends.fold(scene.time_s, f64::max);
        let span_s = [scene.time_s, end_s.min(scene.time_s + STEP_S * STEPS_MAX)];
        let mut source = Self {
            scene,
            on_device,
            world,
            background,
            span_s,
        };
        source.set_time(span_s[0]);
        Ok(source)
    }

    /// First and last time, seconds.
    pub fn span_s(&self) -> [f64; 2] {
        self.span_s
    }

    /// Duration of a step, seconds.
    pub fn step_s(&self) -> f64 {
        STEP_S
    }

    /// Puts the agents where they are at `time_s`.
    pub fn set_time(&mut self, time_s: f64) {
        self.world.set_time(time_s);
    }

    /// The world that a pane shows.
    pub fn world(&self, agents: bool) -> &World {
        match agents {
            true => &self.world,
            false => &self.background,
        }
    }

    /// Camera of `pane` at `time_s`, in a size that fits into the pane.
    ///
    /// # Errors
    /// A sentence, when there is no camera or agent of the name.
    pub fn camera(&self, pane: &Pane, time_s: f64) -> Result<Camera, String> {
        let pinhole = |at: &Pose, pinhole: &Pinhole| Camera {
            name: "view".into(),
            intrinsics: intrinsics_of(pinhole, [pane.width_px, pane.height_px]),
            world_from_camera: at.then(&pose_of(pinhole)),
            motion: decouplegs::scene::Motion::REST,
        };
        match &pane.camera {
            CameraRequest::Named { name } => {
                let mut cameras = self.cameras_at(time_s).into_iter();
                let camera = cameras.find(|camera| camera.name == *name);
                let mut camera =
                    camera.ok_or_else(|| format!("the scene has no camera called {name:?}"))?;
                camera.intrinsics = fitted(&camera.intrinsics, [pane.width_px, pane.height_px]);
                Ok(camera)
            }
            CameraRequest::Free(free) => Ok(pinhole(&Pose::IDENTITY, free)),
            CameraRequest::Attached { agent, pinhole: at } => {
                let pose = match agent {
                    None => self.scene.loaded.ego.at(time_s),
                    Some(name) => {
                        let mut agents = self.world.agents().iter();
                        let agent = agents.find(|agent| agent.name == *name);
                        let agent =
                            agent.ok_or_else(|| format!("the scene has no agent {name:?}"))?;
                        agent.placed.pose
                    }
                };
                Ok(pinhole(&pose, at))
            }
        }
    }

    fn cameras_at(&self, time_s: f64) -> Vec<Camera> {
        self.scene.cameras_after(time_s - self.scene.time_s)
    }

    /// Facts that do not change: cameras, agents, counts, as JSON.
    pub fn facts(&self) -> Value {
        let cameras: Vec<Value> = (self.scene.cameras.iter())
            .map(|camera| {
                let k = &camera.intrinsics;
                json!({"name": camera.name, "width_px": k.width_px, "height_px": k.height_px})
            })
            .collect();
        let loaded = &self.scene.loaded;
        let first = self.scene.cameras.first();
        json!({
            "type": "scene",
            "cameras": cameras,
            "span_s": self.span_s,
            "step_s": STEP_S,
            "has_ego": loaded.rig.cameras().next().is_some(),
            "agents": self.world.agents().len(),
            "plain_agents": loaded.plain_agents.len(),
            "background_splats": self.on_device.background_splats(),
            "assets": loaded.assets.len(),
            "first_camera": first.map(|camera| pose_json(&camera.world_from_camera)),
        })
    }

    /// Poses and boxes of the agents that are present at the time that was set, and of the ego.
    pub fn state(&self, time_s: f64) -> Value {
        let agents: Vec<Value> = (self.world.agents().iter())
            .filter(|agent| agent.present)
            .map(|agent| {
                let placed = &agent.placed;
                let size_m = self
                    .on_device
                    .asset_dims_m(placed.asset)
                    .unwrap_or_default();
                let labels = &self.scene.loaded.agent_labels;
                let label = labels.iter().find(|label| label.name == agent.name);
                json!({
                    "name": agent.name,
                    "id": placed.instance,
                    "class": label.and_then(|label| label.class.clone()),
                    "pose": pose_json(&placed.pose),
                    "size_m": size_m,
                    "speed_mps": placed.motion.velocity_mps.length(),
                })
            })
            .collect();
        json!({"agents": agents, "ego": pose_json(&self.scene.loaded.ego.at(time_s))})
    }
}

/// A pose as the page reads it.
pub fn pose_json(pose: &Pose) -> Value {
    json!({"position_m": pose.translation.to_array(), "rotation": pose.rotation.to_array()})
}

fn pose_of(pinhole: &Pinhole) -> Pose {
    let rotation = DQuat::from_array(pinhole.rotation).normalize();
    Pose::new(rotation, DVec3::from_array(pinhole.position_m))
}

fn intrinsics_of(pinhole: &Pinhole, [width_px, height_px]: [u32; 2]) -> Intrinsics {
    let aspect = f64::from(width_px) / f64::from(height_px);
    let half = (0.5 * pinhole.fov_deg.to_radians()).tan();
    Intrinsics::from_horizontal_fov(width_px, height_px, 2.0 * (half * aspect).atan())
}

/// `own` made smaller, in its shape, until it fits into `pane_px`.
fn fitted(own: &Intrinsics, pane_px: [u32; 2]) -> Intrinsics {
    let share = |pane_px: u32, own_px: u32| f64::from(pane_px) / f64::from(own_px);
    let scale = share(pane_px[0], own.width_px).min(share(pane_px[1], own.height_px));
    scaled(own, scale)
}

/// `own` times `scale`, where that is below 1.
pub fn scaled(own: &Intrinsics, scale: f64) -> Intrinsics {
    if scale >= 1.0 {
        return *own;
    }
    let side = |side_px: u32| ((f64::from(side_px) * scale).round() as u32).max(1);
    own.resized(side(own.width_px), side(own.height_px))
}
