//! Registered boxes stand on roads that are no planes of a map.

use decouplegs_drive::alignment::{clearances, penetration_rate, size_quantile};
use decouplegs_drive::register::grounding::{RoadPlane, corners, plane, pose_on};
use decouplegs_drive::{Ground, GroundOptions, RegisterOptions, register};
use decouplegs_scene::{LaneMap, SplatCloud, Track};
use glam::{DVec2, DVec3};

use crate::lanes::{beside, drive, logged, road, straight};
use crate::register::registered;
use crate::roads::{ROAD, Random, RoadOptions, add_clutter, add_surface};

const DIMS_M: [f64; 3] = [4.5, 1.9, 1.6];

/// Clearances of a car that was registered on the lanes of `map`, above `truth`.
fn car_clearances(
    map: &LaneMap,
    log: &Track,
    cloud: &SplatCloud,
    truth: &dyn Fn(DVec2) -> f64,
) -> Vec<f64> {
    let ground = Ground::new(cloud, DVec3::ZERO, &GroundOptions::default());
    let registration = register(
        map,
        std::slice::from_ref(log),
        Some(&ground),
        &RegisterOptions::default(),
    )
    .unwrap();
    let found = registered(&registration, 0);
    assert!(
        found
            .poses
            .iter()
            .all(|pose| !pose.flags.no_support && !pose.flags.no_height)
    );
    clearances(found.poses.iter().map(|pose| pose.pose), DIMS_M, |at, _| {
        Some(truth(at))
    })
}

/// A road of one lane along x at heights of `height`, `off_m` too high.
fn map_of(height: &dyn Fn(DVec2) -> f64, off_m: f64) -> LaneMap {
    let mut map = road(&straight(40.0), 1, 2, false);
    for point in map.lanes.iter_mut().flat_map(|lane| &mut lane.centerline) {
        point.z = height(point.truncate()) + off_m;
    }
    map
}

#[test]
fn wheels_stand_on_tilted_crowned_and_stacked_roads() {
    let tilted = |at: DVec2| 0.06 * at.x + 0.03 * at.y;
    let crowned = |at: DVec2| -0.02 * (at.y - 0.4).abs();
    let upper = |at: DVec2| 5.5 + 0.02 * at.x;
    let log = logged(
        &drive("car", 36.0, 6.0, |s| beside(&straight(40.0), 2.0 + s, 0.0)),
        0.01,
        DVec2::new(0.1, 0.5),
        0.03,
        1,
    );
    let shapes: [(&str, &dyn Fn(DVec2) -> f64); 4] = [
        ("tilted", &tilted),
        ("crowned", &crowned),
        ("lower deck", &tilted),
        ("upper deck", &upper),
    ];
    for (name, truth) in shapes {
        let (mut cloud, mut random) = (SplatCloud::default(), Random(11));
        add_surface(&mut cloud, &mut random, &ROAD, truth);
        if name.ends_with("deck") {
            let other = |at: DVec2| {
                if name.starts_with("upper") {
                    tilted(at)
                } else {
                    upper(at)
                }
            };
            add_surface(&mut cloud, &mut random, &ROAD, &other);
        }
        add_clutter(&mut cloud, &mut random, &ROAD, truth);
        let found = car_clearances(&map_of(truth, 0.2), &log, &cloud, truth);
        let p95_m = size_quantile(&found, 0.95).unwrap();
        println!(
            "{name}: p95 {p95_m:.4} m, GPR at 2 cm {:.4}",
            penetration_rate(&found, 0.02).unwrap()
        );
        assert!(p95_m < 0.02, "{name}: {p95_m}");
        assert_eq!(penetration_rate(&found, 0.05), Some(0.0));
        // The same car at the map's height floats, and the measure shows it.
        let map_only = register(
            &map_of(truth, 0.2),
            std::slice::from_ref(&log),
            None,
            &RegisterOptions::default(),
        )
        .unwrap();
        let poses = registered(&map_only, 0).poses.iter().map(|pose| pose.pose);
        let floating = clearances(poses, DIMS_M, |at, _| Some(truth(at)));
        assert!(size_quantile(&floating, 0.5).unwrap() > 0.15, "{name}");
    }
}

