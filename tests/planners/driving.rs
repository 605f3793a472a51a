//! Planners of the engine, with the ego that follows their plans.

use decouplegs::planner::{
    ConstantVelocity, LaneFollow, ObservationRequest, Planner, PlannerChoice, Replay,
};
use decouplegs::scene::episode::{
    EpisodeHead, EpisodeTick, LOG_VERSION, PlannerRecord, RoadRecord,
};
use decouplegs::scene::scenario::{EgoTask, Place};
use decouplegs::scene::{Egos, Episode, EpisodeEnd, EpisodeStep, Plan, Scenario, Weather};
use decouplegs::scene::{Pose, TimedPose, Trajectory, VehicleSize, VehicleState};
use glam::DVec2;

use super::road_course::{Course, Moment, bend, last, nearest_m, state, straight};
use super::scene_ahead::{PATIENT, briefing, observation, privileged};

type Agents = Vec<(VehicleState, VehicleSize)>;

fn nobody(_: f64) -> Agents {
    vec![]
}

fn car(x: f64, y: f64, yaw_rad: f64, speed_mps: f64) -> (VehicleState, VehicleSize) {
    (
        state(DVec2::new(x, y), yaw_rad, speed_mps),
        VehicleSize::CAR,
    )
}

fn follow(course: &Course, agents: impl Fn(f64) -> Agents) -> Vec<Moment> {
    course.drive(&mut LaneFollow::default(), agents)
}

#[test]
fn constant_velocity_keeps_on_and_asks_for_nothing() {
    assert_eq!(ConstantVelocity.sees(), ObservationRequest::default());
    let plan = ConstantVelocity.plan(&observation(3, &[], None)).unwrap();
    assert_eq!((plan.points().len(), plan.points()[15].time_s), (16, 4.0));
    assert!(
        [0.1, 1.0, 3.3]
            .iter()
            .all(|&time_s| plan.at(time_s).distance(DVec2::new(7.3 * time_s, 0.0)) < 1e-12)
    );
    let moments = Course::new(bend(20.0), 8.0, 12.0, 12.0).drive(&mut ConstantVelocity, nobody);
    assert!(
        (last(&moments).ego.position_m.x - 96.0).abs() < 0.1 && last(&moments).off_m > 10.0,
        "straight on in a bend"
    );
}

#[test]
fn planners_that_must_know_say_so_when_they_are_not_told() {
    let standing = Replay::along(Trajectory::standing(Pose::IDENTITY));
    let planners: [Box<dyn Planner>; 2] = [Box::new(LaneFollow::default()), Box::new(standing)];
    for mut planner in planners {
        assert!(planner.sees().privileged);
        planner.begin(&briefing()).unwrap();
        let refused = planner
            .plan(&observation(0, &[], None))
            .unwrap_err()
            .to_string();
        assert!(refused.contains("expected privileged state"), "{refused}");
    }
    let mut known = privileged();
    known.route_m.truncate(1);
    let refused = LaneFollow::default()
        .plan(&observation(0, &[], Some(&known)))
        .unwrap_err()
        .to_string();
    assert!(
        refused.contains("a route of at least two positions"),
        "{refused}"
    );
}

#[test]
fn a_replay_drives_where_and_when_the_record_did() {
    let recorded = follow(&Course::new(bend(15.0), 6.0, 10.0, 15.0), nobody);
    let pose = |(at, moment): (usize, &Moment)| TimedPose {
        time_s: 0.1 * (at + 1) as f64,
        pose: Pose::from_yaw(moment.ego.yaw_rad, moment.ego.position_m.extend(0.0)),
    };
    let path = Trajectory::new(recorded.iter().enumerate().map(pose).collect()).unwrap();
    let mut replay = Replay::along(path);
    let driven = Course::new(bend(15.0), 6.0, 10.0, 15.0).drive(&mut replay, nobody);
    let apart = recorded
        .iter()
        .zip(&driven)
        .map(|(a, b)| a.ego.position_m.distance(b.ego.position_m));
    let farthest_m = apart.fold(0.0, f64::max);
    assert!(farthest_m < 0.5, "{farthest_m} m apart");
    // Past the record's end it stands, and is led back when it is elsewhere.
    let known = privileged();
    let plan = replay.plan(&observation(60, &[], Some(&known))).unwrap();
    assert!(
        known
            .ego
            .to_world(plan.at(4.0))
            .distance(last(&recorded).ego.position_m)
            < 1e-9
    );
}

