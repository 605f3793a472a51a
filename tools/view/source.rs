//! Scene or episode that the viewer shows, at every time.

mod facts;

use std::sync::Arc;

use decouplegs::asset::{LoadedScene, lidar_names};
use decouplegs::episode::{LiveEpisode, chosen_lidars};
use decouplegs::explain::explain;
use decouplegs::scene::{Camera, Lidar, Motion, Pose};
use decouplegs::session::{Scene, Session, SessionError, World};
use decouplegs_cli::free_view::FreeView;
use glam::DVec3;

use crate::played::{LoggedImage, Played};
use crate::protocol::{CameraRequest, Edit, Pane};
use crate::scenario_edits::ScenarioEditor;
use crate::scene_course::{Boxed, SceneCourse};
use crate::splat_stream::KeptSplats;
use crate::viewpoint::{fitted, point_at_height};

/// Step of the clock over a scene, seconds: that of nuScenes' LiDARs and of most simulators.
const STEP_S: f64 = 0.1;
/// A scene may have trajectories of days; more steps than this are not counted.
const STEPS_MAX: f64 = 1e6;

const RECORDED: &str =
    "an episode that was recorded is not edited: its score counts. Open its scenario";

const NO_SCENE: &str = "images of an episode are not rendered by a command: 'decouplegs export' writes those that its log has";

/// Origin of worlds, cameras and the ego vehicle at each time.
enum Course {
    /// Trajectories of a scene.
    Scene(Box<SceneCourse>),
    /// Episode, and the scenario that it begins anew from, if it is driven here.
    Episode(Box<Played>, Option<Box<ScenarioEditor>>),
}

/// Agent that is dragged, and its pose until the mouse is released.
type Dragged = Option<(String, Pose)>;

/// A scene on the device, at a time.
pub struct Source {
    course: Course,
    on_device: Arc<Scene>,
    splats: KeptSplats,
    /// The scene without agents.
    background: World,
    /// File or planner that it is shown from, for people.
    title: String,
    now: Now,
    /// Vehicle of an episode that is dragged. Agents of scenes follow by themselves.
    dragged: Dragged,
}

/// State at the time that was set.
struct Now {
    time_s: f64,
    world: World,
    cameras: Vec<Camera>,
    ego: Pose,
    /// Motion of the ego vehicle.
    motion: Motion,
}

impl Source {
    /// Copies the scene of `course` to the device.
    ///
    /// # Errors
    /// Returns an error if the device has not the memory.
    pub fn of_scene(
        course: SceneCourse,
        title: String,
        session: &Session,
    ) -> Result<Self, SessionError> {
        let on_device = session.add_scene(&course.input.loaded)?;
        Ok(Self::new(Course::Scene(Box::new(course)), on_device, title))
    }

    /// Source of a log whose place is `on_device`.
    pub fn of_log(played: Played, title: String, on_device: Arc<Scene>) -> Self {
        Self::new(Course::Episode(Box::new(played), None), on_device, title)
    }

    /// Source of an episode that is driven here.
    ///
    /// # Errors
    /// Returns an error if it cannot begin.
    pub fn of_live(edited: ScenarioEditor, session: &Session) -> anyhow::Result<Self> {
        let (title, scene) = (edited.title(), edited.scene().clone());
        let played = Box::new(edited.begin(session)?);
        let course = Course::Episode(played, Some(Box::new(edited)));
        Ok(Self::new(course, scene, title))
    }

    fn new(course: Course, on_device: Arc<Scene>, title: String) -> Self {
        let mut source = Self {
            course,
            background: World::empty(&on_device),
            title,
            now: Now {
                time_s: 0.0,
                world: World::empty(&on_device),
                cameras: Vec::new(),
                ego: Pose::IDENTITY,
                motion: Motion::REST,
            },
            on_device,
            splats: KeptSplats::default(),
            dragged: None,
        };
        source.set_time(source.span_s()[0]);
        source
    }

