//! Junctions, crossings and edges of lanes, and turns from wrong lanes.

use decouplegs_drive::{RoadGraph, RoadParts, TurnWatch};
use decouplegs_scene::{LaneKind, LaneMap};

use crate::episodes::state;
use crate::traffic_scenes::lane;

/// Two lanes from the west, one to turn left from and one to go straight on, over a road from south
/// to north at x = 60, to two lanes to the east.
fn junction() -> LaneMap {
    let bow: Vec<[f64; 2]> = (0..=8)
        .map(|step| {
            let angle = f64::from(step) / 8.0 * std::f64::consts::FRAC_PI_2;
            [48.0 + 12.0 * angle.sin(), 12.0 - 12.0 * angle.cos()]
        })
        .collect();
    let mut map = LaneMap::default();
    let lines: [(&str, Vec<[f64; 2]>); 9] = [
        ("left", vec![[0.0, 0.0], [48.0, 0.0]]),
        ("straight", vec![[0.0, -3.5], [48.0, -3.5]]),
        ("bow", bow),
        ("over", vec![[48.0, -3.5], [76.0, -3.5]]),
        ("north", vec![[60.0, 12.0], [60.0, 60.0]]),
        ("east", vec![[76.0, -3.5], [160.0, -3.5]]),
        ("east beside", vec![[76.0, 0.0], [160.0, 0.0]]),
        ("from south", vec![[60.0, -60.0], [60.0, -16.0]]),
        ("through", vec![[60.0, -16.0], [60.0, 12.0]]),
    ];
    map.lanes = lines.iter().map(|(id, line)| lane(id, line)).collect();
    let mut link = |from: usize, to: usize| map.lanes[from].successors.push(to);
    link(0, 2);
    link(1, 3);
    link(2, 4);
    link(3, 5);
    link(7, 8);
    link(8, 4);
    (map.lanes[0].right_neighbor, map.lanes[1].left_neighbor) = (Some(1), Some(0));
    map
}

fn parts(map: &LaneMap) -> RoadParts {
    RoadParts::new(map, &RoadGraph::new(map).unwrap())
}

#[test]
fn junctions_are_where_lanes_cross_and_not_where_they_merge() {
    let mut map = junction();
    let at = |map: &LaneMap, x: f64, y: f64| parts(map).record(&state(x, y, 0.0, 8.0));
    let before = at(&map, 20.0, -3.2);
    assert!(!before.in_junction && !before.on_crossing && !before.wrong_turn);
    let lane_offset = before.lane.unwrap();
    assert!((lane_offset.lateral_m - 0.3).abs() < 1e-9);
    assert_eq!(lane_offset.half_width_m, 1.75);
    let within = at(&map, 60.0, -3.5);
    assert!(within.in_junction && within.on_crossing, "{within:?}");
    // Its front is in the lane that crosses, and before it.
    let at_edge = at(&map, 58.8, -3.5);
    assert!(at_edge.in_junction && at_edge.on_crossing, "{at_edge:?}");
    assert!(!at(&map, 53.0, -3.5).on_crossing);
    assert!(!at(&map, 100.0, -3.5).in_junction);
    // Beside all lanes in its direction, and far from all.
    assert_eq!(at(&map, 20.0, 5.0).lane.unwrap().lateral_m, 5.0);
    assert_eq!(at(&map, 20.0, 30.0).lane, None);
    // A crosswalk.
    map.lanes.push(lane("walk", &[[20.0, -8.0], [20.0, 4.0]]));
    let count = map.lanes.len();
    map.lanes[count - 1].kind = LaneKind::Walking;
    let walk = at(&map, 20.0, -3.5);
    assert!(walk.on_crossing && !walk.in_junction);
    assert!(!at(&map, 28.0, -3.5).on_crossing);
    // Two lanes that merge.
    let mut merge = LaneMap::default();
    merge.lanes.push(lane("a", &[[0.0, 0.0], [100.0, 0.0]]));
    merge.lanes.push(lane("b", &[[0.0, -30.0], [100.0, 0.0]]));
    merge.lanes.push(lane("on", &[[100.0, 0.0], [200.0, 0.0]]));
    merge.lanes[0].successors = vec![2];
    merge.lanes[1].successors = vec![2];
    let end = at(&merge, 98.0, 0.0);
    assert!(!end.in_junction && !end.on_crossing);
}

/// Places at which a drive along `line` is a wrong turn, meters along x.
fn wrong_turns(line: &[[f64; 2]]) -> Vec<f64> {
    let (parts, mut watch) = (parts(&junction()), TurnWatch::default());
    let mut found = Vec::new();
    for pair in line.windows(2) {
        let ([x, y], [to_x, to_y]) = (pair[0], pair[1]);
        let (along, count) = (
            [to_x - x, to_y - y],
            1 + (to_x - x).hypot(to_y - y) as usize,
        );
        for step in 0..count {
            let share = step as f64 / count as f64;
            let at = [x + share * along[0], y + share * along[1]];
            let ego = state(at[0], at[1], along[1].atan2(along[0]), 10.0);
            let in_junction = parts.record(&ego).in_junction;
            if watch.advance(&parts, &ego, in_junction) {
                found.push(at[0]);
            }
        }
    }
    found
}

#[test]
fn a_turn_is_wrong_where_the_lane_does_not_lead() {
    // As the lanes lead, and with a change of lanes in time.
    let none: Vec<f64> = Vec::new();
    assert_eq!(wrong_turns(&[[5.0, -3.5], [150.0, -3.5]]), none);
    let left = [
        [5.0, 0.0],
        [48.0, 0.0],
        [52.6, 0.9],
        [56.5, 3.5],
        [59.1, 7.4],
        [60.0, 12.0],
        [60.0, 50.0],
    ];
    assert_eq!(wrong_turns(&left), none);
    let changes = [[5.0, 0.0], [15.0, 0.0], [35.0, -3.5], [150.0, -3.5]];
    assert_eq!(wrong_turns(&changes), none);
    // Straight on from the lane to turn left: known when it is out of the junction.
    let wrong = wrong_turns(&[[5.0, 0.0], [150.0, 0.0]]);
    assert_eq!(wrong.len(), 1);
    assert!((62.0..90.0).contains(&wrong[0]), "{wrong:?}");
    // To the left from the lane that goes straight on.
    let across = [
        [5.0, -3.5],
        [50.0, -3.5],
        [57.0, 2.0],
        [60.0, 10.0],
        [60.0, 50.0],
    ];
    assert_eq!(wrong_turns(&across).len(), 1);
}
