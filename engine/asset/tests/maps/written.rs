//! Maps of all formats, written as OpenDRIVE and read again.

use std::path::Path;

use decouplegs_asset::maps::{open_drive, read_map};
use decouplegs_scene::{Lane, LaneMap};
use glam::DVec3;

fn seed(name: &str) -> LaneMap {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/seeds");
    read_map(&folder.join(name)).unwrap()
}

fn distance_m(line: &[DVec3], point: DVec3) -> f64 {
    let distances = line.windows(2).map(|pair| {
        let along = pair[1] - pair[0];
        let share = (point - pair[0]).dot(along) / along.length_squared().max(1e-12);
        point.distance(pair[0] + along * share.clamp(0.0, 1.0))
    });
    distances.fold(f64::INFINITY, f64::min)
}

fn assert_same_lane(found: &Lane, expected: &Lane) {
    let id = &expected.id;
    for point in &expected.centerline {
        let off_m = distance_m(&found.centerline, *point);
        assert!(off_m < 0.02, "lane {id}: {off_m} m off at {point}");
    }
    for point in &found.centerline {
        let off_m = distance_m(&expected.centerline, *point);
        assert!(off_m < 0.02, "lane {id}: {off_m} m off at {point}");
    }
    assert_eq!(
        (found.kind, found.has_height),
        (expected.kind, expected.has_height)
    );
    let limits = [found, expected].map(|lane| lane.speed_limit_mps.unwrap_or(0.0));
    assert!(
        (limits[0] - limits[1]).abs() < 1e-3,
        "lane {id}: {limits:?}"
    );
}

fn written(map: &LaneMap) -> LaneMap {
    open_drive::decode(&open_drive::encode(map).unwrap()).unwrap()
}

#[test]
fn maps_of_all_formats_are_the_same_as_open_drive() {
    for name in [
        "lane_json/three.json",
        "lanelet2/two.osm",
        "argoverse2/log_map_archive_two.json",
        "commonroad/2020a.xml",
        "open_drive/crossing.xodr",
        "open_drive/three_lanes.xodr",
    ] {
        let seeded = seed(name);
        let found = written(&seeded);
        assert_eq!(found.lanes.len(), seeded.lanes.len(), "{name}");
        for (found, expected) in found.lanes.iter().zip(&seeded.lanes) {
            assert_same_lane(found, expected);
            // Links over a gap are not believed.
            let meets = |next: &usize| {
                let end = expected.centerline[expected.centerline.len() - 1];
                let start = seeded.lanes[*next].centerline[0];
                end.truncate().distance(start.truncate()) < 4.0
            };
            let successors: Vec<usize> =
                expected.successors.iter().copied().filter(meets).collect();
            let sorted = |links: &[usize]| {
                let mut links = links.to_vec();
                links.sort_unstable();
                links
            };
            assert_eq!(
                sorted(&found.successors),
                sorted(&successors),
                "{name}, lane {}",
                expected.id
            );
        }
    }
}

#[test]
fn lanes_that_split_and_merge_meet_in_junctions() {
    let line = |from: [f64; 2], to: [f64; 2]| {
        vec![
            DVec3::new(from[0], from[1], 0.0),
            DVec3::new(to[0], to[1], 1.0),
        ]
    };
    let lane = |id: &str, centerline: Vec<DVec3>, successors: &[usize]| Lane {
        id: id.into(),
        centerline,
        has_height: true,
        successors: successors.to_vec(),
        ..Lane::default()
    };
    // 0 and 1 lead to 2; 1 also to 3; 2 and 3 lead to 4.
    let map = LaneMap {
        lanes: vec![
            lane("a \"<&", line([0.0, 0.0], [20.0, 0.0]), &[2]),
            lane("b", line([0.0, -10.0], [20.0, 0.0]), &[2, 3]),
            lane("c", line([20.0, 0.0], [40.0, 5.0]), &[4]),
            lane("d", line([20.0, 0.0], [40.0, 5.0]), &[4]),
            lane("e", line([40.0, 5.0], [60.0, 5.0]), &[]),
        ],
        ..LaneMap::default()
    };
    let text = String::from_utf8(open_drive::encode(&map).unwrap()).unwrap();
    assert_eq!(text.matches("<junction ").count(), 2, "{text}");
    assert!(text.contains("a &quot;&lt;&amp;"), "{text}");
    let found = written(&map);
    for (found, expected) in found.lanes.iter().zip(&map.lanes) {
        let mut links = found.successors.clone();
        links.sort_unstable();
        assert_eq!(links, expected.successors, "{}", expected.id);
    }
    // Without borders lanes are 3.5 m wide.
    let width_m = found.lanes[0].left[0].distance(found.lanes[0].right[0]);
    assert!((width_m - 3.5).abs() < 1e-6, "{width_m}");
    let mut other = map.clone();
    other.lanes[1].centerline[1].y += 0.5;
    let moved = written(&other).lanes[1].centerline.clone();
    let off_m = distance_m(&moved, map.lanes[1].centerline[1]);
    assert!(off_m > 0.3, "the comparison notices half a meter: {off_m}");
}

#[test]
fn a_lane_without_length_is_named() {
    let map = LaneMap {
        lanes: vec![Lane {
            id: "point".into(),
            centerline: vec![DVec3::ZERO, DVec3::Z],
            ..Lane::default()
        }],
        ..LaneMap::default()
    };
    let message = open_drive::encode(&map).unwrap_err().to_string();
    assert!(message.contains("lane point"), "{message}");
}
