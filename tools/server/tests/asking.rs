//! A server in this process, and clients of it.

use std::path::PathBuf;

use decouplegs::scene::Pose;
use decouplegs_alpasim::wire::common;
use decouplegs_alpasim::wire::sensorsim::available_cameras_return::AvailableCamera;
use decouplegs_alpasim::wire::sensorsim::sensorsim_service_client::SensorsimServiceClient;
use decouplegs_alpasim::wire::sensorsim::{
    AvailableCamerasRequest, BatchRgbRenderRequest, BatchRgbRenderRequestItem, DynamicObject,
    ImageFormat, PosePair, RgbRenderRequest,
};
use decouplegs_server::options::ServerOptions;
use decouplegs_server::running::{self, Running};
use glam::{DQuat, DVec3};
use tonic::transport::{Channel, Endpoint};

/// The defaults, but for fewer of what tests cannot have many of.
pub fn options(scenes: Vec<PathBuf>) -> ServerOptions {
    let mut options = ServerOptions::on_a_free_port(scenes);
    if let Ok(device) = std::env::var("DECOUPLEGS_DEVICE") {
        options.device = device.parse().expect("DECOUPLEGS_DEVICE names a device");
    }
    options.limits.deadline = 120.0;
    options
}

pub async fn serve(options: &ServerOptions) -> Running {
    running::start(options).await.expect("the server starts")
}

pub async fn channel(running: &Running) -> Channel {
    let endpoint = Endpoint::from_shared(format!("http://{}", running.address)).unwrap();
    endpoint.connect().await.expect("the server accepts")
}

pub async fn client(running: &Running) -> SensorsimServiceClient<Channel> {
    SensorsimServiceClient::new(channel(running).await)
        .max_decoding_message_size(64 << 20)
        .max_encoding_message_size(64 << 20)
}

pub async fn cameras(
    client: &mut SensorsimServiceClient<Channel>,
    scene_id: &str,
) -> Vec<AvailableCamera> {
    let request = AvailableCamerasRequest {
        scene_id: scene_id.into(),
    };
    client
        .get_available_cameras(request)
        .await
        .unwrap()
        .into_inner()
        .available_cameras
}

/// A pose as a message; what the server does with it is not asked here.
pub fn message(pose: &Pose) -> common::Pose {
    let (turn, place) = (pose.rotation, pose.translation);
    common::Pose {
        vec: Some(common::Vec3 {
            x: place.x as f32,
            y: place.y as f32,
            z: place.z as f32,
        }),
        quat: Some(common::Quat {
            w: turn.w as f32,
            x: turn.x as f32,
            y: turn.y as f32,
            z: turn.z as f32,
        }),
    }
}

pub fn pose(message: &common::Pose) -> Pose {
    let (place, turn) = (message.vec.unwrap(), message.quat.unwrap());
    let turn = DQuat::from_xyzw(turn.x.into(), turn.y.into(), turn.z.into(), turn.w.into());
    Pose::new(
        turn,
        DVec3::new(place.x.into(), place.y.into(), place.z.into()),
    )
}

pub fn pair(start: &Pose, end: &Pose) -> PosePair {
    PosePair {
        start_pose: Some(message(start)),
        end_pose: Some(message(end)),
    }
}

pub fn object(track_id: &str, start: &Pose, end: &Pose) -> DynamicObject {
    DynamicObject {
        track_id: track_id.into(),
        pose_pair: Some(pair(start, end)),
    }
}

/// The request for what `camera` sees from a rig at `local_from_rig`, 160 pixels wide.
pub fn request(
    scene: &str,
    camera: &AvailableCamera,
    local_from_rig: &Pose,
    format: ImageFormat,
) -> RgbRenderRequest {
    let sensor = local_from_rig.then(&pose(&camera.rig_to_camera.unwrap()));
    RgbRenderRequest {
        scene_id: scene.into(),
        resolution_w: 160,
        resolution_h: 100,
        camera_intrinsics: camera.intrinsics.clone(),
        frame_start_us: 1_000_000,
        frame_end_us: 1_020_000,
        sensor_pose: Some(pair(&sensor, &sensor)),
        image_format: format.into(),
        image_quality: 95.0,
        ..RgbRenderRequest::default()
    }
}

pub fn batch(
    requests: impl IntoIterator<Item = (String, RgbRenderRequest)>,
) -> BatchRgbRenderRequest {
    let item = |(camera_name, request)| BatchRgbRenderRequestItem {
        camera_name,
        request: Some(request),
    };
    BatchRgbRenderRequest {
        items: requests.into_iter().map(item).collect(),
    }
}

/// Width, height and RGB bytes of a PNG.
pub fn png(bytes: &[u8]) -> ([u32; 2], Vec<u8>) {
    let mut reader = png::Decoder::new(std::io::Cursor::new(bytes))
        .read_info()
        .expect("a PNG");
    let mut rgb = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut rgb).unwrap();
    ([reader.info().width, reader.info().height], rgb)
}
