//! The server that is judged, and requests to it.

use anyhow::{Context, Result, ensure};
use glam::DVec3;
use tonic::metadata::{Ascii, MetadataValue};
use tonic::service::Interceptor;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::Channel;
use tonic::{Request, Status};

use decouplegs::scene::Pose;

use super::check::Stop;
use super::rgb_image::RgbImage;
use super::{ConformOptions, MESSAGE_BYTES_MAX};
use decouplegs_alpasim::poses::{message_of, pose_of};
use decouplegs_alpasim::wire::common::Empty;
use decouplegs_alpasim::wire::sensorsim::available_cameras_return::AvailableCamera;
use decouplegs_alpasim::wire::sensorsim::camera_spec::CameraParam;
use decouplegs_alpasim::wire::sensorsim::sensorsim_service_client::SensorsimServiceClient;
use decouplegs_alpasim::wire::sensorsim::{
    AvailableCamerasRequest, AvailableTrajectoriesRequest, CameraSpec, DynamicObject, ImageFormat,
    OpenCvPinholeCameraParam, PosePair, RgbRenderRequest,
};

/// Size of the images that are compared, pixels.
pub(super) const SIZE_PX: [u32; 2] = [320, 200];
/// Focal length of the pinhole that views are compared in, pixels: wide angles are left to the
/// server's own cameras.
pub(super) const FOCAL_PX: f64 = 360.0;
/// Time for which a shutter is open, microseconds.
pub(super) const SHUTTER_US: u64 = 20_000;
/// Distance of a hidden object, meters.
const AHEAD_HIDDEN_M: f64 = 12.0;
/// Images with less contrast show too little to be compared, of 255.
const CONTRAST_MIN: f64 = 3.0;

/// Adds the token to each request.
#[derive(Clone)]
pub(super) struct Token(Option<MetadataValue<Ascii>>);

impl Interceptor for Token {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        if let Some(token) = &self.0 {
            request
                .metadata_mut()
                .insert("authorization", token.clone());
        }
        Ok(request)
    }
}

/// Client of the server.
pub(super) type Client = SensorsimServiceClient<InterceptedService<Channel, Token>>;

/// A server, a scene of it and a view into the scene.
pub(super) struct Target {
    pub(super) client: Client,
    pub(super) channel: InterceptedService<Channel, Token>,
    pub(super) scene: String,
    pub(super) camera: AvailableCamera,
    pub(super) object: Option<String>,
    /// Package that the simulator reads beside the server.
    pub(super) package: Option<std::path::PathBuf>,
    /// Pose of the rig in the middle of its trajectory, and the time there.
    pub(super) local_from_rig: Pose,
    pub(super) time_us: u64,
    /// True if that pose is on a trajectory: without one the view is from the origin, where nobody
    /// may ever have looked.
    pub(super) has_trajectory: bool,
}

impl Target {
    pub(super) async fn new(channel: Channel, options: &ConformOptions) -> Result<Self> {
        let token = match &options.token_file {
            Some(path) => {
                let text = std::fs::read_to_string(path)
                    .with_context(|| format!("cannot read {}", path.display()))?;
                let value = format!("Bearer {}", text.trim()).parse();
                Some(value.with_context(|| format!("{} holds no token", path.display()))?)
            }
            None => None,
        };
        let channel = InterceptedService::new(channel, Token(token));
        let mut client = SensorsimServiceClient::new(channel.clone())
            .max_decoding_message_size(MESSAGE_BYTES_MAX)
            .max_encoding_message_size(MESSAGE_BYTES_MAX);
        let scene = match &options.scene {
            Some(scene) => scene.clone(),
            None => {
                let scenes = client.get_available_scenes(Empty {}).await;
                let scenes = scenes.context("the server does not list its scenes")?;
                let ids = scenes.into_inner().scene_ids;
                ids.into_iter()
                    .next()
                    .context("the server has no scene: name one with --scene")?
            }
        };
        let camera = first_camera(&mut client, &scene, options.camera.as_deref()).await?;
        let middle = middle(&mut client, &scene).await;
        let (local_from_rig, time_us) = middle.unwrap_or((Pose::IDENTITY, 0));
        Ok(Self {
            client,
            channel,
            scene,
            camera,
            object: options.object.clone(),
            package: options.package.clone(),
            local_from_rig,
            time_us,
            has_trajectory: middle.is_some(),
        })
    }

    /// Pose of the camera in the middle of the trajectory.
    pub(super) fn sensor(&self) -> Pose {
        let rig_from_camera = pose_of(self.camera.rig_to_camera.as_ref(), "rig_to_camera");
        let rig_from_camera = rig_from_camera.unwrap_or(Pose::IDENTITY);
        self.local_from_rig.then(&rig_from_camera)
    }

    /// Request for the view of `spec` from `start` to `end`, as PNG.
    pub(super) fn request_of(
        &self,
        spec: CameraSpec,
        start: &Pose,
        end: &Pose,
    ) -> RgbRenderRequest {
        RgbRenderRequest {
            scene_id: self.scene.clone(),
            resolution_w: SIZE_PX[0],
            resolution_h: SIZE_PX[1],
            camera_intrinsics: Some(spec),
            frame_start_us: self.time_us,
            frame_end_us: self.time_us + SHUTTER_US,
            sensor_pose: Some(pair(start, end)),
            image_format: ImageFormat::Png.into(),
            image_quality: 95.0,
            ..RgbRenderRequest::default()
        }
    }

