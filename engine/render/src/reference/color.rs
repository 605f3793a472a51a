//! The color of a splat seen from a point, in f64.

use decouplegs_scene::{SplatCloud, sh};
use decouplegs_shaders::constants::COLOR_MAX;
use glam::DVec3;

/// `max(0, 0.5 + SH(d))` per channel, display-referred RGB, with `d` the unit vector from `center`
/// (the camera's, relative to the world's origin) to the splat's mean.
#[must_use]
pub fn color(splats: &SplatCloud, splat: usize, center: DVec3) -> [f64; 3] {
    let basis = sh::basis((splats.mean_m(splat) - center).normalize_or_zero());
    let coefficients = std::iter::once(&splats.sh_dc[splat]).chain(splats.rest_of(splat));
    let mut rgb = [0.5; 3];
    for (coefficient, y) in coefficients.zip(basis) {
        for (sum, &value) in rgb.iter_mut().zip(coefficient) {
            *sum += f64::from(value) * y;
        }
    }
    rgb.map(|value| value.max(0.0))
}

/// The color of a splat as it is blended: in its light and fog, at most [`COLOR_MAX`] per channel,
/// which is the largest that a record of a splat holds. Only broken files have brighter splats.
#[must_use]
pub fn blended(rgb: [f64; 3]) -> [f64; 3] {
    rgb.map(|value| value.min(f64::from(COLOR_MAX)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cloud(sh_rest: Vec<[f32; 3]>) -> SplatCloud {
        SplatCloud {
            means: vec![[0.0, 0.0, 0.0]],
            sh_dc: vec![[0.0, 1.0, -10.0]],
            sh_degree: if sh_rest.is_empty() { 0 } else { 1 },
            sh_rest,
            ..SplatCloud::default()
        }
    }

    #[test]
    fn dc_is_offset_by_a_half_and_negative_colors_are_black() {
        let [r, g, b] = color(&cloud(vec![]), 0, DVec3::new(0.0, 0.0, -4.0));
        assert!((r - 0.5).abs() < 1e-15 && (g - (0.5 + sh::Y0)).abs() < 1e-15);
        assert_eq!(b, 0.0);
    }

    #[test]
    fn a_positive_y_coefficient_is_dark_along_plus_y() {
        // The first band of the original 3DGS is -y, z, -x; the direction runs from the camera to
        // the splat.
        let cloud = cloud(vec![[0.5, 0.0, 0.0], [0.0, 0.25, 0.0], [0.0; 3]]);
        let band_1 = 0.488_602_511_902_919_9;
        assert!(
            (color(&cloud, 0, DVec3::new(0.0, -3.0, 0.0))[0] - (0.5 - 0.5 * band_1)).abs() < 1e-15
        );
        assert!(
            (color(&cloud, 0, DVec3::new(0.0, 3.0, 0.0))[0] - (0.5 + 0.5 * band_1)).abs() < 1e-15
        );
        assert!(
            (color(&cloud, 0, DVec3::new(0.0, 0.0, -3.0))[1] - (0.5 + sh::Y0 + 0.25 * band_1))
                .abs()
                < 1e-15
        );
    }
}
