//! Tracks that were moved from where they belong are brought back.

use decouplegs_drive::alignment::{TruthError, ade_to_lanes, against_truth};
use decouplegs_drive::register::Registered;
use decouplegs_drive::{
    LaneIndex, Outcome, Polyline, RegisterOptions, Registration, Treatment, register,
};
use decouplegs_scene::{LaneMap, Track};
use glam::DVec2;

use crate::lanes::{beside, curved, drive, logged, road, straight};

const ADE_MAX_M: f64 = 0.05;

pub fn registered(registration: &Registration, track: usize) -> &Registered {
    match &registration.tracks[track].outcome {
        Outcome::Registered(registered) => registered,
        Outcome::Refused { reason } => panic!("track {track} was refused: {reason}"),
    }
}

pub fn reason(registration: &Registration, track: usize) -> &str {
    match &registration.tracks[track].outcome {
        Outcome::Registered(registered) => panic!("registered by {:?}", registered.fit),
        Outcome::Refused { reason } => reason,
    }
}

fn error(registered: &Registered, truth: &Track) -> TruthError {
    let positions = registered
        .poses
        .iter()
        .map(|pose| (pose.time_s, pose.pose.translation.truncate()));
    against_truth(positions, truth).unwrap()
}

/// Options for tracks whose truth lies on the middles of their lanes.
const ON_MIDDLES: fn() -> RegisterOptions = || RegisterOptions {
    keeping_m: 0.0,
    ..RegisterOptions::default()
};

fn alone(map: &LaneMap, track: &Track) -> Registration {
    register(map, std::slice::from_ref(track), None, &ON_MIDDLES()).unwrap()
}

/// Straight, bend to the left, straight, bend to the right: what a whole motion shows in.
fn winding() -> Polyline {
    let within = |s: f64, from: f64, to: f64| f64::from(u8::from((from..to).contains(&s)));
    curved(220.0, move |s| {
        within(s, 50.0, 95.0) / 30.0 - within(s, 140.0, 185.0) / 40.0
    })
}

const DRIFTS: [(f64, [f64; 2]); 5] = [
    (0.0, [0.0, 0.0]),
    (2.0, [0.6, -0.8]),
    (-2.0, [-0.3, 0.9]),
    (1.0, [0.9, 0.4]),
    (-0.5, [0.0, -1.0]),
];

/// The worst errors over drifts and noise: before, across, along.
fn worst(map: &LaneMap, truth: &Track, lane_changes: usize) -> [f64; 3] {
    let mut worst = [0.0f64; 3];
    for (seed, (yaw_deg, shift)) in DRIFTS.into_iter().enumerate() {
        for noise_m in [0.0, 0.05, 0.1] {
            let log = logged(
                truth,
                f64::to_radians(yaw_deg),
                DVec2::from_array(shift),
                noise_m,
                seed as u64,
            );
            let registration = alone(map, &log);
            let found = registered(&registration, 0);
            assert_eq!(
                found.lane_changes.len(),
                lane_changes,
                "{yaw_deg} degrees, {shift:?}, noise {noise_m}: {:?}",
                found.lanes
            );
            let before = against_truth(
                log.points
                    .iter()
                    .map(|point| (point.time_s, point.position_m)),
                truth,
            )
            .unwrap();
            let after = error(found, truth);
            for (worst, value) in
                worst
                    .iter_mut()
                    .zip([before.ade_m, after.lateral_m, after.longitudinal_m])
            {
                *worst = worst.max(value);
            }
        }
    }
    worst
}

#[test]
fn on_a_winding_lane_the_whole_motion_is_recovered() {
    let middle = winding();
    let truth = drive("winding", 215.0, 9.0, |s| beside(&middle, s, 3.0));
    let [before, across, along] = worst(&road(&middle, 3, 4, false), &truth, 0);
    println!("winding: {before:.3} m before; {across:.3} across and {along:.3} along after");
    assert!(
        before > 1.0 && across < ADE_MAX_M && along < ADE_MAX_M,
        "{across} {along}"
    );
}

#[test]
fn on_a_straight_lane_the_motion_across_it_is_recovered_and_none_is_invented_along_it() {
    let middle = straight(150.0);
    let truth = drive("straight", 145.0, 12.0, |s| beside(&middle, s, 3.0));
    let [before, across, along] = worst(&road(&middle, 3, 3, false), &truth, 0);
    println!("straight: {before:.3} m before; {across:.3} across and {along:.3} along after");
    assert!(across < ADE_MAX_M, "{across}");
    // The drifts' own parts along the lane, 0.9 m at most, are neither seen nor made larger.
    assert!((0.85..0.95).contains(&along), "{along}");
}

