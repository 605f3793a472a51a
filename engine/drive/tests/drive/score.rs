//! Scores of episodes that are made by hand, and what holds for all.

use std::f64::consts::FRAC_PI_2;

use decouplegs_drive::PlanarTransform;
use decouplegs_drive::score::{
    Comfort, EpisodeScore, InfractionKind, Moments, Summary, plan_ade_m,
};
use decouplegs_scene::episode::StopLineRecord;
use decouplegs_scene::{
    Episode, EpisodeEnd, Level, LightColor, LightPhase, Plan, PlanPoint, Pose, TimedPose,
    TrafficLight, Trajectory, VehicleState,
};
use glam::DVec2;
use proptest::prelude::*;

use crate::episodes::{Motion, SIZE, episode, state, straight};

#[test]
fn a_drive_without_incident_scores_all() {
    let score = EpisodeScore::new(&episode(
        20,
        &straight(0.0, 0.0, 0.0, 10.0),
        &[straight(30.0, 3.5, 0.0, 8.0)],
        EpisodeEnd::RouteDone,
    ));
    assert_eq!(
        (score.route_completion, score.driving_score, score.success),
        (1.0, 1.0, true)
    );
    assert_eq!(
        (
            score.min_ttc_s(),
            score.ttc_short_share,
            score.infractions.len()
        ),
        (None, 0.0, 0)
    );
    assert!(score.plan_ade_m.unwrap() < 1e-9, "it drove as planned");
    assert_eq!(score.comfort, Comfort::default());
}

#[test]
fn completion_is_the_farthest_place_along_the_route() {
    let driven = |ego: &Motion, end: EpisodeEnd| {
        EpisodeScore::new(&episode(10, ego, &[], end)).route_completion
    };
    assert!((driven(&straight(0.0, 1.0, 0.0, 7.0), EpisodeEnd::Time) - 0.35).abs() < 1e-9);
    // To 30 m and back.
    let back: Motion =
        Box::new(|time_s: f64| state(30.0 - 12.0 * (time_s - 2.5).abs(), 0.0, 0.0, 12.0));
    assert!((driven(&back, EpisodeEnd::Time) - 0.30).abs() < 1e-9);
    // Off the route by more than two lanes counts only up to there.
    let off: Motion = Box::new(|time_s: f64| {
        state(
            10.0 * time_s,
            if time_s > 2.05 { 9.0 } else { 0.0 },
            0.0,
            10.0,
        )
    });
    assert!((driven(&off, EpisodeEnd::Time) - 0.20).abs() < 1e-9);
    // At the end but not done, and done.
    let end = driven(&straight(0.0, 0.0, 0.0, 25.0), EpisodeEnd::Time);
    assert!(end < 1.0 && end > 1.0 - 1e-9);
    assert_eq!(
        driven(&straight(0.0, 0.0, 0.0, 1.0), EpisodeEnd::RouteDone),
        1.0
    );
    // A route that passes itself: standing at the crossing is not having been around.
    let mut around = episode(4, &straight(0.0, 0.0, 0.0, 10.0), &[], EpisodeEnd::Time);
    let corners = [
        [0.0, 0.0],
        [80.0, 0.0],
        [80.0, 60.0],
        [18.0, 60.0],
        [18.0, -60.0],
    ];
    around.head.route_m = corners.map(DVec2::from_array).to_vec();
    assert!((EpisodeScore::new(&around).route_completion - 20.0 / 322.0).abs() < 1e-9);
}

#[test]
fn an_excursion_counts_once_until_the_ego_has_been_back_for_a_second() {
    let off = |spans: &[(f64, f64)], end: EpisodeEnd| {
        let mut made = episode(20, &straight(0.0, 0.0, 0.0, 9.0), &[], end);
        for instant in made.steps.iter_mut().flat_map(|step| &mut step.instants) {
            instant.on_road = !spans
                .iter()
                .any(|&(from_s, to_s)| (from_s - 0.01..to_s - 0.01).contains(&instant.time_s));
        }
        EpisodeScore::new(&made)
    };
    let one = off(&[(1.0, 1.5), (1.8, 1.9), (2.5, 3.0)], EpisodeEnd::RouteDone);
    assert_eq!(
        (one.layout_infractions(), one.collisions(), one.success),
        (1, 0, false)
    );
    assert!(
        (one.driving_score - 0.65).abs() < 1e-12 && (one.infractions[0].time_s - 1.0).abs() < 1e-9
    );
    let two = off(&[(1.0, 1.5), (2.6, 2.7)], EpisodeEnd::Time);
    assert_eq!(two.layout_infractions(), 2);
    assert!((two.driving_score - 0.9 * 0.65 * 0.65).abs() < 1e-9);
}

