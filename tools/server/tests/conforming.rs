//! The conformance kit: all green on this server, and its failures on servers that do wrong are the
//! right ones.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};

use decouplegs::asset::SceneFile;
use decouplegs::asset::packed_scene::{PackOptions, pack};
use decouplegs::scene::Pose;
use decouplegs_alpasim::encoding::{Encoding, encode};
use decouplegs_alpasim::wire::common::{AvailableScenesReturn, Empty, Quat, VersionId};
use decouplegs_alpasim::wire::sensorsim::camera_spec::CameraParam;
use decouplegs_alpasim::wire::sensorsim::ftheta_camera_param::PolynomialType;
use decouplegs_alpasim::wire::sensorsim::sensorsim_service_client::SensorsimServiceClient;
use decouplegs_alpasim::wire::sensorsim::sensorsim_service_server::{
    SensorsimService, SensorsimServiceServer,
};
use decouplegs_alpasim::wire::sensorsim::{
    AggregatedRenderRequest, AggregatedRenderReturn, AvailableCamerasRequest,
    AvailableCamerasReturn, AvailableEgoMasksReturn, AvailableTrajectoriesRequest,
    AvailableTrajectoriesReturn, BatchRgbRenderRequest, BatchRgbRenderReturn, ImageFormat,
    LidarRenderRequest, LidarRenderReturn, LoadedScenesReturn, RgbRenderRequest, RgbRenderReturn,
    ShutterType,
};
use decouplegs_server::conform::{Check, ConformOptions, Outcome, Report, judge};
use glam::DVec3;
use tokio::net::TcpListener;
use tokio_stream::StreamExt;
use tokio_stream::wrappers::TcpListenerStream;
use tonic::transport::{Channel, Server};
use tonic::{Request, Response, Status};

use crate::asking::{channel, object, options, png, serve};
use crate::scenes::street_of;

/// Faults of a server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fault {
    /// F-theta principal points are taken to count from the corner of the first pixel.
    HalfPixel,
    /// All shutters are global.
    IgnoresShutters,
    /// Rolling shutters run from the end pose to the start pose.
    SwapsPoses,
    /// Objects that are listed are not drawn.
    IgnoresObjects,
    /// Images are made in the size of the camera's calibration.
    IgnoresSize,
    /// A batch draws all items with the objects of the last one.
    SharesObjects,
    /// Scenes that do not exist are answered with one that does.
    InventsScenes,
    /// Planes are blue, green, red.
    SwapsPlanes,
    /// A sweep says that it has a point more than it has.
    MiscountsPoints,
    /// Sweeps are in the local frame's directions, however the sensor is turned.
    IgnoresSensorTurn,
    /// Trajectories run backwards.
    ReversesTime,
    /// Images are blue, green, red.
    SwapsColors,
    /// Poses of objects are taken for those of the bottom of a box of 1.5 m.
    LiftsObjects,
    /// Objects are drawn with the heading of the world.
    IgnoresObjectTurn,
    /// The polynomial from pixels to angles is taken, whatever the reference.
    IgnoresReference,
    /// No fault, NuRec's way: an object that is not listed is drawn where it was recorded.
    DrawsUnlisted,
    /// No fault: PNG and JPEG alone.
    HasNoPlanes,
    /// No fault: no trajectories, which AlpaSim's runtime does not ask for.
    HasNoTrajectories,
}

