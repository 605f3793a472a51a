//! Splats as bits of surface: which way they face, and what light makes of their color.

use decouplegs_scene::{SplatCloud, sh};
use glam::DVec3;

use decouplegs_scene::light::{DISPLAY_MAX, to_display, to_linear};

/// Coefficients of the highest degree.
pub(super) const COEFFICIENTS: usize = sh::coefficient_count(sh::DEGREE_MAX);

/// Display value below which the curve is not the power that light multiplies a color by here.
const DISPLAY_MIN: f64 = 0.02;

/// A color as a plain expansion, DC without the 0.5 that splats' colors add: `[coefficient][rgb]`.
pub(super) type Color = [[f64; 3]; COEFFICIENTS];

/// A splat, as far as its color in any light goes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Surface {
    /// Unit, outward.
    pub normal: DVec3,
    /// Color as stored in the asset; absent coefficients are 0.
    pub color: Color,
}

impl Surface {
    /// Splat `splat` of a cloud whose middle is `center`. The normal is the shortest axis, away
    /// from the middle.
    pub(super) fn from_splat(cloud: &SplatCloud, splat: usize, center: DVec3) -> Self {
        let axis = cloud.thin_axis(splat);
        let outward = DVec3::from_array(cloud.means[splat].map(f64::from)) - center;
        let normal = if axis.dot(outward) < 0.0 { -axis } else { axis };
        let mut color = [[0.0; 3]; COEFFICIENTS];
        color[0] = cloud.sh_dc[splat].map(|dc| f64::from(dc) + sh::DC_SHIFT);
        for (coefficient, rest) in color[1..].iter_mut().zip(cloud.rest_of(splat)) {
            *coefficient = rest.map(f64::from);
        }
        Self { normal, color }
    }

    /// Color of this surface under a light that gives a white surface of the same orientation
    /// `white` (E / pi, linear RGB).
    ///
    /// The display value v becomes `display(linear(v) white)`, and what depends on the direction of
    /// view is brightened or dimmed along with it. White 1 leaves the color as it is.
    pub(super) fn lit(&self, white: [f64; 3]) -> Color {
        let mut lit = self.color;
        for channel in 0..3 {
            let shown = (sh::Y0 * self.color[0][channel]).clamp(DISPLAY_MIN, DISPLAY_MAX);
            let ratio = to_display(to_linear(shown) * white[channel]) / shown;
            lit.iter_mut()
                .for_each(|coefficient| coefficient[channel] *= ratio);
        }
        lit
    }
}

/// The middle of what can be drawn of a cloud.
pub(super) fn center_of(cloud: &SplatCloud) -> DVec3 {
    let drawn = (0..cloud.len()).filter(|&splat| cloud.defect_of(splat).is_none());
    let bounds = decouplegs_scene::Bounds::from_points(drawn.map(|splat| &cloud.means[splat]));
    let corner = |corner: [f32; 3]| DVec3::from_array(corner.map(f64::from));
    0.5 * (corner(bounds.min) + corner(bounds.max))
}

/// `cloud` as calibration takes it to look in a light: the truth that a transfer is fitted to.
/// `reflected_by_white` tells E / pi for each unit normal. Splats that cannot be drawn stay as they
/// are.
#[must_use]
pub fn lit_cloud(cloud: &SplatCloud, reflected_by_white: impl Fn(DVec3) -> [f64; 3]) -> SplatCloud {
    let center = center_of(cloud);
    let stride = cloud.rest_stride();
    let mut lit_cloud = cloud.clone();
    for splat in (0..cloud.len()).filter(|&splat| cloud.defect_of(splat).is_none()) {
        let surface = Surface::from_splat(cloud, splat, center);
        let lit = surface.lit(reflected_by_white(surface.normal));
        lit_cloud.sh_dc[splat] = lit[0].map(|value| (value - sh::DC_SHIFT) as f32);
        for (rest, value) in lit_cloud.sh_rest[splat * stride..(splat + 1) * stride]
            .iter_mut()
            .zip(&lit[1..])
        {
            *rest = value.map(|value| value as f32);
        }
    }
    lit_cloud
}
