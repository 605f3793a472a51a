//! Heights of captured roads whose splats are few and scattered, from what is known better.

use decouplegs_drive::register::grounding::{corners, set_on_ground};
use decouplegs_drive::{Ground, GroundGuides, GroundOptions, GroundSource, Survey};
use decouplegs_scene::{LaneMap, Pose, SplatCloud, TimedPose};
use glam::{DQuat, DVec2, DVec3};

use crate::lanes::{road, straight};
use crate::roads::{ROAD, Random, RoadOptions, add_surface, cluttered};

const DIMS_M: [f64; 3] = [4.5, 1.8, 1.5];
const HEIGHT_M: f64 = 0.8;

/// A road that rises and leans a little.
fn road_z_m(at: DVec2) -> f64 {
    0.02 * at.x - 0.015 * at.y
}

/// Splats of a road as images alone leave them: few, a sixth of them on it, the others decimeters
/// above and below.
fn captured(seed: u64) -> SplatCloud {
    let mut cloud = SplatCloud::default();
    let mut random = Random(seed);
    for (density, noise_m) in [(3.0, 0.03), (16.0, 0.3)] {
        let options = RoadOptions {
            density,
            noise_m,
            ..ROAD
        };
        add_surface(&mut cloud, &mut random, &options, &road_z_m);
    }
    cloud
}

/// The way of a vehicle in the middle of the road, which its springs pitch and roll by half a
/// degree.
fn way() -> Vec<TimedPose> {
    let mut random = Random(5);
    let pose = |step: u32| {
        let at = DVec2::new(f64::from(step) * 0.5, 0.0);
        let along = DVec3::new(1.0, 0.0, 0.02).normalize();
        let left = DVec3::new(0.0, 1.0, -0.015).normalize();
        let road = DQuat::from_mat3(&glam::DMat3::from_cols(along, left, along.cross(left)));
        let springs = DQuat::from_rotation_x(0.009 * random.normal())
            * DQuat::from_rotation_y(0.009 * random.normal());
        TimedPose {
            time_s: f64::from(step) * 0.1,
            pose: Pose {
                translation: at.extend(road_z_m(at) + HEIGHT_M),
                rotation: road * springs,
            },
        }
    };
    (0..=80).map(pose).collect()
}

/// Heights of the corners of cars on the way above the road, sorted by size, meters.
fn corner_errors(ground: &Ground) -> Vec<f64> {
    let set = |timed: &TimedPose| set_on_ground(ground, &timed.pose, DIMS_M);
    let mut errors: Vec<f64> = way()
        .iter()
        .filter_map(set)
        .flat_map(|(_, pose)| corners(DIMS_M).map(|at| pose.transform(at.extend(-0.5 * DIMS_M[2]))))
        .map(|corner| (corner.z - road_z_m(corner.truncate())).abs())
        .collect();
    assert!(!errors.is_empty());
    errors.sort_by(f64::total_cmp);
    errors
}

fn guided(cloud: &SplatCloud, guides: GroundGuides<'_>) -> Ground {
    Ground::new(cloud, DVec3::ZERO, &GroundOptions::default()).guided(cloud, guides)
}

#[test]
fn cars_stand_on_the_road_where_a_vehicle_drove() {
    let (cloud, way) = (captured(1), way());
    let alone = corner_errors(&guided(&cloud, GroundGuides::default()));
    let alone_m = alone[alone.len() * 95 / 100];
    assert!(
        alone_m > 0.1,
        "splats alone leave {alone_m:.3} m: the test shows nothing"
    );
    for (height_m, middle_m, most_m) in [(Some(HEIGHT_M), 0.01, 0.03), (None, 0.04, 0.06)] {
        let ground = guided(&cloud, GroundGuides::for_way(&way, height_m));
        let errors = corner_errors(&ground);
        let (middle, p95) = (errors[errors.len() / 2], errors[errors.len() * 95 / 100]);
        assert!(
            middle < middle_m && p95 < most_m,
            "height {height_m:?}: median {middle:.3} m, 95 % {p95:.3} m"
        );
        let quality = ground.quality().unwrap();
        assert_eq!(quality.source, GroundSource::Way);
        assert!(!quality.is_road());
        let warning = quality.warning().unwrap();
        assert_eq!(
            warning.contains("ego_height_m"),
            height_m.is_none(),
            "{warning}"
        );
    }
}

#[test]
fn a_map_with_heights_is_better_than_the_way() {
    let (cloud, way) = (captured(2), way());
    let mut map: LaneMap = road(&straight(40.0), 2, 1, false);
    for lane in &mut map.lanes {
        lane.has_height = true;
        for point in &mut lane.centerline {
            point.z = road_z_m(point.truncate());
        }
    }
    let guides = GroundGuides {
        map: Some(&map),
        ..GroundGuides::for_way(&way, Some(HEIGHT_M))
    };
    let ground = guided(&cloud, guides);
    assert_eq!(ground.quality().unwrap().source, GroundSource::Map);
    // The lane beside the way.
    for x in 5..35 {
        let at = DVec2::new(f64::from(x), 3.0);
        let found = ground.height_at(at, Some(road_z_m(at))).unwrap();
        assert_eq!(found.source, GroundSource::Map);
        assert!((found.z_m - road_z_m(at)).abs() < 0.02, "{at}: {found:?}");
    }
}

#[test]
fn points_of_a_survey_are_trusted_first() {
    let (cloud, way) = (captured(3), way());
    let mut random = Random(9);
    let points_m = (0..20_000)
        .map(|_| {
            let at = DVec2::new(random.between(0.0, 40.0), random.between(-5.0, 5.0));
            at.extend(road_z_m(at))
        })
        .collect();
    let survey = Survey { points_m };
    // The way is said to be 10 cm lower than it is: the survey knows better.
    let guides = GroundGuides {
        survey: Some(&survey),
        ..GroundGuides::for_way(&way, Some(HEIGHT_M - 0.1))
    };
    let ground = guided(&cloud, guides);
    let errors = corner_errors(&ground);
    assert!(errors[errors.len() * 95 / 100] < 0.02);
    assert_eq!(ground.quality().unwrap().warning(), None);
}

#[test]
fn splats_that_are_a_road_are_asked_alone() {
    // Heights of good roads, and so logs of places that are one, do not change by a bit.
    let cloud = cluttered(&ROAD, &road_z_m, 7);
    let way = way();
    let plain = Ground::new(&cloud, DVec3::ZERO, &GroundOptions::default());
    let ground = guided(&cloud, GroundGuides::for_way(&way, Some(HEIGHT_M)));
    let quality = ground.quality().unwrap();
    assert!(
        quality.is_road() && quality.warning().is_none(),
        "{quality:?}"
    );
    for timed in &way {
        let at = timed.pose.translation.truncate() + DVec2::new(0.3, 0.7);
        assert_eq!(
            ground.height_at(at, Some(road_z_m(at))),
            plain.height_at(at, Some(road_z_m(at)))
        );
    }
}
