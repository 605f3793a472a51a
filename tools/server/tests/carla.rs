//! The server as CARLA's NuRec example asks it (`PythonAPI/examples/nvidia/nurec` of
//! carla-simulator/carla: `nurec_integration.py` at 25b0043, `scenario.py` at 2efae66), without the
//! simulator: a package, its cameras in one batch, cameras of other sizes, and a LiDAR.

use decouplegs::asset::SceneFile;
use decouplegs::asset::packed_scene::{PackOptions, pack, read_packed_rig};
use decouplegs::scene::Pose;
use decouplegs_alpasim::wire::sensorsim::camera_spec::CameraParam;
use decouplegs_alpasim::wire::sensorsim::sensorsim_service_client::SensorsimServiceClient;
use decouplegs_alpasim::wire::sensorsim::{
    CameraSpec, FthetaCameraParam, ImageFormat, LidarDeviceType, LidarRenderRequest, LidarSpec,
    RgbRenderRequest, ShutterType,
};
use glam::DVec3;
use tonic::Code;
use tonic::transport::Channel;

use crate::asking::{batch, cameras, client, object, options, pair, pose, serve};
use crate::scenes::street;

/// Largest message that its client takes, bytes (`MAX_MESSAGE_LENGTH`).
const MESSAGE_BYTES: usize = 10_000_000;

/// The request of `generate_request`: one microsecond, all that moves listed, planar bytes.
fn request(
    spec: &CameraSpec,
    scale: f64,
    time_us: u64,
    sensor: &Pose,
    objects: &[(String, Pose)],
) -> RgbRenderRequest {
    let scaled = |pixels: u32| (f64::from(pixels) * scale) as u32;
    RgbRenderRequest {
        scene_id: "place".into(),
        resolution_w: scaled(spec.resolution_w),
        resolution_h: scaled(spec.resolution_h),
        camera_intrinsics: Some(spec.clone()),
        frame_start_us: time_us,
        frame_end_us: time_us + 1,
        sensor_pose: Some(pair(sensor, sensor)),
        dynamic_objects: objects
            .iter()
            .map(|(name, at)| object(name, at, at))
            .collect(),
        image_format: ImageFormat::RgbUint8Planar.into(),
        image_quality: 95.0,
        ..RgbRenderRequest::default()
    }
}

/// The camera of `dict_to_camera_spec`, whose f-theta lens has no polynomial.
fn custom(logical_id: &str, [width, height]: [u32; 2]) -> CameraSpec {
    CameraSpec {
        camera_param: Some(CameraParam::FthetaParam(FthetaCameraParam {
            principal_point_x: f64::from(width) / 2.0,
            principal_point_y: f64::from(height) / 2.0,
            reference_poly: 1,
            max_angle: std::f64::consts::PI,
            ..FthetaCameraParam::default()
        })),
        logical_id: logical_id.into(),
        resolution_w: width,
        resolution_h: height,
        shutter_type: ShutterType::Global.into(),
        ..CameraSpec::default()
    }
}

/// Mean difference of two images of equal size, steps of 8 bits.
fn difference(one: &[u8], other: &[u8]) -> f64 {
    assert_eq!(one.len(), other.len());
    let steps = |(one, other): (&u8, &u8)| f64::from(one.abs_diff(*other));
    one.iter().zip(other).map(steps).sum::<f64>() / one.len() as f64
}

