//! One splat seen by one camera, in f64.

use decouplegs_scene::rules::{ALPHA_MIN, DILATION_PX2, JACOBIAN_MARGIN};
use decouplegs_scene::{Camera, DepthOrder, Intrinsics, RayMap, Rules, SplatCloud};
use glam::{DMat3, DQuat, DVec2, DVec3};

use super::unscented::{Spread, unscented};

/// A camera made ready to project splats whose means are relative to a world's origin.
pub struct View {
    /// Camera from world axes.
    camera_from_world: DMat3,
    /// The camera's center relative to the world's origin, meters.
    pub center: DVec3,
    intrinsics: Intrinsics,
    /// `None`: a pinhole.
    lens: Option<RayMap>,
    rules: Rules,
}

/// Projected splat in the image of one view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Projected64 {
    /// Projected mean, pixels from the top left corner of the image.
    pub mean_px: DVec2,
    /// Conic: the inverse of the 2D covariance.
    pub conic: Conic64,
    /// Peak alpha before the bound `alpha_max`, with the antialias factor where the rules ask for
    /// it.
    pub opacity: f64,
    /// Depth of the front-to-back order, meters: camera-space z of the mean, or its distance if the
    /// order is radial.
    pub depth_m: f64,
    /// Half the size of a box around every pixel center where alpha can reach `ALPHA_MIN`, pixels;
    /// never too small.
    pub half_extent_px: DVec2,
}

/// The inverse of a dilated 2D covariance `[[xx, xy], [xy, yy]]` as a completed square, so that `q`
/// is a sum of two squares: it cannot become negative, and needles lose no digits to cancellation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conic64 {
    /// xy / xx.
    pub slope: f64,
    /// 1 / xx, inverse square pixels.
    pub inverse_xx: f64,
    /// xx / determinant: the inverse variance of y where x is given, inverse square pixels.
    pub inverse_yy_given_x: f64,
}

impl Conic64 {
    /// The squared Mahalanobis distance `d^T S'^-1 d` of an offset from the mean in pixels.
    #[must_use]
    pub fn q(&self, d: DVec2) -> f64 {
        let across = d.y - self.slope * d.x;
        d.x * d.x * self.inverse_xx + across * across * self.inverse_yy_given_x
    }
}

impl View {
    /// The view of `camera` on a world with this `origin` (f64 world coordinates, meters).
    #[must_use]
    pub fn new(origin: DVec3, camera: &Camera, rules: &Rules) -> Self {
        Self {
            camera_from_world: DMat3::from_quat(camera.world_from_camera.rotation.conjugate()),
            center: camera.world_from_camera.translation - origin,
            intrinsics: camera.intrinsics,
            lens: (!camera.intrinsics.is_pinhole()).then(|| RayMap::new(&camera.intrinsics)),
            rules: *rules,
        }
    }

    /// The projection of one splat, or `None` when it adds nothing to any pixel: defective, nearer
    /// than the near plane, too faint everywhere, or so large that its covariance overflows f64.
    #[must_use]
    pub fn project(&self, splats: &SplatCloud, splat: usize) -> Option<Projected64> {
        if splats.defect_of(splat).is_some() {
            return None;
        }
        let t = self.camera_from_world * (dvec3(splats.means[splat]) - self.center);
        if !(t.z >= self.rules.near_m && t.z > 0.0) {
            return None;
        }
        let axes = self.camera_axes(splats.rotations[splat], splats.scales[splat]);
        let spread = match &self.lens {
            None => self.linear(t, &axes),
            Some(lens) => unscented(lens, t, &axes)?,
        };
        let (det, mean_px) = (spread.det, spread.mean_px);
        let (xx, xy, yy) = (
            spread.xx + DILATION_PX2,
            spread.xy,
            spread.yy + DILATION_PX2,
        );
        // det(S + d I) = det S + d trace S + d^2.
        let det_dilated =
            det + DILATION_PX2 * (spread.xx + spread.yy) + DILATION_PX2 * DILATION_PX2;
        let mut opacity = f64::from(splats.opacities[splat]);
        if self.rules.antialias {
            opacity *= (det / det_dilated).max(0.0).sqrt();
        }
        if opacity < ALPHA_MIN || !det_dilated.is_finite() || !mean_px.is_finite() {
            return None;
        }
        Some(Projected64 {
            mean_px,
            conic: Conic64 {
                slope: xy / xx,
                inverse_xx: xx.recip(),
                inverse_yy_given_x: xx / det_dilated,
            },
            opacity,
            depth_m: match self.rules.order {
                DepthOrder::Z => t.z,
                DepthOrder::Radial => t.length(),
            },
            half_extent_px: half_extent_px(opacity, xx, yy),
        })
    }

    /// W R diag(s): the splat's axes in the camera's, each as long as its standard deviation.
    fn camera_axes(&self, rotation_wxyz: [f32; 4], scales: [f32; 3]) -> DMat3 {
        let [w, x, y, z] = rotation_wxyz.map(f64::from);
        let world_from_splat = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        self.camera_from_world * world_from_splat * DMat3::from_diagonal(dvec3(scales))
    }

    /// Linear approximation of a pinhole's projection of a Gaussian with mean `t`.
    fn linear(&self, t: DVec3, camera_from_splat: &DMat3) -> Spread {
        let k = &self.intrinsics;
        let tan_x = clamped_tangent(t.x / t.z, f64::from(k.width_px), k.fx_px, k.cx_px);
        let tan_y = clamped_tangent(t.y / t.z, f64::from(k.height_px), k.fy_px, k.cy_px);
        let [row_x, row_y, row_z] = [
            camera_from_splat.row(0),
            camera_from_splat.row(1),
            camera_from_splat.row(2),
        ];
        // The two rows of J W R diag(s), pixels: the covariance in the image is their Gram matrix.
        let [m0, m1] = [
            (row_x - tan_x * row_z) * (k.fx_px / t.z),
            (row_y - tan_y * row_z) * (k.fy_px / t.z),
        ];
        Spread {
            mean_px: DVec2::new(k.fx_px * t.x / t.z + k.cx_px, k.fy_px * t.y / t.z + k.cy_px),
            xx: m0.length_squared(),
            xy: m0.dot(m1),
            yy: m1.length_squared(),
            // |m0 x m1|^2: no difference of nearly equal numbers.
            det: m0.cross(m1).length_squared(),
        }
    }
}

/// `tangent` held to the image and a margin of `JACOBIAN_MARGIN` times the tangent of half the
/// field of view beyond each edge.
fn clamped_tangent(tangent: f64, size_px: f64, focal_px: f64, principal_px: f64) -> f64 {
    let margin = JACOBIAN_MARGIN * 0.5 * size_px / focal_px;
    tangent.clamp(
        -principal_px / focal_px - margin,
        (size_px - principal_px) / focal_px + margin,
    )
}

/// Half the box around the ellipse `opacity exp(-q / 2) >= ALPHA_MIN`, a little enlarged so that
/// rounding loses no pixel.
fn half_extent_px(opacity: f64, xx: f64, yy: f64) -> DVec2 {
    let q_max = 2.0 * (opacity / ALPHA_MIN).ln() + 1e-12;
    DVec2::new((q_max * xx).sqrt(), (q_max * yy).sqrt()) * (1.0 + 1e-9) + DVec2::splat(1e-9)
}

fn dvec3(v: [f32; 3]) -> DVec3 {
    DVec3::from_array(v.map(f64::from))
}