/// A record of one step: there along x with 5 m/s, seen every half second.
fn recorded() -> Episode {
    let instant = |half: u32| EpisodeTick {
        time_s: 0.5 * f64::from(half),
        ego: state(DVec2::new(2.5 * f64::from(half), 1.0), 0.0, 5.0),
        steer_rad: 0.0,
        on_road: true,
        lanes: None,
        road: Some(RoadRecord::default()),
        agents: vec![],
    };
    let place = Place::Street {
        weather: Weather::Clear,
        background: 1000,
        agent_splats: 100,
        seed: 1,
    };
    let ego = EgoTask {
        route: vec!["a".into()],
        start_m: 0.0,
        end_m: 50.0,
        speed_mps: 5.0,
        cruise_mps: 5.0,
        size: VehicleSize::CAR,
        follows_recording: false,
        start_pose: None,
    };
    let scenario = Scenario {
        name: "seen".into(),
        level: None,
        seed: 1,
        drivers: Default::default(),
        duration_s: 1.0,
        step_s: 1.0,
        place,
        ego,
        egos: Egos::default(),
        agents: vec![],
        lights: vec![],
        pedestrians: vec![],
        signs: vec![],
        story: Default::default(),
    };
    let head = EpisodeHead {
        log_version: LOG_VERSION,
        version: "0".into(),
        scenario,
        planner: PlannerRecord::default(),
        drawn_by: None,
        route_m: straight(50.0),
        agent_sizes: vec![],
        stop_lines: vec![],
        sign_lines: vec![],
        agent_driver: None,
    };
    let step = EpisodeStep {
        step: 0,
        readings: vec![],
        plan: Plan::standing(),
        warm_up: false,
        instants: vec![instant(1), instant(2)],
        handovers: vec![],
        commands: Vec::new(),
        lights: vec![],
    };
    Episode {
        head,
        start: instant(0),
        steps: vec![step],
        end: EpisodeEnd::Time,
        others: vec![],
    }
}

#[test]
fn an_episode_is_replayed_from_its_record() {
    let mut episode = recorded();
    let mut replay = Replay::of_episode(&episode).unwrap();
    let known = privileged();
    let plan = replay.plan(&observation(1, &[], Some(&known))).unwrap();
    for (time_s, x) in [(0.25, 3.75), (0.5, 5.0), (4.0, 5.0)] {
        assert!(
            known
                .ego
                .to_world(plan.at(time_s))
                .distance(DVec2::new(x, 1.0))
                < 1e-9,
            "{time_s} s"
        );
    }
    episode.steps[0].instants[1].time_s = 0.5;
    let refused = Replay::of_episode(&episode).unwrap_err().to_string();
    assert!(
        refused.contains("episode seen") && refused.contains("does not follow"),
        "{refused}"
    );
    let open = |text: &str| text.parse::<PlannerChoice>().unwrap().open(PATIENT);
    assert_eq!(open("lane-follow").unwrap().name(), "lane-follow");
    assert_eq!(
        open("constant-velocity").unwrap().name(),
        "constant-velocity"
    );
    assert!(
        open("replay:no-such.log")
            .map(|_| ())
            .unwrap_err()
            .to_string()
            .contains("no-such.log")
    );
}

#[test]
fn on_a_free_road_it_drives_its_lane_at_its_speed() {
    let moments = follow(&Course::new(straight(300.0), 4.0, 12.0, 20.0), nobody);
    assert!(
        (last(&moments).ego.speed_mps - 12.0).abs() < 0.3,
        "{}",
        last(&moments).ego.speed_mps
    );
    assert!(
        moments
            .iter()
            .all(|moment| moment.off_m < 0.02 && moment.ego.speed_mps < 12.2)
    );
}

