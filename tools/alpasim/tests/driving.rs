//! Drivers of AlpaSim's egodriver contract in the closed loop.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use decouplegs::drive::generate::{Generator, PlaceOptions};
use decouplegs::episode::{Appearance, Driven, ObservationRenderer, Site, chosen, drive, replay};
use decouplegs::planner::{
    EpisodeInfo, Observation, ObservationRequest, Planner, PlannerError, Timeouts,
};
use decouplegs::scene::scenario::Place;
use decouplegs::scene::{EpisodeEnd, Level, Plan, PlanPoint, Scenario, Weather};
use decouplegs::session::{Session, SessionOptions};
use decouplegs_alpasim::egodriver::{
    DriverAddress, DriverOptions, Egodriver, ImageFile, Padding, SensorLens,
};
use decouplegs_alpasim::planner_name::PlannerName;
use decouplegs_alpasim::poses::pose_of;
use decouplegs_alpasim::wire::sensorsim::camera_spec::CameraParam;
use glam::DVec3;

use crate::fake_driver::{FakeDriver, Manner, on_circle};

/// A bend that the street has room for, at 8 m/s.
const CURVE: Manner = Manner::Curve {
    per_m: 2e-4,
    speed_mps: 8.0,
    from: 0,
};

fn street(background: usize) -> Arc<Site> {
    let place = Place::Street {
        weather: Weather::Clear,
        background,
        agent_splats: background.min(100),
        seed: 1,
    };
    let appearance = (background > 0).then(Appearance::default);
    Arc::new(Site::open(&place, Path::new(""), appearance.as_ref()).unwrap())
}

/// An episode of `duration_s` with a decision every tenth of a second.
fn scenario(site: &Site, duration_s: f64) -> Scenario {
    let options = PlaceOptions::Street {
        background: 0,
        agent_splats: 0,
        seed: 1,
    };
    let generator = Generator::new(&site.lanes, options, &site.asset_sizes).unwrap();
    let scenario = generator.scenario(Level::Easy, 3, 0).unwrap();
    Scenario {
        step_s: 0.1,
        duration_s,
        ..scenario
    }
}

/// Size and pixels of a PNG file, three bytes per pixel.
fn png(bytes: &[u8]) -> ([u32; 2], Vec<u8>) {
    let mut reader = png::Decoder::new(std::io::Cursor::new(bytes))
        .read_info()
        .unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let frame = reader.next_frame(&mut pixels).unwrap();
    ([frame.width, frame.height], pixels)
}

fn timeouts(answer: Duration) -> Timeouts {
    Timeouts {
        hello: Duration::from_secs(10),
        answer,
    }
}

fn open(address: &DriverAddress, options: &DriverOptions) -> Egodriver {
    Egodriver::open(address, options, timeouts(Duration::from_secs(20))).unwrap()
}

fn driven(manner: Manner, duration_s: f64, options: &DriverOptions) -> (Driven, FakeDriver) {
    let site = street(0);
    let (address, driver) = FakeDriver::start(manner);
    let mut planner = open(&address, options);
    let scenario = scenario(&site, duration_s);
    let episode = drive(&scenario, &site, None, &mut planner, &mut ()).unwrap();
    (episode, driver)
}

/// The same circle, planned in this process.
struct Circle {
    rear_axle_to_middle_m: f64,
}

impl Planner for Circle {
    fn name(&self) -> String {
        "circle".into()
    }

    fn sees(&self) -> ObservationRequest {
        ObservationRequest::default()
    }

    fn begin(&mut self, info: &EpisodeInfo) -> Result<(), PlannerError> {
        self.rear_axle_to_middle_m = info.rear_axle_to_middle_m;
        Ok(())
    }

    fn plan(&mut self, _observation: &Observation) -> Result<Plan, PlannerError> {
        let middle = DVec3::X * self.rear_axle_to_middle_m;
        let Manner::Curve {
            per_m, speed_mps, ..
        } = CURVE
        else {
            unreachable!("the manner is a curve")
        };
        let points = (1..=40).map(|index| {
            let time_s = f64::from(index) * 0.1;
            let place = on_circle(per_m, speed_mps * time_s).transform(middle) - middle;
            PlanPoint {
                time_s,
                position_m: place.truncate(),
            }
        });
        Ok(Plan::new(points.collect()).unwrap())
    }
}

