//! Haze of a captured road: splats that hover where the recording vehicle itself drove.
//!
//! Training on images leaves splats decimeters above a smooth road, which show it well from where
//! it was photographed. They veil the wheels of a car that is put there, and no shadow falls on
//! them. Where the vehicle drove nothing stood, so that all of them may go.

use decouplegs_scene::{Obstacle, SplatCloud, TimedPose, VehicleSize};
use glam::{DVec2, DVec3};

use crate::ground::Ground;
use crate::obstacles::outline;
use crate::oriented_box::OrientedBox;
use crate::polyline::Polyline;

/// Height above the ground up to which splats are the road, meters.
pub const ROAD_M: f64 = 0.1;
/// Depth below the ground down to which splats count as those of the road, meters.
const BELOW_M: f64 = 1.0;
/// Distance from an obstacle within which splats are its own, meters.
const OBSTACLE_M: f64 = 0.5;
/// Vehicles whose heights differ by more from a place are on another level, meters.
const LEVEL_M: f64 = 4.0;

/// Haze above a way.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Haze {
    /// Indices of the splats that hover, in order.
    pub splats: Vec<u32>,
    /// Standard deviation of heights about the ground, by opacity and area: of the splats of the
    /// road and above it, and of those that stay, meters.
    pub spreads_m: [f64; 2],
}

/// Sums of the heights of splats about the ground.
#[derive(Clone, Copy, Default)]
struct Spread {
    weight: f64,
    square_m2: f64,
}

impl Spread {
    fn add(&mut self, weight: f64, height_m: f64) {
        self.weight += weight;
        self.square_m2 += weight * height_m * height_m;
    }

    fn meters(self) -> f64 {
        (self.square_m2 / self.weight.max(f64::MIN_POSITIVE)).sqrt()
    }
}

/// Splats of `cloud`, whose means are relative to `origin`, that hover within `beside_m` of the way
/// `poses` of a vehicle of `size`: higher than [`ROAD_M`] above `ground`, lower than its roof, and
/// not next to one of `obstacles`.
#[must_use]
pub fn find(
    (cloud, origin): (&SplatCloud, DVec3),
    ground: &Ground,
    (poses, size): (&[TimedPose], &VehicleSize),
    beside_m: f64,
    obstacles: &[Obstacle],
) -> Haze {
    let places: Vec<DVec3> = poses.iter().map(|timed| timed.pose.translation).collect();
    let Some(way) = Polyline::new(places.iter().copied()) else {
        return Haze::default();
    };
    let wide = |one: &Obstacle| outline(one).widened(OBSTACLE_M);
    let obstacles: Vec<OrientedBox> = obstacles.iter().map(wide).collect();
    let (mut haze, mut spreads) = (Haze::default(), [Spread::default(); 2]);
    let (low, high) = places
        .iter()
        .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), at| {
            (low.min(at.truncate()), high.max(at.truncate()))
        });
    for splat in 0..cloud.len() {
        let at = origin + cloud.mean_m(splat);
        let xy_m = at.truncate();
        let is_near = xy_m.cmpge(low - beside_m).all() && xy_m.cmple(high + beside_m).all();
        if !(is_near && at.is_finite()) {
            continue;
        }
        let foot = way.project(xy_m);
        if foot.distance_m > beside_m || (at.z - foot.point.z).abs() > LEVEL_M {
            continue;
        }
        let expected_m = foot.point.z - 0.5 * size.height_m;
        let Some(below) = ground.height_at(xy_m, Some(expected_m)) else {
            continue;
        };
        let above_m = at.z - below.z_m;
        if !(-BELOW_M..size.height_m).contains(&above_m)
            || obstacles.iter().any(|one| one.contains(xy_m))
        {
            continue;
        }
        let mut scales = cloud.scales[splat].map(f64::from);
        scales.sort_by(f64::total_cmp);
        let weight = f64::from(cloud.opacities[splat]) * scales[1] * scales[2];
        if !weight.is_finite() {
            continue;
        }
        spreads[0].add(weight, above_m);
        if above_m > ROAD_M {
            haze.splats.push(splat as u32);
        } else {
            spreads[1].add(weight, above_m);
        }
    }
    haze.spreads_m = spreads.map(Spread::meters);
    haze
}

