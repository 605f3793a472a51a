//! Level of detail by camera path: training refines surfaces that its cameras saw large, so splats
//! are densest and smallest along the path.

use glam::{DVec3, Vec3};

use super::surface::Element;
use super::{lanes, traffic};

/// Distance from the ego's way at which density has halved, meters.
const HALVED_AT_M: f32 = 11.0;

/// The least share of its density that an element keeps however far it is.
const SHARE_MIN: f32 = 0.1;

/// Every how many knots the ego's way is bent: in its turn, half a second of arc departs 0.1 m from
/// its chord.
const KNOT_STRIDE: usize = 5;

/// Standard deviation over distance from a camera, at most. A larger splat beside a camera's image
/// plane spreads over the whole image, since perspective is no longer linear across it; training
/// would have split it.
const LARGEST_OVER_DISTANCE: f32 = 0.25;

/// Height of the cameras over the road, meters.
const CAMERA_HEIGHT_M: f32 = 1.6;

/// Lanes that are driven are examined from within this of the origin, meters: beyond, there is
/// little to see.
const DRIVEN_M: f32 = 110.0;

/// Positions of the cameras of a street's capture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Capture {
    /// Cameras on the way of the street's own ego.
    #[default]
    Ego,
    /// Cameras in every lane of both streets: for those who drive where they like.
    Lanes,
}

/// The positions that the cameras pass.
pub(super) struct Focus {
    /// Straight pieces.
    legs: Vec<[Vec3; 2]>,
}

impl Focus {
    pub(super) fn new(capture: Capture) -> Self {
        match capture {
            Capture::Ego => {
                let way = traffic::ego();
                let bends = way.iter().step_by(KNOT_STRIDE).chain(way.last());
                let passed: Vec<Vec3> = bends
                    .map(|(_, pose)| at_camera_height(pose.translation))
                    .collect();
                Self {
                    legs: passed.windows(2).map(|leg| [leg[0], leg[1]]).collect(),
                }
            }
            Capture::Lanes => {
                let lanes = lanes::lanes().lanes;
                let legs = lanes.iter().flat_map(|lane| lane.centerline.windows(2));
                let legs = legs.map(|leg| [leg[0], leg[1]].map(at_camera_height));
                Self {
                    legs: legs
                        .filter(|leg| leg[0].length().min(leg[1].length()) < DRIVEN_M)
                        .collect(),
                }
            }
        }
    }

    /// Focus without a way: assets are seen from anywhere.
    pub(super) fn nowhere() -> Self {
        Self { legs: Vec::new() }
    }

    /// The element with the density that its middle's distance leaves it.
    pub(super) fn on(&self, element: Element) -> Element {
        let share = self.share(element.middle());
        element.denser(share)
    }

    /// The largest standard deviation of a splat at `position`, meters.
    pub(super) fn largest_m(&self, position: Vec3) -> f32 {
        LARGEST_OVER_DISTANCE * self.nearest_m(position)
    }

    fn nearest_m(&self, position: Vec3) -> f32 {
        let to_leg_squared = |leg: &[Vec3; 2]| {
            let (along, offset) = (leg[1] - leg[0], position - leg[0]);
            let share = (offset.dot(along) / along.length_squared().max(1e-6)).clamp(0.0, 1.0);
            (offset - along * share).length_squared()
        };
        self.legs
            .iter()
            .map(to_leg_squared)
            .fold(f32::MAX, f32::min)
            .sqrt()
    }

    fn share(&self, position: Vec3) -> f32 {
        (1.0 / (1.0 + self.nearest_m(position) / HALVED_AT_M)).max(SHARE_MIN)
    }
}

fn at_camera_height(position: DVec3) -> Vec3 {
    position.as_vec3().with_z(CAMERA_HEIGHT_M)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn density_falls_with_distance_from_the_way_and_never_to_nothing() {
        let focus = Focus::new(Capture::Ego);
        let on_the_way = focus.share(Vec3::new(-30.0, -5.0, 0.8));
        let across = focus.share(Vec3::new(-30.0, 13.0, 3.0));
        assert!(
            on_the_way > 0.9 && across < 0.6 * on_the_way && across > SHARE_MIN,
            "{on_the_way}, {across}"
        );
        assert_eq!(focus.share(Vec3::splat(1e6)), SHARE_MIN);
        assert_eq!(Focus::nowhere().share(Vec3::ZERO), SHARE_MIN);
    }

    #[test]
    fn whoever_drives_in_any_lane_has_small_splats_about_him() {
        let focus = Focus::new(Capture::Lanes);
        let lane_m = f64::from(crate::street::layout::LANE_M) as f32;
        for position in [
            Vec3::new(-60.0, 1.5 * lane_m, 0.0),
            Vec3::new(40.0 + 0.5 * lane_m, 70.0, 0.0),
        ] {
            assert!(
                focus.largest_m(position) < 0.41,
                "{position}: {}",
                focus.largest_m(position)
            );
            assert!(Focus::new(Capture::Ego).largest_m(position) > focus.largest_m(position));
        }
    }
}
