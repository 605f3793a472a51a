//! Invariants of registration: the frame and the order of the tracks do not matter.

use decouplegs_drive::{
    Outcome, PlanarTransform, RegisterError, RegisterOptions, Registration, register,
};
use decouplegs_scene::{LaneMap, Track, TrackPoint};
use glam::{DVec2, DVec3};
use proptest::prelude::*;

use crate::lanes::{beside, curved, drive, logged, road};

fn place() -> (LaneMap, Vec<Track>) {
    let middle = curved(120.0, |s| {
        if (40.0..70.0).contains(&s) {
            1.0 / 35.0
        } else {
            0.0
        }
    });
    let track = |lane: f64, seed: u64| {
        let truth = drive(&format!("car {seed}"), 110.0, 9.0, |s| {
            beside(&middle, s, 3.0 * lane)
        });
        logged(&truth, 0.02, DVec2::new(0.4, -0.5), 0.05, seed)
    };
    (
        road(&middle, 2, 3, false),
        vec![
            track(0.0, 1),
            track(1.0, 2),
            drive("parked", 1.0, 0.2, |_| beside(&middle, 30.0, -3.0)),
        ],
    )
}

fn positions(registration: &Registration) -> Vec<Option<Vec<DVec3>>> {
    let of = |outcome: &Outcome| match outcome {
        Outcome::Registered(registered) => Some(
            registered
                .poses
                .iter()
                .map(|pose| pose.pose.translation)
                .collect(),
        ),
        Outcome::Refused { .. } => None,
    };
    registration
        .tracks
        .iter()
        .map(|track| of(&track.outcome))
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn moving_map_and_tracks_moves_the_poses(yaw_rad in -3.1f64..3.1, x in -6e5f64..6e5, y in -6e6f64..6e6) {
        let (map, tracks) = place();
        let motion = PlanarTransform { pivot_m: DVec2::ZERO, yaw_rad, shift_m: DVec2::new(x, y) };
        let (mut moved_map, mut moved_tracks) = (map.clone(), tracks.clone());
        for point in moved_map.lanes.iter_mut().flat_map(|lane| &mut lane.centerline) {
            *point = motion.apply(point.truncate()).extend(point.z);
        }
        for point in moved_tracks.iter_mut().flat_map(|track| &mut track.points) {
            point.position_m = motion.apply(point.position_m);
        }
        let options = RegisterOptions::default();
        let (here, there) = (register(&map, &tracks, None, &options).unwrap(), register(&moved_map, &moved_tracks, None, &options).unwrap());
        for (here, there) in positions(&here).into_iter().zip(positions(&there)) {
            let (here, there) = (here.unwrap(), there.unwrap());
            for (here, there) in here.iter().zip(&there) {
                let off_m = motion.apply(here.truncate()).distance(there.truncate());
                prop_assert!(off_m < 1e-5, "{off_m} m");
            }
        }
    }

    #[test]
    fn the_order_of_tracks_does_not_matter(order in Just(vec![0usize, 1, 2]).prop_shuffle(), shared in any::<bool>()) {
        let (map, tracks) = place();
        let options = RegisterOptions { shared, ..RegisterOptions::default() };
        let shuffled: Vec<Track> = order.iter().map(|&at| tracks[at].clone()).collect();
        let (first, second) = (register(&map, &tracks, None, &options).unwrap(), register(&map, &shuffled, None, &options).unwrap());
        let first = positions(&first);
        for (place, &at) in order.iter().enumerate() {
            prop_assert_eq!(&positions(&second)[place], &first[at]);
        }
    }

    #[test]
    fn any_numbers_at_all_give_poses_or_a_reason(
        numbers in prop::collection::vec((any::<f64>(), any::<f64>(), any::<f64>(), any::<Option<f64>>()), 0..30),
        scale in prop::sample::select(vec![1.0, 1e3, 1e150]),
    ) {
        let (map, mut tracks) = place();
        let mut time_s = 0.0;
        let points = numbers.into_iter().map(|(dt, x, y, z_m)| {
            time_s += dt.abs().clamp(1e-3, 1e3);
            TrackPoint { time_s, position_m: DVec2::new(x, y) % scale, z_m, yaw_rad: z_m }
        });
        tracks[0].points = points.collect();
        let registration = register(&map, &tracks, None, &RegisterOptions::default()).unwrap();
        for pose in positions(&registration).into_iter().flatten().flatten() {
            prop_assert!(pose.is_finite());
        }
    }
}

#[test]
fn nothing_to_register_is_refused() {
    let (map, tracks) = place();
    let options = RegisterOptions::default();
    assert_eq!(
        register(&LaneMap::default(), &tracks, None, &options).unwrap_err(),
        RegisterError::NoLanes
    );
    assert_eq!(
        register(&map, &[], None, &options).unwrap_err(),
        RegisterError::NoTracks
    );
    let mut broken = map.clone();
    broken.lanes[0].centerline[1].x = f64::NAN;
    assert!(
        register(&broken, &tracks, None, &options)
            .unwrap_err()
            .to_string()
            .contains("0/0")
    );
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let wrong = RegisterOptions {
            band_m: bad,
            ..options
        };
        assert!(
            register(&map, &tracks, None, &wrong)
                .unwrap_err()
                .to_string()
                .contains("band_m")
        );
    }
}
