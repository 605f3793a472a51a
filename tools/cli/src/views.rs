//! Cameras around an asset.

use decouplegs_scene::{Bounds, Camera, Intrinsics, Motion, Pose};
use glam::DVec3;

/// Field of view of the cameras on a sphere, radians: close to a car's, far from an orthographic
/// one.
const SPHERE_FOV_RAD: f64 = 0.7;

/// Turn from one camera on a sphere to the next: the golden angle, radians.
const GOLDEN_ANGLE_RAD: f64 = 2.399_963_229_728_653;

/// The focal length of a 1600x900 driving camera with a horizontal field of view of 65 degrees,
/// pixels.
pub const STREET_FOCAL_PX: f64 = 1266.0;

/// The window of a street camera that is examined: it lies wholly on a car 10 m away, seen from
/// the side.
pub const WINDOW_PX: [u32; 2] = [320, 200];

/// Height of a street camera above the asset's center, as a share of its distance.
const STREET_SLOPE: f64 = 0.07;

/// `views` square images from a Fibonacci sphere around the box, far enough that all of it is in
/// each. Spheres of another `turn_rad` have cameras in other directions.
pub fn sphere(bounds: &Bounds, views: usize, size_px: u32, turn_rad: f64) -> Vec<Camera> {
    let radius_m = DVec3::from_array(bounds.half_extent().map(f64::from))
        .length()
        .max(1e-6);
    // A little more, for what splats reach beyond their means.
    let distance_m = 1.05 * radius_m / (0.5 * SPHERE_FOV_RAD).sin();
    let intrinsics = Intrinsics::from_horizontal_fov(size_px, size_px, SPHERE_FOV_RAD);
    let directions = (0..views).map(|view| {
        let z = 1.0 - (2.0 * view as f64 + 1.0) / views as f64;
        let azimuth = view as f64 * GOLDEN_ANGLE_RAD + turn_rad;
        let radius = (1.0 - z * z).sqrt();
        DVec3::new(radius * azimuth.cos(), radius * azimuth.sin(), z)
    });
    directions
        .enumerate()
        .map(|(view, direction)| looking_at(bounds, direction * distance_m, intrinsics, view))
        .collect()
}

/// `views` cameras around the box that stand on a street, `distance_m` from its middle.
pub fn street(
    bounds: &Bounds,
    views: usize,
    distance_m: f64,
    focal_px: f64,
    size_px: [u32; 2],
) -> Vec<Camera> {
    let intrinsics = Intrinsics::centered(size_px, focal_px);
    let camera = |view: usize| {
        let azimuth = 0.3 + std::f64::consts::TAU * view as f64 / views as f64;
        let eye = DVec3::new(azimuth.cos(), azimuth.sin(), STREET_SLOPE) * distance_m;
        looking_at(bounds, eye, intrinsics, view)
    };
    (0..views).map(camera).collect()
}

/// The camera at `from_center` (meters from the box's middle) that looks at the middle.
fn looking_at(bounds: &Bounds, from_center: DVec3, intrinsics: Intrinsics, view: usize) -> Camera {
    let center = DVec3::from_array(bounds.center().map(f64::from));
    let upright = Pose::look_at(center + from_center, center, DVec3::Z);
    // Straight above and below, any direction in the image is as good as another.
    let pose = upright.or_else(|| Pose::look_at(center + from_center, center, DVec3::X));
    Camera {
        name: format!("view {view}"),
        intrinsics,
        world_from_camera: pose.unwrap_or(Pose::IDENTITY),
        motion: Motion::REST,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_of_the_box_is_in_every_image_of_the_sphere() {
        let bounds = Bounds {
            min: [-2.0, -1.0, 3.0],
            max: [2.5, 1.0, 4.5],
        };
        for camera in sphere(&bounds, 33, 100, 0.4) {
            for corner in 0..8u32 {
                let side = |axis: usize| {
                    f64::from(if corner >> axis & 1 == 0 {
                        bounds.min[axis]
                    } else {
                        bounds.max[axis]
                    })
                };
                let seen = camera.world_from_camera.inverse().transform(DVec3::new(
                    side(0),
                    side(1),
                    side(2),
                ));
                let k = &camera.intrinsics;
                let (x, y) = (
                    k.fx_px * seen.x / seen.z + k.cx_px,
                    k.fy_px * seen.y / seen.z + k.cy_px,
                );
                assert!(
                    seen.z > 0.0 && (0.0..100.0).contains(&x) && (0.0..100.0).contains(&y),
                    "{x} {y}"
                );
            }
        }
    }

    #[test]
    fn a_point_can_be_looked_at_from_everywhere() {
        let point = Bounds {
            min: [1.0; 3],
            max: [1.0; 3],
        };
        let poses =
            sphere(&point, 1, 8, 0.0)
                .into_iter()
                .chain(street(&point, 4, 10.0, 50.0, [8, 8]));
        assert!(
            poses
                .map(|camera| camera.world_from_camera)
                .all(|pose| pose.translation.is_finite() && pose != Pose::IDENTITY)
        );
    }
}
