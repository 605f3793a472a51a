//! Road users on recorded tracks, and their handover to the driver model.

use std::sync::Arc;

use decouplegs_drive::{OrientedBox, RoadGraph, Traffic};
use decouplegs_scene::story::{Handover, TrackedAgent, Tracks};
use decouplegs_scene::{LaneMap, RoadUser, Story, VehicleSize, VehicleState};
use glam::DVec2;

use crate::traffic_scenes::lane;

const STEP_S: f64 = 0.1;
/// Largest change of acceleration of a step without an emergency, m/s^2: 10 m/s^3.
const JERK_STEP_MPS2: f64 = 1.0 + 1e-9;

/// Two lanes of 400 m to the east, 3.5 m apart.
fn map() -> LaneMap {
    LaneMap {
        lanes: vec![
            lane("right", &[[0.0, 0.0], [400.0, 0.0]]),
            lane("left", &[[0.0, 3.5], [400.0, 3.5]]),
        ],
        ..LaneMap::default()
    }
}

/// A track with a pose each `STEP_S` from `from_s` on, at `place(seconds since from_s)`.
fn track(name: &str, from_s: f64, steps: u32, place: impl Fn(f64) -> [f64; 2]) -> TrackedAgent {
    let passed_s = |step: u32| STEP_S * f64::from(step);
    TrackedAgent {
        name: name.into(),
        kind: RoadUser::Car,
        asset: 0,
        size_m: VehicleSize::CAR.to_array(),
        times_s: (0..=steps).map(|step| from_s + passed_s(step)).collect(),
        poses: (0..=steps)
            .map(|step| {
                let [x, y] = place(passed_s(step));
                [x, y, 0.0]
            })
            .collect(),
    }
}

/// A track at a constant speed from `x_m` on.
fn steady(name: &str, x_m: f64, y_m: f64, speed_mps: f64) -> TrackedAgent {
    track(name, 0.0, 150, |s| [x_m + speed_mps * s, y_m])
}

fn traffic(handover: Handover, agents: Vec<TrackedAgent>) -> Traffic {
    let story = Story {
        tracks: Tracks { handover, agents },
        ..Story::default()
    };
    let graph = Arc::new(RoadGraph::new(&map()).unwrap());
    let traffic = Traffic::new(graph, &[], 1).unwrap();
    traffic.with_story(&story, &map()).unwrap()
}

fn standing(x_m: f64, y_m: f64) -> VehicleState {
    VehicleState {
        position_m: DVec2::new(x_m, y_m),
        ..VehicleState::default()
    }
}

/// States of all agents at the start and after each of `steps`, beside an ego that stays.
fn driven(
    traffic: &mut Traffic,
    ego: VehicleState,
    steps: usize,
) -> Vec<Vec<Option<VehicleState>>> {
    let mut all = vec![traffic.states().to_vec()];
    for _ in 0..steps {
        traffic.step(STEP_S, Some((&ego, &VehicleSize::CAR)));
        all.push(traffic.states().to_vec());
    }
    all
}

/// True if a state is where the track says, to the last bit.
fn is_exact(state: &VehicleState, pose: &[f64; 3]) -> bool {
    [state.position_m.x, state.position_m.y, state.yaw_rad] == *pose
}

/// Least gap between an agent's box and another box over all states, meters.
fn least_gap_m(states: &[Vec<Option<VehicleState>>], agent: usize, other: &OrientedBox) -> f64 {
    let boxes = states.iter().filter_map(|all| all[agent]);
    boxes
        .map(|state| OrientedBox::for_vehicle(&state, &VehicleSize::CAR).distance_m(other))
        .fold(f64::INFINITY, f64::min)
}

#[test]
fn who_never_meets_the_ego_stands_where_the_track_says() {
    // In the ego's way is the first alone; the last begins later.
    let agents = vec![
        steady("behind", 20.0, 0.0, 12.0),
        steady("beside", 20.0, 3.5, 12.0),
        track("winding", 0.3, 100, |s| {
            [200.0 + 9.0 * s, 3.5 + 0.2 * s.sin()]
        }),
    ];
    let mut traffic = traffic(Handover::Near, agents.clone());
    let states = driven(&mut traffic, standing(150.0, 0.0), 120);
    let handed = traffic.take_handovers();
    assert_eq!(handed.iter().map(|one| one.agent).collect::<Vec<_>>(), [0]);
    assert!(traffic.take_handovers().is_empty(), "each is told once");
    for (step, all) in states.iter().enumerate() {
        assert!(
            is_exact(&all[1].unwrap(), &agents[1].poses[step]),
            "step {step}"
        );
        let winding = step.checked_sub(3).and_then(|at| agents[2].poses.get(at));
        match (all[2], winding) {
            (Some(state), Some(pose)) => assert!(is_exact(&state, pose), "step {step}"),
            (None, None) => {}
            other => panic!("step {step}: {other:?}"),
        }
    }
    let handed_at = (handed[0].time_s / STEP_S).round() as usize;
    for (step, all) in states.iter().enumerate() {
        let recorded = is_exact(&all[0].unwrap(), &agents[0].poses[step]);
        // The first steps after the handover still brake by little.
        assert!(recorded || step > handed_at, "step {step}");
        assert!(
            !recorded || step < handed_at + 3,
            "step {step} follows its track"
        );
    }
}