#[test]
fn the_closest_call_has_its_moment_and_its_agent() {
    // Towards one that stands, 45.5 m from bumper to bumper, at 10 m/s for 3 s; then the ego
    // stands, 15.5 m from it.
    let ego: Motion = Box::new(|time_s: f64| {
        state(
            10.0 * time_s.min(3.0),
            0.0,
            0.0,
            if time_s <= 3.0 + 1e-9 { 10.0 } else { 0.0 },
        )
    });
    let agents = || [straight(60.0, 9.0, 0.0, 0.0), straight(50.0, 0.0, 0.0, 0.0)];
    let score = EpisodeScore::new(&episode(10, &ego, &agents(), EpisodeEnd::Time));
    let closest = score.closest.unwrap();
    assert!(
        (closest.ttc_s - 1.55).abs() < 1e-9
            && (closest.time_s - 3.0).abs() < 1e-9
            && closest.agent == 1
    );
    assert_eq!(score.ttc_short_share, 0.0);
    // One meter more of the way: two of the 51 moments are below 1.5 s.
    let farther: Motion = Box::new(|time_s: f64| {
        state(
            10.0 * time_s.min(3.2),
            0.0,
            0.0,
            if time_s <= 3.2 + 1e-9 { 10.0 } else { 0.0 },
        )
    });
    let score = EpisodeScore::new(&episode(10, &farther, &agents(), EpisodeEnd::Time));
    assert!(
        (score.ttc_short_share - 2.0 / 51.0).abs() < 1e-12,
        "{}",
        score.ttc_short_share
    );
}

#[test]
fn comfort_and_displacement_are_measured() {
    let turning: Motion = Box::new(|time_s: f64| {
        let angle_rad = 0.2 * time_s;
        let position = DVec2::new(0.0, 40.0) + DVec2::from_angle(angle_rad - FRAC_PI_2) * 40.0;
        VehicleState {
            position_m: position,
            yaw_rad: angle_rad,
            speed_mps: 8.0,
            acceleration_mps2: -3.0 * time_s / 5.0,
        }
    });
    let score = EpisodeScore::new(&episode(10, &turning, &[], EpisodeEnd::Time));
    assert!((score.comfort.lateral_acceleration_max_mps2 - 1.6).abs() < 1e-9);
    assert!((score.comfort.braking_max_mps2 - 3.0).abs() < 1e-9);
    // Every point of every plan is 2 m to the left of what was driven.
    let mut beside = episode(10, &straight(0.0, 0.0, 0.0, 10.0), &[], EpisodeEnd::Time);
    for step in &mut beside.steps {
        let moved = |point: &PlanPoint| PlanPoint {
            position_m: point.position_m + DVec2::Y * 2.0,
            ..*point
        };
        step.plan = Plan::new(step.plan.points().iter().map(moved).collect()).unwrap();
    }
    assert!((EpisodeScore::new(&beside).plan_ade_m.unwrap() - 2.0).abs() < 1e-9);
    // Against a reference: 1 and 3 m off at the two points within it.
    let pose = |time_s: f64, y: f64| TimedPose {
        time_s,
        pose: Pose::from_yaw(FRAC_PI_2, DVec2::new(5.0, y).extend(7.0)),
    };
    let reference = Trajectory::new(vec![pose(2.0, 0.0), pose(4.0, 10.0)]).unwrap();
    let point = |time_s: f64, x: f64| PlanPoint {
        time_s,
        position_m: DVec2::new(x, 0.0),
    };
    let plan = Plan::new(vec![point(1.0, 4.0), point(2.0, 13.0), point(2.5, 90.0)]).unwrap();
    assert!((plan_ade_m(&plan, &pose(2.0, 0.0).pose, 2.0, &reference).unwrap() - 2.0).abs() < 1e-9);
    assert_eq!(plan_ade_m(&plan, &Pose::IDENTITY, 3.5, &reference), None);
}

