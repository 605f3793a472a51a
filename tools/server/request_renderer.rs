//! Images and sweeps of one scene, as requests ask for them. All use of the renderer is in this
//! file.

use std::collections::{HashMap, HashSet};

use decouplegs::AgentInstance;
use decouplegs::asset::LoadedScene;
use decouplegs::asset::packed_scene::stands;
use decouplegs::gpu::GpuError;
use decouplegs::render::RenderError;
use decouplegs::scene::{Camera, Lidar, LidarSweep, Pose};
use decouplegs::session::{
    BatchRenderer, HostImages, Session, SessionError, World, WorldAgent, WorldView,
};
use glam::DVec3;
use tonic::Status;

use crate::render_request::{PlacedObject, RenderRequest};
use crate::sweep_request::SweepRequest;

/// Draws what requests see of one scene.
pub struct RequestRenderer {
    renderer: BatchRenderer,
    /// Objects of the last requests, one world per list of objects; at least one.
    worlds: Vec<World>,
    /// World coordinates of the local frame's origin.
    origin: DVec3,
    /// Assets of the scene's agents, by name; their poses come with each request.
    agents: HashMap<String, AgentInstance>,
    /// Agents that stand all the time: a request that does not list them sees them there.
    standing: Vec<(String, AgentInstance)>,
}

/// Results beside the images.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Drawn {
    /// Objects that were asked for and that the scene has not.
    pub unknown: Vec<String>,
}

impl RequestRenderer {
    /// `loaded` on the device of `session`.
    ///
    /// # Errors
    /// Returns an error if the device has not the memory, or an asset cannot be drawn.
    pub fn new(session: &Session, loaded: &LoadedScene) -> Result<Self, SessionError> {
        let scene = session.add_scene(loaded)?;
        let file = World::new(&scene);
        let placed = file
            .agents()
            .iter()
            .map(|agent| (agent.name.clone(), agent.placed));
        let stood = loaded.agents.iter();
        let stood = stood.filter(|agent| stands(&agent.trajectory, &agent.present));
        let stood: HashSet<&str> = stood.map(|agent| &*agent.name).collect();
        let standing = file
            .agents()
            .iter()
            .filter(|agent| stood.contains(&*agent.name));
        // To clients that do not list it, it is a part of the background.
        let unlisted = |agent: &WorldAgent| AgentInstance {
            instance: 0,
            ..agent.placed
        };
        Ok(Self {
            renderer: session.batch_renderer(),
            standing: standing
                .map(|agent| (agent.name.clone(), unlisted(agent)))
                .collect(),
            agents: placed.collect(),
            worlds: vec![World::empty(&scene)],
            origin: loaded.splat_scene.origin,
        })
    }

    /// Draws what the requests of `views` see, all of them in one submission, into `images`.
    /// Requests of one view see the same objects at the same places.
    ///
    /// # Errors
    /// Returns an error if a camera cannot make an image, the device has not the memory or was
    /// lost.
    pub fn draw(
        &mut self,
        views: &[Vec<RenderRequest>],
        images: &mut HostImages,
    ) -> Result<Drawn, SessionError> {
        let mut drawn = Drawn::default();
        let mut cameras: Vec<Vec<Camera>> = Vec::with_capacity(views.len());
        for (view, requests) in views.iter().enumerate() {
            let objects = requests.first().map_or(&[][..], |request| &request.objects);
            drawn.unknown.extend(self.place(view, objects)?.unknown);
            let of_view = requests.iter().enumerate();
            cameras.push(
                of_view
                    .map(|(at, request)| self.camera(at, request))
                    .collect(),
            );
        }
        let views: Vec<WorldView<'_>> = self
            .worlds
            .iter()
            .zip(&cameras)
            .map(|(world, cameras)| WorldView { world, cameras })
            .collect();
        self.renderer.draw(&views, images)?;
        Ok(drawn)
    }

    /// Traces the sweep that `request` asks for. Its poses are those of the request. Instances are
    /// 1 and more in the order of the objects.
    ///
    /// # Errors
    /// Returns an error if a pose makes no sense, the device has not the memory or was lost.
    pub fn sweep(&mut self, request: &SweepRequest) -> Result<(LidarSweep, Drawn), SessionError> {
        let drawn = self.place(0, &request.objects)?;
        let lidar = Lidar {
            world_from_rig: self.in_world(&request.lidar.world_from_rig),
            ..request.lidar.clone()
        };
        let halfway_s = 0.5 * lidar.model.sweep_s;
        let mode = request.options.mode;
        let traced = self
            .renderer
            .trace(&self.worlds[0], &lidar, halfway_s, mode)?;
        let mut sweep = traced.returns(&request.options);
        sweep.lidar = request.lidar.clone();
        Ok((sweep, drawn))
    }

