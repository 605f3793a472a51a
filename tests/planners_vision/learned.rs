//! The planner that learned, on a street, with images of nothing, and with networks of others.

use std::path::Path;
use std::sync::Arc;

use decouplegs::drive::generate::{Generator, PlaceOptions};
use decouplegs::drive::score::EpisodeScore;
use decouplegs::episode::{Appearance, ObservationRenderer, Site, chosen, drive};
use decouplegs::planner::{
    Cameras, ConstantVelocity, EgoMotion, Learned, Navigation, Observation, Planner, PlannerChoice,
    Reading, Timeouts, Turn,
};
use decouplegs::render::{ColorFormat, Outputs};
use decouplegs::scene::scenario::Place;
use decouplegs::scene::{Episode, Level, Plan, Weather};
use glam::DVec2;

use super::drawn_road::{DrawnRoad, camera};
use super::{briefing, cruising};
use crate::frames::worlds::{assert_silent, session};

/// Plan for `readings` at `step` of 0.5 s.
fn plan(
    planner: &mut Learned,
    step: u32,
    readings: &[Reading],
    ego: EgoMotion,
    guidance: Navigation,
) -> Plan {
    let observation = Observation {
        step,
        time_s: 0.5 * f64::from(step),
        readings,
        ego,
        guidance,
        localization: None,
        privileged: None,
    };
    planner.plan(&observation).expect("it always has a plan")
}

fn at(speed_mps: f64) -> EgoMotion {
    EgoMotion {
        speed_mps,
        ..EgoMotion::default()
    }
}

#[test]
fn it_drives_an_episode_of_a_street_to_the_end_and_again_to_the_bit() {
    let place = Place::Street {
        weather: Weather::Clear,
        background: 60_000,
        agent_splats: 2_000,
        seed: 1,
    };
    let site = Arc::new(Site::open(&place, Path::new(""), Some(&Appearance::default())).unwrap());
    let session = session(Outputs {
        color: ColorFormat::U8,
        ..Outputs::default()
    });
    let scene = site.add_to(&session).unwrap();
    let rig = chosen(&site.loaded.rig, &Cameras::Front, Some([320, 180])).unwrap();
    let options = PlaceOptions::Street {
        background: 0,
        agent_splats: 0,
        seed: 1,
    };
    let generator = Generator::new(&site.lanes, options, &site.asset_sizes).unwrap();
    let scenario = generator.scenario(Level::Medium, 77, 0).unwrap();
    let driven = |planner: &mut dyn Planner| -> Episode {
        let batch = session.batch_renderer();
        let mut renderer = ObservationRenderer::new(batch, &scene, rig.clone(), 1);
        drive(&scenario, &site, Some(&mut renderer), planner, &mut ())
            .unwrap()
            .episode
    };
    let [first, again] = [0, 1].map(|_| driven(&mut Learned::default()));
    assert_eq!(first, again);
    assert!(!first.head.planner.privileged && first.head.planner.cameras == ["front"]);
    let score = EpisodeScore::new(&first);
    assert!(score.success, "{score:?}");
    assert!(
        !EpisodeScore::new(&driven(&mut ConstantVelocity)).success,
        "a planner that sees nothing must lose"
    );
    assert_silent(&session);
}

#[test]
fn images_of_nothing_and_numbers_that_are_none_leave_a_plan() {
    let camera = camera();
    let bytes = camera.intrinsics.pixels() as usize * 4;
    for value in [f64::NAN, f64::INFINITY, -1e300, 0.0] {
        let ego = EgoMotion {
            speed_mps: value,
            acceleration_mps2: value,
            steer_rad: value,
            yaw_rate_radps: value,
        };
        let guidance = Navigation {
            turn: Turn::Left,
            distance_m: value,
            angle_rad: value,
            length_m: value,
            cruise_mps: value,
        };
        for rgba in [vec![0; bytes], vec![255; bytes], vec![9; 3], vec![]] {
            let mut planner = Learned::default();
            planner.begin(&briefing(&camera)).unwrap();
            for step in 0..3 {
                let plan = plan(
                    &mut planner,
                    step,
                    &[Reading::image(&camera, &rgba)],
                    ego,
                    guidance,
                );
                assert!(
                    plan.points()
                        .iter()
                        .all(|point| point.position_m.is_finite()),
                    "{plan:?}"
                );
            }
        }
    }
    let mut blind = Learned::default();
    let mut nothing = briefing(&camera);
    nothing.sensors.clear();
    blind.begin(&nothing).unwrap();
    assert_eq!(
        plan(&mut blind, 0, &[], at(8.0), cruising(10.0))
            .points()
            .len(),
        16
    );
}

#[test]
fn a_car_close_ahead_is_stopped_for_and_a_free_road_is_not() {
    let camera = camera();
    let ahead_m = |road: DrawnRoad| {
        let rgba = road.image(&camera);
        let mut planner = Learned::default();
        planner.begin(&briefing(&camera)).unwrap();
        let mut last = DVec2::ZERO;
        for step in 0..3 {
            let plan = plan(
                &mut planner,
                step,
                &[Reading::image(&camera, &rgba)],
                at(6.0),
                cruising(10.0),
            );
            last = plan.points()[15].position_m;
        }
        last.x
    };
    let free_m = ahead_m(DrawnRoad::default());
    let behind_m = ahead_m(DrawnRoad {
        gap_m: Some(6.0),
        ..DrawnRoad::default()
    });
    assert!(
        free_m > behind_m + 4.0,
        "{free_m} m on a free road, {behind_m} m behind a car"
    );
}

#[test]
fn networks_of_others_are_read_from_files_or_refused_with_the_name_of_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("mine.safetensors");
    let choice: PlannerChoice = format!("learned:{}", file.display()).parse().unwrap();
    let refusal = |choice: &PlannerChoice| match choice.open(Timeouts::default()) {
        Ok(_) => panic!("{choice} was opened"),
        Err(error) => error.to_string(),
    };
    assert!(refusal(&choice).contains("mine.safetensors"));
    std::fs::write(&file, b"no network").unwrap();
    let said = refusal(&choice);
    assert!(
        said.contains("mine.safetensors") && said.contains("train_planner.py"),
        "{said}"
    );
    let own = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("engine/sim/src/planner/learned/weights.safetensors");
    std::fs::copy(own, &file).unwrap();
    let rgba = DrawnRoad::default().image(&camera());
    let camera = camera();
    let readings = [Reading::image(&camera, &rgba)];
    let plans = [Learned::default(), Learned::from_file(&file).unwrap()].map(|mut planner| {
        planner.begin(&briefing(&camera)).unwrap();
        plan(&mut planner, 0, &readings, at(8.0), cruising(10.0))
    });
    assert_eq!(plans[0], plans[1]);
}

#[test]
fn a_plan_before_an_episode_is_refused() {
    let observation = Observation {
        step: 0,
        time_s: 0.0,
        readings: &[],
        ego: at(8.0),
        guidance: cruising(10.0),
        localization: None,
        privileged: None,
    };
    let refusal = Learned::default()
        .plan(&observation)
        .unwrap_err()
        .to_string();
    assert!(refusal.contains("before an episode began"), "{refusal}");
}