#[test]
fn a_driver_drives_what_the_same_planner_drives_in_this_process() {
    let (there, driver) = driven(CURVE, 10.0, &DriverOptions::default());
    let site = street(0);
    let mut circle = Circle {
        rear_axle_to_middle_m: 0.0,
    };
    let here = drive(&scenario(&site, 10.0), &site, None, &mut circle, &mut ()).unwrap();
    assert_eq!(there.episode.end, here.episode.end);
    assert_eq!(there.episode.steps.len(), here.episode.steps.len());
    let pairs = there.episode.instants().zip(here.episode.instants());
    let apart_m = pairs
        .map(|(a, b)| a.ego.position_m.distance(b.ego.position_m))
        .fold(0.0, f64::max);
    // Messages hold f32, which rounds places by 4e-6 m at the end of 80 m.
    let way_m = 8.0 * 10.0;
    println!("{apart_m:e} m apart after {way_m} m");
    assert!(apart_m < 1e-6 * way_m, "{apart_m:e} m");
    assert!(there.episode.steps.iter().all(|step| !step.warm_up));

    // Every moment is told once, and time counts on.
    let asked = driver.asked();
    assert_eq!(asked.sessions.len(), 1);
    assert_eq!(
        asked.sessions[0].random_seed,
        here.episode.head.scenario.seed
    );
    assert_eq!(
        asked.sessions[0].debug_info, None,
        "no scene without --tell-scene"
    );
    assert_eq!(asked.contracts, ["2"]);
    let times: Vec<u64> = asked
        .paths
        .iter()
        .flat_map(|path| path.trajectory.as_ref().unwrap().poses.iter())
        .map(|timed| timed.timestamp_us)
        .collect();
    assert_eq!(times.len(), asked.drives.len());
    assert!(times.windows(2).all(|pair| pair[1] == pair[0] + 100_000));
    let ends = asked
        .drives
        .iter()
        .map(|drive| drive.time_query_us - drive.time_now_us);
    assert!(ends.eq(std::iter::repeat_n(100_000, asked.drives.len())));
    let first = &asked.routes[0].route.as_ref().unwrap().waypoints;
    assert_eq!(first.len(), 20);
    assert!(
        first
            .iter()
            .all(|point| point.y.abs() < 10.0 && point.x > -6.0)
    );
}

#[test]
fn an_episode_of_a_driver_replays_without_the_driver() {
    let options = DriverOptions {
        driver_warm_up: 0.5,
        tell_scene: true,
        ..DriverOptions::default()
    };
    let late = Manner::Curve {
        per_m: 0.0,
        speed_mps: 8.0,
        from: 8,
    };
    let (driven, driver) = driven(late, 3.0, &options);
    let episode = driven.episode;
    // Five steps on the route, three at a stand, and then the driver's own.
    let warm_up: Vec<bool> = episode.steps.iter().map(|step| step.warm_up).collect();
    assert_eq!(warm_up.iter().filter(|warm_up| **warm_up).count(), 5);
    assert!(warm_up[..5].iter().all(|warm_up| *warm_up));
    assert_eq!(episode.steps[6].plan, Plan::standing());
    let speed = |step: usize| episode.steps[step].instants[0].ego.speed_mps;
    assert!(
        (speed(4) - episode.start.ego.speed_mps).abs() < 0.2,
        "{}",
        speed(4)
    );
    assert!(speed(7) < speed(4) - 0.1);
    let score = decouplegs::drive::score::EpisodeScore::new(&episode);
    assert_eq!(score.warm_up_s, 0.5);
    let scene = driver.asked().sessions[0]
        .debug_info
        .clone()
        .unwrap()
        .scene_id;
    assert_eq!(scene, episode.head.scenario.name);
    drop(driver);
    let again = replay(&episode, &street(0), None, &mut ()).unwrap();
    assert_eq!(again.moved_differently, None);
    assert_eq!(again.episode, episode);
}

#[test]
fn a_driver_that_fails_ends_its_episode_with_a_sentence() {
    let site = street(0);
    let cases = [
        (Manner::Ends, "ended the session"),
        (Manner::Hangs, "did not answer `drive` within 0.3 s"),
        (
            Manner::Refuses,
            "refused `drive`: the network [31m is lost (Internal)",
        ),
        (Manner::Nonsense, "answered trajectory.poses[0].vec"),
    ];
    for (manner, expected) in cases {
        let (address, driver) = FakeDriver::start(manner);
        let limit = timeouts(Duration::from_millis(300));
        let mut planner = Egodriver::open(&address, &DriverOptions::default(), limit).unwrap();
        let begin = Instant::now();
        for _ in 0..2 {
            let episode = drive(&scenario(&site, 1.0), &site, None, &mut planner, &mut ());
            let EpisodeEnd::Planner { reason } = episode.unwrap().episode.end else {
                panic!("{manner:?} does not end its episode")
            };
            assert!(reason.contains(expected), "{reason}");
            assert!(
                reason.starts_with("the driver at egodriver://127.0.0.1"),
                "{reason}"
            );
        }
        assert!(begin.elapsed() < Duration::from_secs(20));
        drop(planner);
        // Each episode has a session, and all are closed.
        let asked = driver.asked();
        assert_eq!(
            (asked.sessions.len(), asked.closed.len()),
            (2, 2),
            "{manner:?}"
        );
        assert_ne!(
            asked.sessions[0].session_uuid,
            asked.sessions[1].session_uuid
        );
    }
    let nobody: DriverAddress = "egodriver://127.0.0.1:1".parse().unwrap();
    let refused = Egodriver::open(&nobody, &DriverOptions::default(), Timeouts::default());
    let reason = refused.unwrap_err().to_string();
    assert!(reason.contains("egodriver://127.0.0.1:1"), "{reason}");
}

