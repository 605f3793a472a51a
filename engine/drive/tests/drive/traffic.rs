//! Following, changing lanes and misbehaving on straight roads, against closed forms and what a
//! driver would expect.

use std::sync::Arc;

use decouplegs_drive::idm::{IdmParameters, Leader, advance, stopping_m};
use decouplegs_drive::obstacles::outline as outline_of;
use decouplegs_drive::{Obstacles, OrientedBox, RoadGraph, Traffic, TrafficError};
use decouplegs_scene::scenario::{After, Behavior, DriverKind, Maneuver, TrafficAgent, Trigger};
use decouplegs_scene::{Obstacle, ObstacleKind, VehicleSize, VehicleState};
use glam::DVec2;

use crate::traffic_scenes::{agent, check, place, random_traffic, state, straight, street};

/// Traffic of `agents` with the first seed.
pub fn traffic(graph: &Arc<RoadGraph>, agents: &[TrafficAgent]) -> Traffic {
    Traffic::new(graph.clone(), agents, 1).unwrap()
}

/// A car that heads along x.
pub fn car_at(x: f64, y: f64, speed_mps: f64) -> VehicleState {
    VehicleState {
        position_m: DVec2::new(x, y),
        speed_mps,
        ..VehicleState::default()
    }
}

/// Steps of 0.1 s with an ego that drives straight on; what holds for agents is checked at each.
pub fn drive(
    traffic: &mut Traffic,
    agents: &[TrafficAgent],
    steps: u32,
    mut ego: Option<&mut VehicleState>,
) {
    for step in 0..steps {
        if let Some(ego) = &mut ego {
            ego.position_m += ego.velocity() * 0.1;
        }
        traffic.step(0.1, ego.as_deref().map(|ego| (ego, &VehicleSize::CAR)));
        check(traffic, agents, &|| format!("step {step}"));
    }
}

#[test]
fn a_free_road_is_driven_as_the_model_says() {
    let graph = straight(3000.0, 1, 15.0);
    let agents = [agent("a", "0", 10.0, 0.0)];
    let mut traffic = traffic(&graph, &agents);
    let idm = IdmParameters {
        speed_mps: 15.0,
        ..IdmParameters::default()
    };
    let (mut speed_mps, mut x) = (0.0, 10.0);
    for _ in 0..600 {
        traffic.step(0.1, None);
        let (moved_m, after_mps) = advance(
            speed_mps,
            1.0 - f64::powi(speed_mps / idm.speed_mps, 4),
            0.1,
        );
        (x, speed_mps) = (x + moved_m, after_mps);
        let state = state(&traffic, 0);
        assert!(
            (state.position_m.x - x).abs() < 1e-6 && (state.speed_mps - speed_mps).abs() < 1e-9,
            "{state:?}, {x}"
        );
    }
    assert!(speed_mps > 14.99);
}

#[test]
fn who_follows_comes_to_the_equilibrium_gap_and_stops_two_metres_behind() {
    let graph = straight(4000.0, 1, 50.0 / 3.6);
    let agents = [agent("a", "0", 10.0, 5.0)];
    let mut ego = car_at(60.0, 0.0, 8.0);
    let mut traffic = traffic(&graph, &agents);
    drive(&mut traffic, &agents, 2000, Some(&mut ego));
    // The agent has driven a step after it saw the ego, and the ego has not.
    let gap_m = ego.position_m.x + 0.8 - state(&traffic, 0).position_m.x - 4.5;
    let wanted_m = IdmParameters::default().equilibrium_gap_m(8.0);
    assert!(
        (gap_m - wanted_m).abs() < 0.01,
        "{gap_m} m, expected {wanted_m}"
    );
    ego.speed_mps = 0.0;
    ego.position_m.x += 30.0;
    drive(&mut traffic, &agents, 1200, Some(&mut ego));
    let gap_m = ego.position_m.x - state(&traffic, 0).position_m.x - 4.5;
    assert!(
        (1.9..2.3).contains(&gap_m) && state(&traffic, 0).speed_mps < 0.02,
        "stands {gap_m} m behind"
    );
}

