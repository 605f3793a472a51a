//! Driving policies of AlpaSim as planners of the closed loop: the client of its egodriver
//! contract.
//!
//! A policy ("driver") is a server. Per decision it gets the images, its poses since the decision
//! before and the route, and answers with a trajectory. All calls of a decision share one time
//! limit; a driver that fails or is late ends its episode, and the next one begins a new session.
//! The contract is that of <https://github.com/NVlabs/alpasim>, `egodriver.proto`.

mod messages;
mod options;

use std::hash::{BuildHasher, RandomState};
use std::time::Duration;

use decouplegs::planner::{
    Cameras, EpisodeInfo, Frame, Localization, Observation, ObservationRequest, Planner,
    PlannerError, Timeouts, images,
};
use decouplegs::scene::{Plan, RigCamera, Sensor};
use rayon::prelude::*;
use tokio::runtime::Runtime;
use tonic::metadata::MetadataValue;
use tonic::transport::{Channel, Endpoint};
use tonic::{Request, Status};

use crate::wire::common::Empty;
use crate::wire::egodriver::drive_session_request::rollout_spec::VehicleDefinition;
use crate::wire::egodriver::drive_session_request::{DebugInfo, RolloutSpec};
use crate::wire::egodriver::egodriver_service_client::EgodriverServiceClient;
use crate::wire::egodriver::rollout_camera_image::CameraImage;
use crate::wire::egodriver::{
    DriveRequest, DriveResponse, DriveSessionCloseRequest, DriveSessionRequest, RolloutCameraImage,
    RolloutEgoTrajectory, RouteRequest,
};

use messages::Frames;
pub use options::{CameraChoice, DriverAddress, DriverOptions, ImageFile, Padding, SensorLens};

/// Bytes of the largest message.
const MESSAGE_BYTES_MAX: usize = 64 << 20;
/// Plans beside the chosen one that are kept.
const ALTERNATIVES_MAX: usize = 64;
/// Time for a driver to close a session.
const FAREWELL: Duration = Duration::from_secs(2);
/// Longest part of a driver's own words in an error, characters.
const SAID_CHARS_MAX: usize = 400;
/// Key and value that tell drivers made with the Python package `carla-driver-interface` that
/// `rig_to_camera` is the pose of the optical axes (x right, y down, z forward), as in AlpaSim.
/// Other drivers ignore it.
const CAMERA_AXES: (&str, &str) = ("carla-driver-interface-contract", "2");

/// A driver of AlpaSim's egodriver contract, which plans for the ego.
#[derive(Debug)]
pub struct Egodriver {
    address: DriverAddress,
    options: DriverOptions,
    timeouts: Timeouts,
    runtime: Runtime,
    client: EgodriverServiceClient<Channel>,
    version: String,
    session: Option<DriverSession>,
    is_warming_up: bool,
    alternatives: Vec<Plan>,
}

/// State of an episode.
#[derive(Debug)]
struct DriverSession {
    uuid: String,
    frames: Frames,
    step_s: f64,
}

