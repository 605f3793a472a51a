//! `decouplegs register`, on a small road and on real maps.

mod drift;

use std::fmt::Write;
use std::path::PathBuf;

use decouplegs::asset::read_map;
use decouplegs::drive::alignment::{TruthError, against_truth_along};
use decouplegs::drive::polyline::wrapped;
use decouplegs::drive::register::fit::PlanarFit;
use decouplegs::drive::{
    LaneIndex, Outcome, PlanarTransform, Polyline, RegisterOptions, Treatment, register,
};
use decouplegs::scene::{LaneKind, LaneMap, Track, TrackPoint};
use glam::DVec2;
use serde_json::Value;

use super::stress::assert_page_stands_alone;
use super::*;

/// A lane of 100 m that rises by 4 %, a track 0.4 m beside it, another against it, its truth, and
/// the ground 0.3 m above the map.
fn small_road(folder: &Path) -> [PathBuf; 4] {
    let lane: Vec<[f64; 3]> = (0..=50)
        .map(|i| [2.0 * f64::from(i), 0.0, 0.08 * f64::from(i)])
        .collect();
    let map = serde_json::json!({"version": 1, "lanes": [{"id": "a", "centerline": lane}]});
    let track = |y: f64| {
        let mut table = String::from("time_s,id,class,x,y\n");
        for i in 0..90 {
            let _ = writeln!(
                table,
                "{},there,car,{},{y}",
                0.1 * f64::from(i),
                2.0 + f64::from(i)
            );
            let _ = writeln!(
                table,
                "{},against,car,{},{y}",
                0.1 * f64::from(i),
                98.0 - f64::from(i)
            );
        }
        table
    };
    let mut points = String::from("x,y,z\n");
    for (x, y) in
        (-20..220).flat_map(|x| (-6..=6).map(move |y| (0.5 * f64::from(x), 0.5 * f64::from(y))))
    {
        let _ = writeln!(points, "{x},{y},{}", 0.3 + 0.04 * x);
    }
    let files = ["map.json", "tracks.csv", "truth.csv", "points.csv"].map(|name| folder.join(name));
    for (file, text) in files
        .iter()
        .zip([map.to_string(), track(0.4), track(0.0), points])
    {
        fs::write(file, text).unwrap();
    }
    files
}

#[test]
fn tracks_are_registered_measured_and_reported() {
    let folder = tempfile::tempdir().unwrap();
    let [map, tracks, truth, points] = small_road(folder.path());
    let [out, page] = ["poses.csv", "report.html"].map(|name| folder.path().join(name));
    let inputs = [
        "register",
        "--map",
        text(&map),
        "--tracks",
        text(&tracks),
        "--scene",
        text(&points),
        "--truth",
        text(&truth),
    ];
    let outputs = [
        "--habit",
        "0",
        "--ground-truth",
        text(&points),
        "--out",
        text(&out),
        "--report",
        text(&page),
    ];
    let said = succeed(&[&inputs[..], &outputs].concat());
    assert!(
        said.contains("1 of 2 tracks registered") && said.contains("against its lanes"),
        "{said}"
    );
    assert!(said.contains("0.400 -> 0.00"), "{said}");
    let poses = decouplegs::asset::read_tracks(&out).unwrap();
    assert_eq!((poses.len(), poses[0].points.len()), (1, 90));
    for point in &poses[0].points {
        let expected_m = 0.3 + 0.04 * point.position_m.x + 0.5 * poses[0].dims_m.unwrap()[2];
        assert!(
            point.position_m.y.abs() < 0.01 && (point.z_m.unwrap() - expected_m).abs() < 0.02,
            "{point:?}"
        );
    }
    let page = fs::read_to_string(page).unwrap();
    assert_page_stands_alone(&page);
    for part in [
        "as logged",
        "registered",
        "Corners by clearance",
        "independent ground",
        "Ground penetration rate",
        "was refused",
    ] {
        assert!(page.contains(part), "{part}");
    }
}

