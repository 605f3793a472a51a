//! The protocol from end to end: what a Python planner gets is what was sent, to the byte and to
//! the bit.

use std::path::Path;
use std::process::{Child, Command};
use std::sync::Arc;
use std::time::{Duration, Instant};

use decouplegs::asset::read_lidar;
use decouplegs::planner::{
    Cameras, EgoMotion, External, Localization, LocatedEgo, Observation, ObservationRequest,
    Planner, Reading, Transport,
};
use decouplegs::scene::lidar::{LidarReturn, PointFrame};
use decouplegs::scene::{LidarSweep, Motion, Pose, RigLidar, Sensor, VehicleState};
use glam::{DQuat, DVec2, DVec3};

use super::scene_ahead::{PATIENT, briefing, cameras, observation, opened, privileged};

/// Checksum as in `checksum_planner.py`.
fn checksum(rgba: &[u8]) -> u64 {
    rgba.iter()
        .enumerate()
        .map(|(at, &byte)| (at as u64 % 251 + 1) * u64::from(byte))
        .sum::<u64>()
        % 1_000_003
}

/// Bytes that look like the end of a line, of a string and of everything, among others.
fn image(pixels: u64, seed: u64) -> Vec<u8> {
    (0..4 * pixels)
        .map(|at| (at.wrapping_mul(at + 7).wrapping_add(seed * 10) >> 2) as u8)
        .collect()
}

/// Two steps of an episode, each number and each image as it was sent.
fn drive(planner: &mut dyn Planner) {
    assert_eq!(planner.name(), "checksums");
    assert_eq!(
        planner.sees(),
        ObservationRequest {
            cameras: Cameras::All,
            privileged: true,
            ..ObservationRequest::default()
        }
    );
    let (briefing, known, rig) = (briefing(), privileged(), cameras());
    planner.begin(&briefing).unwrap();
    for step in 0..2 {
        let images: Vec<Vec<u8>> = rig
            .iter()
            .map(|camera| image(camera.intrinsics.pixels(), u64::from(step)))
            .collect();
        let readings: Vec<Reading> = rig
            .iter()
            .zip(&images)
            .map(|(camera, rgba)| Reading::image(camera, rgba))
            .collect();
        let plan = planner
            .plan(&observation(step, &readings, Some(&known)))
            .unwrap();
        let expected: Vec<DVec2> = images
            .iter()
            .map(|rgba| DVec2::new(checksum(rgba) as f64 / 1000.0, 0.0))
            .collect();
        let message = [
            0.5 * f64::from(step),
            7.3,
            1.25,
            known.ego.position_m.x,
            known.agents[0].state.yaw_rad,
            0.1,
            rig[0].intrinsics.fx_px,
            0.75,
        ];
        let places = plan.points().iter().map(|point| point.position_m);
        let all = expected
            .into_iter()
            .chain(message.map(|value| DVec2::new(0.0, value)));
        assert_eq!(
            places.collect::<Vec<_>>(),
            all.collect::<Vec<_>>(),
            "step {step}"
        );
    }
}

#[test]
fn what_is_sent_arrives_to_the_byte() {
    drive(&mut opened("checksum_planner.py", &[], PATIENT));
}

#[test]
fn the_pose_and_the_route_arrive_to_the_bit() {
    let mut planner = opened("route_planner.py", &[], PATIENT);
    assert_eq!(
        planner.sees(),
        ObservationRequest {
            localization: true,
            ..ObservationRequest::default()
        }
    );
    planner.begin(&briefing()).unwrap();
    let pose = Pose::new(
        DQuat::from_xyzw(0.1, 0.2, 0.3, 0.927_361_849_549_570_4),
        DVec3::new(430.125, 0.1 + 0.2, 1.0 / 3.0),
    );
    let state = VehicleState {
        position_m: pose.translation.truncate(),
        yaw_rad: 0.7,
        speed_mps: 8.1,
        acceleration_mps2: -0.3,
    };
    let motion = EgoMotion {
        speed_mps: 8.1,
        acceleration_mps2: -0.3,
        steer_rad: 0.01,
        yaw_rate_radps: 0.02,
    };
    let at = |time_s| LocatedEgo {
        time_s,
        pose,
        state,
        motion,
    };
    let known = Localization {
        path: vec![at(0.1), at(0.2)],
        route_m: vec![DVec3::ZERO, DVec3::new(0.1, 4.0, 1e-9)],
    };
    let asked = Observation {
        localization: Some(&known),
        ..observation(1, &[], None)
    };
    let plan = planner.plan(&asked).unwrap();
    let received: Vec<f64> = plan
        .points()
        .iter()
        .map(|point| point.position_m.y)
        .collect();
    let (p, q) = (pose.translation, pose.rotation);
    let expected = [
        2.0, 0.2, p.x, p.y, p.z, q.w, q.x, q.y, q.z, 0.7, 8.1, -0.3, 0.02, 2.0, 0.1, 4.0, 1e-9,
    ];
    assert_eq!(received, expected);
}

/// A sweep with two returns.
fn sweep() -> LidarSweep {
    let model = read_lidar("xt32".as_ref()).unwrap();
    let lidar = RigLidar {
        name: "top".into(),
        model: Arc::new(model),
        rig_from_lidar: Pose::new(DQuat::IDENTITY, DVec3::new(0.5, 0.25, 2.0)),
    };
    let motion = Motion {
        velocity_mps: DVec3::X * 10.0,
        ..Motion::REST
    };
    let found = |beam, range_m| LidarReturn {
        beam,
        range_m,
        intensity: 0.25,
        instance: 3,
        number: 1,
        count: 1,
    };
    LidarSweep {
        beams: lidar.model.beams().into(),
        lidar: lidar.sweep_until(&Pose::from_yaw(1.0, DVec3::new(40.0, 5.0, 1.0)), &motion),
        returns: vec![found(15, 10.0), found(1000 * 32 + 31, 20.0)],
    }
}

