//! Scene or episode that the viewer shows, at every time.

use std::sync::Arc;

use decouplegs::scene::{Camera, Intrinsics, Motion, Pose};
use decouplegs::session::{Session, SessionScene, World};
use decouplegs_cli::scene_source::Scene;
use glam::{DQuat, DVec3};
use serde_json::{Value, json};

use crate::log::Played;
use crate::protocol::{CameraRequest, Pane, Pinhole};

/// Step of the clock over a scene, seconds: that of nuScenes' LiDARs and of most simulators.
const STEP_S: f64 = 0.1;
/// A scene may have trajectories of days; more steps than this are not counted.
const STEPS_MAX: f64 = 1e6;

/// Origin of worlds, cameras and the ego vehicle at each time.
pub enum Course {
    /// Trajectories of a scene.
    Scene(Box<Scene>),
    /// Log of an episode.
    Log(Box<Played>),
}

/// A scene on the device, at a time.
pub struct Source {
    course: Course,
    on_device: Arc<SessionScene>,
    /// The scene without agents.
    background: World,
    /// First and last time, seconds.
    span_s: [f64; 2],
    now: Now,
}

/// State at the time that was set.
struct Now {
    time_s: f64,
    world: World,
    cameras: Vec<Camera>,
    ego: Pose,
}

impl Source {
    /// Copies `scene` to the device.
    ///
    /// # Errors
    /// Returns an error if the device has not the memory.
    pub fn of_scene(scene: Scene, session: &Session) -> anyhow::Result<Self> {
        let on_device = session.add_scene(&scene.loaded)?;
        let agents = scene.loaded.agents.iter().map(|agent| &agent.trajectory);
        let ends = agents
            .chain([&scene.loaded.ego])
            .filter(|trajectory| trajectory.poses().len() > 1)
            .map(|trajectory| trajectory.end_s());
        let end_s = ends.fold(scene.time_s, f64::max);
        let span_s = [scene.time_s, end_s.min(scene.time_s + STEP_S * STEPS_MAX)];
        Ok(Self::new(Course::Scene(Box::new(scene)), on_device, span_s))
    }

    /// Source of a log whose place is `on_device`.
    pub fn of_log(played: Played, on_device: Arc<SessionScene>) -> Self {
        let span_s = played.span_s();
        Self::new(Course::Log(Box::new(played)), on_device, span_s)
    }

    fn new(course: Course, on_device: Arc<SessionScene>, span_s: [f64; 2]) -> Self {
        let mut source = Self {
            course,
            background: World::empty(&on_device),
            now: Now {
                time_s: span_s[0],
                world: World::new(&on_device),
                cameras: Vec::new(),
                ego: Pose::IDENTITY,
            },
            on_device,
            span_s,
        };
        source.set_time(span_s[0]);
        source
    }

    /// First and last time, seconds.
    pub fn span_s(&self) -> [f64; 2] {
        self.span_s
    }

    /// Duration of a step, seconds.
    pub fn step_s(&self) -> f64 {
        match &self.course {
            Course::Scene(_) => STEP_S,
            Course::Log(played) => played.step_s(),
        }
    }

    /// Puts agents, cameras and the ego vehicle where they are at `time_s`: between the moments of
    /// a log, at the moment before.
    pub fn set_time(&mut self, time_s: f64) {
        match &self.course {
            Course::Scene(scene) => {
                self.now.time_s = time_s;
                self.now.world.set_time(time_s);
                self.now.cameras = scene.cameras_after(time_s - scene.time_s);
                self.now.ego = scene.loaded.ego.at(time_s);
            }
            Course::Log(played) => {
                let moment = played.at(time_s);
                self.now = Now {
                    time_s: moment.time_s,
                    world: moment.world.clone(),
                    cameras: played.cameras(moment),
                    ego: moment.ego,
                };
            }
        }
    }

    /// Time that is shown, seconds.
    pub fn time_s(&self) -> f64 {
        self.now.time_s
    }

    /// The world that a pane shows.
    pub fn world(&self, agents: bool) -> &World {
        match agents {
            true => &self.now.world,
            false => &self.background,
        }
    }