#[test]
fn what_cannot_be_registered_is_told_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let [map, tracks, _, points] = small_road(folder.path());
    let out = folder.path().join("poses.csv");
    let run = |map: &Path, tracks: &Path, more: &[&str]| {
        let files = [
            "register",
            "--map",
            text(map),
            "--tracks",
            text(tracks),
            "--out",
            text(&out),
        ];
        decouplegs(&[&files[..], more].concat())
    };
    let other = folder.path().join("other.csv");
    fs::write(&other, "time_s,id,x,y\n0,b,1,2\n").unwrap();
    let against = folder.path().join("against.csv");
    let only = fs::read_to_string(&tracks).unwrap();
    fs::write(
        &against,
        only.lines()
            .filter(|line| !line.contains("there"))
            .collect::<Vec<_>>()
            .join("\n"),
    )
    .unwrap();
    let broken = folder.path().join("broken.csv");
    fs::write(&broken, "x,y,z\n1,2,three\n").unwrap();
    let cases: [(&Path, &Path, &[&str], &str); 5] = [
        (&map, &map, &[], "map.json"),
        (&folder.path().join("none.json"), &tracks, &[], "none.json"),
        (
            &map,
            &tracks,
            &["--truth", text(&other)],
            "none of the tracks",
        ),
        (&map, &tracks, &["--scene", text(&broken)], "line 2"),
        (
            &map,
            &against,
            &["--scene", text(&points)],
            "could be registered",
        ),
    ];
    for (map, tracks, more, expected) in cases {
        let output = run(map, tracks, more);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(
            output.status.code() == Some(1) && said.contains(expected),
            "{more:?} said: {said}"
        );
        assert!(!out.exists());
    }
    assert_eq!(
        run(&map, &tracks, &["--sigma", "-1"]).status.code(),
        Some(2)
    );
}

/// A real map, or `None` with a word of it where the test files are missing.
fn real_map(file: &str) -> Option<LaneMap> {
    let path = data::file("a real map", file)?;
    Some(read_map(&path).unwrap())
}

/// Result of the registration of a car on a map.
struct Found {
    error: TruthError,
    fit: PlanarFit,
    /// Mean error of the whole track along its mean direction, meters: [`PlanarFit::along_m`] is
    /// its deviation.
    shifted_m: f64,
}

/// Cars on `map` that were moved by up to 1.1 m and 1.7 degrees, with noise of 8 cm, as they were
/// brought back; those changing to a lane on the left where `changing`. Several draws of noise and
/// drift for each route.
fn brought_back(map: &LaneMap, changing: bool) -> Vec<Found> {
    const YAWS: [f64; 4] = [0.02, -0.03, 0.01, 0.0];
    const DRAWS: usize = 4;
    let mut all = Vec::new();
    let lines = routes(map, 60.0, 24);
    let short = lines
        .iter()
        .enumerate()
        .filter(|(_, line)| line.length_m() < 250.0);
    for ((at, line), draw) in short.flat_map(|route| (0..DRAWS).map(move |draw| (route, draw))) {
        let middle_m = 0.5 * line.length_m();
        let width_m = if changing {
            left_lane_m(map, line, middle_m + 20.0)
        } else {
            Some(0.0)
        };
        let Some(width_m) = width_m else { continue };
        let left = |s: f64| {
            0.5 * width_m
                * (1.0
                    - (std::f64::consts::PI * ((s - middle_m + 15.0) / 30.0).clamp(0.0, 1.0)).cos())
        };
        let truth = drive("car", line, left);
        let drift = at + 7 * draw;
        let shift_m = DVec2::new(
            [0.6, -0.7, 0.2][drift % 3],
            [-0.6, 0.5, 0.8, -0.9, 0.1][drift % 5],
        );
        let log = logged(&truth, YAWS[drift % 4], shift_m, 0.08, draw as u64 + 1);
        // The truth lies on the middles of lanes.
        let options = RegisterOptions {
            keeping_m: 0.0,
            ..RegisterOptions::default()
        };
        let registration = register(map, &[log], None, &options).unwrap();
        let Outcome::Registered(found) = &registration.tracks[0].outcome else {
            panic!("{:?}", registration.tracks[0].outcome)
        };
        assert_eq!(
            found.lane_changes.len(),
            usize::from(changing),
            "route {at}, draw {draw}"
        );
        let places = found.poses.iter().map(|pose| {
            let lane_heading = pose.lane.map(|lane| lane.heading_rad);
            (pose.time_s, pose.pose.translation.truncate(), lane_heading)
        });
        let error = against_truth_along(places, &truth).unwrap();
        let off = found
            .poses
            .iter()
            .zip(&truth.points)
            .map(|(pose, point)| pose.pose.translation.truncate() - point.position_m);
        let way: DVec2 = truth
            .points
            .windows(2)
            .map(|pair| (pair[1].position_m - pair[0].position_m).normalize())
            .sum();
        let shifted_m = (off.sum::<DVec2>() / truth.points.len() as f64)
            .dot(way.normalize())
            .abs();
        all.push(Found {
            error,
            fit: found.fit,
            shifted_m,
        });
    }
    all
}

