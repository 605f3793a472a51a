//! Logs that drift, and logs that do not.

use super::*;

/// The truth of a log on `map`: cars that keep up to `habit_m` beside the middle of their lane and
/// weave by `weave_m`, some that change lanes, and parked ones.
fn truth_of_log(map: &LaneMap, habit_m: f64, weave_m: f64) -> Vec<Track> {
    let mut tracks = Vec::new();
    for (at, line) in routes(map, 60.0, 24)
        .iter()
        .enumerate()
        .filter(|(_, line)| line.length_m() < 250.0)
    {
        let middle_m = 0.5 * line.length_m();
        let own_m = habit_m * [1.0, -1.0, 0.6, -0.3, 0.0][at % 5];
        let weave = |s: f64| own_m + weave_m * (s / (6.0 + at as f64 % 4.0)).sin();
        let to_left_m = if at % 4 == 3 {
            left_lane_m(map, line, middle_m + 20.0)
        } else {
            None
        };
        let change = |s: f64| {
            0.5 * (1.0
                - (std::f64::consts::PI * ((s - middle_m + 15.0) / 30.0).clamp(0.0, 1.0)).cos())
        };
        tracks.push(drive(&format!("car {at}"), line, |s| {
            weave(s) + to_left_m.map_or(0.0, |width_m| width_m * change(s))
        }));
        if at % 3 == 0 {
            let mut parked = drive(&format!("parked {at}"), line, |_| -2.6);
            let place = parked.points[parked.points.len() / 2].position_m;
            parked.points.truncate(40);
            parked
                .points
                .iter_mut()
                .for_each(|point| point.position_m = place);
            tracks.push(parked);
        }
    }
    tracks
}

/// Mean distance of the registered poses of a track from the truth, across the truth's way, meters.
/// None where it was refused.
fn across_m(found: &Outcome, truth: &Track) -> Option<f64> {
    let Outcome::Registered(found) = found else {
        return None;
    };
    Some(mean_across_m(
        found
            .poses
            .iter()
            .map(|pose| pose.pose.translation.truncate()),
        truth,
    ))
}

fn mean_across_m(places: impl Iterator<Item = DVec2>, truth: &Track) -> f64 {
    let last = truth.points.len() - 1;
    let way = |at: usize| {
        truth.points[(at + 1).min(last)].position_m - truth.points[at.saturating_sub(1)].position_m
    };
    let off = |(at, place): (usize, DVec2)| {
        let off = place - truth.points[at].position_m;
        // A parked car has no way: all of it counts.
        way(at)
            .try_normalize()
            .map_or(off.length(), |way| way.perp_dot(off).abs())
    };
    let offs: Vec<f64> = places.enumerate().map(off).collect();
    offs.iter().sum::<f64>() / offs.len() as f64
}

#[test]
fn a_log_without_drift_is_not_made_worse() {
    let (mut better, mut worse, mut refused) = (0, Vec::new(), 0);
    for file in MAPS {
        let Some(map) = real_map(file) else { continue };
        for (seed, (habit_m, weave_m)) in [(0.35, 0.15), (0.35, 0.0), (0.0, 0.2), (0.2, 0.1)]
            .into_iter()
            .enumerate()
        {
            let truths = truth_of_log(&map, habit_m, weave_m);
            let logs: Vec<Track> = truths
                .iter()
                .map(|truth| logged(truth, 0.0, DVec2::ZERO, 0.05, seed as u64 + 1))
                .collect();
            let registration = register(&map, &logs, None, &RegisterOptions::default()).unwrap();
            assert!(
                registration.shared.is_none(),
                "{file}, habits of {habit_m} m: {:?}",
                registration.shared
            );
            for ((log, truth), found) in logs.iter().zip(&truths).zip(&registration.tracks) {
                let before_m =
                    mean_across_m(log.points.iter().map(|point| point.position_m), truth);
                match across_m(&found.outcome, truth) {
                    // The log's noise, which smoothing mostly removes, is no registration.
                    Some(after_m) if after_m <= before_m + 0.005 => better += 1,
                    Some(after_m) => {
                        worse.push(format!("{file} {}: {before_m:.3} -> {after_m:.3}", log.id));
                    }
                    None => refused += 1,
                }
                if log.id.starts_with("parked") {
                    let Outcome::Registered(found) = &found.outcome else {
                        panic!("{}: {:?}", log.id, found.outcome)
                    };
                    assert_eq!(found.treatment, Treatment::KeptParked);
                }
            }
        }
    }
    let all = better + worse.len() + refused;
    println!("{better} of {all} tracks no worse than logged, {refused} refused, worse: {worse:?}");
    assert!(refused == 0 && 100 * worse.len() <= all, "{worse:?}");
}