#[test]
fn a_driver_gets_the_cameras_and_images_that_it_asked_for() {
    let site = street(2_000);
    let session = Session::open(&SessionOptions::default()).expect("a device");
    let scene = site.add_to(&session).unwrap();
    let rig = &site.loaded.rig;
    let driven = |options: &DriverOptions, manner: Manner| {
        let (address, driver) = FakeDriver::start(manner);
        let mut planner = open(&address, options);
        let seen = chosen(rig, &planner.sees().cameras, Some([64, 36])).unwrap();
        let renderer = ObservationRenderer::new(session.batch_renderer(), &scene, seen, 1);
        let name = PlannerName::Driver(address);
        let mut renderer = name.fit(renderer, options).unwrap();
        let short = scenario(&site, 0.2);
        let episode = drive(&short, &site, Some(&mut renderer), &mut planner, &mut ());
        (episode.unwrap().episode, driver.asked())
    };
    let options = DriverOptions {
        driver_camera: vec!["front=camera_front_wide_120fov".parse().unwrap()],
        driver_lens: SensorLens::FTheta,
        driver_images: ImageFile::Png,
        driver_padding: Padding::None,
        ..DriverOptions::default()
    };
    let (episode, asked) = driven(&options, CURVE);
    assert_eq!(episode.end, EpisodeEnd::Time);
    assert_eq!(episode.head.planner.cameras, ["front"]);
    assert!(episode.head.planner.localization && !episode.head.planner.privileged);
    let vehicle = asked.sessions[0]
        .rollout_spec
        .clone()
        .unwrap()
        .vehicle
        .unwrap();
    let [camera] = vehicle.available_cameras.as_slice() else {
        panic!("{vehicle:?}")
    };
    assert_eq!(camera.logical_id, "camera_front_wide_120fov");
    let spec = camera.intrinsics.as_ref().unwrap();
    assert_eq!([spec.resolution_w, spec.resolution_h], [64, 36]);
    assert!(
        matches!(spec.camera_param, Some(CameraParam::FthetaParam(_))),
        "{spec:?}"
    );
    // The rig is on the ground below the rear axle, the engine's frame in the middle of the box.
    let own = rig.cameras().find(|camera| camera.name == "front").unwrap();
    let size = episode.head.scenario.ego.size;
    let up = DVec3::new(0.3 * size.length_m, 0.0, 0.5 * size.height_m);
    let told = pose_of(camera.rig_to_camera.as_ref(), "camera")
        .unwrap()
        .translation;
    assert!(
        (told - own.rig_from_camera.translation - up).length() < 1e-5,
        "{told}"
    );
    // Two steps, one image each, as large as declared and taken now.
    assert_eq!(asked.images.len(), 2);
    for (image, drive) in asked.images.iter().zip(&asked.drives) {
        let image = image.camera_image.as_ref().unwrap();
        assert_eq!(image.logical_id, "camera_front_wide_120fov");
        assert_eq!(image.frame_end_us, drive.time_now_us);
        let (size_px, rgb) = png(&image.image_bytes);
        assert_eq!(size_px, [64, 36]);
        assert!(rgb.iter().any(|byte| *byte > 30), "the image is black");
    }

    // All cameras by their own names, as JPEG.
    let all = DriverOptions {
        driver_images: ImageFile::Jpeg,
        ..DriverOptions::default()
    };
    let (_, asked) = driven(&all, CURVE);
    assert_eq!(asked.images.len(), 2 * rig.cameras().count());
    let first = asked.images[0].camera_image.as_ref().unwrap();
    assert_eq!(&first.image_bytes[..2], [0xff, 0xd8], "JPEG begins so");

    // A name that the driver does not know is its error, and one that the rig does not have ours.
    let foreign = DriverOptions {
        driver_camera: vec!["front=foreign".parse().unwrap()],
        ..DriverOptions::default()
    };
    let (episode, _) = driven(&foreign, CURVE);
    let EpisodeEnd::Planner { reason } = &episode.end else {
        panic!("{:?}", episode.end)
    };
    assert!(
        reason.contains("refused `submit_image_observation`: camera foreign"),
        "{reason}"
    );
    let names = decouplegs::planner::Cameras::Named(vec!["no such".into()]);
    let refused = chosen(rig, &names, None).unwrap_err();
    assert!(
        refused
            .reason()
            .contains("no camera \"no such\"; it has front"),
        "{refused}"
    );
}
