//! Lines of points: what the readers of maps do with borders and centerlines.

use glam::DVec3;

/// Points nearer than this to their neighbor are the same point, meters.
const SAME_POINT_M: f64 = 1e-6;

/// `points` without those that repeat their neighbor.
pub(super) fn cleaned(points: impl IntoIterator<Item = DVec3>) -> Vec<DVec3> {
    let mut kept: Vec<DVec3> = Vec::new();
    for point in points {
        // Written so that what is no number stays, for the check of the whole map to find.
        if !kept
            .last()
            .is_some_and(|last| last.distance(point) < SAME_POINT_M)
        {
            kept.push(point);
        }
    }
    kept
}

/// Length from the first point to each, meters.
fn lengths_m(points: &[DVec3]) -> Vec<f64> {
    let mut length_m = 0.0;
    let mut lengths_m = Vec::with_capacity(points.len());
    for (at, point) in points.iter().enumerate() {
        length_m += if at > 0 {
            point.distance(points[at - 1])
        } else {
            0.0
        };
        lengths_m.push(length_m);
    }
    lengths_m
}

/// Length of a line, meters.
#[must_use]
pub fn length_m(points: &[DVec3]) -> f64 {
    points
        .windows(2)
        .map(|pair| pair[0].distance(pair[1]))
        .sum()
}

/// Position of each point on its line, as a share of the whole length.
fn shares(points: &[DVec3]) -> Vec<f64> {
    let lengths_m = lengths_m(points);
    let whole_m = lengths_m.last().copied().unwrap_or(0.0);
    lengths_m
        .iter()
        .map(|length_m| {
            if whole_m > 0.0 {
                length_m / whole_m
            } else {
                0.0
            }
        })
        .collect()
}

/// The line in the middle of two that run the same way: midpoints of the points at equal shares of
/// the two lengths.
///
/// It has a point wherever one of the lines has one, so it is exact between them and grows with the
/// lines alone. Empty where a line is.
pub(super) fn between(left: &[DVec3], right: &[DVec3]) -> Vec<DVec3> {
    if left.is_empty() || right.is_empty() {
        return Vec::new();
    }
    let (left_shares, right_shares) = (shares(left), shares(right));
    let mut all: Vec<f64> = left_shares.iter().chain(&right_shares).copied().collect();
    all.sort_by(f64::total_cmp);
    all.dedup_by(|a, b| *a - *b < 1e-9);
    let (mut on_left, mut on_right) = (Walk::default(), Walk::default());
    cleaned(all.into_iter().map(|share| {
        0.5 * (on_left.at(left, &left_shares, share) + on_right.at(right, &right_shares, share))
    }))
}

/// `line` at the heights of `other`, which runs beside it: at equal shares of the two lengths.
pub(super) fn at_heights_of(line: &[DVec3], other: &[DVec3]) -> Vec<DVec3> {
    let (own_shares, other_shares) = (shares(line), shares(other));
    let mut on_other = Walk::default();
    line.iter()
        .zip(own_shares)
        .map(|(point, share)| {
            point
                .truncate()
                .extend(on_other.at(other, &other_shares, share).z)
        })
        .collect()
}

/// A way along a line whose shares only rise.
#[derive(Default)]
struct Walk {
    segment: usize,
}

impl Walk {
    fn at(&mut self, points: &[DVec3], shares: &[f64], share: f64) -> DVec3 {
        while self.segment + 2 < points.len() && shares[self.segment + 1] < share {
            self.segment += 1;
        }
        let Some(end) = points.get(self.segment + 1) else {
            return points[self.segment];
        };
        let (from, to) = (shares[self.segment], shares[self.segment + 1]);
        let part = if to > from {
            ((share - from) / (to - from)).clamp(0.0, 1.0)
        } else {
            0.0
        };
        points[self.segment].lerp(*end, part)
    }
}

/// The point at half the length of a line, which has points.
pub(super) fn halfway(points: &[DVec3]) -> DVec3 {
    Walk::default().at(points, &shares(points), 0.5)
}

/// Length of a line on the plane, meters.
pub(super) fn plan_length_m(line: &[DVec3]) -> f64 {
    let length_m = |pair: &[DVec3]| pair[0].truncate().distance(pair[1].truncate());
    line.windows(2).map(length_m).sum()
}

/// The position on a line that is nearest to `point` on the plane, meters along the line.
pub(super) fn foot_m(line: &[DVec3], point: DVec3) -> f64 {
    let (mut nearest_m, mut found_m, mut start_m) = (f64::INFINITY, 0.0, 0.0);
    for pair in line.windows(2) {
        let along = (pair[1] - pair[0]).truncate();
        let length_m = along.length();
        let to_point = (point - pair[0]).truncate();
        // A line that is not finite is refused later.
        let at_m = to_point
            .dot(along.normalize_or_zero())
            .min(length_m)
            .max(0.0);
        let distance_m = to_point.distance(along.normalize_or_zero() * at_m);
        if distance_m < nearest_m {
            (nearest_m, found_m) = (distance_m, start_m + at_m);
        }
        start_m += length_m;
    }
    found_m
}

/// True if `point` is to the left of a line, seen from above.
///
/// Told by the nearest segment; where the nearest is the point between two of them, by both.
pub(super) fn is_left_of(line: &[DVec3], point: DVec3) -> bool {
    let mut nearest_m = f64::INFINITY;
    let mut side = 0.0;
    for pair in line.windows(2) {
        let along = (pair[1] - pair[0]).truncate();
        let Some(direction) = along.try_normalize() else {
            continue;
        };
        let to_point = (point - pair[0]).truncate();
        let foot = direction * to_point.dot(direction).clamp(0.0, along.length());
        let distance_m = to_point.distance(foot);
        let sine = direction.perp_dot(to_point);
        if distance_m < nearest_m - SAME_POINT_M {
            (nearest_m, side) = (distance_m, sine);
        } else if distance_m < nearest_m + SAME_POINT_M {
            side += sine;
        }
    }
    side > 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(points: &[(f64, f64)]) -> Vec<DVec3> {
        points.iter().map(|&(x, y)| DVec3::new(x, y, 0.0)).collect()
    }

    #[test]
    fn the_middle_has_the_points_of_both_sides() {
        let left = line(&[(0.0, 2.0), (5.0, 2.0), (10.0, 2.0)]);
        let right = line(&[(0.0, 0.0), (2.5, 0.0), (10.0, 0.0)]);
        assert_eq!(
            between(&left, &right),
            line(&[(0.0, 1.0), (2.5, 1.0), (5.0, 1.0), (10.0, 1.0)])
        );
        assert!(between(&[], &right).is_empty());
        assert_eq!(
            between(&left[..1], &right).last(),
            Some(&DVec3::new(5.0, 1.0, 0.0))
        );
    }

    #[test]
    fn sides_are_told_at_bends_too() {
        let bend = line(&[(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)]);
        assert!(
            is_left_of(&bend, DVec3::new(5.0, 1.0, 0.0))
                && is_left_of(&bend, DVec3::new(9.0, 5.0, 0.0))
        );
        assert!(
            !is_left_of(&bend, DVec3::new(12.0, -1.0, 0.0))
                && !is_left_of(&bend, DVec3::new(5.0, -1.0, 0.0))
        );
        assert_eq!(halfway(&bend), DVec3::new(10.0, 0.0, 0.0));
        assert!((length_m(&bend) - 20.0).abs() < 1e-12);
        assert_eq!(
            cleaned(line(&[(0.0, 0.0), (0.0, 0.0), (1.0, 0.0)])).len(),
            2
        );
    }
}
