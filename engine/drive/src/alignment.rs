//! Alignment of road users: distances to lanes and to a ground truth, and clearances above the
//! ground.

use decouplegs_scene::{Pose, Track};
use glam::{DVec2, DVec3};

use crate::lane_index::{LaneIndex, LanePoint};
use crate::register::grounding::corners;

/// Average displacement error to centerlines, meters: the mean distance of `positions` from the
/// nearest position on any lane that `accept` takes. `None` where there are no positions or no
/// lanes.
///
/// It measures errors across lanes only: a vehicle a car's length too far ahead on its lane has
/// none.
#[must_use]
pub fn ade_to_lanes(
    index: &LaneIndex,
    positions: impl IntoIterator<Item = DVec2>,
    accept: impl Fn(&LanePoint) -> bool,
) -> Option<f64> {
    mean(
        positions
            .into_iter()
            .map(|position| Some(index.nearest(position, &accept)?.foot.distance_m)),
    )
}

/// Average displacement errors to a truth, meters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthError {
    /// Mean distance.
    pub ade_m: f64,
    /// Mean size of the distance across the lane, or where none is given across the truth's
    /// direction of motion.
    pub lateral_m: f64,
    /// Mean size of the distance along it, which lanes do not show where they are straight.
    pub longitudinal_m: f64,
    /// Moments compared.
    pub moments: usize,
}

/// `positions` with their times in seconds against `truth`, linear between its points; moments
/// outside it are passed over. `None` where no moment is left.
#[must_use]
pub fn against_truth(
    positions: impl IntoIterator<Item = (f64, DVec2)>,
    truth: &Track,
) -> Option<TruthError> {
    against_truth_along(
        positions
            .into_iter()
            .map(|(time_s, position)| (time_s, position, None)),
        truth,
    )
}

/// Compares positions with the truth. Each comes with the direction, radians, along which and
/// across which its error is given: that of the lane, where one is known. The motion of a vehicle
/// that changes lanes is at an angle to them, and an error along the lane, which lanes do not show,
/// would count as one across its motion.
#[must_use]
pub fn against_truth_along(
    positions: impl IntoIterator<Item = (f64, DVec2, Option<f64>)>,
    truth: &Track,
) -> Option<TruthError> {
    let points = &truth.points;
    let (mut sums, mut moments) = (DVec3::ZERO, 0);
    for (time_s, position, heading_rad) in positions {
        let next = points.partition_point(|point| point.time_s < time_s);
        let exact = points.get(next).is_some_and(|point| point.time_s <= time_s);
        let (before, after) = (if exact { next } else { next.wrapping_sub(1) }, next);
        let (Some(a), Some(b)) = (points.get(before), points.get(after)) else {
            continue;
        };
        let share = if exact {
            0.0
        } else {
            (time_s - a.time_s) / (b.time_s - a.time_s)
        };
        let true_position = a.position_m.lerp(b.position_m, share);
        // The way over a neighbor to each side.
        let (first, last) = (
            &points[before.saturating_sub(1)],
            &points[(after + 1).min(points.len() - 1)],
        );
        let way = (last.position_m - first.position_m).try_normalize();
        let way = way.or(a.yaw_rad.map(DVec2::from_angle)).unwrap_or(DVec2::X);
        let way = heading_rad.map_or(way, DVec2::from_angle);
        let off = position - true_position;
        sums += DVec3::new(off.length(), way.perp_dot(off).abs(), way.dot(off).abs());
        moments += 1;
    }
    let mean = sums / moments as f64;
    (moments > 0).then_some(TruthError {
        ade_m: mean.x,
        lateral_m: mean.y,
        longitudinal_m: mean.z,
        moments,
    })
}

/// Height of each bottom corner of boxes of `dims_m` at `poses` above a ground, meters; negative
/// below it. `ground` tells the height at a position, near the height given; corners without ground
/// are passed over.
#[must_use]
pub fn clearances(
    poses: impl IntoIterator<Item = Pose>,
    dims_m: [f64; 3],
    ground: impl Fn(DVec2, f64) -> Option<f64>,
) -> Vec<f64> {
    let bottom = corners(dims_m).map(|corner| corner.extend(-0.5 * dims_m[2]));
    let anchors = poses
        .into_iter()
        .flat_map(|pose| bottom.map(|corner| pose.transform(corner)));
    anchors
        .filter_map(|anchor| Some(anchor.z - ground(anchor.truncate(), anchor.z)?))
        .collect()
}

/// Ground penetration rate: the share of `clearances_m` below `-tolerance_m`. `None` where there
/// are none.
#[must_use]
pub fn penetration_rate(clearances_m: &[f64], tolerance_m: f64) -> Option<f64> {
    mean(
        clearances_m
            .iter()
            .map(|clearance| Some(f64::from(u8::from(*clearance < -tolerance_m)))),
    )
}

