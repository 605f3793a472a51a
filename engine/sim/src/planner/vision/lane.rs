//! The lane that the ego believes itself in.

use glam::DVec2;

use super::markings::LaneFix;
use super::way::{RoadPath, seen_from};

/// Width of a lane until it is measured, meters.
const WIDTH_M: f64 = 3.4;
/// The rear axle, which does not slip, lies this share of the length behind the middle of the box.
const REAR_AXLE_SHARE: f64 = 0.3;
/// Filter gain of a newly measured width.
const WIDTH_GAIN: f64 = 0.3;
/// A believed lane never lies farther from the ego than this, meters: it would be another one.
const OFFSET_M_MAX: f64 = 2.0;

/// Motion of the ego from one image to the next.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    /// Distance driven by the rear axle, meters.
    pub driven_m: f64,
    /// Change of heading, radians, positive to the left.
    pub turned_rad: f64,
    /// Progress along the way, as navigation tells, meters.
    pub progress_m: Option<f64>,
}

/// Estimated lane of the ego, with standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LaneBelief {
    /// Offset of its center from the ego, positive to the left, meters.
    pub offset_m: f64,
    /// Heading in the ego's frame.
    pub heading_rad: f64,
    /// 1/m, to the left where above zero.
    pub curvature: f64,
    /// Width from border to border, meters.
    pub width_m: f64,
    pub offset_sigma_m: f64,
    pub heading_sigma_rad: f64,
    pub curvature_sigma: f64,
    pub width_sigma_m: f64,
    /// Distance driven since the markings were last seen, meters.
    pub unseen_m: f64,
}

impl LaneBelief {
    /// Assumption at the start: the ego stands in a lane, along it, near its center.
    pub(super) fn at_start() -> Self {
        Self {
            offset_m: 0.0,
            heading_rad: 0.0,
            curvature: 0.0,
            width_m: WIDTH_M,
            offset_sigma_m: 0.3,
            heading_sigma_rad: 0.04,
            curvature_sigma: 0.003,
            width_sigma_m: 0.25,
            unseen_m: 0.0,
        }
    }

    /// The belief after the ego moved by `step` while the way was `way`. Where navigation gives the
    /// progress on the way, that is taken: from the image alone, another position in a bend looks
    /// like another heading.
    pub(super) fn moved(&self, way: &RoadPath, step: &Step, length_m: f64) -> Self {
        let Step {
            driven_m,
            turned_rad,
            progress_m,
        } = *step;
        let to_rear = REAR_AXLE_SHARE * length_m;
        let half_rad = 0.5 * turned_rad;
        let chord = if half_rad.abs() < 1e-6 {
            1.0
        } else {
            half_rad.sin() / half_rad
        };
        let at_m = DVec2::from_angle(half_rad) * (chord * driven_m)
            + (DVec2::from_angle(turned_rad) - DVec2::X) * to_rear;
        let foot = progress_m.map_or_else(
            || way.nearest(at_m, 1.5 * driven_m + 2.0),
            |arc_m| way.at(arc_m),
        );
        let (offset_m, heading_rad) = seen_from(at_m, turned_rad, &foot);
        Self {
            offset_m: offset_m.clamp(-OFFSET_M_MAX, OFFSET_M_MAX),
            heading_rad,
            curvature: self.curvature,
            offset_sigma_m: self
                .offset_sigma_m
                .hypot(0.06 + 0.015 * driven_m + 0.5 * turned_rad.abs())
                .min(0.8),
            heading_sigma_rad: self
                .heading_sigma_rad
                .hypot(0.008 + 0.1 * turned_rad.abs())
                .min(0.12),
            curvature_sigma: self
                .curvature_sigma
                .hypot(0.0005 + 0.0001 * driven_m)
                .min(0.006),
            unseen_m: self.unseen_m + driven_m,
            ..*self
        }
    }

    /// The belief after the markings showed the lane as `fix` says, relative to `way` at
    /// `reference_m` along it.
    ///
    /// The whole way is turned and moved as one piece, so that a lane beyond a turn also tells how
    /// the ego stands in the turn.
    pub(super) fn corrected(&self, fix: &LaneFix, way: &RoadPath, reference_m: f64) -> Self {
        let (beside, there) = (way.at(0.0), way.at(reference_m));
        let moved_m = there.left() * fix.offset_m
            + (beside.position_m - there.position_m).perp() * fix.heading_rad;
        let here = reference_m == 0.0;
        Self {
            offset_m: (self.offset_m + moved_m.dot(beside.left()))
                .clamp(-OFFSET_M_MAX, OFFSET_M_MAX),
            heading_rad: self.heading_rad + fix.heading_rad,
            curvature: if here {
                self.curvature + fix.curvature
            } else {
                self.curvature
            },
            width_m: self.width_m + WIDTH_GAIN * (fix.width_m - self.width_m),
            offset_sigma_m: self.offset_sigma_m.min(0.15),
            heading_sigma_rad: self.heading_sigma_rad.min(0.012),
            curvature_sigma: if here {
                self.curvature_sigma.min(0.0015)
            } else {
                self.curvature_sigma
            },
            width_sigma_m: self.width_sigma_m.min(0.15),
            unseen_m: 0.0,
        }
    }
}