#[cfg(test)]
mod tests {
    use decouplegs_scene::{ObstacleKind, Pose};
    use glam::DQuat;

    use super::*;
    use crate::ground::{GroundGuides, GroundOptions, Survey};

    /// Splats at heights above a flat road at 5 m: `(x, y, height)`.
    fn cloud(places: &[[f32; 3]]) -> SplatCloud {
        let count = places.len();
        SplatCloud {
            means: places.to_vec(),
            scales: vec![[0.2, 0.2, 0.01]; count],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; count],
            opacities: vec![0.5; count],
            sh_dc: vec![[0.0; 3]; count],
            ..SplatCloud::default()
        }
    }

    #[test]
    fn what_hovers_where_the_vehicle_drove_is_haze() {
        let origin = DVec3::new(0.0, 0.0, 5.0);
        let cloud = cloud(&[
            [10.0, 0.0, 0.5],  // hovers
            [10.0, 1.9, 0.5],  // hovers at the edge
            [10.0, 0.0, 0.05], // road
            [10.0, 0.0, -0.4], // below the road
            [10.0, 0.0, 1.8],  // above the roof
            [10.0, 2.5, 0.5],  // beside the way
            [20.0, 1.8, 0.5],  // of an obstacle
            [60.0, 0.0, 0.5],  // after the way
            [f32::NAN, 0.0, 0.5],
        ]);
        let poses: Vec<TimedPose> = (0..40)
            .map(|x| TimedPose {
                time_s: f64::from(x),
                pose: Pose::new(DQuat::IDENTITY, DVec3::new(f64::from(x), 0.0, 5.75)),
            })
            .collect();
        let size = VehicleSize::from_array([4.5, 1.8, 1.5]);
        let points_m = (0..400).flat_map(|x| {
            (-15..15).map(move |y| DVec3::new(0.2 * f64::from(x), 0.2 * f64::from(y), 5.0))
        });
        let survey = Survey::from_points(points_m.collect());
        let guides = GroundGuides {
            survey: survey.as_ref(),
            ..GroundGuides::for_way(&poses, Some(0.75))
        };
        let ground = Ground::new(&cloud, origin, &GroundOptions::default()).guided(&cloud, guides);
        let post = Obstacle {
            kind: ObstacleKind::Captured,
            center_m: DVec2::new(20.0, 2.3),
            yaw_rad: 0.0,
            length_m: 0.3,
            width_m: 0.3,
        };
        let find = |beside_m: f64, obstacles: &[Obstacle]| {
            find(
                (&cloud, origin),
                &ground,
                (&poses, &size),
                beside_m,
                obstacles,
            )
        };
        let haze = find(2.0, &[post]);
        assert_eq!(haze.splats, [0, 1]);
        // Of two at 0.5 m, one at 0.05 and one at -0.4 m; the last two stay.
        let expected_m = [0.665, 0.1625].map(|sum: f64| sum);
        assert!(
            (haze.spreads_m[0] - (expected_m[0] / 4.0).sqrt()).abs() < 2e-3,
            "{haze:?}"
        );
        assert!(
            (haze.spreads_m[1] - (expected_m[1] / 2.0).sqrt()).abs() < 2e-3,
            "{haze:?}"
        );
        assert_eq!(find(2.0, &[]).splats, [0, 1, 6]);
        assert_eq!(find(1.2, &[]).splats, [0]);
    }

    #[test]
    fn a_vehicle_that_stood_has_no_haze() {
        let cloud = cloud(&[[0.0, 0.0, 0.5]]);
        let ground = Ground::new(&cloud, DVec3::ZERO, &GroundOptions::default());
        let size = VehicleSize::from_array([4.5, 1.8, 1.5]);
        let haze = find((&cloud, DVec3::ZERO), &ground, (&[], &size), 2.0, &[]);
        assert_eq!(haze, Haze::default());
    }
}