#[test]
fn points_arrive_to_the_bit_in_the_frame_of_the_ego() {
    let (mut planner, sweep, camera) = (
        opened("sweep_planner.py", &[], PATIENT),
        sweep(),
        &cameras()[0],
    );
    assert!(planner.sees().lidars && !planner.sees().privileged);
    let model = &sweep.lidar.model;
    let mut info = briefing();
    info.sensors.push(Sensor::Lidar(RigLidar {
        name: "top".into(),
        model: model.clone(),
        rig_from_lidar: sweep.lidar.rig_from_lidar,
    }));
    planner.begin(&info).unwrap();
    let rgba = image(camera.intrinsics.pixels(), 3);
    let readings = [Reading::image(camera, &rgba), Reading::Sweep(&sweep)];
    let plan = planner.plan(&observation(1, &readings, None)).unwrap();
    let rgba_sum = rgba.iter().map(|&byte| f64::from(byte)).sum::<f64>() % 1000.0;
    let mut expected = vec![DVec2::new(32.0, 0.1), DVec2::new(rgba_sum, 2.0)];
    for found in sweep.points(PointFrame::EgoAt(model.sweep_s)) {
        let [x, y, z] = found.position_m.as_vec3().to_array().map(f64::from);
        let offset_ms = 1e-6 * (1e9 * found.beam.time_s).round();
        let lasers = f64::from(10 * found.beam.ring + found.beam.laser);
        expected.extend([[x, y], [z, 0.25], [offset_ms, lasers]].map(DVec2::from_array));
    }
    let places = plan.points().iter().map(|point| point.position_m);
    assert_eq!(places.collect::<Vec<_>>(), expected);
}

#[test]
fn an_exception_ends_its_episode_and_the_planner_goes_on() {
    let mut planner = opened("checksum_planner.py", &[], PATIENT);
    drive(&mut planner);
    let known = privileged();
    for (step, reason) in [
        (13, "ValueError: thirteen"),
        (14, "Out of range float values"),
    ] {
        let failed = planner
            .plan(&observation(step, &[], Some(&known)))
            .unwrap_err()
            .to_string();
        assert!(
            failed.starts_with("the external planner failed: ") && failed.contains(reason),
            "{failed}"
        );
        drive(&mut planner);
    }
}

/// A planner that listens on a socket, ended with the test.
struct Server(Child);

impl Drop for Server {
    fn drop(&mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }
}

fn serve(path: &Path) -> Server {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/planners/checksum_planner.py");
    let server = Server(
        Command::new("python3")
            .arg("-B")
            .arg(script)
            .arg("--socket")
            .arg(path)
            .spawn()
            .unwrap(),
    );
    let deadline = Instant::now() + PATIENT.hello;
    while !path.exists() && Instant::now() < deadline {
        std::thread::sleep(Duration::from_millis(5));
    }
    server
}

/// The server binds before it listens; in between a connection is refused.
fn connect(path: &Path) -> External {
    let deadline = Instant::now() + PATIENT.hello;
    loop {
        match External::open(Transport::Socket(path.to_owned()), PATIENT) {
            Ok(planner) => return planner,
            Err(error) => assert!(Instant::now() < deadline, "{error}"),
        }
    }
}

#[test]
fn a_server_on_a_unix_socket_drives_for_many() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("planner.sock");
    let refused = External::open(Transport::Socket(path.clone()), PATIENT)
        .unwrap_err()
        .to_string();
    assert!(
        refused.contains("cannot connect to") && refused.contains("planner.sock"),
        "{refused}"
    );
    let mut server = serve(&path);
    let (mut one, mut other) = (connect(&path), connect(&path));
    drive(&mut one);
    drive(&mut other);
    drop(one);
    drive(&mut other);
    server.0.kill().unwrap();
    server.0.wait().unwrap();
    let lost = other
        .plan(&observation(0, &[], None))
        .unwrap_err()
        .to_string();
    assert!(lost.contains("closed the connection"), "{lost}");
    std::fs::remove_file(&path).unwrap();
    assert!(
        other
            .begin(&briefing())
            .unwrap_err()
            .to_string()
            .contains("cannot connect to")
    );
    let again = serve(&path);
    drop(connect(&path));
    drive(&mut other);
    drop(again);
}

#[test]
fn the_example_slows_down_in_the_dark() {
    let example =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("tools/planner_client/example_planner.py");
    let words = [
        "python3".into(),
        "-B".into(),
        example.to_string_lossy().into_owned(),
    ];
    let mut planner = External::open(Transport::Command(words.to_vec()), PATIENT).unwrap();
    assert_eq!(
        planner.sees(),
        ObservationRequest {
            cameras: Cameras::Front,
            privileged: false,
            ..ObservationRequest::default()
        }
    );
    let rig = cameras();
    let mut travel_m = |gray: u8| {
        planner.begin(&briefing()).unwrap();
        let rgba = vec![gray; 4 * rig[0].intrinsics.pixels() as usize];
        let plan = planner
            .plan(&observation(0, &[Reading::image(&rig[0], &rgba)], None))
            .unwrap();
        plan.at(4.0).x
    };
    let (bright_m, dark_m) = (travel_m(150), travel_m(20));
    assert!(
        (bright_m - 4.0 * 7.3).abs() < 1e-9 && dark_m < 0.75 * bright_m && dark_m > 0.0,
        "{bright_m} {dark_m}"
    );
}
