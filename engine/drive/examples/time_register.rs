//! Time of registering one long track, against its points.

use std::time::Instant;

use decouplegs_drive::{RegisterOptions, register};
use decouplegs_scene::{Lane, LaneMap, Track, TrackPoint};
use glam::{DVec2, DVec3};

fn main() {
    for count in [8_000_u32, 16_000, 32_000] {
        let centerline = (0..=count / 10)
            .map(|i| DVec3::new(f64::from(i), 0.0, 0.0))
            .collect();
        let map = LaneMap {
            lanes: vec![Lane {
                id: "a".into(),
                centerline,
                ..Lane::default()
            }],
            ..LaneMap::default()
        };
        let point = |at: u32| TrackPoint {
            time_s: 0.01 * f64::from(at),
            position_m: DVec2::new(0.1 * f64::from(at), 0.2 * (f64::from(at) * 1e-3).sin()),
            z_m: None,
            yaw_rad: None,
        };
        let track = Track {
            id: "long".into(),
            class: "car".into(),
            dims_m: None,
            points: (0..count).map(point).collect(),
        };
        let since = Instant::now();
        register(&map, &[track], None, &RegisterOptions::default()).expect("a map and a track");
        println!("{count} points: {:.2} s", since.elapsed().as_secs_f64());
    }
}
