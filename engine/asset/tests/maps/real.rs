//! Public maps and tracks, which are not part of the project.

use decouplegs_asset::maps::length_m;
use decouplegs_asset::{read_map, read_tracks};
use decouplegs_scene::{Lane, LaneKind, LaneMap};
use glam::{DVec2, DVec3};

use super::data::data;

/// Distance from a point to a line, seen from above, meters.
fn distance_m(point: DVec2, line: &[DVec3]) -> f64 {
    let to_segment = |pair: &[DVec3]| {
        let (from, along) = (pair[0].truncate(), (pair[1] - pair[0]).truncate());
        let part = ((point - from).dot(along) / along.length_squared().max(1e-300)).clamp(0.0, 1.0);
        point.distance(from + along * part)
    };
    line.windows(2)
        .map(to_segment)
        .fold(f64::INFINITY, f64::min)
}

/// Width of a lane where its centerline is half over, meters.
fn width_m(lane: &Lane) -> f64 {
    let middle = lane.centerline[lane.centerline.len() / 2].truncate();
    distance_m(middle, &lane.left) + distance_m(middle, &lane.right)
}

/// Gaps between the ends of lanes and the starts of their successors, meters.
fn gaps_m(map: &LaneMap) -> Vec<f64> {
    let gaps = map.lanes.iter().flat_map(|lane| {
        lane.successors.iter().map(|&next| {
            lane.centerline
                .last()
                .unwrap()
                .distance(map.lanes[next].centerline[0])
        })
    });
    gaps.collect()
}

/// Checks what holds in every map: borders on their sides, links both ways.
fn check_sides_and_links(map: &LaneMap) {
    for (at, lane) in map.lanes.iter().enumerate() {
        let along = (lane.centerline[1] - lane.centerline[0]).truncate();
        let to = |border: &[DVec3]| (border[0] - lane.centerline[0]).truncate();
        assert!(
            along.perp_dot(to(&lane.left)) > -1e-6 && along.perp_dot(to(&lane.right)) < 1e-6,
            "lane {}",
            lane.id
        );
        assert!(
            lane.successors
                .iter()
                .all(|&next| map.lanes[next].predecessors.contains(&at)),
            "lane {}",
            lane.id
        );
    }
}

#[test]
fn lanelet2_lanes_are_as_wide_as_lanes() {
    let Some(path) = data("maps/lanelet2_mapping_example.osm") else {
        return;
    };
    let map = read_map(&path).unwrap();
    assert_eq!(map.lanes.len(), 371);
    check_sides_and_links(&map);
    let count = |kind| map.lanes.iter().filter(|lane| lane.kind == kind).count();
    let kinds = [
        LaneKind::Driving,
        LaneKind::Walking,
        LaneKind::Bicycle,
        LaneKind::Other,
    ]
    .map(count);
    println!("driving, walking, bicycle, other: {kinds:?}");
    // 337 roads, of which 17 are for pedestrians and bicycles alone, and 8 highways; 8 crosswalks
    // and 2 walkways; 2 rails.
    assert_eq!(kinds, [328, 27, 14, 2]);
    let roads: Vec<&Lane> = map
        .lanes
        .iter()
        .filter(|lane| lane.kind == LaneKind::Driving)
        .collect();
    let within = |widest_m: f64| {
        roads
            .iter()
            .filter(|lane| (2.0..=widest_m).contains(&width_m(lane)))
            .count()
    };
    println!(
        "of {} driving lanes {} are 2 to 6 m wide, {} up to 8 m",
        roads.len(),
        within(6.0),
        within(8.0)
    );
    // Streets for both directions are one lanelet of 6 m and more: by the nodes of its ways, 284 of
    // 345 are up to 6 m wide.
    assert!(within(6.0) * 100 >= roads.len() * 75 && within(8.0) * 100 >= roads.len() * 93);
    let gaps_m = gaps_m(&map);
    println!(
        "{} links, the widest gap {:.2e} m",
        gaps_m.len(),
        gaps_m.iter().fold(0.0, |a: f64, b| a.max(*b))
    );
    assert!(gaps_m.len() > 200 && gaps_m.iter().all(|gap_m| *gap_m < 1e-6));
    assert!(
        map.lanes
            .iter()
            .filter(|lane| lane.right_neighbor.is_some())
            .count()
            > 40
    );
    // Karlsruhe in zone 32.
    let at = map.lanes[0].centerline[0];
    assert!(
        (457_000.0..459_000.0).contains(&at.x) && (5_427_000.0..5_429_500.0).contains(&at.y),
        "{at}"
    );
}