#[test]
fn bends_are_taken_slowly_enough_and_in_the_lane() {
    for radius_m in [9.0, 20.0, 50.0] {
        let moments = follow(&Course::new(bend(radius_m), 12.0, 12.0, 30.0), nobody);
        let lateral_mps2 = moments
            .iter()
            .map(|moment| moment.lateral_mps2)
            .fold(0.0, f64::max);
        // Behind the route's end it goes straight on.
        let on_route = moments
            .iter()
            .filter(|moment| moment.arc_m < 60.0 + 1.57 * radius_m + 99.0);
        let off_m = on_route.map(|moment| moment.off_m).fold(0.0, f64::max);
        println!(
            "radius {radius_m} m: {lateral_mps2:.2} m/s^2 sideways, {off_m:.2} m off, at {:.0} m",
            last(&moments).arc_m
        );
        assert!(
            lateral_mps2 < 2.4 && off_m < 0.3,
            "{radius_m}: {lateral_mps2} {off_m}"
        );
        assert!(last(&moments).arc_m > 150.0, "it gets through");
    }
}

#[test]
fn it_stops_behind_who_stands_and_starts_with_who_starts() {
    let moments = follow(&Course::new(straight(400.0), 12.0, 12.0, 20.0), |_| {
        vec![car(120.0, 0.0, 0.0, 0.0)]
    });
    let gap_m = last(&moments).gap_m;
    assert!(
        last(&moments).ego.speed_mps < 0.2 && nearest_m(&moments) > 1.0 && gap_m < 4.0,
        "{gap_m}"
    );
    let starting = |time_s: f64| {
        let gone_s = (time_s - 15.0).max(0.0);
        vec![car(120.0 + gone_s * gone_s, 0.0, 0.0, 2.0 * gone_s)]
    };
    let moments = follow(&Course::new(straight(400.0), 12.0, 12.0, 25.0), starting);
    assert!(
        last(&moments).arc_m > 150.0 && nearest_m(&moments) > 1.0,
        "{}",
        last(&moments).arc_m
    );
}

#[test]
fn hard_braking_ahead_is_survived() {
    // From 12 m/s with 8 m/s^2, at several gaps that a driver would keep.
    for gap_m in [15.0, 20.0, 30.0] {
        for brakes_s in [3.0, 3.2, 3.4] {
            let moments = follow(&Course::new(straight(400.0), 12.0, 12.0, 15.0), |time_s| {
                let braking_s: f64 = (time_s - brakes_s).clamp(0.0, 1.5);
                let x = 4.5 + gap_m + 12.0 * (time_s.min(brakes_s) + braking_s)
                    - 4.0 * braking_s * braking_s;
                let (mut leader, size) = car(x, 0.0, 0.0, 12.0 - 8.0 * braking_s);
                leader.acceleration_mps2 = if braking_s > 0.0 && braking_s < 1.5 {
                    -8.0
                } else {
                    0.0
                };
                vec![(leader, size)]
            });
            println!(
                "gap {gap_m} m, braking at {brakes_s} s: nearest {:.2} m",
                nearest_m(&moments)
            );
            assert!(
                nearest_m(&moments) > 1.5,
                "gap {gap_m}, at {brakes_s} s: {} m",
                nearest_m(&moments)
            );
        }
    }
}

#[test]
fn cut_ins_are_braked_for() {
    // Slower by 4 m/s, over to our lane in two seconds, from 3 m ahead of our bumper on.
    for ahead_m in [12.3, 15.0, 20.0] {
        let moments = follow(&Course::new(straight(400.0), 11.0, 11.0, 12.0), |time_s| {
            let share = ((time_s - 1.2) / 2.0).clamp(0.0, 1.0);
            let yaw_rad = if share > 0.0 && share < 1.0 {
                -(1.75_f64 / 7.0).atan()
            } else {
                0.0
            };
            vec![car(
                ahead_m + 7.0 * time_s,
                3.5 * (1.0 - share),
                yaw_rad,
                7.0,
            )]
        });
        println!(
            "cut in from {ahead_m} m ahead: nearest {:.2} m",
            nearest_m(&moments)
        );
        assert!(
            nearest_m(&moments) > 0.3,
            "{ahead_m} m ahead: {} m",
            nearest_m(&moments)
        );
        assert!(
            (last(&moments).ego.speed_mps - 7.0).abs() < 1.0,
            "it follows"
        );
    }
}

