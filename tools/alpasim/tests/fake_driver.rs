//! A driver of AlpaSim's egodriver contract, for tests: it answers as it is told, and keeps what it
//! was asked.

use std::collections::HashMap;
use std::f64::consts::FRAC_1_SQRT_2;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use decouplegs::scene::Pose;
use decouplegs_alpasim::egodriver::DriverAddress;
use decouplegs_alpasim::poses::{message_of, pose_of};
use decouplegs_alpasim::wire::common::{
    Empty, PoseAtTime, SessionRequestStatus, Trajectory, VersionId,
};
use decouplegs_alpasim::wire::egodriver::egodriver_service_server::{
    EgodriverService, EgodriverServiceServer,
};
use decouplegs_alpasim::wire::egodriver::{
    DriveRequest, DriveResponse, DriveSessionCloseRequest, DriveSessionRequest, GroundTruthRequest,
    RolloutCameraImage, RolloutEgoTrajectory, RouteRequest,
};
use glam::{DQuat, DVec3};
use tonic::transport::server::TcpIncoming;
use tonic::{Request, Response, Status};

/// Interval between poses of an answer, and the number of poses.
const SPACING_US: u64 = 100_000;
const POSES: u64 = 40;

/// Answers of a driver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Manner {
    /// A circle of this curvature (1/m, to the left) at this speed (m/s), from the second decision
    /// of this number on; nothing before.
    Curve {
        per_m: f64,
        speed_mps: f64,
        from: usize,
    },
    /// The end of the session, at once.
    Ends,
    /// Nothing, ever: the call never returns.
    Hangs,
    /// A refusal.
    Refuses,
    /// A pose that is none.
    Nonsense,
}

/// Requests that a driver got.
#[derive(Clone, Debug, Default)]
pub struct Asked {
    pub sessions: Vec<DriveSessionRequest>,
    pub contracts: Vec<String>,
    pub images: Vec<RolloutCameraImage>,
    pub paths: Vec<RolloutEgoTrajectory>,
    pub routes: Vec<RouteRequest>,
    pub drives: Vec<DriveRequest>,
    pub closed: Vec<String>,
}

/// The driver.
#[derive(Clone, Debug)]
pub struct FakeDriver {
    manner: Manner,
    asked: Arc<Mutex<Asked>>,
    /// Last pose of each session.
    poses: Arc<Mutex<HashMap<String, PoseAtTime>>>,
}

impl FakeDriver {
    /// Starts a driver on a thread of its own, which ends with the process.
    pub fn start(manner: Manner) -> (DriverAddress, Self) {
        let driver = Self {
            manner,
            asked: Arc::default(),
            poses: Arc::default(),
        };
        let (served, (told, address)) = (driver.clone(), std::sync::mpsc::channel());
        std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread()
                .enable_all()
                .build()
                .unwrap();
            runtime.block_on(async {
                let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
                told.send(listener.local_addr().unwrap()).unwrap();
                let service = EgodriverServiceServer::new(served);
                let service = service.max_decoding_message_size(64 << 20);
                let incoming = TcpIncoming::from(listener).with_nodelay(Some(true));
                tonic::transport::Server::builder()
                    .add_service(service)
                    .serve_with_incoming(incoming)
                    .await
                    .unwrap();
            });
        });
        let address = format!("egodriver://{}", address.recv().unwrap());
        (address.parse().unwrap(), driver)
    }

    /// Requests so far.
    pub fn asked(&self) -> Asked {
        self.asked.lock().unwrap().clone()
    }

    fn note(&self, note: impl FnOnce(&mut Asked)) -> Result<Response<Empty>, Status> {
        note(&mut self.asked.lock().unwrap());
        Ok(Response::new(Empty {}))
    }
}

/// Pose on a circle of curvature `per_m`, `way_m` along it, in the frame of its start.
pub fn on_circle(per_m: f64, way_m: f64) -> Pose {
    let turn_rad = per_m * way_m;
    let place = match per_m == 0.0 {
        true => DVec3::X * way_m,
        false => DVec3::new(turn_rad.sin(), 1.0 - turn_rad.cos(), 0.0) / per_m,
    };
    Pose::new(DQuat::from_rotation_z(turn_rad), place)
}

