//! Poses, by where balls of light at known places land in images: against a projection in f64 that
//! is written here.

use decouplegs::scene::Pose;
use decouplegs_alpasim::wire::common;
use decouplegs_alpasim::wire::sensorsim::available_cameras_return::AvailableCamera;
use decouplegs_alpasim::wire::sensorsim::camera_spec::CameraParam;
use decouplegs_alpasim::wire::sensorsim::{ImageFormat, RgbRenderRequest, ShutterType};
use glam::{DQuat, DVec3};

use crate::asking::{cameras, client, message, object, options, pair, pose, request, serve};
use crate::scenes::{GREEN, RED, marked};

/// `p' = R p + t`, from the numbers of a message: R p is the vector part of q p q*.
fn moved(pose: &common::Pose, p: DVec3) -> DVec3 {
    let (q, t) = (pose.quat.unwrap(), pose.vec.unwrap());
    let (w, v) = (
        f64::from(q.w),
        DVec3::new(q.x.into(), q.y.into(), q.z.into()),
    );
    let norm = w * w + v.dot(v);
    let turned = (p * (w * w - v.dot(v)) + v * (2.0 * v.dot(p)) + v.cross(p) * (2.0 * w)) / norm;
    turned + DVec3::new(t.x.into(), t.y.into(), t.z.into())
}

/// The inverse of [`moved`].
fn unmoved(pose: &common::Pose, p: DVec3) -> DVec3 {
    let (q, t) = (pose.quat.unwrap(), pose.vec.unwrap());
    let back = common::Pose {
        vec: None,
        quat: Some(common::Quat {
            w: q.w,
            x: -q.x,
            y: -q.y,
            z: -q.z,
        }),
    };
    let back = common::Pose {
        vec: Some(common::Vec3::default()),
        ..back
    };
    moved(&back, p - DVec3::new(t.x.into(), t.y.into(), t.z.into()))
}

/// Projection of a point of the local frame, pixels: OpenCV axes, the middle of the top left pixel
/// at (0.5, 0.5).
fn projected(
    camera: &AvailableCamera,
    size: [u32; 2],
    sensor: &common::Pose,
    point: DVec3,
) -> [f64; 2] {
    let spec = camera.intrinsics.as_ref().unwrap();
    let Some(CameraParam::OpencvPinholeParam(pinhole)) = &spec.camera_param else {
        panic!("{spec:?}")
    };
    let seen = unmoved(sensor, point);
    assert!(seen.z > 1.0, "{seen} is not in front of the camera");
    let own = [
        pinhole.focal_length_x * seen.x / seen.z + pinhole.principal_point_x,
        pinhole.focal_length_y * seen.y / seen.z + pinhole.principal_point_y,
    ];
    [
        own[0] * f64::from(size[0]) / f64::from(spec.resolution_w),
        own[1] * f64::from(size[1]) / f64::from(spec.resolution_h),
    ]
}

/// The middle of the light of one channel, pixels.
fn middle_of_light(planar: &[u8], size: [u32; 2], channel: usize) -> [f64; 2] {
    let pixels = (size[0] * size[1]) as usize;
    let (mut sum, mut x, mut y) = (0.0, 0.0, 0.0);
    for (i, byte) in planar[channel * pixels..(channel + 1) * pixels]
        .iter()
        .enumerate()
    {
        let light = f64::from(*byte);
        sum += light;
        x += light * ((i as u32 % size[0]) as f64 + 0.5);
        y += light * ((i as u32 / size[0]) as f64 + 0.5);
    }
    assert!(sum > 200.0, "there is no light in channel {channel}: {sum}");
    [x / sum, y / sum]
}

fn assert_near(found: [f64; 2], expected: [f64; 2], what: &str) {
    let off = (found[0] - expected[0]).hypot(found[1] - expected[1]);
    assert!(
        off < 0.3,
        "{what}: found at {found:?}, expected at {expected:?}"
    );
}