impl Egodriver {
    /// Connects to the driver at `address` and asks for its version.
    ///
    /// # Errors
    /// Returns an error if no driver answers there in time, or the options contradict each other.
    pub fn open(
        address: &DriverAddress,
        options: &DriverOptions,
        timeouts: Timeouts,
    ) -> Result<Self, PlannerError> {
        options
            .check()
            .map_err(|fault| PlannerError(fault.into()))?;
        let failed = |reason: String| PlannerError(format!("the driver at {address}: {reason}"));
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|error| failed(error.to_string()))?;
        let endpoint = Endpoint::from_shared(address.uri())
            .map_err(|error| failed(error.to_string()))?
            .tcp_nodelay(true)
            .connect_timeout(timeouts.hello);
        // A lazy channel belongs to the runtime that is entered.
        let channel = {
            let _entered = runtime.enter();
            endpoint.connect_lazy()
        };
        let mut client = EgodriverServiceClient::new(channel)
            .max_decoding_message_size(MESSAGE_BYTES_MAX)
            .max_encoding_message_size(MESSAGE_BYTES_MAX);
        let asked = runtime.block_on(async {
            tokio::time::timeout(timeouts.hello, client.get_version(Empty {})).await
        });
        let version = asked
            .map_err(|_| failed(late("get_version", timeouts.hello)))?
            .map_err(|status| failed(refused("get_version", &status)))?;
        Ok(Self {
            address: address.clone(),
            options: options.clone(),
            timeouts,
            runtime,
            client,
            version: printable(&version.into_inner().version_id),
            session: None,
            is_warming_up: false,
            alternatives: Vec::new(),
        })
    }

    fn failed(&self, reason: &str) -> PlannerError {
        PlannerError(format!("the driver at {} {reason}", self.address))
    }

    /// Runs `call`, named `what`, within the time limit of an answer.
    fn ask<T>(
        &mut self,
        what: &str,
        call: impl AsyncFnOnce(
            &mut EgodriverServiceClient<Channel>,
        ) -> Result<T, (&'static str, Status)>,
    ) -> Result<T, PlannerError> {
        let limit = self.timeouts.answer;
        let client = &mut self.client;
        let asked = self
            .runtime
            .block_on(async { tokio::time::timeout(limit, call(client)).await });
        match asked {
            Ok(Ok(answer)) => Ok(answer),
            Ok(Err((call, status))) => Err(self.failed(&refused(call, &status))),
            Err(_) => Err(self.failed(&late(what, limit))),
        }
    }

    /// Message with the image `frame`, drawn at `now_us`.
    fn image(
        &self,
        frame: &Frame,
        uuid: &str,
        now_us: u64,
    ) -> Result<RolloutCameraImage, PlannerError> {
        let file = self.options.driver_images.encode(frame);
        let name = &frame.camera.name;
        let image_bytes =
            file.map_err(|error| self.failed(&format!("gets no image of {name}: {error}")))?;
        let [frame_start_us, frame_end_us] =
            messages::exposure_us(&frame.camera.intrinsics, now_us);
        Ok(RolloutCameraImage {
            session_uuid: uuid.to_owned(),
            camera_image: Some(CameraImage {
                frame_start_us,
                frame_end_us,
                image_bytes: image_bytes.into(),
                logical_id: self.options.logical_id(name).to_owned(),
            }),
        })
    }

    fn close(&mut self) {
        let Some(DriverSession { uuid, .. }) = self.session.take() else {
            return;
        };
        let client = &mut self.client;
        let request = DriveSessionCloseRequest { session_uuid: uuid };
        // A driver that is gone has closed it already.
        let _ = self.runtime.block_on(async {
            tokio::time::timeout(FAREWELL, client.close_session(request)).await
        });
    }

    /// Sends all of `observation` and asks for the decision.
    fn decide(
        &mut self,
        session: &DriverSession,
        observation: &Observation,
        localization: &Localization,
    ) -> Result<DriveResponse, PlannerError> {
        let uuid = &session.uuid;
        let now_us = messages::time_us(observation.time_s);
        let frames: Vec<Frame> = images(observation.readings).collect();
        // Files of large images take longer to make than the images.
        let files = frames
            .par_iter()
            .map(|frame| self.image(frame, uuid, now_us));
        let sent_images: Vec<RolloutCameraImage> = files.collect::<Result<_, _>>()?;
        let (trajectory, dynamic_states) = session.frames.path(localization);
        let egomotion = RolloutEgoTrajectory {
            session_uuid: uuid.clone(),
            trajectory: Some(trajectory),
            dynamic_states,
        };
        let route = RouteRequest {
            session_uuid: uuid.clone(),
            route: Some(
                session
                    .frames
                    .route(localization, self.options.driver_padding),
            ),
        };
        let drive = DriveRequest {
            session_uuid: uuid.clone(),
            time_now_us: now_us,
            time_query_us: messages::time_us(observation.time_s + session.step_s),
            renderer_data: Default::default(),
        };
        self.ask("drive", async |client| {
            for image in sent_images {
                let sent = client.submit_image_observation(image).await;
                sent.map_err(|status| ("submit_image_observation", status))?;
            }
            let sent = client.submit_egomotion_observation(egomotion).await;
            sent.map_err(|status| ("submit_egomotion_observation", status))?;
            let sent = client.submit_route(route).await;
            sent.map_err(|status| ("submit_route", status))?;
            let answer = client.drive(drive).await;
            Ok(answer.map_err(|status| ("drive", status))?.into_inner())
        })
    }
}

impl Planner for Egodriver {
    fn name(&self) -> String {
        format!("egodriver:{}", self.version)
    }