#[test]
fn a_vehicle_stops_behind_an_ego_that_stands_without_a_jump() {
    let ego = standing(150.0, 0.0);
    let outline = OrientedBox::for_vehicle(&ego, &VehicleSize::CAR);
    let mut near = traffic(Handover::Near, vec![steady("a", 20.0, 0.0, 12.0)]);
    let states = driven(&mut near, ego, 300);
    assert!(least_gap_m(&states, 0, &outline) > 1.0);
    let own: Vec<VehicleState> = states.iter().map(|all| all[0].unwrap()).collect();
    assert!(own[300].speed_mps < 0.05, "{:?}", own[300]);
    for pair in own.windows(2) {
        let moved_m = pair[1].position_m.distance(pair[0].position_m);
        let mean_mps = 0.5 * (pair[0].speed_mps + pair[1].speed_mps);
        assert!((moved_m - mean_mps * STEP_S).abs() < 0.02, "{pair:?}");
        let change_mps2 = (pair[1].acceleration_mps2 - pair[0].acceleration_mps2).abs();
        assert!(change_mps2 < JERK_STEP_MPS2, "{pair:?}");
        assert!(pair[1].acceleration_mps2 > -4.0, "{pair:?}");
    }
    // What must fail: on its track it drives through the ego.
    let mut never = traffic(Handover::Never, vec![steady("a", 20.0, 0.0, 12.0)]);
    let states = driven(&mut never, ego, 150);
    assert_eq!(least_gap_m(&states, 0, &outline), 0.0);
    assert!(never.take_handovers().is_empty());
}

#[test]
fn handovers_go_on_from_vehicle_to_vehicle_and_real_gaps_are_accepted() {
    // A row with gaps of 8.5 m at 12 m/s: 0.7 s.
    let row = (0..4).map(|at| steady(&format!("r{at}"), 70.0 - 13.0 * f64::from(at), 0.0, 12.0));
    let mut traffic = traffic(Handover::Near, row.collect());
    let states = driven(&mut traffic, standing(170.0, 0.0), 300);
    let handed = traffic.take_handovers();
    assert_eq!(
        handed.iter().map(|one| one.agent).collect::<Vec<_>>(),
        [0, 1, 2, 3]
    );
    assert!(
        handed
            .windows(2)
            .all(|pair| pair[0].time_s < pair[1].time_s)
    );
    for (step, all) in states.iter().enumerate() {
        for pair in all.windows(2) {
            let gap_m = pair[0].unwrap().position_m.x - pair[1].unwrap().position_m.x - 4.5;
            assert!(gap_m > 0.4, "step {step}: {gap_m}");
        }
    }
    let braking = states
        .iter()
        .flatten()
        .flatten()
        .map(|state| state.acceleration_mps2);
    assert!(braking.fold(0.0, f64::min) > -7.0);
}

#[test]
fn one_who_changed_lanes_does_so_after_the_handover() {
    // From the left lane to the right one, between 40 and 80 m.
    let changed = |s: f64| {
        let x = 10.0 + 12.0 * s;
        let share = ((x - 40.0) / 40.0).clamp(0.0, 1.0);
        [x, 3.5 * (1.0 - share * share * (3.0 - 2.0 * share))]
    };
    let agents = vec![track("a", 0.0, 150, changed)];
    let mut all = traffic(Handover::All, agents);
    let states = driven(&mut all, standing(150.0, 0.0), 200);
    assert_eq!(all.take_handovers()[0].time_s, 0.0);
    let last = states[200][0].unwrap();
    assert!(
        last.position_m.y.abs() < 0.05 && last.position_m.x < 150.0 - 4.5,
        "{last:?}"
    );
}

#[test]
fn pedestrians_keep_to_their_tracks_and_who_finds_no_room_stays_away() {
    let walker = TrackedAgent {
        kind: RoadUser::Pedestrian,
        size_m: VehicleSize::PEDESTRIAN.to_array(),
        ..steady("w", 145.0, 0.0, 1.0)
    };
    let late = track("late", 2.0, 50, |s| [149.0 + s, 0.0]);
    let mut near = traffic(Handover::Near, vec![walker.clone(), late.clone()]);
    let states = driven(&mut near, standing(150.0, 0.0), 60);
    assert!(near.take_handovers().is_empty());
    for (step, all) in states.iter().enumerate() {
        assert!(is_exact(&all[0].unwrap(), &walker.poses[step]));
        assert_eq!(all[1], None, "step {step}");
    }
    let mut never = traffic(Handover::Never, vec![late]);
    let states = driven(&mut never, standing(150.0, 0.0), 60);
    assert!(states[30][0].is_some(), "without handovers all come");
}

#[test]
fn tracks_without_a_meaning_are_refused() {
    let mut agent = steady("a", 0.0, 0.0, 1.0);
    agent.times_s[5] = agent.times_s[4];
    let story = Story {
        tracks: Tracks {
            handover: Handover::Near,
            agents: vec![agent],
        },
        ..Story::default()
    };
    let graph = Arc::new(RoadGraph::new(&map()).unwrap());
    let refused = Traffic::new(graph, &[], 1)
        .unwrap()
        .with_story(&story, &map());
    assert!(String::from(refused.unwrap_err()).contains("is not after the one before"));
}