/// Distance from `line` to the left lane of the same direction from `from_m` on, if there is one
/// all along.
fn left_lane_m(map: &LaneMap, line: &Polyline, from_m: f64) -> Option<f64> {
    let index = LaneIndex::new(map);
    let beside = |arc_m: f64| {
        let near = index.lanes_near(line.at(arc_m).truncate(), 5.0);
        let same_way =
            |heading_rad: f64| wrapped(heading_rad - line.heading_at(arc_m)).abs() < 0.15;
        let found = near.iter().find(|near| {
            let kind = map.lanes[near.lane].kind;
            same_way(near.foot.heading_rad)
                && kind == LaneKind::Driving
                && (-4.5..-2.3).contains(&near.foot.lateral_m)
        });
        found.map(|near| -near.foot.lateral_m)
    };
    let width_m = beside(from_m)?;
    let rest_m = line.length_m() - 1.0 - from_m;
    (0..30)
        .all(|i| {
            beside(from_m + rest_m * f64::from(i) / 29.0)
                .is_some_and(|own| (own - width_m).abs() < 0.05)
        })
        .then_some(width_m)
}

#[test]
fn tracks_on_real_maps_are_brought_back_across_their_lanes() {
    const ADE_MAX_M: f64 = 0.05;
    // How many logs each map has at least, keeping their lanes and changing them.
    let maps = [
        ("maps/lanelet2_mapping_example.osm", [80, 0]),
        ("maps/esmini_fabriksgatan.xodr", [44, 0]),
        ("scenarios/commonroad_USA_Lanker-1_1_T-1.xml", [76, 16]),
    ];
    let mut along = Vec::new();
    for (file, least) in maps {
        let Some(map) = real_map(file) else { continue };
        for (changing, least) in [false, true].into_iter().zip(least) {
            let found = brought_back(&map, changing);
            let worst = found
                .iter()
                .map(|found| found.error.lateral_m)
                .fold(0.0, f64::max);
            println!(
                "{file}, changing {changing}: {} logs, at worst {worst:.3} m across",
                found.len()
            );
            assert!(found.len() >= least, "{} logs", found.len());
            assert!(worst <= ADE_MAX_M, "{file}, changing {changing}: {worst}");
            along.extend(
                found
                    .iter()
                    .map(|found| (found.shifted_m, found.fit.along_m)),
            );
        }
    }
    assert_deviations_hold(&along);
}

/// Maps on which logs of many tracks are made.
const MAPS: [&str; 3] = [
    "maps/lanelet2_mapping_example.osm",
    "maps/esmini_fabriksgatan.xodr",
    "scenarios/commonroad_USA_Lanker-1_1_T-1.xml",
];