    /// Request for the view of the pinhole at rest, as PNG.
    pub(super) fn request(&self) -> RgbRenderRequest {
        let sensor = self.sensor();
        self.request_of(spec_of(pinhole()), &sensor, &sensor)
    }

    /// Image of a request, which is sent as PNG.
    pub(super) async fn image(&mut self, request: RgbRenderRequest) -> Result<RgbImage, Stop> {
        let image = self.client.render_rgb(request).await?.into_inner();
        RgbImage::of_png(&image.image_bytes)
    }

    /// Image of a request that shows something.
    ///
    /// Skips the check where it does not.
    pub(super) async fn view(&mut self, request: RgbRenderRequest) -> Result<RgbImage, Stop> {
        let image = self.image(request).await?;
        let contrast = image.contrast();
        if contrast < CONTRAST_MIN {
            return Err(Stop::Skipped(format!(
                "the view shows nothing to compare (contrast {contrast:.1} of 255): choose another --camera"
            )));
        }
        Ok(image)
    }

    /// Object of the options, `ahead_m` in front of the camera, level with it, and `right_m` to its
    /// right, upright, turned by `yaw_rad` from the heading of the camera.
    pub(super) fn object(
        &self,
        ahead_m: f64,
        right_m: f64,
        yaw_rad: f64,
    ) -> Result<DynamicObject, Stop> {
        let track_id = self.object.clone().ok_or_else(|| {
            Stop::Skipped("the contract does not list objects: name one with --object".into())
        })?;
        let forward = self.object_direction();
        let right = forward.cross(DVec3::Z);
        let place = self.sensor().translation + forward * ahead_m + right * right_m;
        let pose = Pose::from_yaw(forward.y.atan2(forward.x) + yaw_rad, place);
        Ok(DynamicObject {
            track_id,
            pose_pair: Some(pair(&pose, &pose)),
        })
    }

    /// Object of the options where nobody sees it, as AlpaSim hides it
    /// (`src/runtime/alpasim_runtime/unbound_rollout.py:243`).
    pub(super) fn hidden_object(&self) -> Result<DynamicObject, Stop> {
        let mut object = self.object(AHEAD_HIDDEN_M, 0.0, 0.0)?;
        let poses = object.pose_pair.iter_mut();
        for pose in poses.flat_map(|pair| [&mut pair.start_pose, &mut pair.end_pose]) {
            if let Some(place) = pose.as_mut().and_then(|pose| pose.vec.as_mut()) {
                place.z -= 100.0;
            }
        }
        Ok(object)
    }

    /// Horizontal direction in which the camera looks.
    pub(super) fn object_direction(&self) -> DVec3 {
        let ahead = (self.sensor().rotation * DVec3::Z).truncate();
        ahead.normalize_or(glam::DVec2::X).extend(0.0)
    }
}

/// Start and end as a message.
pub(super) fn pair(start: &Pose, end: &Pose) -> PosePair {
    PosePair {
        start_pose: Some(message_of(start)),
        end_pose: Some(message_of(end)),
    }
}

/// The pinhole that views are compared in.
pub(super) fn pinhole() -> CameraParam {
    CameraParam::OpencvPinholeParam(OpenCvPinholeCameraParam {
        principal_point_x: f64::from(SIZE_PX[0]) / 2.0,
        principal_point_y: f64::from(SIZE_PX[1]) / 2.0,
        focal_length_x: FOCAL_PX,
        focal_length_y: FOCAL_PX,
        ..OpenCvPinholeCameraParam::default()
    })
}

/// A camera of the compared size with this lens and a global shutter.
pub(super) fn spec_of(lens: CameraParam) -> CameraSpec {
    CameraSpec {
        logical_id: "conform".into(),
        camera_param: Some(lens),
        resolution_w: SIZE_PX[0],
        resolution_h: SIZE_PX[1],
        shutter_type: decouplegs_alpasim::wire::sensorsim::ShutterType::Global.into(),
        ..CameraSpec::default()
    }
}

async fn first_camera(
    client: &mut Client,
    scene: &str,
    wanted: Option<&str>,
) -> Result<AvailableCamera> {
    let asked = AvailableCamerasRequest {
        scene_id: scene.to_owned(),
    };
    let cameras = client
        .get_available_cameras(asked)
        .await
        .with_context(|| format!("the server does not list the cameras of {scene:?}"))?
        .into_inner()
        .available_cameras;
    ensure!(!cameras.is_empty(), "scene {scene:?} has no cameras");
    let known: Vec<String> = cameras.iter().map(|c| c.logical_id.clone()).collect();
    let found = cameras
        .into_iter()
        .find(|camera| wanted.is_none_or(|wanted| camera.logical_id == wanted));
    found.with_context(|| {
        format!(
            "scene {scene:?} has no camera {:?}; it has {}",
            wanted.unwrap_or_default(),
            known.join(", ")
        )
    })
}

/// Middle of the first trajectory; `None` where the server has none.
async fn middle(client: &mut Client, scene: &str) -> Option<(Pose, u64)> {
    let asked = AvailableTrajectoriesRequest {
        scene_id: scene.to_owned(),
    };
    let answer = client.get_available_trajectories(asked).await;
    let poses = answer
        .ok()
        .and_then(|answer| {
            answer
                .into_inner()
                .available_trajectories
                .into_iter()
                .next()
        })
        .and_then(|available| available.trajectory)
        .map(|trajectory| trajectory.poses)
        .unwrap_or_default();
    let middle = poses.get(poses.len() / 2)?;
    let pose = pose_of(middle.pose.as_ref(), "trajectory").ok()?;
    Some((pose, middle.timestamp_us))
}