#[test]
fn who_crosses_is_let_through_and_then_it_goes_on() {
    let (mut met, mut slow, mut nearest) = (0, 0, f64::INFINITY);
    for case in 0..80 {
        // Through the same place from either side, early or late, slow or fast, square or aslant.
        let speed_mps = 4.0 + f64::from(case % 5) * 2.0;
        let side = if case % 2 == 0 { 1.0 } else { -1.0 };
        let yaw_rad = -side * (1.1 + 0.2 * f64::from(case % 4));
        let crosses_s = 4.5 + 0.15 * f64::from(case % 16);
        let moments = follow(&Course::new(straight(300.0), 10.0, 10.0, 20.0), |time_s| {
            let place = DVec2::new(60.0, 0.0)
                + DVec2::from_angle(yaw_rad) * speed_mps * (time_s - crosses_s);
            vec![(state(place, yaw_rad, speed_mps), VehicleSize::CAR)]
        });
        met += u32::from(nearest_m(&moments) == 0.0);
        nearest = nearest_m(&moments).min(nearest);
        slow += u32::from(last(&moments).arc_m < 120.0);
    }
    println!("80 crossings: {met} met, nearest {nearest:.2} m, {slow} still waiting");
    assert_eq!((met, slow), (0, 0));
}

#[test]
fn who_is_beside_oncoming_or_behind_is_no_reason_to_brake() {
    let beside = |time_s: f64| {
        vec![
            car(20.0 + 8.0 * time_s, 3.5, 0.0, 8.0),
            car(400.0 - 12.0 * time_s, 3.5, std::f64::consts::PI, 12.0),
            car(-8.0 + 10.0 * time_s, 0.0, 0.0, 10.0),
            car(50.0, -2.3, 0.0, 0.0),
        ]
    };
    let course = Course::new(straight(400.0), 10.0, 10.0, 20.0);
    let (free, among) = (follow(&course, nobody), follow(&course, beside));
    assert!(
        (last(&free).arc_m - last(&among).arc_m).abs() < 1e-9,
        "{} {}",
        last(&free).arc_m,
        last(&among).arc_m
    );
    // In a bend as well: who goes around it in the next lane is not expected to go straight on into
    // ours.
    let around = |time_s: f64| {
        let turned_rad = 8.0 * time_s / 33.5 - 0.2;
        let place = DVec2::new(60.0, 30.0)
            + DVec2::from_angle(turned_rad - std::f64::consts::FRAC_PI_2) * 33.5;
        vec![(state(place, turned_rad, 8.0), VehicleSize::CAR)]
    };
    let course = Course::new(bend(30.0), 8.0, 8.0, 12.0);
    let (free, among) = (follow(&course, nobody), follow(&course, around));
    let lost_m = last(&free).arc_m - last(&among).arc_m;
    assert!(
        lost_m < 1.0,
        "{lost_m} m lost to a car that was never in the way"
    );
}

#[test]
fn the_same_is_planned_twice_and_an_episode_is_forgotten_by_the_next() {
    let course = Course::new(bend(20.0), 8.0, 10.0, 10.0);
    let agents = |time_s: f64| {
        vec![
            car(50.0 + 3.0 * time_s, 0.0, 0.0, 3.0),
            car(40.0, 20.0 - 4.0 * time_s, -1.6, 4.0),
        ]
    };
    let mut planner = LaneFollow::default();
    let bits = |moments: Vec<Moment>| {
        moments
            .iter()
            .map(|m| m.ego.position_m.to_array().map(f64::to_bits))
            .collect::<Vec<_>>()
    };
    let first = bits(course.drive(&mut planner, agents));
    assert_eq!(first, bits(course.drive(&mut planner, agents)));
}