    /// Camera of `pane`, in a size that fits into the pane.
    ///
    /// # Errors
    /// A sentence, when there is no camera or agent of the name.
    pub fn camera(&self, pane: &Pane) -> Result<Camera, String> {
        let pinhole = |at: &Pose, pinhole: &Pinhole| Camera {
            name: "view".into(),
            intrinsics: intrinsics_of(pinhole, [pane.width_px, pane.height_px]),
            world_from_camera: at.then(&pose_of(pinhole)),
            motion: Motion::REST,
        };
        match &pane.camera {
            CameraRequest::Named { name } => {
                let mut cameras = self.now.cameras.iter();
                let camera = cameras.find(|camera| camera.name == *name).cloned();
                let mut camera =
                    camera.ok_or_else(|| format!("the scene has no camera called {name:?}"))?;
                camera.intrinsics = fitted(&camera.intrinsics, [pane.width_px, pane.height_px]);
                Ok(camera)
            }
            CameraRequest::Free(free) => Ok(pinhole(&Pose::IDENTITY, free)),
            CameraRequest::Attached { agent, pinhole: at } => {
                let pose = match agent {
                    None => self.now.ego,
                    Some(name) => {
                        let mut agents = self.now.world.agents().iter();
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

    /// True if `rgba`, the image of `pane`, has the hash that the log has for its camera at this
    /// time; `None` where the log has none.
    pub fn is_logged(&self, pane: &Pane, size_px: [u32; 2], rgba: &[u8]) -> Option<bool> {
        match (&self.course, &pane.camera) {
            (Course::Log(played), CameraRequest::Named { name }) if pane.shows_all() => {
                played.is_logged(self.now.time_s, name, size_px, rgba)
            }
            _ => None,
        }
    }

    /// Facts that do not change: cameras, agents, counts, as JSON.
    pub fn facts(&self) -> Value {
        let cameras: Vec<Value> = (self.now.cameras.iter())
            .map(|camera| {
                let k = &camera.intrinsics;
                json!({"name": camera.name, "width_px": k.width_px, "height_px": k.height_px})
            })
            .collect();
        let (loaded, log) = match &self.course {
            Course::Scene(scene) => (&scene.loaded, Value::Null),
            Course::Log(played) => (played.loaded(), played.facts()),
        };
        let first = self.now.cameras.first();
        let first = first.map_or(self.now.ego, |camera| camera.world_from_camera);
        json!({
            "type": "scene",
            "cameras": cameras,
            "span_s": self.span_s,
            "step_s": self.step_s(),
            "has_ego": !log.is_null() || loaded.rig.cameras().next().is_some(),
            "agents": self.now.world.agents().len(),
            "plain_agents": loaded.plain_agents.len(),
            "background_splats": self.on_device.background_splats(),
            "assets": loaded.assets.len(),
            "first_camera": pose_json(&first),
            "log": log,
        })
    }

    /// Poses and boxes of the agents that are present at the time that was set, and of the ego.
    pub fn state(&self) -> Value {
        let agents: Vec<Value> = (self.now.world.agents().iter())
            .filter(|agent| agent.present)
            .map(|agent| {
                let placed = &agent.placed;
                let size_m = self
                    .on_device
                    .asset_dims_m(placed.asset)
                    .unwrap_or_default();
                json!({
                    "name": agent.name,
                    "id": placed.instance,
                    "class": self.class_of(&agent.name),
                    "pose": pose_json(&placed.pose),
                    "size_m": size_m,
                    "speed_mps": placed.motion.velocity_mps.length(),
                })
            })
            .collect();
        let plan = match &self.course {
            Course::Scene(_) => Vec::new(),
            Course::Log(played) => played.plan(self.now.time_s),
        };
        json!({"agents": agents, "ego": pose_json(&self.now.ego), "plan": plan})
    }

    fn class_of(&self, agent: &str) -> Option<String> {
        match &self.course {
            Course::Scene(scene) => {
                let mut labels = scene.loaded.agent_labels.iter();
                labels.find(|label| label.name == agent)?.class.clone()
            }
            Course::Log(played) => played.class_of(agent),
        }
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