/// Halfway between two places on a line and between two turns about one axis.
fn between(a: &Pose, b: &Pose) -> Pose {
    let sum = a.rotation
        + if a.rotation.dot(b.rotation) < 0.0 {
            -b.rotation
        } else {
            b.rotation
        };
    Pose {
        rotation: sum.normalize(),
        translation: 0.5 * (a.translation + b.translation),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn light_lands_where_rolling_shutters_see_it() {
    let folder = tempfile::tempdir().unwrap();
    let running = serve(&options(vec![marked(folder.path())])).await;
    let mut client = client(&running).await;
    let camera = cameras(&mut client, "marked").await.remove(0);
    let size = [160, 100];
    let place = Pose::from_yaw(0.12, DVec3::new(0.6, -0.9, 0.8));
    let start = place.then(&pose(&camera.rig_to_camera.unwrap()));
    let end = Pose::new(DQuat::from_rotation_z(0.2), DVec3::new(0.4, 0.2, 0.1)).then(&start);
    let mut found = Vec::new();
    for (shutter, axis, forward) in [
        (ShutterType::Global, 0, true),
        (ShutterType::RollingTopToBottom, 1, true),
        (ShutterType::RollingBottomToTop, 1, false),
        (ShutterType::RollingLeftToRight, 0, true),
        (ShutterType::RollingRightToLeft, 0, false),
    ] {
        let mut asked = request("marked", &camera, &place, ImageFormat::RgbUint8Planar);
        asked.sensor_pose = Some(pair(&start, &end));
        asked.camera_intrinsics.as_mut().unwrap().shutter_type = shutter.into();
        let image = client
            .render_rgb(asked)
            .await
            .unwrap()
            .into_inner()
            .image_bytes;
        let seen_at = |share: f64| {
            let sensor = message(&start.interpolate(&end, share));
            projected(&camera, size, &sensor, RED)
        };
        // The row or column that shows the light is exposed when it stands there.
        let mut share = 0.5;
        for _ in 0..20 {
            let along = seen_at(share)[axis] / f64::from(size[axis]);
            share = match (shutter, forward) {
                (ShutterType::Global, _) => 0.5,
                (_, true) => along,
                (_, false) => 1.0 - along,
            };
        }
        let light = middle_of_light(&image, size, 0);
        assert_near(light, seen_at(share), shutter.as_str_name());
        found.push(light);
    }
    let apart = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    assert!(
        apart(found[1], found[2]) > 1.0 && apart(found[3], found[4]) > 0.5,
        "{found:?}"
    );
    // A readout that takes seconds is none.
    let mut asked = request("marked", &camera, &place, ImageFormat::RgbUint8Planar);
    asked.frame_end_us = asked.frame_start_us + 5_000_000;
    asked.camera_intrinsics.as_mut().unwrap().shutter_type = ShutterType::RollingTopToBottom.into();
    let refused = client.render_rgb(asked).await.unwrap_err();
    assert_eq!(refused.code(), tonic::Code::InvalidArgument);
    assert!(refused.message().contains("shutter_type"), "{refused}");
    running.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn light_lands_where_poses_say() {
    let folder = tempfile::tempdir().unwrap();
    let running = serve(&options(vec![marked(folder.path())])).await;
    let mut client = client(&running).await;
    let rig = cameras(&mut client, "marked").await;
    let mut lights = async |asked: &RgbRenderRequest| {
        client
            .render_rgb(asked.clone())
            .await
            .unwrap()
            .into_inner()
            .image_bytes
    };
    let size = [160, 100];
    let local_from_rig = Pose::new(
        DQuat::from_rotation_z(0.12) * DQuat::from_rotation_y(-0.03),
        DVec3::new(0.6, -0.9, 0.8),
    );
    let level = Pose::IDENTITY;
    for camera in &rig {
        // rig_to_camera is the pose of the camera in the rig.
        let asked = request(
            "marked",
            camera,
            &local_from_rig,
            ImageFormat::RgbUint8Planar,
        );
        let sensor = asked.sensor_pose.unwrap().start_pose.unwrap();
        let in_rig = unmoved(&message(&local_from_rig), moved(&sensor, DVec3::Z));
        assert!((in_rig - moved(&camera.rig_to_camera.unwrap(), DVec3::Z)).length() < 1e-5);
        assert_near(
            middle_of_light(&lights(&asked).await, size, 0),
            projected(camera, size, &sensor, RED),
            &camera.logical_id,
        );
        // Another size shows the same.
        let small = [96, 80];
        let resized = RgbRenderRequest {
            resolution_w: small[0],
            resolution_h: small[1],
            ..asked
        };
        assert_near(
            middle_of_light(&lights(&resized).await, small, 0),
            projected(camera, small, &sensor, RED),
            "resized",
        );
    }
    // The sensor moves and turns while the shutter is open: it is drawn from where it is halfway.
    let camera = &rig[0];
    let start = local_from_rig.then(&pose(&camera.rig_to_camera.unwrap()));
    let end = Pose::new(DQuat::from_rotation_z(0.1), DVec3::new(1.0, 0.8, 0.3)).then(&start);
    let mut asked = request(
        "marked",
        camera,
        &local_from_rig,
        ImageFormat::RgbUint8Planar,
    );
    asked.sensor_pose = Some(pair(&start, &end));
    let middle = message(&between(&start, &end));
    assert_near(
        middle_of_light(&lights(&asked).await, size, 0),
        projected(camera, size, &middle, RED),
        "moving sensor",
    );
    // An object stands where its pose says, and halfway where it has two.
    let mut asked = request("marked", camera, &level, ImageFormat::RgbUint8Planar);
    let sensor = asked.sensor_pose.unwrap().start_pose.unwrap();
    let start = Pose::new(
        DQuat::from_rotation_z(0.9) * DQuat::from_rotation_x(0.2),
        DVec3::new(9.0, 1.0, 0.2),
    );
    let end = Pose::new(
        DQuat::from_rotation_z(0.4) * start.rotation,
        DVec3::new(8.0, -1.5, 0.9),
    );
    for (start, end) in [(start, start), (start, end), (end, start)] {
        asked.dynamic_objects = vec![object("lamp", &start, &end)];
        let lit = moved(&message(&between(&start, &end)), GREEN);
        assert_near(
            middle_of_light(&lights(&asked).await, size, 1),
            projected(camera, size, &sensor, lit),
            "object",
        );
    }
    running.stop().await.unwrap();
}

/// AlpaSim lists no agent that its package calls static (`alpasim_runtime/events/camera.py:22` at
/// 3032e0c), and NuRec draws them all the same.
#[tokio::test(flavor = "multi_thread")]
async fn what_stands_is_seen_where_a_request_does_not_list_it() {
    let folder = tempfile::tempdir().unwrap();
    let running = serve(&options(vec![marked(folder.path())])).await;
    let mut client = client(&running).await;
    let camera = cameras(&mut client, "marked").await.remove(0);
    let size = [160, 100];
    // Six meters behind the lamp, which is ahead then.
    let place = Pose::from_yaw(0.0, DVec3::new(-6.0, 0.0, 0.5));
    let asked = request("marked", &camera, &place, ImageFormat::RgbUint8Planar);
    let sensor = asked.sensor_pose.unwrap().start_pose.unwrap();
    assert!(asked.dynamic_objects.is_empty());
    let image = client.render_rgb(asked.clone()).await.unwrap().into_inner();
    assert_near(
        middle_of_light(&image.image_bytes, size, 1),
        projected(&camera, size, &sensor, GREEN),
        "not listed",
    );
    // One that is listed is where the list says, and nowhere else.
    let aside = Pose::from_yaw(0.3, DVec3::new(4.0, 2.0, 0.3));
    let mut listed = asked;
    listed.dynamic_objects = vec![object("lamp", &aside, &aside)];
    let image = client.render_rgb(listed).await.unwrap().into_inner();
    assert_near(
        middle_of_light(&image.image_bytes, size, 1),
        projected(&camera, size, &sensor, aside.transform(GREEN)),
        "listed",
    );
    running.stop().await.unwrap();
}