#[test]
fn without_splats_below_the_lanes_height_counts_and_is_flagged() {
    let height = |at: DVec2| 3.0 + 0.05 * at.x;
    let (mut cloud, mut random) = (SplatCloud::default(), Random(1));
    // A road that ends half way.
    add_surface(
        &mut cloud,
        &mut random,
        &RoadOptions {
            length_m: 20.0,
            ..ROAD
        },
        &height,
    );
    let ground = Ground::new(&cloud, DVec3::ZERO, &GroundOptions::default());
    let log = drive("car", 36.0, 6.0, |s| beside(&straight(40.0), 2.0 + s, 0.0));
    let registration = register(
        &map_of(&height, 0.0),
        &[log],
        Some(&ground),
        &RegisterOptions::default(),
    )
    .unwrap();
    let poses = &registered(&registration, 0).poses;
    assert!(poses.iter().all(
        |pose| pose.flags.no_support == (pose.pose.translation.x > 19.0)
            || (pose.pose.translation.x - 20.0).abs() < 3.5
    ));
    assert!(
        poses.iter().any(|pose| pose.flags.no_support)
            && poses.iter().any(|pose| !pose.flags.no_support)
    );
    for pose in poses {
        let up = pose.pose.rotation * DVec3::Z;
        assert!(
            (up - DVec3::new(-0.05, 0.0, 1.0).normalize()).length() < 0.02,
            "{up} at {}",
            pose.pose.translation
        );
    }
    let mut flat = map_of(&height, 0.0);
    flat.lanes
        .iter_mut()
        .for_each(|lane| lane.has_height = false);
    let nothing = drive("car", 36.0, 6.0, |s| beside(&straight(40.0), 2.0 + s, 0.0));
    let registration = register(&flat, &[nothing], None, &RegisterOptions::default()).unwrap();
    assert!(
        registered(&registration, 0)
            .poses
            .iter()
            .all(|pose| pose.flags.no_height)
    );
}

#[test]
fn a_box_on_a_plane_touches_it_with_four_corners() {
    let road = RoadPlane {
        height_m: 12.0,
        forward: 0.08,
        left: -0.03,
    };
    let pose = pose_on(&road, DVec2::new(5.0, -7.0), 0.7, 1.6);
    assert_eq!(pose.translation.truncate(), DVec2::new(5.0, -7.0));
    for corner in corners(DIMS_M) {
        let bottom = pose.transform(corner.extend(-0.8));
        let local = DVec2::from_angle(-0.7).rotate(bottom.truncate() - DVec2::new(5.0, -7.0));
        assert!((bottom.z - (12.0 + 0.08 * local.x - 0.03 * local.y)).abs() < 1e-12);
    }
    let nose = pose.rotation * DVec3::X;
    assert!(
        (nose.y.atan2(nose.x) - 0.7).abs() < 1e-12,
        "the nose points where it did"
    );
    let heights = corners(DIMS_M).map(|corner| Some(12.0 + 0.08 * corner.x - 0.03 * corner.y));
    let (found, off_m) = plane(&corners(DIMS_M), &heights).unwrap();
    assert!(
        (found.height_m - 12.0).abs() < 1e-12
            && (found.forward - 0.08).abs() < 1e-12
            && off_m < 1e-12
    );
    let [a, b, c, _] = heights;
    assert!(
        plane(&corners(DIMS_M), &[a, b, c, None]).is_some()
            && plane(&corners(DIMS_M), &[a, b, None, None]).is_none()
    );
    let (_, kerb_m) = plane(&corners(DIMS_M), &[a, b, c, Some(12.4)]).unwrap();
    assert!(kerb_m > 0.05, "four corners that are no plane are seen");
    assert!(
        plane(
            &corners(DIMS_M),
            &[Some(0.0), Some(0.0), Some(9.0), Some(9.0)]
        )
        .is_none(),
        "a wall is no road"
    );
}