impl Fault {
    /// Each fault, with the checks that fail for it and no others.
    const ALL: [(Self, &'static [Check]); 18] = [
        (Self::HalfPixel, &[Check::FTheta, Check::FThetaBackward]),
        (
            Self::IgnoresShutters,
            &[Check::RollingRows, Check::RollingReversed],
        ),
        (
            Self::SwapsPoses,
            &[Check::RollingRows, Check::RollingReversed],
        ),
        (
            Self::IgnoresObjects,
            &[Check::ObjectShown, Check::ObjectMoves],
        ),
        (Self::IgnoresSize, &[Check::LargeAnswer, Check::Resized]),
        (Self::SharesObjects, &[Check::BatchPerCameraObjects]),
        (Self::InventsScenes, &[Check::UnknownScene]),
        (Self::SwapsPlanes, &[Check::Planar]),
        (
            Self::MiscountsPoints,
            &[Check::Lidar, Check::LidarPose, Check::Aggregated],
        ),
        (Self::IgnoresSensorTurn, &[Check::LidarPose]),
        (Self::ReversesTime, &[Check::Trajectories]),
        (Self::SwapsColors, &[Check::Colors]),
        (Self::LiftsObjects, &[Check::ObjectCentered]),
        (Self::IgnoresObjectTurn, &[Check::ObjectTurns]),
        (Self::IgnoresReference, &[Check::FTheta]),
        (Self::DrawsUnlisted, &[]),
        (Self::HasNoPlanes, &[]),
        (Self::HasNoTrajectories, &[]),
    ];
}

/// Answers of the good server to what it was asked before.
#[derive(Clone, Default)]
struct Known<T>(Arc<Mutex<HashMap<Vec<u8>, T>>>);

impl<T: Clone> Known<T> {
    /// Each request is drawn once for all faults, and as often as it is asked without one.
    async fn or_asked<Q: prost::Message>(
        &self,
        fault: Option<Fault>,
        request: Q,
        ask: impl AsyncFnOnce(Q) -> Result<Response<T>, Status>,
    ) -> Result<T, Status> {
        let key = request.encode_to_vec();
        if let (Some(_), Some(known)) = (fault, self.0.lock().unwrap().get(&key)) {
            return Ok(known.clone());
        }
        let answer = ask(request).await?.into_inner();
        self.0.lock().unwrap().insert(key, answer.clone());
        Ok(answer)
    }
}

/// Answers of the good server.
#[derive(Clone, Default)]
struct Answers {
    images: Known<RgbRenderReturn>,
    batches: Known<BatchRgbRenderReturn>,
    sweeps: Known<LidarRenderReturn>,
}

/// A server that hands all requests to a good one, and spoils them or the answers where it has a
/// fault.
struct Faulty {
    good: SensorsimServiceClient<Channel>,
    answers: Answers,
    scene: String,
    fault: Option<Fault>,
}

impl Faulty {
    fn spoiled(&self, mut request: RgbRenderRequest) -> RgbRenderRequest {
        let has_format = request.image_format() != ImageFormat::Undefined;
        if self.fault == Some(Fault::SwapsColors) && has_format {
            // Its pixels are swapped before they are encoded.
            request.image_format = ImageFormat::Png.into();
        }
        if let Some(spec) = &mut request.camera_intrinsics {
            match (self.fault, &mut spec.camera_param) {
                (Some(Fault::HalfPixel), Some(CameraParam::FthetaParam(lens))) => {
                    lens.principal_point_x -= 0.5;
                    lens.principal_point_y -= 0.5;
                }
                (Some(Fault::IgnoresReference), Some(CameraParam::FthetaParam(lens))) => {
                    lens.reference_poly = PolynomialType::PixeldistToAngle.into();
                }
                (Some(Fault::IgnoresShutters), _) => spec.shutter_type = ShutterType::Global.into(),
                (Some(Fault::IgnoresSize), _) => {
                    request.resolution_w = spec.resolution_w;
                    request.resolution_h = spec.resolution_h;
                }
                _ => {}
            }
        }
        match (self.fault, &mut request.sensor_pose) {
            (Some(Fault::SwapsPoses), Some(pair)) => {
                std::mem::swap(&mut pair.start_pose, &mut pair.end_pose);
            }
            (Some(Fault::IgnoresObjects), _) => request.dynamic_objects.clear(),
            (Some(Fault::InventsScenes), _) => request.scene_id = self.scene.clone(),
            (Some(Fault::DrawsUnlisted), _) => {
                let recorded = Pose::from_yaw(0.3, DVec3::new(8.0, 3.0, 0.8));
                let mut listed = request.dynamic_objects.iter();
                if !listed.any(|object| object.track_id == "car_000") {
                    let recorded = object("car_000", &recorded, &recorded);
                    request.dynamic_objects.push(recorded);
                }
            }
            _ => {}
        }
        let poses = request.dynamic_objects.iter_mut();
        let poses = poses.filter_map(|object| object.pose_pair.as_mut());
        for pose in poses.flat_map(|pair| [&mut pair.start_pose, &mut pair.end_pose]) {
            match (self.fault, pose) {
                (Some(Fault::LiftsObjects), Some(pose)) => {
                    pose.vec.iter_mut().for_each(|place| place.z += 0.75);
                }
                (Some(Fault::IgnoresObjectTurn), Some(pose)) => {
                    pose.quat = Some(Quat {
                        w: 1.0,
                        ..Default::default()
                    });
                }
                _ => {}
            }
        }
        request
    }

