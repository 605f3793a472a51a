use super::*;
use decouplegs_scene::Lane;
use glam::DVec3;

fn lane(id: &str, points: &[[f64; 2]]) -> Lane {
    let centerline = points.iter().map(|&[x, y]| DVec3::new(x, y, 0.0)).collect();
    Lane {
        id: id.into(),
        centerline,
        ..Lane::default()
    }
}

fn map(lanes: Vec<Lane>) -> LaneMap {
    LaneMap {
        lanes,
        ..LaneMap::default()
    }
}

#[test]
fn lanes_that_cross_know_where_and_who_goes_first() {
    let east = lane("east", &[[-50.0, 0.0], [50.0, 0.0]]);
    let north = lane("north", &[[0.0, -50.0], [0.0, 50.0]]);
    let beside = lane("beside", &[[-50.0, 3.3], [-10.0, 3.3]]);
    let graph = RoadGraph::new(&map(vec![east, north, beside])).unwrap();
    let conflict = graph.lane(0).unwrap().conflicts[0];
    assert_eq!(
        (conflict.other, conflict.goes_first),
        (1, false),
        "who drives north comes from the right of who drives east"
    );
    // Corridors of 2.2 m, in whole cells of 2 m.
    assert!(
        (46.0..=49.0).contains(&conflict.from_m) && (51.0..=54.0).contains(&conflict.to_m),
        "{conflict:?}"
    );
    assert!(
        graph.lane(1).unwrap().conflicts[0].goes_first
            && graph.lane(2).unwrap().conflicts.is_empty()
    );
    assert_eq!((graph.find("north"), graph.find("south")), (Some(1), None));
}

#[test]
fn lanes_under_a_bridge_do_not_cross() {
    let mut east = lane("east", &[[-50.0, 0.0], [50.0, 0.0]]);
    let mut north = lane("north", &[[0.0, -50.0], [0.0, 50.0]]);
    (east.has_height, north.has_height) = (true, true);
    north.centerline.iter_mut().for_each(|point| point.z = 5.0);
    let graph = RoadGraph::new(&map(vec![east.clone(), north.clone()])).unwrap();
    assert!(graph.lane(0).unwrap().conflicts.is_empty());
    north.centerline.iter_mut().for_each(|point| point.z = 1.0);
    let graph = RoadGraph::new(&map(vec![east, north])).unwrap();
    assert_eq!(graph.lane(0).unwrap().conflicts.len(), 1);
}

#[test]
fn forks_are_followed_and_merges_are_conflicts() {
    let mut before = lane("before", &[[-50.0, 0.0], [0.0, 0.0]]);
    let mut straight = lane("straight", &[[0.0, 0.0], [60.0, 0.0]]);
    let mut aside = lane("aside", &[[0.0, 0.0], [20.0, 2.0], [40.0, 12.0]]);
    let mut join = lane("join", &[[20.0, -20.0], [40.0, -2.0], [60.0, 0.0]]);
    let after = lane("after", &[[60.0, 0.0], [100.0, 0.0]]);
    before.successors = vec![1, 2];
    (straight.successors, join.successors) = (vec![4], vec![4]);
    (straight.predecessors, aside.predecessors) = (vec![0], vec![0]);
    let graph = RoadGraph::new(&map(vec![before, straight, aside, join, after])).unwrap();
    let [straight, aside, join] = [1, 2, 3].map(|lane| graph.lane(lane).unwrap());
    assert_eq!(
        (
            straight.forks.len(),
            straight.forks[0].other,
            aside.forks[0].other
        ),
        (1, 2, 1)
    );
    assert!(
        (10.0..40.0).contains(&straight.forks[0].to_m),
        "{:?}",
        straight.forks
    );
    assert!(
        straight
            .conflicts
            .iter()
            .all(|conflict| conflict.other == 3),
        "{:?}",
        straight.conflicts
    );
    let merge = straight.conflicts[0];
    assert!(
        (merge.to_m - 60.0).abs() < 1e-9 && merge.goes_first,
        "{merge:?}"
    );
    assert!(!join.conflicts[0].goes_first && graph.lane(4).unwrap().predecessors == [1, 3]);
    assert_eq!(graph.lane(0).unwrap().onward_m, 150.0);
}

#[test]
fn circles_go_on_for_ever_and_links_over_gaps_are_left_out() {
    let mut there = lane("there", &[[0.0, 0.0], [40.0, 0.0], [40.0, 30.0]]);
    let mut back = lane("back", &[[40.0, 30.0], [0.0, 30.0], [0.0, 0.0]]);
    let far = lane("far", &[[43.0, 30.0], [90.0, 30.0]]);
    (there.successors, back.successors) = (vec![1, 2], vec![0]);
    let graph = RoadGraph::new(&map(vec![there, back, far])).unwrap();
    assert_eq!(graph.lane(0).unwrap().successors, [1]);
    assert_eq!(
        (
            graph.lane(0).unwrap().onward_m,
            graph.lane(2).unwrap().onward_m
        ),
        (2000.0, 47.0)
    );
}

#[test]
fn what_is_no_road_is_refused() {
    let far = lane("far", &[[0.0, 0.0], [1e9, 0.0]]);
    assert!(
        RoadGraph::new(&map(vec![far]))
            .unwrap_err()
            .reason()
            .contains("km of driving lanes")
    );
    let one = lane("one", &[[1.0, 1.0], [1.0, 1.0]]);
    assert!(
        RoadGraph::new(&map(vec![one]))
            .unwrap_err()
            .reason()
            .contains("lane one")
    );
    let heap = vec![lane("heap", &[[0.0, 0.0], [20.0, 0.0]]); 40_000];
    assert!(
        RoadGraph::new(&map(heap))
            .unwrap_err()
            .reason()
            .contains("by the thousand")
    );
    let graph = RoadGraph::new(&map(vec![lane("a", &[[0.0, 0.0], [9.0, 0.0]])])).unwrap();
    assert!(
        graph
            .for_vehicle(VehicleSize {
                length_m: f64::NAN,
                ..VehicleSize::CAR
            })
            .is_err()
    );
}