    /// Replaces the agents of world `view` by `objects` and those that stand and are not among
    /// them; makes the world if it is the next one.
    fn place(&mut self, view: usize, objects: &[PlacedObject]) -> Result<Drawn, SessionError> {
        let mut drawn = Drawn::default();
        let mut placed = Vec::with_capacity(objects.len());
        for (index, object) in objects.iter().enumerate() {
            let track_id = &object.track_id;
            match self.agents.get(track_id) {
                Some(agent) => {
                    let (pose, motion) = (self.in_world(&object.pose), object.motion);
                    let instance = AgentInstance {
                        pose,
                        motion,
                        instance: u16::try_from(index + 1).unwrap_or(u16::MAX),
                        ..*agent
                    };
                    placed.push((track_id.clone(), instance));
                }
                None => drawn.unknown.push(track_id.clone()),
            }
        }
        if !self.standing.is_empty() {
            let listed: HashSet<&str> = objects.iter().map(|object| &*object.track_id).collect();
            let standing = self.standing.iter();
            placed.extend(
                standing
                    .filter(|(name, _)| !listed.contains(&**name))
                    .cloned(),
            );
        }
        if view == self.worlds.len() {
            self.worlds.push(World::empty(self.worlds[0].scene()));
        }
        self.worlds[view].set_agents(placed)?;
        Ok(drawn)
    }

    fn camera(&self, index: usize, request: &RenderRequest) -> Camera {
        let world_from_camera = self.in_world(&request.local_from_camera);
        Camera {
            name: index.to_string(),
            intrinsics: request.intrinsics,
            world_from_camera,
            motion: request.motion,
        }
    }

    fn in_world(&self, pose: &Pose) -> Pose {
        Pose {
            translation: pose.translation + self.origin,
            ..*pose
        }
    }
}

/// gRPC status of `error` for a client: INVALID_ARGUMENT for what its request asks for,
/// FAILED_PRECONDITION for what a scene file holds, and INTERNAL for faults of the server alone,
/// which clients try again.
pub fn status_of(error: &SessionError) -> Status {
    use SessionError::{NoAgent, NoAsset, NoCameras, PlainSplats, TooManyAgents};
    if is_lost(error) {
        return Status::unavailable(error.to_string());
    }
    match error {
        SessionError::Render(RenderError::Gpu(error)) | SessionError::Gpu(error) => match error {
            GpuError::OutOfMemory { .. } | GpuError::BufferTooLarge { .. } => {
                Status::resource_exhausted(error.to_string())
            }
            _ => Status::internal(error.to_string()),
        },
        SessionError::Render(error) => match error {
            RenderError::View(error) => Status::invalid_argument(error.reason()),
            RenderError::Lidar { .. }
            | RenderError::AgentPose { .. }
            | RenderError::AgentMotion { .. } => Status::invalid_argument(error.to_string()),
            RenderError::Asset(_)
            | RenderError::AgentLight { .. }
            | RenderError::Shadow { .. }
            | RenderError::TooManySplats { .. } => Status::failed_precondition(error.to_string()),
            _ => Status::internal(error.to_string()),
        },
        NoAgent { .. } | NoAsset { .. } | TooManyAgents { .. } | NoCameras => {
            Status::invalid_argument(error.to_string())
        }
        SessionError::Asset(_) | PlainSplats { .. } => {
            Status::failed_precondition(error.to_string())
        }
        _ => Status::internal(error.to_string()),
    }
}

/// True if the device is lost for good.
pub fn is_lost(error: &SessionError) -> bool {
    error.gpu().is_some_and(GpuError::is_lost)
}

#[cfg(test)]
mod tests {
    use decouplegs::scene::Invalid;
    use tonic::Code;

    use super::*;

    #[test]
    fn a_fault_of_the_client_is_never_one_of_the_server() {
        let reason = || Invalid::new("a turn of 1.57 rad in 0.0000005 s".to_owned());
        let of_request = [
            SessionError::Render(RenderError::View(reason())),
            SessionError::Render(RenderError::AgentMotion {
                instance: 1,
                reason: reason(),
            }),
            SessionError::Render(RenderError::AgentPose {
                instance: 1,
                pose: "NaN".into(),
            }),
            SessionError::Render(RenderError::Lidar {
                name: "roof".into(),
                reason: reason(),
            }),
            SessionError::TooManyAgents { max: 65_535 },
            SessionError::NoCameras,
        ];
        for error in of_request {
            assert_eq!(status_of(&error).code(), Code::InvalidArgument, "{error}");
        }
        let of_scene = SessionError::Render(RenderError::Asset(reason()));
        assert_eq!(status_of(&of_scene).code(), Code::FailedPrecondition);
        let of_server = SessionError::Render(RenderError::NothingInFlight);
        assert_eq!(status_of(&of_server).code(), Code::Internal);
    }
}