#[test]
fn opendrive_lanes_go_on_where_they_end() {
    for (name, lanes, links) in [("fabriksgatan", 44, 40), ("soderleden", 33, 12)] {
        let Some(path) = data(&format!("maps/esmini_{name}.xodr")) else {
            return;
        };
        let map = read_map(&path).unwrap();
        assert_eq!(map.lanes.len(), lanes, "{name}");
        check_sides_and_links(&map);
        let gaps_m = gaps_m(&map);
        let close = gaps_m.iter().filter(|gap_m| **gap_m < 0.05).count();
        let meters: f64 = map
            .lanes
            .iter()
            .map(|lane| length_m(&lane.centerline))
            .sum();
        let widest_m = gaps_m.iter().fold(0.0, |a: f64, b| a.max(*b));
        println!(
            "{name}: {close} of {} links within 5 cm, the widest gap {widest_m:.2} m; {meters:.0} m in all",
            gaps_m.len()
        );
        assert!(
            gaps_m.len() >= links && close * 10 >= gaps_m.len() * 9,
            "{name}: {gaps_m:?}"
        );
        for lane in map
            .lanes
            .iter()
            .filter(|lane| lane.kind == LaneKind::Driving)
        {
            let longest_m = lane
                .centerline
                .windows(2)
                .map(|pair| pair[0].distance(pair[1]))
                .fold(0.0, f64::max);
            assert!(
                longest_m < 2.5,
                "{name}, lane {}: a step of {longest_m} m",
                lane.id
            );
            assert!(
                (2.5..=5.0).contains(&width_m(lane)),
                "{name}, lane {}: {} m wide",
                lane.id,
                width_m(lane)
            );
            let neighbor = lane.right_neighbor.map(|at| &map.lanes[at]);
            if let Some(neighbor) = neighbor.filter(|other| other.kind == LaneKind::Driving) {
                let apart_m = distance_m(
                    lane.centerline[lane.centerline.len() / 2].truncate(),
                    &neighbor.centerline,
                );
                assert!(
                    (2.5..=5.0).contains(&apart_m),
                    "{name}, lanes {} and {}: {apart_m} m",
                    lane.id,
                    neighbor.id
                );
            }
        }
    }
}

#[test]
fn commonroad_vehicles_drive_on_its_lanes() {
    let Some(path) = data("scenarios/commonroad_USA_Lanker-1_1_T-1.xml") else {
        return;
    };
    let (map, tracks) = (read_map(&path).unwrap(), read_tracks(&path).unwrap());
    assert_eq!((map.lanes.len(), tracks.len()), (91, 24));
    check_sides_and_links(&map);
    let gaps_m = gaps_m(&map);
    assert!(
        gaps_m.len() >= 84 && gaps_m.iter().all(|gap_m| *gap_m < 0.05),
        "{gaps_m:?}"
    );
    assert!(
        map.lanes
            .iter()
            .all(|lane| lane.speed_limit_mps.is_some() && !lane.has_height)
    );
    let (mut inside, mut count) = (0, 0);
    for track in &tracks {
        assert_eq!(
            track.dims_m.map(|dims| dims[2]),
            Some(1.5),
            "{} {}",
            track.id,
            track.class
        );
        for pair in track.points.windows(2) {
            assert!(
                (pair[1].time_s - pair[0].time_s - 0.1).abs() < 1e-9,
                "{}",
                track.id
            );
        }
        for point in &track.points {
            let nearest_m = map
                .lanes
                .iter()
                .map(|lane| distance_m(point.position_m, &lane.centerline))
                .fold(f64::INFINITY, f64::min);
            inside += usize::from(nearest_m < 2.5);
            count += 1;
        }
    }
    println!("{inside} of {count} points within 2.5 m of a centerline");
    assert!(
        count == 938 && inside * 100 >= count * 95,
        "{inside} of {count}"
    );
}