    /// First and last time, seconds.
    pub fn span_s(&self) -> [f64; 2] {
        match &self.course {
            Course::Scene(course) => {
                let time_s = course.input.time_s;
                let moving = course.trajectories().filter(|way| way.poses().len() > 1);
                let ends = moving.map(|way| way.end_s());
                let Some(end_s) = ends.reduce(f64::max) else {
                    return [time_s; 2];
                };
                // A scene that is shown from a later time on has the earlier ones too.
                let start_s = time_s.min(course.input.loaded.ego.start_s());
                let end_s = end_s.min(start_s + STEP_S * STEPS_MAX);
                [start_s, end_s.max(time_s)]
            }
            Course::Episode(played, _) => played.span_s(),
        }
    }

    /// Duration of a step, seconds.
    pub fn step_s(&self) -> f64 {
        match &self.course {
            Course::Scene(_) => STEP_S,
            Course::Episode(played, _) => played.step_s(),
        }
    }

    /// The episode, if it is one.
    pub fn episode(&self) -> Option<&Played> {
        match &self.course {
            Course::Scene(_) => None,
            Course::Episode(played, _) => Some(played),
        }
    }

    /// The scene.
    ///
    /// # Errors
    /// A sentence, if it is an episode.
    pub fn scene(&self) -> Result<&SceneCourse, &'static str> {
        match &self.course {
            Course::Scene(course) => Ok(course),
            Course::Episode(..) => Err(NO_SCENE),
        }
    }

    /// True while more steps of an episode can be driven.
    pub fn goes_on(&self) -> bool {
        self.episode().is_some_and(Played::goes_on)
    }

    /// Drives one more step of an episode that goes on, and waits for it.
    ///
    /// # Errors
    /// A sentence.
    pub fn drive_on(&mut self) -> Result<(), String> {
        match &mut self.course {
            Course::Scene(_) => Ok(()),
            Course::Episode(played, _) => played.drive_on().map_err(|error| explain(&error)),
        }
    }

    /// Lends the episode for one more step, if it goes on and is not lent already: itself, and a
    /// number that tells it from one that began anew.
    pub fn lend(&mut self) -> Option<(u64, Box<LiveEpisode>)> {
        match &mut self.course {
            Course::Scene(_) => None,
            Course::Episode(played, _) => played.lend(),
        }
    }

    /// Takes an episode back, with one more step if `has_step`. One that began anew meanwhile is
    /// left as it is.
    ///
    /// # Errors
    /// A sentence.
    pub fn take_back(
        &mut self,
        number: u64,
        live: Box<LiveEpisode>,
        has_step: bool,
    ) -> Result<(), String> {
        match &mut self.course {
            Course::Scene(_) => Ok(()),
            Course::Episode(played, _) => {
                let taken = played.take_back(number, live, has_step);
                taken.map_err(|error| explain(&error))
            }
        }
    }

    /// Puts agents, cameras and the ego vehicle where they are at `time_s`: between the moments of
    /// an episode, at the moment before.
    pub fn set_time(&mut self, time_s: f64) {
        match &self.course {
            Course::Scene(course) => {
                let input = &course.input;
                self.now.time_s = time_s;
                // The assets are those of the scene: placing them does not fail.
                let _ = self.now.world.set_agents(course.agents_at(time_s));
                self.now.cameras = input.cameras_after(time_s - input.time_s);
                self.now.ego = input.loaded.ego.at(time_s);
                self.now.motion = input.loaded.ego.motion_at(time_s);
            }
            Course::Episode(played, _) => {
                let moment = played.at(time_s);
                self.now = Now {
                    time_s: moment.time_s,
                    world: moment.world.clone(),
                    cameras: played.cameras(moment),
                    ego: moment.ego,
                    motion: moment.motion,
                };
            }
        }
    }

    /// Time that is shown, seconds.
    pub fn time_s(&self) -> f64 {
        self.now.time_s
    }

    /// Cameras of the scene at the time that was set.
    pub fn cameras(&self) -> &[Camera] {
        &self.now.cameras
    }

    /// Pose of the ego at the time that was set.
    pub fn ego(&self) -> Pose {
        self.now.ego
    }

    /// The world that a pane shows.
    pub fn world(&self, agents: bool) -> &World {
        match agents {
            true => &self.now.world,
            false => &self.background,
        }
    }

    /// Makes `edit`. Returns a sentence for the user, where there is something to say. A live
    /// episode begins anew.
    ///
    /// # Errors
    /// A sentence. Nothing is changed then.
    pub fn edit(&mut self, edit: &Edit, session: &Session) -> Result<Option<String>, String> {
        self.end_drag();
        match &mut self.course {
            Course::Scene(course) => {
                let (said, on_device) = course.edit(edit, self.now.time_s, session)?;
                self.show_anew(on_device);
                Ok(said)
            }
            Course::Episode(played, edited) => {
                let edited = edited.as_mut().ok_or(RECORDED)?;
                let (said, anew) = edited.apply(edit, session)?;
                if let Some(anew) = anew {
                    **played = anew;
                    self.begin_anew();
                }
                Ok(said)
            }
        }
    }

    /// Drags the agent called `name` from the pixel `from` of `camera` to the pixel `to`, both in
    /// shares of the image. `free`: it does not snap to lanes. `done`: the mouse is released.
    ///
    /// # Errors
    /// A sentence. Nothing is changed then; where the mouse is released the agent is where it was.
    pub fn drag(
        &mut self,
        name: &str,
        camera: &Camera,
        pixels: [[f64; 2]; 2],
        (free, done): (bool, bool),
        session: &Session,
    ) -> Result<(), String> {
        let moved = self.drag_or_drop(name, camera, pixels, (free, done), session);
        if done && moved.is_err() {
            self.end_drag();
        }
        moved
    }

    /// Puts an agent that is dragged back to where it was.
    pub fn end_drag(&mut self) {
        self.dragged = None;
        if let Course::Scene(course) = &mut self.course {
            course.end_drag();
        }
        self.set_time(self.now.time_s);
    }

    fn drag_or_drop(
        &mut self,
        name: &str,
        camera: &Camera,
        [from, to]: [[f64; 2]; 2],
        (free, done): (bool, bool),
        session: &Session,
    ) -> Result<(), String> {
        let time_s = self.now.time_s;
        let no_agent = || format!("the scene has no agent {name:?}");
        let start = match &self.course {
            Course::Scene(course) => course.pose_of(name, time_s),
            Course::Episode(..) => {
                let mut agents = self.now.world.agents().iter();
                let agent = agents.find(|agent| agent.name == name);
                agent.map(|agent| agent.placed.pose)
            }
        };
        let start = start.ok_or_else(no_agent)?;
        let on_level = |at: [f64; 2]| point_at_height(camera, at, start.translation.z);
        let by_m = match (on_level(from), on_level(to)) {
            (Some(from), Some(to)) => to - from,
            _ => return Err("there is no ground at that point of the image".into()),
        };
        match &mut self.course {
            Course::Scene(course) => {
                let on_device = course.drag(name, (by_m, free, done), time_s, session)?;
                self.show_anew(on_device);
            }
            Course::Episode(played, edited) => {
                let edited = edited.as_mut().ok_or(RECORDED)?;
                let at_m = (start.translation + by_m).truncate();
                self.dragged = None;
                if done {
                    **played = edited.move_to(name, at_m, played.lanes(), session)?;
                    self.begin_anew();
                } else if let Some((at_m, yaw_rad)) = played.lanes().snapped(at_m) {
                    let at_m = at_m.extend(start.translation.z);
                    self.dragged = Some((name.to_owned(), Pose::from_yaw(yaw_rad, at_m)));
                }
            }
        }
        Ok(())
    }

    fn begin_anew(&mut self) {
        if let Course::Episode(_, Some(edited)) = &self.course {
            self.title = edited.title();
        }
        self.set_time(0.0);
    }

    fn show_anew(&mut self, on_device: Option<Arc<Scene>>) {
        if let Some(on_device) = on_device {
            self.background = World::empty(&on_device);
            self.now.world = World::empty(&on_device);
            self.on_device = on_device;
            self.splats.forget();
        }
        self.set_time(self.now.time_s);
    }

    /// Name of the agent with instance id `instance`.
    pub fn agent_of(&self, instance: u16) -> Option<String> {
        let mut boxes = self.boxes().into_iter();
        Some(boxes.find(|agent| agent.instance == instance)?.name)
    }

    /// The LiDAR called `name`, of the scene or a model on the roof of the ego, for the sweep that
    /// ends now, and the ego's position.
    ///
    /// # Errors
    /// A sentence, if there is no such LiDAR.
    pub fn lidar(&self, name: &str) -> Result<(Lidar, DVec3), String> {
        let rig = &self.loaded().rig;
        // A page names sensors, no files.
        let known = rig.lidars().any(|lidar| lidar.name == name) || lidar_names().contains(&name);
        if !known {
            return Err(format!("there is no LiDAR called {name:?}"));
        }
        let chosen = chosen_lidars(rig, false, &[name.to_owned()]);
        let chosen = chosen.map_err(|error| explain(&error))?;
        let lidar = chosen.first().ok_or("there is no LiDAR")?;
        let sweep = lidar.sweep_until(&self.now.ego, &self.now.motion);
        Ok((sweep, self.now.ego.translation))
    }

    /// Splats that pages draw by themselves, at most `most`.
    pub fn splats(&self, most: usize) -> Arc<[u8]> {
        self.splats.bytes(self.loaded(), most)
    }

    /// Scene as it was read.
    pub fn loaded(&self) -> &LoadedScene {
        match &self.course {
            Course::Scene(course) => &course.input.loaded,
            Course::Episode(played, _) => played.loaded(),
        }
    }

    /// Camera of `pane`, in a size that fits into the pane.
    ///
    /// # Errors
    /// A sentence, when there is no camera or agent of the name.
    pub fn camera(&self, pane: &Pane) -> Result<Camera, String> {
        let size_px = [pane.width_px, pane.height_px];
        let pinhole = |at: &Pose, pinhole: FreeView| Camera {
            name: "view".into(),
            intrinsics: pinhole.intrinsics(size_px),
            world_from_camera: at.then(&pinhole.pose()),
            motion: Motion::REST,
        };
        match &pane.camera {
            CameraRequest::Named { name } => {
                let mut cameras = self.now.cameras.iter();
                let camera = cameras.find(|camera| camera.name == *name).cloned();
                let mut camera =
                    camera.ok_or_else(|| format!("the scene has no camera called {name:?}"))?;
                camera.intrinsics = fitted(&camera.intrinsics, size_px);
                Ok(camera)
            }
            CameraRequest::Free(free) => Ok(free.view().camera("view", size_px)),
            CameraRequest::Attached { agent, pinhole: at } => {
                let pose = match agent {
                    None => self.now.ego,
                    Some(name) => {
                        let mut agents = self.boxes().into_iter();
                        let agent = agents.find(|agent| agent.name == *name);
                        agent
                            .ok_or_else(|| format!("the scene has no agent {name:?}"))?
                            .pose
                    }
                };
                Ok(pinhole(&pose, at.view()))
            }
        }
    }

    /// Image that the log has of the camera of `pane` at this time, if it has one.
    pub fn logged_image(&self, pane: &Pane) -> Option<LoggedImage> {
        match (&self.course, &pane.camera) {
            (Course::Episode(played, _), CameraRequest::Named { name }) if pane.shows_all() => {
                played.logged_image(self.now.time_s, name)
            }
            _ => None,
        }
    }

    /// Agents with their boxes at the time that was set.
    pub fn boxes(&self) -> Vec<Boxed> {
        match &self.course {
            Course::Scene(course) => course.boxes_at(self.now.time_s),
            Course::Episode(played, _) => {
                let dragged = |name: &str| {
                    let dragged = self.dragged.as_ref().filter(|(one, _)| one == name);
                    dragged.map(|(_, pose)| *pose)
                };
                let agents = self.now.world.agents().iter().filter(|agent| agent.present);
                let boxed = agents.map(|agent| {
                    let placed = &agent.placed;
                    let size_m = self.on_device.asset_dims_m(placed.asset);
                    Boxed {
                        name: agent.name.clone(),
                        instance: placed.instance,
                        class: played.class_of(&agent.name),
                        pose: dragged(&agent.name).unwrap_or(placed.pose),
                        size_m: size_m.unwrap_or_default(),
                        speed_mps: placed.motion.velocity_mps.length(),
                        fixed: false,
                        asset: Some(placed.asset),
                    }
                });
                boxed.collect()
            }
        }
    }
}