/// Gain of a slow wave of speed, `rate_radps`, from each vehicle of a platoon to the one behind it:
/// the amplitude of the last of `followers` over that of the first, for one of them.
fn growth(idm: &IdmParameters, even_mps: f64, rate_radps: f64, followers: usize) -> f64 {
    let gap_m = idm.equilibrium_gap_m(even_mps);
    let mut places: Vec<f64> = (0..=followers)
        .map(|number| -(gap_m + 4.5) * number as f64)
        .collect();
    let mut speeds = vec![even_mps; followers + 1];
    let mut widest = vec![0.0_f64; followers + 1];
    let steps = (12.0 * std::f64::consts::TAU / rate_radps / 0.02) as u32;
    for step in 0..steps {
        let phase = rate_radps * 0.02 * f64::from(step);
        let mut accelerations = vec![0.02 * rate_radps * phase.cos()];
        accelerations.extend((1..=followers).map(|number| {
            let gap_m = places[number - 1] - places[number] - 4.5;
            idm.acceleration(
                speeds[number],
                Some(Leader {
                    gap_m,
                    speed_mps: speeds[number - 1],
                }),
            )
        }));
        for number in 0..=followers {
            let (moved_m, after_mps) = advance(speeds[number], accelerations[number], 0.02);
            (places[number], speeds[number]) = (places[number] + moved_m, after_mps);
            // The first waves are not even yet.
            if step > steps / 2 {
                widest[number] = widest[number].max((after_mps - even_mps).abs());
            }
        }
    }
    (widest[followers] / widest[0]).powf(1.0 / followers as f64)
}

/// Derivatives of the acceleration by gap, own speed and the leader's, at the equilibrium.
fn derivatives(idm: &IdmParameters, speed_mps: f64) -> [f64; 3] {
    let (gap_m, h) = (idm.equilibrium_gap_m(speed_mps), 1e-4);
    let at = |gap: f64, own: f64, leader: f64| {
        idm.acceleration(
            speed_mps + own,
            Some(Leader {
                gap_m: gap_m + gap,
                speed_mps: speed_mps + leader,
            }),
        )
    };
    [
        at(h, 0.0, 0.0) - at(-h, 0.0, 0.0),
        at(0.0, h, 0.0) - at(0.0, -h, 0.0),
        at(0.0, 0.0, h) - at(0.0, 0.0, -h),
    ]
    .map(|d| d / (2.0 * h))
}

/// Growth rate by linear theory, for comparison with [`growth`]: the size of `(f_s + i w f_l) /
/// (f_s - w^2 - i w f_v)` Treiber, A. Kesting: Traffic Flow Dynamics, 2013, chapter 15).
fn growth_in_theory(idm: &IdmParameters, speed_mps: f64, rate_radps: f64) -> f64 {
    let [by_gap, by_own, by_leader] = derivatives(idm, speed_mps);
    by_gap.hypot(rate_radps * by_leader)
        / (by_gap - rate_radps * rate_radps).hypot(rate_radps * by_own)
}

#[test]
fn waves_grow_and_fade_along_a_platoon_as_theory_says() {
    let stable = IdmParameters {
        acceleration_mps2: 2.0,
        ..IdmParameters::default()
    };
    let unstable = IdmParameters {
        acceleration_mps2: 0.4,
        headway_s: 1.0,
        ..IdmParameters::default()
    };
    // Slow waves fade where f_v^2 - f_l^2 > 2 f_s.
    let is_stable = |idm: &IdmParameters| {
        let [by_gap, by_own, by_leader] = derivatives(idm, 8.0);
        by_own * by_own - by_leader * by_leader > 2.0 * by_gap
    };
    assert!(is_stable(&stable) && !is_stable(&unstable));
    for (idm, grows) in [
        (&stable, false),
        (&unstable, true),
        (
            &IdmParameters::default(),
            !is_stable(&IdmParameters::default()),
        ),
    ] {
        for rate_radps in [0.05, 0.1] {
            let (measured, theory) = (
                growth(idm, 8.0, rate_radps, 20),
                growth_in_theory(idm, 8.0, rate_radps),
            );
            println!(
                "{rate_radps} rad/s, a = {}: {measured:.5}, theory {theory:.5}",
                idm.acceleration_mps2
            );
            assert!(
                (measured - theory).abs() < 2e-3,
                "{idm:?}: {measured}, theory {theory}"
            );
            assert!(
                rate_radps > 0.05 || (measured > 1.0) == grows,
                "{idm:?}: {measured}"
            );
        }
    }
}