    fn spoiled_image(&self, format: ImageFormat, mut image: RgbRenderReturn) -> RgbRenderReturn {
        if self.fault == Some(Fault::SwapsPlanes) && format == ImageFormat::RgbUint8Planar {
            let plane = image.image_bytes.len() / 3;
            let bytes = &image.image_bytes;
            let planes = [
                &bytes[2 * plane..],
                &bytes[plane..2 * plane],
                &bytes[..plane],
            ];
            image.image_bytes = planes.concat().into();
        }
        if self.fault == Some(Fault::SwapsColors) {
            let (size, rgb) = png(&image.image_bytes);
            let swapped = rgb.chunks_exact(3).flat_map(|p| [p[2], p[1], p[0], 255]);
            let encoding = Encoding::from_request(format.into(), 95.0, "").unwrap();
            let bytes = encode(&swapped.collect::<Vec<u8>>(), size, encoding).unwrap();
            image.image_bytes = bytes.into();
        }
        image
    }

    fn spoiled_sweep(&self, mut sweep: LidarRenderReturn) -> LidarRenderReturn {
        if self.fault == Some(Fault::MiscountsPoints) {
            sweep.num_points += 1;
        }
        sweep
    }

    fn spoiled_lidar(&self, mut request: LidarRenderRequest) -> LidarRenderRequest {
        let poses = request
            .sensor_pose
            .as_mut()
            .map(|pair| [&mut pair.start_pose, &mut pair.end_pose]);
        for pose in poses.into_iter().flatten().flatten() {
            if self.fault == Some(Fault::IgnoresSensorTurn) {
                pose.quat = Some(Quat {
                    w: 1.0,
                    ..Default::default()
                });
            }
        }
        request
    }
}

#[tonic::async_trait]
impl SensorsimService for Faulty {
    async fn render_rgb(
        &self,
        request: Request<RgbRenderRequest>,
    ) -> Result<Response<RgbRenderReturn>, Status> {
        let request = request.into_inner();
        let format = request.image_format();
        if self.fault == Some(Fault::HasNoPlanes) && format == ImageFormat::RgbUint8Planar {
            return Err(Status::invalid_argument("PNG and JPEG only"));
        }
        let mut good = self.good.clone();
        let ask = async |request| good.render_rgb(request).await;
        let image = self
            .answers
            .images
            .or_asked(self.fault, self.spoiled(request), ask)
            .await?;
        Ok(Response::new(self.spoiled_image(format, image)))
    }

    async fn batch_render_rgb(
        &self,
        request: Request<BatchRgbRenderRequest>,
    ) -> Result<Response<BatchRgbRenderReturn>, Status> {
        let mut request = request.into_inner();
        let last = request.items.last().and_then(|item| item.request.clone());
        for item in &mut request.items {
            let mut asked = self.spoiled(item.request.take().unwrap_or_default());
            if let (Some(Fault::SharesObjects), Some(last)) = (self.fault, &last) {
                asked.dynamic_objects = last.dynamic_objects.clone();
            }
            item.request = Some(asked);
        }
        let mut good = self.good.clone();
        let ask = async |request| good.batch_render_rgb(request).await;
        let mut batch = self
            .answers
            .batches
            .or_asked(self.fault, request, ask)
            .await?;
        for item in &mut batch.items {
            let image = item.result.take();
            item.result = image.map(|image| self.spoiled_image(ImageFormat::Png, image));
        }
        Ok(Response::new(batch))
    }