/// The size that `share` of `values` do not exceed, signs left out. `None` where there are none.
#[must_use]
pub fn size_quantile(values: &[f64], share: f64) -> Option<f64> {
    let mut sizes: Vec<f64> = values.iter().map(|value| value.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    sizes
        .get(
            ((share * sizes.len() as f64).ceil() as usize)
                .saturating_sub(1)
                .min(sizes.len().saturating_sub(1)),
        )
        .copied()
}

/// Histogram of `values` in `bins` equal parts of -`limit` to `limit`; values beyond are in the
/// first and the last bin.
#[must_use]
pub fn histogram(values: &[f64], limit: f64, bins: usize) -> Vec<usize> {
    let mut counts = vec![0; bins];
    for value in values {
        let bin = ((value / limit + 1.0) * 0.5 * bins as f64).floor().max(0.0) as usize;
        if let Some(count) = counts.get_mut(bin.min(bins.saturating_sub(1))) {
            *count += 1;
        }
    }
    counts
}

fn mean(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0);
    for value in values {
        sum += value?;
        count += 1;
    }
    (count > 0).then(|| sum / f64::from(count))
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs_scene::{Lane, LaneMap, TrackPoint};

    #[test]
    fn distances_to_lanes_are_across_only() {
        let lane = Lane {
            centerline: vec![DVec3::ZERO, DVec3::X * 100.0],
            ..Lane::default()
        };
        let index = LaneIndex::new(&LaneMap {
            lanes: vec![lane],
            ..LaneMap::default()
        });
        let at = |off: f64, ahead: f64| (0..20).map(move |i| DVec2::new(f64::from(i) + ahead, off));
        assert!((ade_to_lanes(&index, at(0.48, 0.0), |_| true).unwrap() - 0.48).abs() < 1e-12);
        assert!(ade_to_lanes(&index, at(0.0, 5.0), |_| true).unwrap() < 1e-12);
        assert_eq!(ade_to_lanes(&index, at(0.0, 5.0), |_| false), None);
        assert_eq!(ade_to_lanes(&index, [], |_| true), None);
    }

    #[test]
    fn errors_to_a_truth_are_told_apart_and_seen() {
        let point = |i: i32| TrackPoint {
            time_s: f64::from(i),
            position_m: DVec2::new(0.0, 10.0 * f64::from(i)),
            z_m: None,
            yaw_rad: None,
        };
        let truth = Track {
            points: (0..10).map(point).collect(),
            ..Track::default()
        };
        let moved = |off: DVec2| {
            (-5..40).map(move |i| {
                (
                    0.3 * f64::from(i),
                    DVec2::new(0.0, 3.0 * f64::from(i)) + off,
                )
            })
        };
        let exact = against_truth(moved(DVec2::ZERO), &truth).unwrap();
        assert!(exact.ade_m < 1e-12 && exact.moments == 31, "{exact:?}");
        let aside = against_truth(moved(DVec2::new(0.3, 0.4)), &truth).unwrap();
        assert!(
            (aside.ade_m - 0.5).abs() < 1e-9 && (aside.lateral_m - 0.3).abs() < 1e-9,
            "{aside:?}"
        );
        assert!((aside.longitudinal_m - 0.4).abs() < 1e-9, "{aside:?}");
        let lane =
            moved(DVec2::new(0.3, 0.4)).map(|(time_s, position)| (time_s, position, Some(0.0)));
        let along_x = against_truth_along(lane, &truth).unwrap();
        assert!(
            (along_x.lateral_m - 0.4).abs() < 1e-9 && (along_x.longitudinal_m - 0.3).abs() < 1e-9,
            "{along_x:?}"
        );
        assert_eq!(against_truth([(100.0, DVec2::ZERO)], &truth), None);
        assert_eq!(against_truth(moved(DVec2::ZERO), &Track::default()), None);
    }

    #[test]
    fn floating_and_sinking_are_told_apart() {
        let pose = |z: f64| Pose::from_yaw(0.3, DVec3::new(5.0, 5.0, z));
        let level = |_: DVec2, _: f64| Some(10.0);
        let of = |z: f64| clearances([pose(z)], [4.0, 2.0, 1.5], level);
        assert!(of(10.75).iter().all(|clearance| clearance.abs() < 1e-12) && of(10.75).len() == 4);
        assert!((of(10.5)[0] + 0.25).abs() < 1e-12, "sunk");
        let mixed: Vec<f64> = [of(10.74), of(10.5), of(11.0), of(10.75)].concat();
        assert_eq!(
            (
                penetration_rate(&mixed, 0.02),
                penetration_rate(&mixed, 0.3)
            ),
            (Some(0.25), Some(0.0))
        );
        assert_eq!(penetration_rate(&[], 0.0), None);
        assert!((size_quantile(&mixed, 0.95).unwrap() - 0.25).abs() < 1e-12);
        assert_eq!(
            histogram(&[-9.0, -0.2, 0.0, 0.1, 0.3, 9.0], 0.5, 4),
            [1, 1, 2, 2]
        );
        assert!(clearances([pose(0.0)], [4.0, 2.0, 1.5], |_, _| None).is_empty());
        assert_eq!(size_quantile(&[], 0.95), None);
    }
}
