//! Lines measured along their length, with headings that do not jump.

use glam::{DVec2, DVec3};

/// A line of at least two points.
#[derive(Clone, Debug, PartialEq)]
pub struct Polyline {
    points: Vec<DVec3>,
    /// Length up to each point, meters, from above: heights do not count.
    arcs: Vec<f64>,
    /// Heading of each segment; unwrapped, so that neighbors differ by less than pi.
    headings: Vec<f64>,
}

/// The position on a line nearest to a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Foot {
    /// Length along the line up to it, meters.
    pub arc_m: f64,
    /// The position itself.
    pub point: DVec3,
    /// Heading of the line there, radians, as [`Polyline::heading_at`].
    pub heading_rad: f64,
    /// Offset of the point across the line, meters, positive to the left.
    pub lateral_m: f64,
    /// Distance from the line to the point, meters; more than the lateral offset beyond the line's
    /// ends.
    pub distance_m: f64,
}

/// Points nearer to each other than this are one, meters.
const SAME_POINT_M: f64 = 1e-6;
/// A heading is that of the chord from so far before a position to so far behind it, meters: about
/// the length of a car, so that a corner of the line turns as a car does, while the middle of a
/// long segment points where the segment does.
const HALF_CHORD_M: f64 = 2.0;

impl Polyline {
    /// The line through `points`, repeated ones left out; `None` where fewer than two are left or
    /// one is not finite.
    #[must_use]
    pub fn new(points: impl IntoIterator<Item = DVec3>) -> Option<Self> {
        let mut kept: Vec<DVec3> = Vec::new();
        for point in points {
            if !point.is_finite() {
                return None;
            }
            if kept
                .last()
                .is_none_or(|last| last.truncate().distance(point.truncate()) > SAME_POINT_M)
            {
                kept.push(point);
            }
        }
        if kept.len() < 2 {
            return None;
        }
        let mut arcs = vec![0.0];
        for pair in kept.windows(2) {
            arcs.push(arcs[arcs.len() - 1] + pair[0].truncate().distance(pair[1].truncate()));
        }
        arcs[arcs.len() - 1].is_finite().then(|| Self {
            headings: segment_headings(&kept),
            points: kept,
            arcs,
        })
    }

    /// The points it goes through.
    #[must_use]
    pub fn points(&self) -> &[DVec3] {
        &self.points
    }

    /// Meters from end to end.
    #[must_use]
    pub fn length_m(&self) -> f64 {
        self.arcs[self.arcs.len() - 1]
    }

    /// Length up to each of [`Polyline::points`], meters.
    #[must_use]
    pub fn arcs_m(&self) -> &[f64] {
        &self.arcs
    }

    /// The position `arc_m` along it, its ends beyond them.
    #[must_use]
    pub fn at(&self, arc_m: f64) -> DVec3 {
        let (segment, share) = self.locate(arc_m);
        self.points[segment].lerp(self.points[segment + 1], share)
    }

    /// Heading `arc_m` along it, radians: that of a chord of 4 m about it; not wrapped to a turn.
    #[must_use]
    pub fn heading_at(&self, arc_m: f64) -> f64 {
        let heading_rad = self.headings[self.segment_at(arc_m)];
        let chord = (self.at(arc_m + HALF_CHORD_M) - self.at(arc_m - HALF_CHORD_M)).truncate();
        if chord.length() < HALF_CHORD_M {
            // A line that turns back within the chord: its own segment says more.
            return heading_rad;
        }
        heading_rad + wrapped(chord.to_angle() - heading_rad)
    }

    /// Direction across the line, to the left, in which its distance from `at` grows: `foot` is the
    /// position nearest to `at`. Beside a corner, that is the way from the corner; beyond an end of
    /// the line, across its last segment, as nothing is known along it.
    pub(crate) fn across(&self, foot: &Foot, at: DVec2) -> DVec2 {
        let segment = self.segment_at(foot.arc_m);
        let normal = DVec2::from_angle(self.headings[segment]).perp();
        let last = self.points.len() - 1;
        let corner = [segment, segment + 1]
            .into_iter()
            .any(|at| 0 < at && at < last && (self.arcs[at] - foot.arc_m).abs() < SAME_POINT_M);
        let away = if corner {
            (at - foot.point.truncate()).try_normalize()
        } else {
            None
        };
        away.map_or(
            normal,
            |away| if away.dot(normal) < 0.0 { -away } else { away },
        )
    }

    /// Height a meter along it at `arc_m`.
    #[must_use]
    pub fn grade_at(&self, arc_m: f64) -> f64 {
        let (segment, _) = self.locate(arc_m);
        (self.points[segment + 1].z - self.points[segment].z)
            / (self.arcs[segment + 1] - self.arcs[segment])
    }

    fn locate(&self, arc_m: f64) -> (usize, f64) {
        let segment = self.segment_at(arc_m);
        let share = (arc_m - self.arcs[segment]) / (self.arcs[segment + 1] - self.arcs[segment]);
        (segment, share.clamp(0.0, 1.0))
    }

    fn segment_at(&self, arc_m: f64) -> usize {
        self.arcs
            .partition_point(|&arc| arc <= arc_m)
            .saturating_sub(1)
            .min(self.points.len() - 2)
    }

    /// The position nearest to `at`.
    #[must_use]
    pub fn project(&self, at: DVec2) -> Foot {
        self.project_within(at, f64::NEG_INFINITY, f64::INFINITY)
    }

