//! Support of a captured scene: places near the views that it was seen from, in their directions.

use std::collections::HashMap;

use decouplegs_scene::CapturedView;
use glam::{DVec2, DVec3};

use crate::polyline::wrapped;
use crate::route::Route;

/// Distance between places along a route that are examined, meters.
const STRIDE_M: f64 = 1.0;
/// Views one after the other that are no farther apart than this are of one way, meters; between
/// them the scene was seen too.
const GAP_M_MAX: f64 = 20.0;
/// Distance between views that are put between two of a way, meters.
const BETWEEN_M: f64 = 1.0;
/// Least part of a direction of view that lies in the plane: one that looks up or down faces no
/// way.
const LEVEL_MIN: f64 = 0.3;

/// Places and headings from which a scene was seen.
#[derive(Clone, Debug)]
pub struct ViewSupport {
    /// Views by the square of [`ViewSupport::NEAR_M`] that they lie in.
    squares: HashMap<(i64, i64), Vec<(DVec2, f64)>>,
}

impl ViewSupport {
    /// A vehicle farther than this from all views is where the scene was not seen from, meters: a
    /// lane beside that of the capture is near enough.
    pub const NEAR_M: f64 = 5.0;
    /// A vehicle that heads farther aside than this from all views near it looks where none looked,
    /// radians: 40 degrees.
    pub const TURN_RAD: f64 = 0.7;

    /// The support of `views`; `None` where not one of them looks along the ground.
    #[must_use]
    pub fn from_views(views: &[CapturedView]) -> Option<Self> {
        let mut support = Self {
            squares: HashMap::new(),
        };
        let mut last: Option<(DVec3, f64)> = None;
        for view in views {
            let level = view.ahead.truncate();
            if !(level.length() >= LEVEL_MIN && view.position_m.is_finite()) {
                continue;
            }
            let (at, yaw_rad) = (view.position_m, level.to_angle());
            if let Some((from, from_rad)) = last {
                support.add_between((from, from_rad), (at, yaw_rad));
            }
            support.add(at.truncate(), yaw_rad);
            last = Some((at, yaw_rad));
        }
        (!support.squares.is_empty()).then_some(support)
    }

    /// Adds the views between two of one way.
    fn add_between(&mut self, from: (DVec3, f64), to: (DVec3, f64)) {
        let turn_rad = wrapped(to.1 - from.1);
        let way_m = from.0.distance(to.0);
        if way_m > GAP_M_MAX || turn_rad.abs() > Self::TURN_RAD {
            return;
        }
        let steps = (way_m / BETWEEN_M).ceil() as u32;
        for step in 1..steps {
            let share = f64::from(step) / f64::from(steps);
            self.add(
                from.0.lerp(to.0, share).truncate(),
                from.1 + share * turn_rad,
            );
        }
    }

    fn add(&mut self, at: DVec2, yaw_rad: f64) {
        self.squares
            .entry(square(at))
            .or_default()
            .push((at, yaw_rad));
    }

    /// True if the scene was seen from near `at`, world coordinates in meters, with a heading near
    /// `yaw_rad`.
    #[must_use]
    pub fn holds(&self, at: DVec2, yaw_rad: f64) -> bool {
        let (x, y) = square(at);
        let is_near = |(place, heading_rad): &(DVec2, f64)| {
            place.distance(at) <= Self::NEAR_M
                && wrapped(yaw_rad - heading_rad).abs() <= Self::TURN_RAD
        };
        let around = (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (x + dx, y + dy)));
        around
            .filter_map(|square| self.squares.get(&square))
            .flatten()
            .any(is_near)
    }

    /// Distance along `route` up to which it leads where the scene was seen from, meters.
    #[must_use]
    pub fn along_m(&self, route: &Route) -> f64 {
        let strides = (route.length_m() / STRIDE_M).ceil() as u32;
        let mut at_m = (0..=strides).map(|stride| {
            let at_m = (f64::from(stride) * STRIDE_M).min(route.length_m());
            (at_m, route.pose_at(at_m))
        });
        let left = at_m.find(|(_, (at, yaw_rad))| !self.holds(at.truncate(), *yaw_rad));
        left.map_or(route.length_m(), |(at_m, _)| (at_m - STRIDE_M).max(0.0))
    }
}

fn square(at: DVec2) -> (i64, i64) {
    let square = (at / ViewSupport::NEAR_M).floor();
    (square.x as i64, square.y as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn way(ys_m: [f64; 2], step_m: f64) -> Vec<CapturedView> {
        let view = |index: u32| CapturedView {
            position_m: DVec3::new(
                f64::from(index) * step_m,
                ys_m[0] + (ys_m[1] - ys_m[0]) * f64::from(index),
                1.0,
            ),
            ahead: DVec3::X,
        };
        (0..10).map(view).collect()
    }

    #[test]
    fn a_scene_is_seen_near_its_views_and_in_their_directions() {
        let support = ViewSupport::from_views(&way([0.0, 0.0], 10.0)).unwrap();
        let holds = |x, y, yaw_rad| support.holds(DVec2::new(x, y), yaw_rad);
        assert!(holds(0.0, 0.0, 0.0));
        // Halfway between two views.
        assert!(holds(45.0, 4.9, 0.0));
        assert!(!holds(45.0, 5.1, 0.0));
        assert!(holds(94.9, 0.0, 0.6) && !holds(95.1, 0.0, 0.6));
        assert!(!holds(45.0, 0.0, 0.8) && !holds(45.0, 0.0, std::f64::consts::PI));
        // Headings wrap around.
        assert!(holds(45.0, 0.0, 2.0 * std::f64::consts::PI - 0.5));
    }

    #[test]
    fn nothing_is_seen_between_views_of_two_ways() {
        let support = ViewSupport::from_views(&way([0.0, 0.0], 30.0)).unwrap();
        assert!(!support.holds(DVec2::new(15.0, 0.0), 0.0));
        let mut views = way([0.0, 0.0], 10.0);
        // Back on the same way.
        views.extend(way([0.0, 0.0], 10.0).iter().rev().map(|view| CapturedView {
            ahead: -view.ahead,
            ..*view
        }));
        let support = ViewSupport::from_views(&views).unwrap();
        assert!(support.holds(DVec2::new(45.0, 0.0), 0.0));
        assert!(support.holds(DVec2::new(45.0, 0.0), 3.1));
        assert!(!support.holds(DVec2::new(45.0, 0.0), 1.5));
    }

    #[test]
    fn views_that_face_no_way_support_none() {
        let down = CapturedView {
            position_m: DVec3::ZERO,
            ahead: DVec3::NEG_Z,
        };
        assert!(ViewSupport::from_views(&[down]).is_none());
        assert!(ViewSupport::from_views(&[]).is_none());
        let nowhere = CapturedView {
            position_m: DVec3::NAN,
            ahead: DVec3::X,
        };
        assert!(ViewSupport::from_views(&[nowhere]).is_none());
    }
}
