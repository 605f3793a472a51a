//! Agents that another program drives, among traffic and on recorded tracks.

use std::sync::Arc;

use decouplegs_drive::traffic::body::ACCELERATION_MPS2_MAX;
use decouplegs_drive::traffic::{DrivenBy, SteerableAgent};
use decouplegs_drive::{OrientedBox, RoadGraph, Traffic};
use decouplegs_scene::episode::AgentCommand;
use decouplegs_scene::scenario::TrafficAgent;
use decouplegs_scene::story::{Handover, TrackedAgent, Tracks};
use decouplegs_scene::{LaneMap, RoadUser, Story, VehicleSize, VehicleState};

use crate::traffic_scenes::{agent, lane};

const STEP_S: f64 = 0.1;

/// A straight lane of 400 m to the east, which leaves the map.
fn map() -> LaneMap {
    LaneMap {
        lanes: vec![lane("a", &[[0.0, 0.0], [400.0, 0.0]])],
        ..LaneMap::default()
    }
}

/// Two cars on the lane, 60 m apart, at 10 m/s.
fn two_cars() -> Vec<TrafficAgent> {
    [("behind", 40.0), ("ahead", 100.0)]
        .map(|(name, at_m)| agent(name, "a", at_m, 10.0))
        .into()
}

fn traffic() -> Traffic {
    let graph = Arc::new(RoadGraph::new(&map()).unwrap());
    Traffic::new(graph, &two_cars(), 1).unwrap()
}

fn command(agent: usize, acceleration_mps2: f64, curvature_per_m: Option<f64>) -> AgentCommand {
    AgentCommand {
        agent,
        acceleration_mps2,
        curvature_per_m,
    }
}

fn state_of(traffic: &Traffic, agent: usize) -> VehicleState {
    traffic.states()[agent].unwrap()
}

fn told(traffic: &Traffic, agent: usize) -> SteerableAgent {
    let all = traffic.steerable(&[]);
    all.into_iter().find(|one| one.agent == agent).unwrap()
}

#[test]
fn traffic_without_commands_is_the_same_to_the_last_bit() {
    let (mut plain, mut asked) = (traffic(), traffic());
    for _ in 0..300 {
        asked.steer(&[]).unwrap();
        let there = asked.states().iter().flatten().count();
        assert_eq!(asked.steerable(&[]).len(), there);
        for traffic in [&mut plain, &mut asked] {
            traffic.step(STEP_S, None);
        }
        assert_eq!(plain.states(), asked.states());
    }
}

#[test]
fn commands_are_carried_out_and_others_react() {
    let mut traffic = traffic();
    assert_eq!(told(&traffic, 0).driven_by, DrivenBy::Model);
    let leader = told(&traffic, 0).leader.unwrap();
    assert_eq!(leader.agent, Some(1));
    let gap_m = 60.0 - VehicleSize::CAR.length_m;
    assert!((leader.gap_m - gap_m).abs() < 1e-6, "{leader:?}");
    assert_eq!(told(&traffic, 1).leader, None);
    let start = state_of(&traffic, 1);
    for step in 1..=50 {
        traffic.steer(&[command(1, -2.0, None)]).unwrap();
        traffic.step(STEP_S, None);
        let now = state_of(&traffic, 1);
        let time_s = STEP_S * f64::from(step);
        let speed_mps = (10.0 - 2.0 * time_s).max(0.0);
        assert!((now.speed_mps - speed_mps).abs() < 1e-9, "{now:?}");
        let way_m = 10.0 * time_s - time_s * time_s;
        assert!((now.position_m.x - start.position_m.x - way_m).abs() < 1e-6);
    }
    assert!(traffic.take_limited().is_empty());
    assert_eq!(told(&traffic, 1).driven_by, DrivenBy::Commands);
    // The driver model sees it as it sees the ego, and stops behind it.
    for _ in 0..300 {
        traffic.steer(&[command(1, -2.0, None)]).unwrap();
        traffic.step(STEP_S, None);
        let outline =
            |agent| OrientedBox::for_vehicle(&state_of(&traffic, agent), &VehicleSize::CAR);
        assert!(!outline(0).overlaps(&outline(1)));
    }
    assert!(
        state_of(&traffic, 0).speed_mps < 0.1,
        "{:?}",
        state_of(&traffic, 0)
    );
    // Without a command it drives on by the model.
    for _ in 0..50 {
        traffic.steer(&[]).unwrap();
        traffic.step(STEP_S, None);
    }
    assert!(
        state_of(&traffic, 1).speed_mps > 2.0,
        "{:?}",
        state_of(&traffic, 1)
    );
    assert!(state_of(&traffic, 1).position_m.y.abs() < 0.01);
}

#[test]
fn one_that_does_not_brake_touches_and_is_not_kept_from_it() {
    let mut traffic = traffic();
    let touches = (0..150).any(|_| {
        let commands = [command(0, 2.0, None), command(1, -2.0, None)];
        traffic.steer(&commands).unwrap();
        traffic.step(STEP_S, None);
        let outline =
            |agent| OrientedBox::for_vehicle(&state_of(&traffic, agent), &VehicleSize::CAR);
        outline(0).overlaps(&outline(1))
    });
    assert!(touches);
}

