//! Obstacles on and beside the roads, as boxes in the orange of barriers.

use decouplegs_scene::Obstacle;
use glam::{DVec3, Vec2, Vec3};

use super::Drawn;
use super::canvas::{Canvas, Look};
use super::houses::tiles;
use super::relief::Relief;
use crate::street::surface::display;

/// Height of a box, meters.
const HEIGHT_M: f32 = 1.0;
/// Patches along the longer side of a face, and largest patch, meters.
const PATCHES: f32 = 4.0;
const PATCH_M_MAX: f32 = 0.25;
/// Objects farther than this from the middle of the map are not drawn, meters.
const FAR_M: f64 = 50_000.0;

/// A box on the ground.
pub(super) struct Object {
    middle: Vec3,
    /// Vectors from the middle to the front and to the left side.
    ahead: Vec3,
    left: Vec3,
}

/// The boxes of `obstacles`, relative to `origin`.
pub(super) fn objects(obstacles: &[Obstacle], origin: DVec3, relief: &Relief) -> Vec<Object> {
    let near = obstacles
        .iter()
        .filter(|one| one.center_m.distance(origin.truncate()) < FAR_M);
    near.map(|one| {
        let middle = (one.center_m - origin.truncate()).as_vec2();
        let ahead = Vec2::from_angle(one.yaw_rad as f32);
        Object {
            middle: middle.extend(relief.height_m(middle)),
            ahead: (ahead * (0.5 * one.length_m as f32)).extend(0.0),
            left: (ahead.perp() * (0.5 * one.width_m as f32)).extend(0.0),
        }
    })
    .collect()
}

/// Draws all boxes.
pub(super) fn draw(canvas: &mut Canvas, place: &Drawn) {
    let color = display(222, 96, 32);
    for object in &place.objects {
        let corner = |u: f32, v: f32| object.middle + object.ahead * u + object.left * v;
        let (ahead, left, up) = (2.0 * object.ahead, 2.0 * object.left, Vec3::Z * HEIGHT_M);
        let faces = [
            (corner(-1.0, -1.0), ahead, up),
            (corner(1.0, -1.0), left, up),
            (corner(1.0, 1.0), -ahead, up),
            (corner(-1.0, 1.0), -left, up),
            (corner(-1.0, -1.0) + up, ahead, left),
        ];
        for face in faces {
            let longer_m = face.1.length().max(face.2.length());
            let patch_m = (longer_m / PATCHES).min(PATCH_M_MAX);
            tiles(canvas, face, patch_m, |_, _| {
                (color, Look::Lit { gloss: 0.0 })
            });
        }
    }
}