#[test]
fn a_log_that_drifted_as_a_whole_is_brought_back() {
    const ACROSS_MAX_M: f64 = 0.05;
    for file in MAPS {
        let Some(map) = real_map(file) else { continue };
        // Where lanes show nothing of the place along them, a parked car stays as far off along as
        // it was logged.
        let truths: Vec<Track> = truth_of_log(&map, 0.0, 0.0)
            .into_iter()
            .filter(|track| track.id.starts_with("car"))
            .collect();
        for (seed, shift) in [
            [0.3, 0.0],
            [-0.4, 0.6],
            [1.0, -0.9],
            [-1.3, -1.1],
            [0.4, 2.1],
        ]
        .into_iter()
        .enumerate()
        {
            let logs: Vec<Track> = truths
                .iter()
                .map(|truth| logged(truth, 0.0, DVec2::from_array(shift), 0.05, seed as u64 + 1))
                .collect();
            let registration = register(&map, &logs, None, &RegisterOptions::default()).unwrap();
            let found = registration
                .tracks
                .iter()
                .zip(&truths)
                .filter_map(|(found, truth)| across_m(&found.outcome, truth));
            let across: Vec<f64> = found.collect();
            let worst_m = across.iter().copied().fold(0.0, f64::max);
            println!(
                "{file}, drift {shift:?}: {} of {} tracks, at worst {worst_m:.3} m across",
                across.len(),
                truths.len()
            );
            assert!(registration.shared.is_some(), "{file} {shift:?}");
            assert!(
                across.len() == truths.len() && worst_m <= ACROSS_MAX_M,
                "{file} {shift:?}: {worst_m}"
            );
        }
    }
}

#[test]
fn a_track_that_fits_two_lanes_is_not_moved_into_either() {
    // Three lanes side by side: 2.2 m off one is 1.3 m off the next.
    let lane = |y: f64| {
        (0..=60)
            .map(|i| serde_json::json!([2.0 * f64::from(i), y, 0.0]))
            .collect::<Vec<_>>()
    };
    let lanes: Vec<Value> = (0..3)
        .map(
            |at| serde_json::json!({"id": at.to_string(), "centerline": lane(3.5 * f64::from(at))}),
        )
        .collect();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.json");
    fs::write(
        &path,
        serde_json::json!({"version": 1, "lanes": lanes}).to_string(),
    )
    .unwrap();
    let map = read_map(&path).unwrap();
    let line = Polyline::new(map.lanes[1].centerline.iter().copied()).unwrap();
    let truth = drive("car", &line, |_| 0.0);
    let log = logged(&truth, 0.0, DVec2::new(0.0, 2.2), 0.03, 1);
    let registration = register(
        &map,
        std::slice::from_ref(&log),
        None,
        &RegisterOptions::default(),
    )
    .unwrap();
    let Outcome::Registered(found) = &registration.tracks[0].outcome else {
        panic!()
    };
    assert_eq!(found.treatment, Treatment::KeptLaneUnsure);
    assert!(found.poses.iter().all(|pose| pose.flags.lane_unsure));
    assert!(
        (across_m(&registration.tracks[0].outcome, &truth).unwrap() - 2.2).abs() < 0.05,
        "it stays where it was logged"
    );
}