/// Shifts along lanes that are left and the deviations told with them: as a normal distribution has
/// them, about two thirds within one deviation and few beyond two. Errors of no motion at all, as
/// deviations too large to say anything would have them, are not.
fn assert_deviations_hold(along: &[(f64, f64)]) {
    let shown: Vec<f64> = along
        .iter()
        .filter(|(_, told_m)| *told_m < 0.2)
        .map(|(error_m, told_m)| error_m / told_m)
        .collect();
    if shown.is_empty() {
        return;
    }
    let share = |limit: f64| {
        shown.iter().filter(|error| **error <= limit).count() as f64 / shown.len() as f64
    };
    println!(
        "{} logs that show the place along: {:.2} within a deviation, {:.2} within two",
        shown.len(),
        share(1.0),
        share(2.0)
    );
    assert!(
        (0.5..0.9).contains(&share(1.0)) && share(2.0) >= 0.9 && share(5.0) >= 1.0,
        "{} {}",
        share(1.0),
        share(2.0)
    );
}

/// Ways of at least `least_m` along lanes that follow one another, about `count` of them, spread
/// over the map.
fn routes(map: &LaneMap, least_m: f64, count: usize) -> Vec<Polyline> {
    let mut routes = Vec::new();
    for (start, lane) in map
        .lanes
        .iter()
        .enumerate()
        .filter(|(_, lane)| lane.kind == LaneKind::Driving)
    {
        let (mut lanes, mut points) = (vec![start], lane.centerline.clone());
        loop {
            let line = Polyline::new(points.iter().copied()).unwrap();
            if line.length_m() > 150.0 {
                break;
            }
            let next = map.lanes[lanes[lanes.len() - 1]].successors.iter().copied();
            let Some(next) = next
                .clone()
                .find(|next| !lanes.contains(next) && map.lanes[*next].kind == LaneKind::Driving)
            else {
                break;
            };
            lanes.push(next);
            // The first point of a lane is the last of the one before, or nearly.
            points.extend(&map.lanes[next].centerline[1..]);
        }
        let line = Polyline::new(points).unwrap();
        if line.length_m() >= least_m {
            routes.push(line);
        }
    }
    let step = routes.len().div_ceil(count).max(1);
    routes.into_iter().step_by(step).collect()
}

/// A car along `line` from `from_m`, seen ten times a second, `left(meters)` to the left of it.
fn drive(id: &str, line: &Polyline, left: impl Fn(f64) -> f64) -> Track {
    let count = ((line.length_m() - 2.0) / 0.8) as usize;
    let point = |at: usize| {
        let arc_m = 1.0 + 0.8 * at as f64;
        let side = DVec2::from_angle(line.heading_at(arc_m)).perp() * left(arc_m);
        TrackPoint {
            time_s: 0.1 * at as f64,
            position_m: line.at(arc_m).truncate() + side,
            z_m: None,
            yaw_rad: None,
        }
    };
    Track {
        id: id.into(),
        class: "car".into(),
        dims_m: Some([4.5, 1.9, 1.6]),
        points: (0..count).map(point).collect(),
    }
}

/// `truth` as a log that drifts has it: moved about its middle and noisy.
fn logged(truth: &Track, yaw_rad: f64, shift_m: DVec2, noise_m: f64, seed: u64) -> Track {
    let first = truth.points[0].position_m;
    let sum: DVec2 = truth
        .points
        .iter()
        .map(|point| point.position_m - first)
        .sum();
    let drift = PlanarTransform {
        pivot_m: first + sum / truth.points.len() as f64,
        yaw_rad,
        shift_m,
    };
    let mut seed = seed;
    let mut uniform = || {
        // The sum of four even numbers is normal enough for noise.
        seed = seed
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (seed >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    };
    let mut normal = || (uniform() + uniform() + uniform() + uniform()) * 3f64.sqrt();
    let mut track = truth.clone();
    for point in &mut track.points {
        point.position_m = drift.apply(point.position_m) + DVec2::new(normal(), normal()) * noise_m;
    }
    track
}
