//! Small maps, and tracks on them whose truth is known.

use decouplegs_drive::{PlanarTransform, Polyline};
use decouplegs_scene::{Lane, LaneMap, Track, TrackPoint};
use glam::{DVec2, DVec3};

use crate::roads::Random;

/// Lanes side by side, 3 m apart to the left, along `middle`, which is cut into `parts` that follow
/// one another. The last lane runs the other way where `opposite`.
pub fn road(middle: &Polyline, lanes: usize, parts: usize, opposite: bool) -> LaneMap {
    let mut map = LaneMap::default();
    for lane in 0..lanes {
        let against = opposite && lane + 1 == lanes;
        for part in 0..parts {
            let (from, to) = (part as f64 / parts as f64, (part + 1) as f64 / parts as f64);
            let position =
                |share: f64| beside(middle, share * middle.length_m(), 3.0 * lane as f64);
            let mut centerline: Vec<DVec3> = (0..=100)
                .map(|i| position(from + (to - from) * f64::from(i) / 100.0))
                .collect();
            let own = lane * parts + part;
            let neighbor =
                |lane: usize| (lane < lanes - usize::from(opposite)).then_some(lane * parts + part);
            let next = (part + 1 < parts).then_some(own + 1);
            let last = part.checked_sub(1).map(|_| own - 1);
            let (mut successors, mut predecessors) =
                (next.into_iter().collect(), last.into_iter().collect());
            if against {
                centerline.reverse();
                std::mem::swap(&mut successors, &mut predecessors);
            }
            map.lanes.push(Lane {
                id: format!("{lane}/{part}"),
                centerline,
                has_height: true,
                successors,
                predecessors,
                left_neighbor: if against { None } else { neighbor(lane + 1) },
                right_neighbor: if against {
                    None
                } else {
                    lane.checked_sub(1).and_then(neighbor)
                },
                ..Lane::default()
            });
        }
    }
    map
}

/// `left_m` to the left of `line`, `arc_m` along it.
pub fn beside(line: &Polyline, arc_m: f64, left_m: f64) -> DVec3 {
    line.at(arc_m) + (DVec2::from_angle(line.heading_at(arc_m)).perp() * left_m).extend(0.0)
}

pub fn straight(length_m: f64) -> Polyline {
    Polyline::new((0..=200).map(|i| DVec3::X * (length_m * f64::from(i) / 200.0))).unwrap()
}

/// Line with curvature `curvature(s)`, in steps of half a meter.
pub fn curved(length_m: f64, curvature: impl Fn(f64) -> f64) -> Polyline {
    let (mut at, mut heading) = (DVec2::ZERO, 0.0);
    let step = 0.5;
    let points = (0..(length_m / step) as usize).map(|i| {
        heading += step * curvature(i as f64 * step);
        at += DVec2::from_angle(heading) * step;
        at.extend(0.0)
    });
    Polyline::new(points.collect::<Vec<_>>()).unwrap()
}

/// A car that drives `position(meters)` at `speed_mps`, seen ten times a second.
pub fn drive(id: &str, length_m: f64, speed_mps: f64, position: impl Fn(f64) -> DVec3) -> Track {
    let count = (10.0 * length_m / speed_mps) as usize;
    let point = |i: usize| {
        let time_s = 0.1 * i as f64;
        TrackPoint {
            time_s,
            position_m: position(speed_mps * time_s).truncate(),
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

/// `truth` as a log that drifts has it: moved about its middle by `yaw_rad` and `shift_m`, and
/// noisy.
pub fn logged(truth: &Track, yaw_rad: f64, shift_m: DVec2, noise_m: f64, seed: u64) -> Track {
    let sum: DVec2 = truth.points.iter().map(|point| point.position_m).sum();
    let drift = PlanarTransform {
        pivot_m: sum / truth.points.len() as f64,
        yaw_rad,
        shift_m,
    };
    let mut random = Random(seed);
    let mut track = truth.clone();
    for point in &mut track.points {
        point.position_m =
            drift.apply(point.position_m) + DVec2::new(random.normal(), random.normal()) * noise_m;
        point.yaw_rad = point.yaw_rad.map(|yaw| yaw + yaw_rad);
    }
    track
}