    fn sees(&self) -> ObservationRequest {
        ObservationRequest {
            cameras: match self.options.camera_names() {
                names if names.is_empty() => Cameras::All,
                names => Cameras::Named(names),
            },
            localization: true,
            ..ObservationRequest::default()
        }
    }

    fn begin(&mut self, info: &EpisodeInfo) -> Result<(), PlannerError> {
        self.close();
        self.is_warming_up = false;
        self.alternatives.clear();
        let frames = Frames::new(info);
        let cameras = info.sensors.iter().filter_map(|sensor| match sensor {
            Sensor::Camera(camera) => Some(camera),
            Sensor::Lidar(_) => None,
        });
        let available_cameras = cameras
            .map(|camera: &RigCamera| frames.camera(camera, self.options.logical_id(&camera.name)))
            .collect();
        let uuid = uuid_v4();
        let mut request = Request::new(DriveSessionRequest {
            session_uuid: uuid.clone(),
            random_seed: info.seed,
            debug_info: self.options.tell_scene.then(|| DebugInfo {
                scene_id: info.scenario.clone(),
            }),
            rollout_spec: Some(RolloutSpec {
                vehicle: Some(VehicleDefinition { available_cameras }),
            }),
        });
        let (key, revision) = CAMERA_AXES;
        request
            .metadata_mut()
            .insert(key, MetadataValue::from_static(revision));
        self.ask("start_session", async |client| {
            let begun = client.start_session(request).await;
            begun.map_err(|status| ("start_session", status))
        })?;
        self.session = Some(DriverSession {
            uuid,
            frames,
            step_s: info.step_s,
        });
        Ok(())
    }

    fn plan(&mut self, observation: &Observation) -> Result<Plan, PlannerError> {
        let localization = observation
            .localization
            .ok_or_else(|| self.failed("was not told where the ego is"))?;
        let mut session = self
            .session
            .take()
            .ok_or_else(|| self.failed("has no session: its episode was not begun"))?;
        session.frames.begin_at(localization);
        let answer = self.decide(&session, observation, localization);
        self.alternatives.clear();
        let plan = answer.and_then(|answer| {
            let sampled = answer.debug_info.iter();
            let sampled = sampled.flat_map(|info| &info.sampled_trajectories);
            // They are for people: one that is no plan is left out.
            let plans = sampled.take(ALTERNATIVES_MAX).filter_map(|trajectory| {
                session.frames.plan(trajectory, localization).ok().flatten()
            });
            self.alternatives.extend(plans);
            if answer.terminate_session {
                return Err(self.failed("ended the session"));
            }
            let trajectory = answer.trajectory.unwrap_or_default();
            let planned = session.frames.plan(&trajectory, localization);
            planned.map_err(|fault| self.failed(&format!("answered {fault}")))
        });
        self.session = Some(session);
        let plan = plan?;
        self.is_warming_up = plan.is_none() && observation.time_s < self.options.driver_warm_up;
        match plan {
            Some(plan) => Ok(plan),
            None if self.is_warming_up => messages::along_route(localization),
            None => Ok(Plan::standing()),
        }
    }

    fn is_warming_up(&self) -> bool {
        self.is_warming_up
    }

    fn alternatives(&self) -> &[Plan] {
        &self.alternatives
    }
}

impl Drop for Egodriver {
    fn drop(&mut self) {
        self.close();
    }
}

/// A UUID of version 4 (RFC 9562), from the random keys of hash maps.
fn uuid_v4() -> String {
    let random = || RandomState::new().hash_one(std::time::Instant::now());
    let bits = u128::from(random()) << 64 | u128::from(random());
    let bits = bits & !(0xf << 76) & !(0x3 << 62) | 0x4 << 76 | 0x2 << 62;
    let hex = format!("{bits:032x}");
    let parts = [
        &hex[..8],
        &hex[8..12],
        &hex[12..16],
        &hex[16..20],
        &hex[20..],
    ];
    parts.join("-")
}

fn late(call: &str, limit: Duration) -> String {
    format!("did not answer `{call}` within {} s", limit.as_secs_f64())
}

fn refused(call: &str, status: &Status) -> String {
    format!(
        "refused `{call}`: {} ({:?})",
        printable(status.message()),
        status.code()
    )
}

/// Start of a driver's words, without characters that a terminal would obey.
fn printable(text: &str) -> String {
    let shown = text.chars().take(SAID_CHARS_MAX);
    shown
        .map(|c| if c.is_control() { ' ' } else { c })
        .collect()
}