#[test]
fn what_no_vehicle_can_do_is_limited_and_told() {
    let mut traffic = traffic();
    traffic.steer(&[command(0, 30.0, Some(3.0))]).unwrap();
    let before = state_of(&traffic, 0);
    traffic.step(STEP_S, None);
    assert_eq!(traffic.take_limited(), [0]);
    assert!(traffic.take_limited().is_empty(), "each is told once");
    let after = state_of(&traffic, 0);
    let change_mps = after.speed_mps - before.speed_mps;
    assert!((change_mps - ACCELERATION_MPS2_MAX * STEP_S).abs() < 1e-9);
    assert!(
        after.position_m.distance(before.position_m) < 1.1,
        "{after:?}"
    );
    traffic.steer(&[command(0, 1.0, Some(0.001))]).unwrap();
    for _ in 0..20 {
        traffic.step(STEP_S, None);
    }
    traffic.take_limited();
    traffic.step(STEP_S, None);
    assert!(traffic.take_limited().is_empty());
}

#[test]
fn commands_that_cannot_be_given_are_refused_and_change_nothing() {
    let mut traffic = traffic();
    let good = command(0, 1.0, None);
    for (commands, says) in [
        (
            vec![good, command(2, 0.0, None)],
            "agent 2 takes no commands",
        ),
        (vec![good, good], "agent 0 has two commands"),
        (vec![command(1, f64::NAN, None)], "not finite"),
        (vec![command(1, 0.0, Some(f64::INFINITY))], "not finite"),
    ] {
        let refusal = traffic.steer(&commands).unwrap_err().to_string();
        assert!(refusal.contains(says), "{refusal}");
    }
    assert_eq!(told(&traffic, 0).driven_by, DrivenBy::Model);
}

#[test]
fn who_drives_over_the_border_is_gone_and_enters_again_by_the_model() {
    let mut traffic = traffic();
    let mut was_gone = false;
    for _ in 0..900 {
        let there = traffic.states()[1].is_some();
        let commands = [command(1, 1.0, None)];
        traffic
            .steer(&commands[..usize::from(there && !was_gone)])
            .unwrap();
        traffic.step(STEP_S, None);
        was_gone |= traffic.states()[1].is_none();
        if was_gone && traffic.states()[1].is_some() {
            break;
        }
    }
    assert!(was_gone);
    assert_eq!(told(&traffic, 1).driven_by, DrivenBy::Model);
}

/// A car that keeps to 2 m to the left of the lane's middle, at 8 m/s for 10 s.
fn tracked() -> Traffic {
    let steps = 0..=100_u32;
    let agent = TrackedAgent {
        name: "recorded".into(),
        kind: RoadUser::Car,
        asset: 0,
        size_m: VehicleSize::CAR.to_array(),
        times_s: steps.clone().map(|step| STEP_S * f64::from(step)).collect(),
        poses: steps
            .map(|step| [50.0 + 0.8 * f64::from(step), 2.0, 0.0])
            .collect(),
    };
    let story = Story {
        tracks: Tracks {
            handover: Handover::Never,
            agents: vec![agent],
        },
        ..Story::default()
    };
    traffic().with_story(&story, &map()).unwrap()
}

#[test]
fn recorded_vehicles_leave_their_tracks_with_the_first_command() {
    let mut traffic = tracked();
    for _ in 0..10 {
        traffic.step(STEP_S, None);
    }
    assert_eq!(told(&traffic, 2).driven_by, DrivenBy::Track);
    assert!(traffic.take_handovers().is_empty());
    let before = state_of(&traffic, 2);
    traffic.steer(&[command(2, 1.5, None)]).unwrap();
    assert_eq!(state_of(&traffic, 2), before, "nothing jumps");
    for _ in 0..40 {
        traffic.step(STEP_S, None);
    }
    let handed = traffic.take_handovers();
    assert_eq!((handed.len(), handed[0].agent), (1, 2));
    assert!((handed[0].time_s - 1.0).abs() < 1e-9);
    let now = state_of(&traffic, 2);
    assert!((now.speed_mps - 14.0).abs() < 1e-6, "{now:?}");
    let way_m = 8.0 * 4.0 + 0.5 * 1.5 * 16.0;
    assert!((now.position_m.x - before.position_m.x - way_m).abs() < 1e-3);
    assert!((now.position_m.y - 2.0).abs() < 1e-3, "{now:?}");
    // Without commands the model drives it on its line.
    traffic.steer(&[]).unwrap();
    for _ in 0..20 {
        traffic.step(STEP_S, None);
    }
    assert_eq!(told(&traffic, 2).driven_by, DrivenBy::Commands);
    assert!(state_of(&traffic, 2).position_m.x > now.position_m.x + 15.0);
}