#[tonic::async_trait]
impl EgodriverService for FakeDriver {
    async fn start_session(
        &self,
        request: Request<DriveSessionRequest>,
    ) -> Result<Response<SessionRequestStatus>, Status> {
        let contract = request.metadata().get("carla-driver-interface-contract");
        let contract = contract.map(|revision| revision.to_str().unwrap().to_owned());
        self.note(|asked| {
            asked.contracts.extend(contract);
            asked.sessions.push(request.into_inner());
        })?;
        Ok(Response::new(SessionRequestStatus {}))
    }

    async fn close_session(
        &self,
        request: Request<DriveSessionCloseRequest>,
    ) -> Result<Response<Empty>, Status> {
        self.note(|asked| asked.closed.push(request.into_inner().session_uuid))
    }

    async fn submit_image_observation(
        &self,
        request: Request<RolloutCameraImage>,
    ) -> Result<Response<Empty>, Status> {
        let image = request.into_inner();
        let id = image.camera_image.as_ref().unwrap().logical_id.clone();
        if id.starts_with("foreign") {
            return Err(Status::invalid_argument(format!(
                "camera {id} was not declared"
            )));
        }
        self.note(|asked| asked.images.push(image))
    }

    async fn submit_egomotion_observation(
        &self,
        request: Request<RolloutEgoTrajectory>,
    ) -> Result<Response<Empty>, Status> {
        let path = request.into_inner();
        let last = *path.trajectory.as_ref().unwrap().poses.last().unwrap();
        let mut poses = self.poses.lock().unwrap();
        poses.insert(path.session_uuid.clone(), last);
        self.note(|asked| asked.paths.push(path))
    }

    async fn submit_route(
        &self,
        request: Request<RouteRequest>,
    ) -> Result<Response<Empty>, Status> {
        self.note(|asked| asked.routes.push(request.into_inner()))
    }

    async fn submit_recording_ground_truth(
        &self,
        _request: Request<GroundTruthRequest>,
    ) -> Result<Response<Empty>, Status> {
        Err(Status::unimplemented("there is no recording"))
    }

    async fn drive(
        &self,
        request: Request<DriveRequest>,
    ) -> Result<Response<DriveResponse>, Status> {
        let request = request.into_inner();
        let anchor = self.poses.lock().unwrap()[&request.session_uuid];
        self.note(|asked| asked.drives.push(request.clone()))?;
        let count = self.asked().drives.len();
        let at = |pose: &Pose, timestamp_us: u64| PoseAtTime {
            pose: Some(message_of(pose)),
            timestamp_us,
        };
        let mut response = DriveResponse::default();
        match self.manner {
            Manner::Curve {
                per_m,
                speed_mps,
                from,
            } if count > from => {
                let begin = pose_of(anchor.pose.as_ref(), "anchor").unwrap();
                let poses = (0..=POSES).map(|index| {
                    let after_us = index * SPACING_US;
                    let way_m = speed_mps * after_us as f64 * 1e-6;
                    let ahead = begin.then(&on_circle(per_m, way_m));
                    at(&ahead, request.time_now_us + after_us)
                });
                response.trajectory = Some(Trajectory {
                    poses: poses.collect(),
                });
            }
            Manner::Curve { .. } => {}
            Manner::Ends => response.terminate_session = true,
            Manner::Hangs => tokio::time::sleep(Duration::from_secs(3600)).await,
            Manner::Refuses => return Err(Status::internal("the network\u{1b}[31m is lost")),
            Manner::Nonsense => {
                let turned = DQuat::from_xyzw(0.0, 0.0, FRAC_1_SQRT_2, FRAC_1_SQRT_2);
                let far = Pose::new(turned, DVec3::splat(f64::from(f32::MAX)));
                let poses = vec![at(&far, request.time_now_us + SPACING_US)];
                response.trajectory = Some(Trajectory { poses });
            }
        }
        Ok(Response::new(response))
    }

    async fn get_version(&self, _request: Request<Empty>) -> Result<Response<VersionId>, Status> {
        Ok(Response::new(VersionId {
            version_id: "fake".into(),
            ..VersionId::default()
        }))
    }
}