#[tokio::test(flavor = "multi_thread")]
async fn its_requests_are_answered() {
    let folder = tempfile::tempdir().unwrap();
    let scene = street(folder.path());
    let package = folder.path().join("place.usdz");
    let file = SceneFile::read(&scene).unwrap();
    let packed = PackOptions::new("place");
    pack(&file, scene.parent().unwrap(), &packed, &package).unwrap();
    let running = serve(&options(vec![package.clone()])).await;
    let mut sensorsim = client(&running)
        .await
        .max_decoding_message_size(MESSAGE_BYTES);

    let rig = read_packed_rig(&package).unwrap();
    let start = rig.way.start_s();
    let time_us = (start * 1e6) as u64 + 500_000;
    let from_rig = rig.way.at(time_us as f64 * 1e-6);
    let served = cameras(&mut sensorsim, "place").await;
    let at = |camera: usize| from_rig.then(&pose(&served[camera].rig_to_camera.unwrap()));
    let objects: Vec<(String, Pose)> = Vec::new();
    let spec = |camera: usize| served[camera].intrinsics.clone().unwrap();

    // Before the replay begins: an image from the origin, to warm the renderer.
    let warm = request(&spec(0), 0.25, time_us, &Pose::IDENTITY, &objects);
    sensorsim.render_rgb(warm).await.unwrap();
    // All cameras that are due, in one batch.
    let asked = (0..served.len()).map(|index| {
        let one = request(&spec(index), 1.0, time_us, &at(index), &objects);
        (format!("cam{index}"), one)
    });
    let answer = sensorsim.batch_render_rgb(batch(asked)).await.unwrap();
    let items = answer.into_inner().items;
    assert_eq!(items.len(), 6);
    let planar = |index: usize| items[index].result.as_ref().unwrap().image_bytes.to_vec();
    for (index, item) in items.iter().enumerate() {
        assert!(item.success, "{}: {}", item.camera_name, item.error_message);
        assert_eq!(planar(index).len(), 3 * 160 * 90);
    }

    // A lens without polynomials is that of the camera: at its size the same image, at twice the
    // size the same view.
    let own = custom(&served[0].logical_id, [160, 90]);
    let Some(CameraParam::FthetaParam(known)) = spec(0).camera_param else {
        panic!("lenses of packages are f-theta");
    };
    let mut centered = own.clone();
    if let Some(CameraParam::FthetaParam(lens)) = &mut centered.camera_param {
        lens.principal_point_x = known.principal_point_x;
        lens.principal_point_y = known.principal_point_y;
    }
    let same = request(&centered, 1.0, time_us, &at(0), &objects);
    let same = sensorsim.render_rgb(same).await.unwrap().into_inner();
    assert!(same.image_bytes == planar(0));
    let small = request(&own, 1.0, time_us, &at(0), &objects);
    let small = sensorsim.render_rgb(small).await.unwrap().into_inner();
    let large = custom(&served[0].logical_id, [320, 180]);
    let large = request(&large, 0.5, time_us, &at(0), &objects);
    let large = sensorsim.render_rgb(large).await.unwrap().into_inner();
    let apart = difference(&small.image_bytes, &large.image_bytes);
    let others = difference(&small.image_bytes, &planar(3));
    assert!(apart < 2.0 && others > 10.0, "{apart} and {others} steps");
    let nobody = request(&custom("nobody", [160, 90]), 1.0, time_us, &at(0), &objects);
    let refused = sensorsim.render_rgb(nobody).await.unwrap_err();
    assert_eq!(refused.code(), Code::InvalidArgument);
    assert!(refused.message().contains("ftheta_param"), "{refused}");

    sweep_fits(&mut sensorsim, time_us, &from_rig).await;
    running.stop().await.unwrap();
}

/// All points of a Pandar128 fit into a message that CARLA takes, as buffers, which it reads first.
async fn sweep_fits(
    sensorsim: &mut SensorsimServiceClient<Channel>,
    time_us: u64,
    from_rig: &Pose,
) {
    let roof = from_rig.then(&Pose::from_yaw(0.0, DVec3::new(0.0, 0.0, 1.9)));
    let asked = LidarRenderRequest {
        scene_id: "place".into(),
        lidar_config: Some(LidarSpec {
            lidar_type: LidarDeviceType::Pandar128.into(),
        }),
        frame_start_us: time_us,
        frame_end_us: time_us + 1,
        sensor_pose: Some(pair(&roof, &roof)),
        dynamic_objects: Vec::new(),
    };
    let sweep = sensorsim.render_lidar(asked).await.unwrap().into_inner();
    let count = sweep.num_points as usize;
    assert!(count > 150_000, "{count} points");
    assert_eq!(sweep.point_xyzs_buffer.len(), 12 * count);
    assert_eq!(sweep.point_intensities_buffer.len(), 4 * count);
    assert!(sweep.point_xyzs.is_empty() && sweep.point_intensities.is_empty());
}