/// Time at which the second of two behaviors has begun: it waits 2 s after the first, which brakes
/// from 1 s to 2 s and is never due where `first_s` is `None`.
#[track_caller]
fn cruises_from_s(is_over: bool, first_s: Option<f64>) -> Option<f64> {
    let graph = straight(3000.0, 1, 50.0 / 3.6);
    let brake = Behavior {
        trigger: Trigger::Time {
            time_s: first_s.unwrap_or(3600.0),
        },
        maneuver: Maneuver::Brake {
            deceleration_mps2: 4.0,
            duration_s: 1.0,
        },
    };
    let stop = Behavior {
        trigger: Trigger::After(After {
            behavior: 0,
            is_over,
            from_s: 0.0,
            delay_s: 2.0,
        }),
        maneuver: Maneuver::Brake {
            deceleration_mps2: 8.0,
            duration_s: 10.0,
        },
    };
    let mut agents = vec![agent("0", "0", 100.0, 12.0)];
    agents[0].behaviors = vec![brake, stop];
    let mut traffic = traffic(&graph, &agents);
    (0..120).find_map(|step| {
        drive(&mut traffic, &agents, 1, None);
        (state(&traffic, 0).acceleration_mps2 < -6.0).then_some(f64::from(step) * 0.1)
    })
}

#[test]
fn a_behavior_waits_for_the_begin_or_the_end_of_another() {
    let near = |found: Option<f64>, expected_s: f64| {
        let found_s = found.expect("it begins");
        assert!((found_s - expected_s).abs() < 0.25, "{found_s} s");
    };
    near(cruises_from_s(false, Some(1.0)), 3.0);
    near(cruises_from_s(true, Some(1.0)), 4.0);
    assert_eq!(cruises_from_s(true, None), None);
}

#[test]
fn a_teleport_waits_for_room() {
    let graph = straight(3000.0, 1, 50.0 / 3.6);
    let y_m = state(&traffic(&graph, &[agent("0", "0", 100.0, 12.0)]), 0)
        .position_m
        .y;
    let to_500 = Behavior {
        trigger: Trigger::Time { time_s: 1.0 },
        maneuver: Maneuver::Teleport {
            point_m: DVec2::new(500.0, y_m + 0.5),
        },
    };
    // Far from the other, and where it drives by.
    for (other_m, until) in [(1000.0, 12), (488.0, 90)] {
        let mut agents = vec![agent("0", "0", 100.0, 12.0), agent("1", "0", other_m, 12.0)];
        agents[0].behaviors = vec![to_500];
        let mut traffic = traffic(&graph, &agents);
        drive(&mut traffic, &agents, 9, None);
        assert!(state(&traffic, 0).position_m.x < 115.0);
        let found = (9..110).find_map(|step| {
            drive(&mut traffic, &agents, 1, None);
            let now = state(&traffic, 0);
            (now.position_m.x >= 500.0).then_some((step + 1, now))
        });
        let (steps, now) = found.expect("it is put there");
        assert!(now.position_m.x < 502.0 && now.speed_mps > 11.0, "{now:?}");
        assert!(steps <= until, "{steps} steps");
        assert_eq!(steps > 12, other_m < 500.0, "{steps} steps");
    }
}

#[test]
fn a_platoon_survives_a_leader_that_brakes_as_hard_as_tyres_hold() {
    let graph = straight(3000.0, 1, 50.0 / 3.6);
    for driver in DriverKind::ALL {
        let mut agents: Vec<TrafficAgent> = (0..25)
            .map(|number| TrafficAgent {
                driver,
                ..agent(
                    &number.to_string(),
                    "0",
                    900.0 - 9.0 * f64::from(number),
                    12.0,
                )
            })
            .collect();
        let brake = Maneuver::Brake {
            deceleration_mps2: 99.0,
            duration_s: 5.0,
        };
        agents[0].behaviors.push(Behavior {
            trigger: Trigger::Time { time_s: 2.0 },
            maneuver: brake,
        });
        let mut traffic = traffic(&graph, &agents);
        for step in 0..45 {
            drive(&mut traffic, &agents, 1, None);
            // What is more than not to touch: all could stop where they are, one behind the other.
            let stops: Vec<f64> = traffic
                .states()
                .iter()
                .flatten()
                .map(|state| state.position_m.x + stopping_m(state.speed_mps))
                .collect();
            assert!(
                stops.windows(2).all(|pair| pair[0] - pair[1] >= 4.5 + 0.49),
                "{driver:?}, step {step}: {stops:?}"
            );
        }
        assert_eq!(
            state(&traffic, 0).speed_mps,
            0.0,
            "12 m/s are gone in 1.5 s"
        );
        drive(&mut traffic, &agents, 800, None);
        assert!(
            traffic
                .states()
                .iter()
                .flatten()
                .all(|state| state.speed_mps > 5.0),
            "{driver:?}: they drive on"
        );
    }
}