#[test]
fn a_lane_change_is_no_drift() {
    let middle = winding();
    // From the right lane to the middle one within 35 m, about four seconds, between the bends.
    let left =
        |s: f64| 1.5 - 1.5 * (std::f64::consts::PI * ((s - 98.0) / 35.0).clamp(0.0, 1.0)).cos();
    let truth = drive("changing", 215.0, 9.0, |s| beside(&middle, s, left(s)));
    let map = road(&middle, 3, 4, false);
    let [before, across, along] = worst(&map, &truth, 1);
    println!("lane change: {before:.3} m before; {across:.3} across and {along:.3} along after");
    assert!(across < ADE_MAX_M && along < ADE_MAX_M, "{across} {along}");
    // Where links between neighbors are missing, the change is found all the same.
    let mut unlinked = map.clone();
    unlinked
        .lanes
        .iter_mut()
        .for_each(|lane| (lane.left_neighbor, lane.right_neighbor) = (None, None));
    let found = alone(&unlinked, &truth);
    assert_eq!(registered(&found, 0).lane_changes.len(), 1);
    // And it lasts about as long as it takes: 35 m at 9 m/s, but for what is near either lane.
    let change = registered(&found, 0).lane_changes[0];
    assert!(
        (2.0..4.5).contains(&(change.to_s - change.from_s)),
        "{change:?}"
    );
}

#[test]
fn outliers_and_jitter_do_not_move_a_track() {
    let middle = winding();
    let truth = drive("winding", 215.0, 9.0, |s| beside(&middle, s, 0.0));
    let mut log = logged(&truth, 0.02, DVec2::new(0.5, 0.5), 0.05, 9);
    for at in (5..log.points.len()).step_by(13) {
        log.points[at].position_m += DVec2::new(4.0, -6.0);
    }
    let registration = alone(&road(&middle, 3, 4, false), &log);
    let found = registered(&registration, 0);
    let after = error(found, &truth);
    assert!(after.ade_m < ADE_MAX_M, "{after:?}");
    let marked = found.poses.iter().filter(|pose| pose.flags.outlier).count();
    assert_eq!(marked, (5..log.points.len()).step_by(13).count());
}

#[test]
fn lanes_three_metres_apart_are_told_apart() {
    let middle = straight(120.0);
    let map = road(&middle, 3, 3, false);
    for lane in 0..3 {
        let truth = drive("car", 115.0, 10.0, |s| {
            beside(&middle, s, 3.0 * f64::from(lane))
        });
        for off in [-1.0, -0.5, 0.5, 1.0] {
            let log = logged(&truth, 0.0, DVec2::new(0.0, off), 0.1, 3);
            let registration = alone(&map, &log);
            let lanes = &registered(&registration, 0).lanes;
            assert!(
                lanes.iter().all(|&own| own / 3 == lane as usize),
                "lane {lane}, {off} m off: {lanes:?}"
            );
        }
    }
}

#[test]
fn a_figure_of_eight_is_followed_through_its_crossing() {
    let at = |t: f64| DVec2::new(60.0 * t.sin(), 30.0 * (2.0 * t).sin()).extend(0.0);
    let middle =
        Polyline::new((0..=600).map(|i| at(f64::from(i) / 600.0 * std::f64::consts::TAU))).unwrap();
    let map = road(&middle, 1, 6, false);
    let truth = drive("eight", middle.length_m() - 5.0, 10.0, |s| middle.at(s));
    for (yaw, shift) in [(0.02, [0.8, -0.6]), (-0.03, [-0.9, 0.3])] {
        let registration = alone(&map, &logged(&truth, yaw, DVec2::from_array(shift), 0.1, 5));
        let found = registered(&registration, 0);
        assert_eq!(found.lanes, [0, 1, 2, 3, 4, 5]);
        let after = error(found, &truth);
        assert!(after.ade_m < ADE_MAX_M, "{after:?}");
    }
}

#[test]
fn who_drives_against_lanes_or_beside_them_is_refused_with_the_reason() {
    let middle = winding();
    let map = road(&middle, 2, 2, false);
    let mut truth = drive("car", 200.0, 9.0, |s| beside(&middle, s, 0.0));
    let times: Vec<f64> = truth.points.iter().map(|point| point.time_s).collect();
    truth.points.reverse();
    truth
        .points
        .iter_mut()
        .zip(times)
        .for_each(|(point, time_s)| point.time_s = time_s);
    assert!(reason(&alone(&map, &truth), 0).contains("against its lanes"));
    // With a lane for that direction three meters away, it is three meters of drift: on a lane, but
    // farther than is believed.
    let mut far = truth.clone();
    far.points
        .iter_mut()
        .for_each(|point| point.position_m += DVec2::new(500.0, 0.0));
    assert!(reason(&alone(&map, &far), 0).contains("no lane"));
    let crossing = drive("crossing", 60.0, 8.0, |s| {
        glam::DVec3::new(20.0, s - 30.0, 0.0)
    });
    assert!(!reason(&alone(&map, &crossing), 0).is_empty());
    let mut walker = drive("walker", 100.0, 1.5, |s| beside(&middle, s, 0.0));
    walker.class = "pedestrian".into();
    assert!(reason(&alone(&map, &walker), 0).contains("pedestrian"));
    let mut broken = truth.clone();
    broken.points[3].position_m.x = f64::NAN;
    assert!(reason(&alone(&map, &broken), 0).contains("not finite"));
}