    /// The position nearest to `at` between two lengths along the line.
    #[must_use]
    pub fn project_within(&self, at: DVec2, from_m: f64, to_m: f64) -> Foot {
        // What is no number is taken for the line's start.
        let within = |arc_m: f64| arc_m.clamp(0.0, self.length_m()).max(0.0);
        let (from_m, to_m) = (within(from_m), within(to_m));
        let segments = self.segment_at(from_m)..=self.segment_at(to_m);
        let nearest = |segment: usize| {
            let arc_m = self.arcs[segment]
                + self.share_of(segment, at) * (self.arcs[segment + 1] - self.arcs[segment]);
            let arc_m = arc_m.clamp(from_m, to_m.max(from_m));
            (self.at(arc_m).truncate().distance_squared(at), arc_m)
        };
        let best = segments.map(nearest).min_by(|a, b| a.0.total_cmp(&b.0));
        self.foot(at, best.map_or(from_m, |best| best.1))
    }

    /// Position of the nearest point to `at` along segment `segment`, 0 to 1.
    pub(crate) fn share_of(&self, segment: usize, at: DVec2) -> f64 {
        let (a, b) = (
            self.points[segment].truncate(),
            self.points[segment + 1].truncate(),
        );
        ((at - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0)
    }

    /// The foot of `at` where it is known to be `arc_m` along the line.
    pub(crate) fn foot(&self, at: DVec2, arc_m: f64) -> Foot {
        let (point, heading_rad) = (self.at(arc_m), self.heading_at(arc_m));
        let off = at - point.truncate();
        // Across the segment itself: the interpolated heading would lean where the line is coarse.
        let segment = self.segment_at(arc_m);
        let along = (self.points[segment + 1] - self.points[segment])
            .truncate()
            .normalize_or_zero();
        let lateral_m = along.perp_dot(off);
        Foot {
            arc_m,
            point,
            heading_rad,
            lateral_m,
            distance_m: off.length(),
        }
    }
}

/// Angles between neighbors by the shorter way around.
fn segment_headings(points: &[DVec3]) -> Vec<f64> {
    let mut segments: Vec<f64> = Vec::with_capacity(points.len() - 1);
    for pair in points.windows(2) {
        let heading = (pair[1] - pair[0]).truncate().to_angle();
        let last = segments.last().copied().unwrap_or(heading);
        segments.push(last + wrapped(heading - last));
    }
    segments
}

/// The same angle between -pi and pi.
#[must_use]
pub fn wrapped(angle_rad: f64) -> f64 {
    angle_rad - std::f64::consts::TAU * (angle_rad / std::f64::consts::TAU).round()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_offsets_and_headings_are_those_of_the_line() {
        let line = Polyline::new(
            [
                [0.0, 0.0, 0.0],
                [0.0, 0.0, 0.0],
                [10.0, 0.0, 1.0],
                [10.0, 10.0, 1.0],
            ]
            .map(DVec3::from_array),
        )
        .unwrap();
        assert_eq!((line.points().len(), line.length_m()), (3, 20.0));
        let foot = line.project(DVec2::new(4.0, 0.5));
        assert_eq!((foot.arc_m, foot.lateral_m, foot.point.z), (4.0, 0.5, 0.4));
        let beyond = line.project(DVec2::new(10.5, 13.0));
        assert!((beyond.arc_m - 20.0).abs() < 1e-12 && beyond.distance_m > 3.0);
        assert!((line.heading_at(10.0) - std::f64::consts::FRAC_PI_4).abs() < 1e-12);
        let windowed = line.project_within(DVec2::new(4.0, 0.5), 11.0, 15.0);
        assert_eq!(windowed.arc_m, 11.0);
        assert_eq!(line.grade_at(3.0), 0.1);
    }

    #[test]
    fn headings_do_not_jump_where_angles_do() {
        let circle = (0..200).map(|at| DVec2::from_angle(0.1 * f64::from(at)).extend(0.0) * 20.0);
        let line = Polyline::new(circle).unwrap();
        let mut last = line.heading_at(0.0);
        for at in 1..4000 {
            let heading = line.heading_at(0.1 * f64::from(at));
            assert!(
                (heading - last).abs() < 0.02,
                "at {at}: {last} to {heading}"
            );
            last = heading;
        }
    }

    #[test]
    fn beside_a_corner_the_distance_grows_away_from_it_and_beside_a_segment_across_it() {
        let line = Polyline::new(
            [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [10.0, 10.0, 0.0]].map(DVec3::from_array),
        )
        .unwrap();
        let across =
            |x: f64, y: f64| line.across(&line.project(DVec2::new(x, y)), DVec2::new(x, y));
        assert!(
            across(4.0, -0.5).distance(DVec2::Y) < 1e-12
                && across(10.2, 6.0).distance(DVec2::NEG_X) < 1e-12
        );
        // Outside the corner, to its right.
        assert!(across(11.0, -1.0).distance(DVec2::new(-1.0, 1.0).normalize()) < 1e-9);
        // Beyond an end nothing is known along the line.
        assert!(across(-3.0, 1.0).distance(DVec2::Y) < 1e-12);
        // The middle of a long segment points where the segment does, though a corner follows.
        assert_eq!(line.heading_at(5.0), 0.0);
    }

    #[test]
    fn what_is_no_line_is_refused() {
        assert!(Polyline::new([DVec3::ZERO; 5]).is_none());
        assert!(Polyline::new([DVec3::ZERO, DVec3::NAN]).is_none());
        assert!(Polyline::new([DVec3::ZERO, DVec3::X * 1e200, -DVec3::X * 1.7e308]).is_none());
    }
}