#[test]
fn summaries_have_the_layout_of_the_table_and_hold_what_must_be_true() {
    let ego = || straight(0.0, 0.0, 0.0, 9.0);
    let score = |end: EpisodeEnd, level: Option<Level>| {
        let mut made = episode(10, &ego(), &[straight(74.5, 0.0, 0.0, 0.0)], end);
        made.head.scenario.level = level;
        EpisodeScore::new(&made)
    };
    let (done, late, other) = (
        score(EpisodeEnd::RouteDone, Some(Level::Hard)),
        score(EpisodeEnd::Time, Some(Level::Hard)),
        score(EpisodeEnd::Time, None),
    );
    let summary = Summary::from_scores(&[done, other, late]);
    assert_eq!(
        summary.levels.keys().copied().collect::<Vec<_>>(),
        [None, Some(Level::Hard)]
    );
    let hard = summary.levels[&Some(Level::Hard)];
    assert_eq!(
        (
            hard.count(),
            hard.success.mean,
            hard.min_ttc_s.unwrap().count
        ),
        (2, 0.5, 2)
    );
    assert!((hard.route_completion.mean - 0.725).abs() < 1e-9);
    assert!((hard.route_completion.std.unwrap() - 0.275 * 2.0_f64.sqrt()).abs() < 1e-9);
    assert!((hard.min_ttc_s.unwrap().mean - 25.0 / 9.0).abs() < 1e-9);
    assert_eq!(
        (
            summary.all.unwrap().count(),
            summary.levels[&None].route_completion.std
        ),
        (3, None)
    );
    summary.check().unwrap();
    // The paper's Table 3 would not pass: more success than completion. Neither would a score above
    // it, or no number.
    let broken: [fn(&mut Summary); 3] = [
        |summary| {
            summary
                .levels
                .get_mut(&Some(Level::Hard))
                .unwrap()
                .success
                .mean = 0.8;
        },
        |summary| summary.all.as_mut().unwrap().driving_score.mean = 0.99,
        |summary| summary.all.as_mut().unwrap().driving_score.mean = f64::NAN,
    ];
    for (breaks, names) in broken.into_iter().zip([
        "hard: a success rate of 0.8",
        "all levels: a mean driving score",
        "NaN",
    ]) {
        let mut summary = summary.clone();
        breaks(&mut summary);
        assert!(summary.check().unwrap_err().reason().contains(names));
    }
    assert_eq!(
        (
            Summary::from_scores(&[]).all,
            Summary::from_scores(&[]).check()
        ),
        (None, Ok(()))
    );
    let moments = Moments::from_values(&[1.0, 2.0, 4.0]).unwrap();
    assert!(
        (moments.mean - 7.0 / 3.0).abs() < 1e-12
            && (moments.std.unwrap() - (7.0_f64 / 3.0).sqrt()).abs() < 1e-12
    );
}

#[test]
fn records_that_are_nonsense_score_without_a_panic() {
    let mut made = episode(
        4,
        &straight(0.0, 0.0, 0.0, 9.0),
        &[straight(20.0, 0.0, 0.0, 0.0)],
        EpisodeEnd::Collision { agent: 7 },
    );
    made.steps[1].instants[2].ego = state(f64::NAN, f64::INFINITY, f64::NAN, -1.0);
    made.steps[2].instants[0].agents.clear();
    made.steps[3].instants[0].time_s = f64::NAN;
    made.steps[0].instants.clear();
    for route_m in [
        vec![],
        vec![DVec2::ZERO; 5],
        vec![DVec2::NAN, DVec2::X],
        vec![DVec2::splat(-1e200), DVec2::splat(1e200)],
    ] {
        made.head.route_m = route_m;
        let score = EpisodeScore::new(&made);
        assert!(
            (0.0..=1.0).contains(&score.route_completion)
                && score.driving_score <= score.route_completion
        );
    }
}