#[test]
fn slow_leaders_are_overtaken_where_there_is_room_and_only_then() {
    let graph = straight(2000.0, 2, 15.0);
    let overtaker = TrafficAgent {
        changes_lanes: true,
        cruise_mps: None,
        driver: DriverKind::Hurried,
        ..agent("fast", "0", 50.0, 10.0)
    };
    let mut slow = car_at(90.0, 0.0, 5.0);
    let agents = [overtaker.clone()];
    let mut alone = traffic(&graph, &agents);
    drive(&mut alone, &agents, 300, Some(&mut slow));
    assert!(
        state(&alone, 0).position_m.x > slow.position_m.x + 50.0,
        "it is past: {:?}",
        state(&alone, 0)
    );
    // A row of cars as slow beside it leaves no room.
    let mut agents = vec![overtaker];
    agents.extend((0..12).map(|number| {
        agent(
            &format!("row {number}"),
            "1",
            30.0 + 9.0 * f64::from(number),
            5.0,
        )
    }));
    let mut beside = traffic(&graph, &agents);
    let mut slow = car_at(90.0, 0.0, 5.0);
    drive(&mut beside, &agents, 40, Some(&mut slow));
    assert_eq!(place(&beside, 0).lane, 0);
}

#[test]
fn lane_changes_are_smooth_and_count_on_both_lanes() {
    let graph = straight(2000.0, 2, 15.0);
    let agents = [
        TrafficAgent {
            changes_lanes: true,
            cruise_mps: None,
            driver: DriverKind::Aggressive,
            ..agent("changes", "0", 100.0, 10.0)
        },
        agent("behind", "0", 60.0, 12.0),
        agent("aside", "1", 40.0, 12.0),
    ];
    let mut traffic = traffic(&graph, &agents);
    let mut slow = car_at(135.0, 0.0, 4.0);
    let (mut before, mut on_both) = (state(&traffic, 0), 0);
    for step in 0..300 {
        drive(&mut traffic, &agents, 1, Some(&mut slow));
        let after = state(&traffic, 0);
        let moved_m = after.position_m.distance(before.position_m);
        assert!(
            moved_m < 0.1 * (before.speed_mps + 1.0) * 1.1,
            "step {step}: {moved_m} m"
        );
        assert!(
            (after.yaw_rad - before.yaw_rad).abs() < 0.06,
            "step {step}: {before:?}, {after:?}"
        );
        on_both += u32::from((0.2..3.3).contains(&after.position_m.y));
        before = after;
    }
    assert!(
        (10..80).contains(&on_both) && (before.position_m.y - 3.5).abs() < 1e-6,
        "{on_both} steps, {before:?}"
    );
}

fn does(maneuver: Maneuver) -> Vec<Behavior> {
    vec![Behavior {
        trigger: Trigger::Time { time_s: 1.0 },
        maneuver,
    }]
}

#[test]
fn who_cuts_in_minds_agents_but_not_the_ego() {
    let graph = straight(2000.0, 3, 15.0);
    let cutter = TrafficAgent {
        behaviors: does(Maneuver::CutIn),
        ..agent("cutter", "1", 106.0, 10.0)
    };
    let run = |ego_y: f64, others: Vec<TrafficAgent>| {
        let agents: Vec<TrafficAgent> = [cutter.clone()].into_iter().chain(others).collect();
        let mut traffic = traffic(&graph, &agents);
        let mut ego = car_at(100.0, ego_y, 10.0);
        drive(&mut traffic, &agents, 60, Some(&mut ego));
        place(&traffic, 0).lane
    };
    assert_eq!(run(0.0, vec![]), 0, "1.5 m before the ego");
    assert_eq!(run(7.0, vec![]), 2, "to the other side too");
    assert_eq!(run(3.5, vec![]), 1, "the ego is on its own lane");
    let wall = (0..30)
        .map(|number| {
            agent(
                &format!("{number}"),
                "0",
                60.0 + 7.0 * f64::from(number),
                10.0,
            )
        })
        .collect();
    assert_eq!(run(0.0, wall), 1, "agents are in the way");
}

