//! Maps of all formats, written as OpenDRIVE and read again.

use std::path::Path;

use decouplegs_asset::maps::open_drive;
use decouplegs_asset::read_map;
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
        let expected = seed(name);
        let found = written(&expected);
        let places = places_in(&found, &expected);
        for (number, lane) in expected.lanes.iter().enumerate() {
            let found = &found.lanes[places[number]];
            assert_same_lane(found, lane);
            // Links over a gap are not believed.
            let meets = |next: &&usize| {
                let end = lane.centerline[lane.centerline.len() - 1];
                let start = expected.lanes[**next].centerline[0];
                end.truncate().distance(start.truncate()) < 4.0
            };
            let next = lane.successors.iter().filter(meets);
            let links: Vec<usize> = next.map(|next| places[*next]).collect();
            assert_eq!(
                sorted(&found.successors),
                sorted(&links),
                "{name}, lane {}",
                lane.id
            );
        }
    }
}

fn sorted(links: &[usize]) -> Vec<usize> {
    let mut links = links.to_vec();
    links.sort_unstable();
    links
}

/// Places of the lanes of `expected` in `found`, where those of one road follow each other.
fn places_in(found: &LaneMap, expected: &LaneMap) -> Vec<usize> {
    assert_eq!(found.lanes.len(), expected.lanes.len());
    let ends = |lane: &Lane| {
        [
            lane.centerline[0],
            lane.centerline[lane.centerline.len() - 1],
        ]
    };
    let places = expected.lanes.iter().map(|lane| {
        let off_m = |at: &usize| {
            let pairs = ends(&found.lanes[*at]).into_iter().zip(ends(lane));
            pairs.map(|(a, b)| a.distance(b)).sum::<f64>()
        };
        let nearest = (0..found.lanes.len()).min_by(|a, b| off_m(a).total_cmp(&off_m(b)));
        nearest.unwrap()
    });
    let places: Vec<usize> = places.collect();
    let mut all = sorted(&places);
    all.dedup();
    assert_eq!(all.len(), places.len(), "each lane is found once");
    places
}

/// `count` lanes beside each other along a bend to the left of 1 rad, 3.5 m wide, and as many
/// straight on behind them.
fn bend(count: usize) -> LaneMap {
    let around = |radius_m: f64| -> Vec<DVec3> {
        let angles = (0..=20).map(|step| f64::from(step) * 0.05);
        angles
            .map(|angle| DVec3::new(radius_m * angle.sin(), -radius_m * angle.cos(), 0.0))
            .collect()
    };
    let on = |line: &[DVec3]| {
        let end = line[line.len() - 1];
        let along = DVec3::new(1.0_f64.cos(), 1.0_f64.sin(), 0.0);
        vec![end, end + 15.0 * along, end + 30.0 * along]
    };
    let mut map = LaneMap::default();
    for lane in 0..count {
        // A bend to the left: the left lane has the smallest radius.
        let radius_m = 20.0 + 3.5 * lane as f64;
        let [left, middle, right] = [-1.75, 0.0, 1.75].map(|side_m| around(radius_m + side_m));
        let neighbors = |first: usize| {
            let left = lane.checked_sub(1).map(|left| first + left);
            (left, (lane + 1 < count).then_some(first + lane + 1))
        };
        let (left_neighbor, right_neighbor) = neighbors(0);
        let curved = Lane {
            id: format!("bend {lane}"),
            centerline: middle.clone(),
            left: left.clone(),
            right: right.clone(),
            successors: vec![count + lane],
            left_neighbor,
            right_neighbor,
            ..Lane::default()
        };
        map.lanes.insert(lane, curved);
        let (left_neighbor, right_neighbor) = neighbors(count);
        map.lanes.push(Lane {
            id: format!("on {lane}"),
            centerline: on(&middle),
            left: on(&left),
            right: on(&right),
            left_neighbor,
            right_neighbor,
            ..Lane::default()
        });
    }
    map
}

/// AlpaSim's evaluation takes each outer border of a road for a curb (trajdata at c4c3c6d,
/// `src/trajdata/dataset_specific/xodr/lane_processing.py:354`), and the union of lanes for road
/// only where their borders are the same numbers (`src/eval/src/eval/scorers/offroad.py:186`).
#[test]
fn lanes_beside_each_other_are_lanes_of_one_road() {
    let map = bend(3);
    let text = String::from_utf8(open_drive::encode(&map).unwrap()).unwrap();
    assert_eq!(text.matches("<road ").count(), 2, "{text}");
    assert_eq!(text.matches("<lane id=\"-3\"").count(), 2, "{text}");
    assert!(
        !text.contains("<junction "),
        "lane by lane, without a junction"
    );
    let found = written(&map);
    let places = places_in(&found, &map);
    for (number, lane) in map.lanes.iter().enumerate() {
        let read = &found.lanes[places[number]];
        for (line, own) in [
            (&read.centerline, &lane.centerline),
            (&read.left, &lane.left),
            (&read.right, &lane.right),
        ] {
            for point in own {
                let off_m = distance_m(line, *point);
                assert!(off_m < 0.03, "lane {}: {off_m} m off at {point}", lane.id);
            }
            for pair in line.windows(2) {
                let off_m = distance_m(own, pair[1]);
                assert!(off_m < 0.03, "lane {}: {off_m} m off", lane.id);
            }
        }
        let next: Vec<usize> = lane.successors.iter().map(|next| places[*next]).collect();
        assert_eq!(read.successors, next, "lane {}", lane.id);
        let neighbor = |neighbor: Option<usize>| neighbor.map(|neighbor| places[neighbor]);
        assert_eq!(
            read.right_neighbor,
            neighbor(lane.right_neighbor),
            "lane {}",
            lane.id
        );
        if let Some(right) = read.right_neighbor {
            assert_eq!(
                read.right, found.lanes[right].left,
                "one border, to the last bit"
            );
        }
    }
}

#[test]
fn lanes_that_are_not_beside_each_other_along_their_length_stay_apart() {
    let roads = |map: &LaneMap| {
        let text = String::from_utf8(open_drive::encode(map).unwrap()).unwrap();
        assert_eq!(written(map).lanes.len(), map.lanes.len());
        text.matches("<road ").count()
    };
    assert_eq!(roads(&bend(2)), 2);
    // The right lane of the straight part ends 10 m before the left one.
    let mut short = bend(2);
    short.lanes[3].centerline.pop();
    assert_eq!(roads(&short), 3);
    // One leads away.
    let mut away = bend(2);
    away.lanes[3].centerline[2].y -= 4.0;
    assert_eq!(roads(&away), 3);
    // Neighbors that do not agree.
    let mut one_sided = bend(2);
    one_sided.lanes[1].left_neighbor = None;
    assert_eq!(roads(&one_sided), 3);
    // A lane that splits in two makes a junction, in which lanes keep their neighbors.
    let mut split = bend(2);
    split.lanes[0].successors.push(3);
    let text = String::from_utf8(open_drive::encode(&split).unwrap()).unwrap();
    assert_eq!(text.matches("<laneLink ").count(), 3, "{text}");
    let found = written(&split);
    let places = places_in(&found, &split);
    let next = sorted(&[places[2], places[3]]);
    assert_eq!(sorted(&found.lanes[places[0]].successors), next);
    assert_eq!(found.lanes[places[1]].successors, [places[3]]);
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