fn any_motion() -> impl Strategy<Value = (f64, f64, f64, f64, f64)> {
    (
        -20.0f64..60.0,
        -6.0f64..6.0,
        -3.1f64..3.1,
        0.0f64..12.0,
        -0.3f64..0.3,
    )
}

/// Motion on a circle, or nearly straight.
fn motion<'a>((x, y, yaw_rad, speed_mps, rate_radps): (f64, f64, f64, f64, f64)) -> Motion<'a> {
    Box::new(move |time_s| {
        let turned = rate_radps * time_s;
        let chord_m = if turned.abs() < 1e-9 {
            speed_mps * time_s
        } else {
            speed_mps * time_s * (0.5 * turned).sin() / (0.5 * turned)
        };
        let position = DVec2::new(x, y) + DVec2::from_angle(yaw_rad + 0.5 * turned) * chord_m;
        VehicleState {
            position_m: position,
            yaw_rad: yaw_rad + turned,
            speed_mps,
            acceleration_mps2: 0.0,
        }
    })
}

fn any_episode() -> impl Strategy<Value = Episode> {
    let ends = prop::sample::select(vec![
        EpisodeEnd::RouteDone,
        EpisodeEnd::Story,
        EpisodeEnd::Time,
        EpisodeEnd::Collision { agent: 0 },
    ]);
    let ego = (-1.0f64..1.0, -0.2f64..0.2, 0.0f64..12.0, -0.05f64..0.05);
    let off = (0.0f64..8.0, 0.0f64..1.0);
    (ego, prop::collection::vec(any_motion(), 1..5), off, ends).prop_map(
        |((y, yaw_rad, speed_mps, rate), agents, off, end)| {
            let agents: Vec<Motion> = agents.into_iter().map(motion).collect();
            let mut made = episode(
                12,
                &motion((0.0, y, yaw_rad, speed_mps, rate)),
                &agents,
                end,
            );
            for instant in made.steps.iter_mut().flat_map(|step| &mut step.instants) {
                instant.on_road = !(off.0..off.0 + off.1).contains(&instant.time_s);
            }
            made
        },
    )
}

fn moved(episode: &Episode, motion: &PlanarTransform) -> Episode {
    let mut there = episode.clone();
    there
        .head
        .route_m
        .iter_mut()
        .for_each(|point| *point = motion.apply(*point));
    let instants = there
        .steps
        .iter_mut()
        .flat_map(|step| &mut step.instants)
        .chain([&mut there.start]);
    for state in instants.flat_map(|instant| {
        instant
            .agents
            .iter_mut()
            .flatten()
            .chain([&mut instant.ego])
    }) {
        state.position_m = motion.apply(state.position_m);
        state.yaw_rad += motion.yaw_rad;
    }
    there
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    #[test]
    fn scores_are_in_their_bounds(episodes in prop::collection::vec(any_episode(), 1..6)) {
        let scores: Vec<EpisodeScore> = episodes.iter().map(EpisodeScore::new).collect();
        for (score, episode) in scores.iter().zip(&episodes) {
            prop_assert!(0.0 <= score.driving_score && score.driving_score <= score.counted_completion);
            let others_fault = score.infractions.iter().any(|found| !found.at_fault());
            match episode.end {
                EpisodeEnd::Story => prop_assert!((0.0..=1.0).contains(&score.counted_completion)),
                _ if score.ended_by_other => prop_assert_eq!(score.counted_completion, 1.0),
                _ => prop_assert_eq!(score.counted_completion, score.route_completion),
            }
            prop_assert!(!score.ended_by_other || others_fault && !score.success);
            prop_assert_eq!(score.route_completion == 1.0, episode.end == EpisodeEnd::RouteDone);
            prop_assert!(score.route_completion <= 1.0 && (!score.success || score.driving_score == 1.0));
            prop_assert_eq!(score.collisions() > 0, score.min_ttc_s() == Some(0.0) || matches!(episode.end, EpisodeEnd::Collision { .. }));
            prop_assert_eq!(&EpisodeScore::new(episode), score, "scoring again");
        }
        prop_assert_eq!(Summary::from_scores(&scores).check(), Ok(()));
    }

    #[test]
    fn the_frame_of_the_world_does_not_matter(
        episode in any_episode(), yaw_rad in -3.1f64..3.1, x in -6e5f64..6e5, y in -6e6f64..6e6,
    ) {
        let motion = PlanarTransform { pivot_m: DVec2::ZERO, yaw_rad, shift_m: DVec2::new(x, y) };
        let (here, there) = (EpisodeScore::new(&episode), EpisodeScore::new(&moved(&episode, &motion)));
        prop_assert_eq!(&here.infractions, &there.infractions);
        prop_assert_eq!(here.success, there.success);
        prop_assert!((here.driving_score - there.driving_score).abs() < 1e-7);
        prop_assert!((here.route_completion - there.route_completion).abs() < 1e-7);
        prop_assert!((here.plan_ade_m.unwrap() - there.plan_ade_m.unwrap()).abs() < 1e-6);
        // A call that grazes may be one in one frame only, as may one at the horizon.
        match (here.min_ttc_s(), there.min_ttc_s()) {
            (Some(here_s), Some(there_s)) => prop_assert!((here_s - there_s).abs() < 1e-4),
            (here_s, there_s) => prop_assert_eq!(here_s, there_s),
        }
    }

    #[test]
    fn agents_far_away_do_not_matter(episode in any_episode(), x in 2000.0f64..1e5, y in -1e5f64..1e5, speed_mps in 0.0f64..30.0) {
        let mut with = episode.clone();
        with.head.agent_sizes.push(SIZE);
        for instant in with.steps.iter_mut().flat_map(|step| &mut step.instants).chain([&mut with.start]) {
            instant.agents.push(Some(state(x, y, 1.0, speed_mps)));
        }
        prop_assert_eq!(EpisodeScore::new(&episode), EpisodeScore::new(&with));
    }
}