#[test]
fn a_swerve_is_as_wide_as_there_is_room() {
    let graph = straight(2000.0, 2, 15.0);
    let swerver = |amplitude_m: f64| TrafficAgent {
        behaviors: does(Maneuver::Swerve {
            amplitude_m,
            duration_s: 3.0,
        }),
        ..agent("swerver", "0", 100.0, 12.0)
    };
    let widest = |agents: &[TrafficAgent]| {
        let mut traffic = traffic(&graph, agents);
        let mut widest_m = 0.0_f64;
        for _ in 0..100 {
            drive(&mut traffic, agents, 1, None);
            widest_m = widest_m.max(state(&traffic, 0).position_m.y.abs());
        }
        assert!(state(&traffic, 0).position_m.y.abs() < 1e-9, "it is back");
        widest_m
    };
    // A parked car beside the lane, where the swerve would be widest.
    let parked = Obstacle {
        kind: ObstacleKind::ParkedCar,
        center_m: DVec2::new(122.0, -3.2),
        yaw_rad: 0.0,
        length_m: 4.5,
        width_m: 1.8,
    };
    let agents = [swerver(-1.6)];
    let mut beside_parked = traffic(&graph, &agents).among(Arc::new(Obstacles::new(vec![parked])));
    let mut nearest_m = f64::INFINITY;
    for _ in 0..100 {
        drive(&mut beside_parked, &agents, 1, None);
        let outline = OrientedBox::for_vehicle(&state(&beside_parked, 0), &agents[0].size);
        nearest_m = nearest_m.min(outline.distance_m(&outline_of(&parked)));
    }
    assert!((0.01..1.0).contains(&nearest_m), "{nearest_m} m");
    let free_m = widest(&[swerver(1.6)]);
    assert!((free_m - 1.6).abs() < 0.05, "{free_m} m");
    let beside = agent("beside", "1", 100.0, 12.0);
    let hemmed_m = widest(&[swerver(1.6), beside.clone()]);
    assert!(hemmed_m < 1.25, "{hemmed_m} m");
    let away_m = widest(&[swerver(-1.6), beside]);
    assert!(
        (away_m - 1.6).abs() < 0.05,
        "nobody is to the right: {away_m} m"
    );
}

#[test]
fn the_same_seed_drives_the_same_bits_on_any_number_of_threads() {
    let run = |seed: u64| {
        let (mut traffic, _) = random_traffic(&street(), 40, seed);
        let mut ego = car_at(-60.0, -1.65, 11.0);
        for _ in 0..200 {
            ego.position_m += ego.velocity() * 0.1;
            traffic.step(0.1, Some((&ego, &VehicleSize::CAR)));
        }
        let bits = |state: &Option<VehicleState>| {
            state.map(|state| {
                [state.position_m.x, state.position_m.y, state.yaw_rad].map(f64::to_bits)
            })
        };
        traffic.states().iter().map(bits).collect::<Vec<_>>()
    };
    let on = |threads: usize| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap()
            .install(|| run(5))
    };
    assert_eq!(on(1), on(2));
    assert_eq!(run(5), on(1));
    assert_ne!(run(5), run(6));
}

#[test]
fn agents_that_cannot_be_there_are_refused_by_name() {
    let graph = straight(100.0, 1, 15.0);
    let refused = |agents: &[TrafficAgent]| Traffic::new(graph.clone(), agents, 1).unwrap_err();
    assert!(
        refused(&[agent("a", "9", 1.0, 1.0)])
            .to_string()
            .contains("agent a: lane 9")
    );
    assert!(
        refused(&[agent("a", "0", 100.5, 1.0)])
            .to_string()
            .contains("0 to 100.00")
    );
    assert!(
        refused(&[agent("a", "0", f64::NAN, 1.0)])
            .to_string()
            .contains("NaN m along lane 0")
    );
    assert!(
        refused(&[agent("a", "0", 9.0, -1.0)])
            .to_string()
            .contains("a speed of -1")
    );
    let giant = VehicleSize {
        length_m: 300.0,
        ..VehicleSize::CAR
    };
    assert!(
        refused(&[TrafficAgent {
            size: giant,
            ..agent("a", "0", 9.0, 1.0)
        }])
        .to_string()
        .contains("a length of 300")
    );
    let error = refused(&[
        agent("a", "0", 9.0, 1.0),
        agent("b", "0", 60.0, 1.0),
        agent("c", "0", 13.0, 1.0),
    ]);
    assert_eq!(
        error,
        TrafficError::Overlap {
            first: "a".into(),
            second: "c".into()
        }
    );
    // Who is too fast for the gap starts slower.
    let agents = [agent("a", "0", 20.0, 20.0), agent("b", "0", 28.0, 0.0)];
    let traffic = traffic(&graph, &agents);
    assert!(state(&traffic, 0).speed_mps < 8.0 && state(&traffic, 0).speed_mps > 1.0);
}
