//! Framing: cameras that show the whole of something.

use glam::{DQuat, DVec3};
use rayon::prelude::*;

use crate::{Camera, Intrinsics, Pose, SplatCloud};

/// The middle and the size are those of this share of the splats, on each axis: a few stray ones
/// are far away in every capture.
const CORE: f64 = 0.9;
/// Splats with a smaller opacity do not count.
const OPACITY_MIN: f32 = 0.1;
/// The least radius, meters: that of one splat.
const RADIUS_MIN_M: f64 = 1e-3;
/// Directions to cameras rise from the level by this angle, radians.
const ELEVATION_RAD: f64 = 20.0 * std::f64::consts::PI / 180.0;
/// The sphere fills this share of the image's shorter side.
const FILLED: f64 = 0.8;

/// The sphere that an image is to show.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Framing {
    /// Center, world coordinates, meters.
    pub center: DVec3,
    /// Radius, meters, above 0.
    pub radius_m: f64,
}

impl Framing {
    /// Field of view of [`Framing::camera`] across the longer side of an image, radians.
    pub const VIEW_RAD: f64 = 60.0 * std::f64::consts::PI / 180.0;

    /// The sphere around a box, whose corners are in world coordinates, meters.
    #[must_use]
    pub fn from_box(min: DVec3, max: DVec3) -> Self {
        Self {
            center: 0.5 * (min + max),
            radius_m: (0.5 * (max - min).length()).max(RADIUS_MIN_M),
        }
    }

    /// The sphere around the core of the splats that can be seen, whose means are relative to
    /// `origin`, world coordinates: around the middle 90 % of them on each axis. `None` where there
    /// are none.
    #[must_use]
    pub fn from_splats(splats: &SplatCloud, origin: DVec3) -> Option<Self> {
        let is_seen = |splat: &usize| {
            splats.opacities[*splat] >= OPACITY_MIN && splats.defect_of(*splat).is_none()
        };
        let seen: Vec<usize> = (0..splats.len()).into_par_iter().filter(is_seen).collect();
        let last = seen.len().checked_sub(1)?;
        let spans: Vec<(f64, f64)> = (0..3)
            .into_par_iter()
            .map(|axis| {
                let along = seen.iter().map(|&splat| splats.means[splat][axis]);
                let mut along: Vec<f32> = along.collect();
                let mut at = |share: f64| {
                    let place = (share * last as f64).round() as usize;
                    f64::from(*along.select_nth_unstable_by(place, f32::total_cmp).1)
                };
                (at(0.5 - 0.5 * CORE), at(0.5 + 0.5 * CORE))
            })
            .collect();
        let corner = |of: fn(&(f64, f64)) -> f64| {
            DVec3::from_array(std::array::from_fn(|axis| of(&spans[axis])))
        };
        let framed = Self::from_box(corner(|span| span.0), corner(|span| span.1));
        Some(Self {
            center: framed.center + origin,
            ..framed
        })
    }

    /// A camera that shows the sphere: a pinhole with a field of view of [`Framing::VIEW_RAD`]
    /// across the longer side of its image of `size_px`, width and height. It stands from the
    /// center towards `direction`, of any length, with `up` up in the image. `None` where the two
    /// are parallel or no directions.
    #[must_use]
    pub fn camera(
        &self,
        name: impl Into<String>,
        size_px: [u32; 2],
        direction: DVec3,
        up: DVec3,
    ) -> Option<Camera> {
        let [width_px, height_px] = size_px;
        let intrinsics =
            Intrinsics::from_horizontal_fov(width_px, height_px, view_rad(size_px, width_px));
        let away = direction.try_normalize()?;
        let eye = self.center + away * self.distance_m(size_px);
        let world_from_camera = Pose::look_at(eye, self.center, up)?;
        Some(Camera::new(name, intrinsics, world_from_camera))
    }

    /// The direction from a center to a camera that looks at it from a little above. It is turned
    /// around `up`, a unit vector, by `turn_rad` from a direction that only depends on `up`.
    #[must_use]
    pub fn direction_above(up: DVec3, turn_rad: f64) -> DVec3 {
        let aside = DQuat::from_axis_angle(up, turn_rad) * up.any_orthonormal_vector();
        aside * ELEVATION_RAD.cos() + up * ELEVATION_RAD.sin()
    }

    /// Distance of the camera from the center, meters.
    #[must_use]
    pub fn distance_m(&self, size_px: [u32; 2]) -> f64 {
        let shorter_px = size_px[0].min(size_px[1]);
        self.radius_m / FILLED / (0.5 * view_rad(size_px, shorter_px)).sin()
    }
}

/// Field of view along a side of `side_px` pixels, radians.
fn view_rad([width_px, height_px]: [u32; 2], side_px: u32) -> f64 {
    let longer_px = width_px.max(height_px);
    2.0 * ((0.5 * Framing::VIEW_RAD).tan() * f64::from(side_px) / f64::from(longer_px)).atan()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_whole_core_is_in_the_image_from_everywhere() {
        let origin = DVec3::new(4.5e6, 0.0, 0.0);
        let mut means: Vec<[f32; 3]> = (0..200)
            .map(|i| {
                let angle = i as f32 * 0.7;
                [
                    5.0 + angle.cos(),
                    6.0 + angle.sin(),
                    6.0 + (i % 21) as f32 / 10.0,
                ]
            })
            .collect();
        means.push([1e6; 3]);
        let count = means.len();
        let splats = SplatCloud {
            means,
            scales: vec![[0.1; 3]; count],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; count],
            opacities: vec![0.9; count],
            sh_degree: 0,
            sh_dc: vec![[0.0; 3]; count],
            sh_rest: vec![],
        };
        let framing = Framing::from_splats(&splats, origin).unwrap();
        assert!((framing.center - origin - DVec3::new(5.0, 6.0, 7.0)).length() < 0.1);
        let above = Framing::direction_above(DVec3::Z, 2.0);
        for direction in [
            DVec3::X,
            DVec3::new(-1.0, 2.0, 0.5),
            DVec3::NEG_Y * 9.0,
            above,
        ] {
            for size_px in [[200, 100], [100, 200]] {
                let camera = framing.camera("a", size_px, direction, DVec3::Z).unwrap();
                camera.intrinsics.check().unwrap();
                let [width_px, height_px] = size_px.map(f64::from);
                for mean in &splats.means[..200] {
                    let place = DVec3::from_array(mean.map(f64::from)) + origin;
                    let ray = camera.world_from_camera.inverse().transform(place);
                    let at = camera.intrinsics.project(ray).unwrap();
                    assert!((0.0..width_px).contains(&at.x) && (0.0..height_px).contains(&at.y));
                }
            }
        }
        assert!(framing.camera("a", [9, 9], DVec3::Z, DVec3::Z).is_none());
        assert!(framing.camera("a", [9, 9], DVec3::ZERO, DVec3::Z).is_none());
        assert!(Framing::from_splats(&SplatCloud::default(), origin).is_none());
        assert_eq!(
            Framing::from_box(DVec3::ONE, DVec3::ONE).radius_m,
            RADIUS_MIN_M
        );
    }
}
