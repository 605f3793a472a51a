//! Borders of the map: vehicles leave there, enter there, and merge where a lane ends elsewhere.

use std::sync::Arc;

use decouplegs_drive::RoadGraph;
use decouplegs_scene::LaneMap;

use crate::traffic::{car_at, drive, traffic};
use crate::traffic_scenes::{agent, lane, straight};

#[test]
fn vehicles_leave_at_the_border_of_the_map_and_enter_again() {
    let graph = straight(300.0, 1, 25.0);
    let agents = [
        agent("first", "0", 60.0, 25.0),
        agent("second", "0", 20.0, 25.0),
    ];
    let mut traffic = traffic(&graph, &agents);
    let (mut left, mut entered, mut away) = ([0; 2], [0; 2], [0_u32; 2]);
    let mut before = traffic.states().to_vec();
    for _ in 0..1200 {
        drive(&mut traffic, &agents, 1, None);
        for number in 0..2 {
            match (before[number], traffic.states()[number]) {
                (Some(last), None) => {
                    assert!(last.position_m.x > 290.0, "{last:?}");
                    left[number] += 1;
                }
                (None, Some(first)) => {
                    assert!(first.position_m.x < 15.0, "{first:?}");
                    assert!(
                        first.speed_mps > 15.0,
                        "it does not stop to enter: {first:?}"
                    );
                    entered[number] += 1;
                }
                (None, None) => away[number] += 1,
                (Some(_), Some(_)) => {}
            }
        }
        before.copy_from_slice(traffic.states());
    }
    assert!(left.iter().all(|left| *left >= 5), "{left:?}");
    assert!((0..2).all(|number| left[number] - entered[number] <= 1));
    assert!(away.iter().all(|steps| *steps < 400), "{away:?}");
}

#[test]
fn vehicles_do_not_enter_beside_the_ego() {
    let graph = straight(300.0, 1, 25.0);
    let agents = [agent("first", "0", 250.0, 25.0)];
    let mut traffic = traffic(&graph, &agents);
    let mut ego = car_at(30.0, 8.0, 0.0);
    drive(&mut traffic, &agents, 300, Some(&mut ego));
    assert_eq!(traffic.states(), [None]);
}

#[test]
fn vehicles_merge_where_a_lane_ends_beside_another() {
    // The right lane ends after 300 m, the left one goes on.
    let mut map = LaneMap::default();
    for (id, y, length_m) in [
        ("right", 0.0, 300.0),
        ("left", 3.5, 300.0),
        ("on", 3.5, 900.0),
    ] {
        let begin_m = if id == "on" { 300.0 } else { 0.0 };
        map.lanes
            .push(lane(id, &[[begin_m, y], [begin_m + length_m, y]]));
    }
    (map.lanes[0].left_neighbor, map.lanes[1].right_neighbor) = (Some(1), Some(0));
    map.lanes[1].successors = vec![2];
    let graph = Arc::new(RoadGraph::new(&map).unwrap());
    assert_eq!(graph.entrances().len(), 2);
    assert!(!graph.lane(0).unwrap().leaves_map && graph.lane(2).unwrap().leaves_map);
    // Those that do not change lanes of their own will do so here.
    let agents: Vec<_> = (0..6)
        .map(|number| {
            let lane = if number % 2 == 0 { "right" } else { "left" };
            agent(
                &format!("{number}"),
                lane,
                20.0 + 15.0 * f64::from(number),
                12.0,
            )
        })
        .collect();
    let mut traffic = traffic(&graph, &agents);
    let mut merged = [false; 6];
    for _ in 0..600 {
        drive(&mut traffic, &agents, 1, None);
        for (merged, place) in merged.iter_mut().zip(traffic.lane_positions()) {
            *merged |= place.is_some_and(|place| place.lane == 2);
        }
    }
    assert_eq!(merged, [true; 6]);
}
