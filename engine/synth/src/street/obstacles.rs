//! Boxes of what stands along the street.

use decouplegs_scene::{Obstacle, ObstacleKind};
use glam::Vec3;

use super::car::Build;
use super::layout::{Layout, Spot};
use super::signals::signal_feet;
use super::variant_of;

/// Side of the square that stands for a trunk or a post, meters.
const TRUNK_M: f64 = 0.36;
const POST_M: f64 = 0.3;

/// Houses, trunks, posts of lamps and traffic lights, and parked cars of a street. Nothing that a
/// car drives below is among them.
pub(super) fn obstacles(layout: &Layout) -> Vec<Obstacle> {
    let at = |kind: ObstacleKind, spot: &Spot, length_m: f64, width_m: f64| Obstacle {
        kind,
        center_m: spot.position.truncate().as_dvec2(),
        yaw_rad: f64::from(spot.yaw_rad),
        length_m,
        width_m,
    };
    let houses = layout.lots.iter().map(|lot| {
        let middle = lot.rotation() * Vec3::new(0.5 * lot.size.x, 0.5 * lot.size.y, 0.0);
        Obstacle {
            kind: ObstacleKind::House,
            center_m: (lot.translation() + middle).truncate().as_dvec2(),
            yaw_rad: f64::from(lot.yaw_rad),
            length_m: f64::from(lot.size.x),
            width_m: f64::from(lot.size.y),
        }
    });
    let trees = layout.trees.iter();
    let lamps = layout.lamps.iter().copied();
    let signals = signal_feet().map(|(position, yaw_rad, _)| Spot {
        position,
        yaw_rad,
        seed: 0,
    });
    let posts = lamps.chain(signals);
    let parked = layout.parked.iter().map(|spot| {
        let size = Build::for_variant(variant_of(spot)).0.size.as_dvec3();
        at(ObstacleKind::ParkedCar, spot, size.x, size.y)
    });
    houses
        .chain(trees.map(|spot| at(ObstacleKind::Tree, spot, TRUNK_M, TRUNK_M)))
        .chain(posts.map(|spot| at(ObstacleKind::Post, &spot, POST_M, POST_M)))
        .chain(parked)
        .collect()
}