    async fn render_lidar(
        &self,
        request: Request<LidarRenderRequest>,
    ) -> Result<Response<LidarRenderReturn>, Status> {
        let request = self.spoiled_lidar(request.into_inner());
        let mut good = self.good.clone();
        let ask = async |request| good.render_lidar(request).await;
        let sweep = self
            .answers
            .sweeps
            .or_asked(self.fault, request, ask)
            .await?;
        Ok(Response::new(self.spoiled_sweep(sweep)))
    }

    async fn render_aggregated(
        &self,
        request: Request<AggregatedRenderRequest>,
    ) -> Result<Response<AggregatedRenderReturn>, Status> {
        let asked = request.into_inner();
        if self.fault.is_none() {
            return self.good.clone().render_aggregated(asked).await;
        }
        let mut answer = AggregatedRenderReturn::default();
        for image in asked.rgb_requests {
            let image = self.render_rgb(Request::new(image)).await?;
            answer.rgb_returns.push(image.into_inner());
        }
        for sweep in asked.lidar_requests {
            let sweep = self.render_lidar(Request::new(sweep)).await?;
            answer.lidar_returns.push(sweep.into_inner());
        }
        Ok(Response::new(answer))
    }

    async fn get_version(&self, _: Request<Empty>) -> Result<Response<VersionId>, Status> {
        self.good.clone().get_version(Empty {}).await
    }

    async fn get_available_scenes(
        &self,
        _: Request<Empty>,
    ) -> Result<Response<AvailableScenesReturn>, Status> {
        self.good.clone().get_available_scenes(Empty {}).await
    }

    async fn get_loaded_scenes(
        &self,
        _: Request<Empty>,
    ) -> Result<Response<LoadedScenesReturn>, Status> {
        self.good.clone().get_loaded_scenes(Empty {}).await
    }

    async fn get_available_cameras(
        &self,
        request: Request<AvailableCamerasRequest>,
    ) -> Result<Response<AvailableCamerasReturn>, Status> {
        self.good
            .clone()
            .get_available_cameras(request.into_inner())
            .await
    }

    async fn get_available_trajectories(
        &self,
        request: Request<AvailableTrajectoriesRequest>,
    ) -> Result<Response<AvailableTrajectoriesReturn>, Status> {
        if self.fault == Some(Fault::HasNoTrajectories) {
            return Err(Status::unimplemented(""));
        }
        let mut good = self.good.clone();
        let answer = good.get_available_trajectories(request.into_inner());
        let mut answer = answer.await?.into_inner();
        if self.fault == Some(Fault::ReversesTime) {
            for trajectory in &mut answer.available_trajectories {
                trajectory
                    .trajectory
                    .iter_mut()
                    .for_each(|t| t.poses.reverse());
            }
        }
        Ok(Response::new(answer))
    }

    async fn get_available_ego_masks(
        &self,
        _: Request<Empty>,
    ) -> Result<Response<AvailableEgoMasksReturn>, Status> {
        self.good.clone().get_available_ego_masks(Empty {}).await
    }
}

async fn serve_faulty(good: Channel, answers: &Answers, fault: Option<Fault>) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let faulty = Faulty {
        good: SensorsimServiceClient::new(good).max_decoding_message_size(64 << 20),
        answers: answers.clone(),
        scene: "street".into(),
        fault,
    };
    let service = SensorsimServiceServer::new(faulty);
    let server = Server::builder().add_service(service);
    // Without waiting for more to send: answers would be 40 ms late.
    let connections = TcpListenerStream::new(listener).map(|stream| {
        let stream = stream?;
        stream.set_nodelay(true)?;
        Ok::<_, std::io::Error>(stream)
    });
    tokio::spawn(server.serve_with_incoming(connections));
    address
}

async fn judged(address: SocketAddr, checks: &[Check]) -> Report {
    let options = ConformOptions {
        object: Some("car_000".into()),
        ..ConformOptions::of_target(address.to_string())
    };
    judge(&options, checks, &mut |_, _| {}).await.unwrap()
}