#[test]
fn short_tracks_take_the_motion_of_the_log_and_are_kept_without() {
    let middle = winding();
    let map = road(&middle, 3, 4, false);
    let drift = |truth: &Track| logged(truth, 0.0, DVec2::new(0.6, -0.5), 0.02, 2);
    let (long, parked) = (
        drive("long", 200.0, 9.0, |s| beside(&middle, s, 3.0)),
        drive("parked", 1.0, 0.1, |_| beside(&middle, 60.0, -3.0)),
    );
    let mut single = parked.clone();
    single.points.truncate(1);
    let logs = [drift(&long), drift(&parked), drift(&single)];
    let all = register(&map, &logs, None, &ON_MIDDLES()).unwrap();
    for (at, truth) in [&long, &parked, &single].into_iter().enumerate() {
        let found = registered(&all, at);
        assert_eq!(
            found.treatment,
            if at > 0 {
                Treatment::LogParked
            } else {
                Treatment::Own
            }
        );
        assert!(
            error(found, truth).ade_m < ADE_MAX_M,
            "{at}: {:?}",
            error(found, truth)
        );
    }
    // Nothing shows a motion: they are kept where they were logged.
    for options in [ON_MIDDLES(), RegisterOptions::default()] {
        let without = register(&map, &logs[1..], None, &options).unwrap();
        for at in 0..2 {
            let found = registered(&without, at);
            assert_eq!(found.treatment, Treatment::KeptParked);
            assert!(found.poses.iter().all(|pose| pose.flags.parked));
            let off = found.poses[0]
                .pose
                .translation
                .truncate()
                .distance(logs[1 + at].points[0].position_m);
            assert!(off < 0.03, "{off}");
        }
    }
}

#[test]
fn one_motion_for_the_whole_log_shows_what_single_straight_tracks_do_not() {
    // Two straight roads that cross: each shows what the other does not.
    let (east, north) = (
        straight(150.0),
        Polyline::new((0..=150).map(|y| glam::DVec3::new(70.0, f64::from(y) - 75.0, 0.0))).unwrap(),
    );
    let mut map = road(&east, 1, 1, false);
    map.lanes.extend(road(&north, 1, 1, false).lanes);
    let truths = [
        drive("east", 145.0, 10.0, |s| east.at(s)),
        drive("north", 145.0, 10.0, |s| north.at(s)),
    ];
    let logs = truths
        .clone()
        .map(|truth| logged(&truth, 0.0, DVec2::new(0.7, 0.4), 0.05, 4));
    let shared = register(
        &map,
        &logs,
        None,
        &RegisterOptions {
            shared: true,
            ..ON_MIDDLES()
        },
    )
    .unwrap();
    let own = register(&map, &logs, None, &ON_MIDDLES()).unwrap();
    for (at, truth) in truths.iter().enumerate() {
        assert!(
            error(registered(&shared, at), truth).ade_m < ADE_MAX_M,
            "{:?}",
            error(registered(&shared, at), truth)
        );
        assert!(error(registered(&own, at), truth).longitudinal_m > 0.3);
    }
    assert!(shared.shared.unwrap().along_m < 0.1);
}

#[test]
fn without_registration_the_error_is_seen() {
    let middle = straight(120.0);
    let map = road(&middle, 1, 1, false);
    let log = logged(
        &drive("car", 115.0, 10.0, |s| middle.at(s)),
        0.0,
        DVec2::new(0.0, 0.48),
        0.0,
        1,
    );
    let index = LaneIndex::new(&map);
    let before = ade_to_lanes(
        &index,
        log.points.iter().map(|point| point.position_m),
        |_| true,
    )
    .unwrap();
    assert!((before - 0.48).abs() < 1e-9);
    let registration = alone(&map, &log);
    let positions = registered(&registration, 0)
        .poses
        .iter()
        .map(|pose| pose.pose.translation.truncate());
    assert!(ade_to_lanes(&index, positions, |_| true).unwrap() < 0.01);
}