#[test]
fn a_red_light_costs_and_yellow_does_not() {
    // The front, 2.25 m before the middle, passes the line at x = 50 m after 4.775 s.
    let run = |phases: &[(LightColor, f64)], ends_m: [[f64; 2]; 2]| {
        let ego = straight(0.0, 0.0, 0.0, 10.0);
        let mut made = episode(20, &ego, &[], EpisodeEnd::RouteDone);
        made.head.scenario.lights = vec![TrafficLight {
            name: "a".into(),
            phases: phases
                .iter()
                .map(|&(color, duration_s)| LightPhase { color, duration_s })
                .collect(),
            ..TrafficLight::default()
        }];
        let ends_m = ends_m.map(DVec2::from_array);
        // A line on the lane beside has the same light.
        let beside = ends_m.map(|end_m| end_m + DVec2::Y * 0.5);
        made.head.stop_lines = [ends_m, beside]
            .map(|ends_m| StopLineRecord { index: 0, ends_m })
            .into();
        EpisodeScore::new(&made)
    };
    let (green, yellow, red) = (LightColor::Green, LightColor::Yellow, LightColor::Red);
    let across = [[50.0, -2.0], [50.0, 2.0]];
    let score = run(&[(red, 30.0)], across);
    assert_eq!((score.red_lights(), score.success), (1, false));
    assert!((score.driving_score - 0.7).abs() < 1e-12);
    assert_eq!(
        score.infractions[0].kind,
        InfractionKind::RedLight { light: 0 }
    );
    assert!((score.infractions[0].time_s - 4.775).abs() < 1e-9);
    for phases in [[(green, 30.0), (red, 1.0)], [(yellow, 30.0), (red, 1.0)]] {
        let score = run(&phases, across);
        assert!(score.success && score.driving_score == 1.0);
    }
    // To the tenth of a tick: red from 4.77 s or from 4.78 s on.
    assert_eq!(run(&[(green, 4.77), (red, 30.0)], across).red_lights(), 1);
    assert_eq!(run(&[(green, 4.78), (red, 30.0)], across).red_lights(), 0);
    // Lines of the opposite direction, and beside the way.
    for ends_m in [[[50.0, 2.0], [50.0, -2.0]], [[50.0, 3.0], [50.0, 7.0]]] {
        assert_eq!(run(&[(red, 30.0)], ends_m).red_lights(), 0);
    }
}