fn scene(folder: &tempfile::TempDir) -> Vec<PathBuf> {
    // Lenses are told apart by edges: with fewer splats these are as wide as the image.
    vec![street_of(folder.path(), 30_000)]
}

#[tokio::test(flavor = "multi_thread")]
async fn this_server_conforms_and_faults_are_found_where_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let running = serve(&options(scene(&folder))).await;
    let good = channel(&running).await;
    let answers = Answers::default();
    let between = serve_faulty(good.clone(), &answers, None).await;
    let report = judged(between, &Check::ALL).await;
    // What stands between drops fields that it does not know.
    let direct = judged(running.address, &[Check::UnknownFields]).await;
    for (check, outcome) in report.results.iter().chain(&direct.results) {
        assert!(!check.rests_on().is_empty());
        if *check == Check::Package {
            assert!(matches!(outcome, Outcome::Skipped(_)), "{outcome:?}");
            continue;
        }
        assert!(
            matches!(outcome, Outcome::Passed(_)),
            "{check:?}: {outcome:?}"
        );
    }
    assert_eq!(report.results.len(), Check::ALL.len());
    assert_eq!(direct.results.len(), 1);
    for (fault, expected) in Fault::ALL {
        let report = judged(
            serve_faulty(good.clone(), &answers, Some(fault)).await,
            &Check::ALL,
        )
        .await;
        let details: Vec<_> = report
            .results
            .iter()
            .map(|(check, outcome)| format!("{check:?}: {outcome:?}"))
            .collect();
        assert_eq!(
            report.failed(),
            expected,
            "{fault:?}\n{}",
            details.join("\n")
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_is_not_there_and_a_camera_that_is_not_are_named() {
    let absent = ConformOptions::of_target("127.0.0.1:1".into());
    let message = format!(
        "{:#}",
        judge(&absent, &Check::ALL, &mut |_, _| {})
            .await
            .unwrap_err()
    );
    assert!(
        message.contains("no server answers at 127.0.0.1:1"),
        "{message}"
    );
    let folder = tempfile::tempdir().unwrap();
    let running = serve(&options(scene(&folder))).await;
    let of_camera = ConformOptions {
        camera: Some("roof".into()),
        ..ConformOptions::of_target(running.address.to_string())
    };
    let message = format!(
        "{:#}",
        judge(&of_camera, &Check::ALL, &mut |_, _| {})
            .await
            .unwrap_err()
    );
    assert!(message.contains("no camera \"roof\"; it has "), "{message}");
    let unknown = ConformOptions {
        scene: Some("nowhere".into()),
        ..ConformOptions::of_target(running.address.to_string())
    };
    let message = format!(
        "{:#}",
        judge(&unknown, &Check::ALL, &mut |_, _| {})
            .await
            .unwrap_err()
    );
    assert!(message.contains("nowhere"), "{message}");
}

/// AlpaSim puts its cameras where the package has the rig and the server has `rig_to_camera`.
#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_does_not_answer_as_the_package_says_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(&folder).remove(0);
    let package = folder.path().join("place.usdz");
    let file = SceneFile::read(&scene).unwrap();
    let packed = PackOptions::new("place");
    pack(&file, scene.parent().unwrap(), &packed, &package).unwrap();
    let judged = async |rig_origin| {
        let mut served = options(vec![package.clone()]);
        served.rig_origin = rig_origin;
        let running = serve(&served).await;
        let asked = ConformOptions {
            package: Some(package.clone()),
            ..ConformOptions::of_target(running.address.to_string())
        };
        let report = judge(&asked, &[Check::Package], &mut |_, _| {}).await;
        running.stop().await.unwrap();
        report.unwrap().results.remove(0).1
    };
    let own = judged(None).await;
    assert!(matches!(own, Outcome::Passed(_)), "{own:?}");
    let middle = judged(Some([0.0; 3])).await;
    assert!(
        matches!(&middle, Outcome::Failed(fault) if fault.contains("1.544 m")),
        "1.35 m along and 0.75 m up: {middle:?}"
    );
}
