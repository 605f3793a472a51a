//! The rules of image formation: what a Gaussian adds to a pixel.
//!
//! Public renderers disagree here by far more than by rounding, so an image is compared only with
//! images made by the same rules. The shaders repeat the constants; `tests/stages/layout.rs`
//! compares them.

/// Added to both diagonal entries of a projected covariance, square pixels
/// (Kerbl et al., 3D Gaussian Splatting, 2023: a splat never falls below about a pixel).
pub const DILATION_PX2: f64 = 0.3;

/// [`Rules::lidar_dilation_rad`] by default: that of images of 1100 pixels focal length,
/// sqrt([`DILATION_PX2`]) pixels. Opacities were trained under it.
pub const LIDAR_DILATION_RAD: f64 = 5e-4;

/// A splat adds nothing to a pixel where its alpha is below this.
pub const ALPHA_MIN: f64 = 1.0 / 255.0;

/// Transmittance at which a pixel counts as full.
pub const TRANSMITTANCE_MIN: f64 = 1e-4;

/// Transmittance at which a pixel ends by [`EarlyStop::Inclusive`] (3DGUT's).
pub const TRANSMITTANCE_MIN_INCLUSIVE: f64 = 1e-3;

/// Margin beyond the image edges, as a share of tan(fov/2), to which x/z and y/z are clamped in the
/// projection's Jacobian (gsplat's form, right for off-center principal points).
pub const JACOBIAN_MARGIN: f64 = 0.3;

/// Early termination of a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EarlyStop {
    /// Never, by definition. An implementation may stop after the splat that takes the
    /// transmittance to [`TRANSMITTANCE_MIN`] or below: an error of at most that.
    None,
    /// The splat that would take the transmittance to [`TRANSMITTANCE_MIN`] or below is not
    /// blended, nor any behind it.
    Exclusive,
    /// The splat that takes the transmittance to [`TRANSMITTANCE_MIN_INCLUSIVE`] or below is the
    /// last that is blended.
    Inclusive,
}

/// Depth by which splats are ordered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DepthOrder {
    /// Camera-space z: what scenes are trained with.
    #[default]
    Z,
    /// Distance from the camera center: the order does not change when the camera turns. Splats
    /// behind the near plane are dropped all the same, so no camera sees more than a half-space.
    Radial,
}

/// One definition of an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rules {
    /// Upper bound of a splat's alpha.
    pub alpha_max: f64,
    /// A splat adds nothing to a pixel where its response, alpha as a share of its opacity, is
    /// below this; 0: no bound.
    pub response_min: f64,
    /// Early termination of a pixel.
    pub stop: EarlyStop,
    /// A splat whose center has z below this is dropped, meters.
    pub near_m: f64,
    /// Multiply opacity by sqrt(det S / det S') so that dilation does not brighten thin splats
    /// (Yu et al., Mip-Splatting, 2024).
    pub antialias: bool,
    /// Front to back by what.
    pub order: DepthOrder,
    /// Standard deviation that sweeps of LiDARs add to splats across the direction to their means,
    /// radians.
    pub lidar_dilation_rad: f64,
}

impl Rules {
    /// Ours: alpha at most 0.99, no early stop, near plane at 0.01 m.
    pub const DEFAULT: Self = Self {
        alpha_max: 0.99,
        response_min: 0.0,
        stop: EarlyStop::None,
        near_m: 0.01,
        antialias: false,
        order: DepthOrder::Z,
        lidar_dilation_rad: LIDAR_DILATION_RAD,
    };
    /// gsplat 1.5's: alpha at most 0.999, exclusive stop.
    pub const GSPLAT15: Self = Self {
        alpha_max: 0.999,
        stop: EarlyStop::Exclusive,
        ..Self::DEFAULT
    };
    /// gsplat 1.6's: alpha at most 0.99, exclusive stop.
    pub const GSPLAT16: Self = Self {
        stop: EarlyStop::Exclusive,
        ..Self::DEFAULT
    };
    /// The INRIA rasterizer's: exclusive stop, near plane at 0.2 m.
    pub const INRIA: Self = Self {
        stop: EarlyStop::Exclusive,
        near_m: 0.2,
        ..Self::DEFAULT
    };
    /// NuRec's and 3DGUT's: no response below 0.0113, inclusive stop, near plane at 0.2 m. Their
    /// renderers evaluate splats along rays; images by these rules have footprints all the same.
    pub const NUREC: Self = Self {
        response_min: 0.0113,
        stop: EarlyStop::Inclusive,
        near_m: 0.2,
        ..Self::DEFAULT
    };

    /// The rules called `name`, of [`Rules::NAMES`].
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        match name {
            "default" => Some(Self::DEFAULT),
            "gsplat15" => Some(Self::GSPLAT15),
            "gsplat16" => Some(Self::GSPLAT16),
            "inria" => Some(Self::INRIA),
            "nurec" => Some(Self::NUREC),
            _ => None,
        }
    }

    /// Names that [`Rules::by_name`] accepts.
    pub const NAMES: [&'static str; 5] = ["default", "gsplat15", "gsplat16", "inria", "nurec"];
}

impl Default for Rules {
    fn default() -> Self {
        Self::DEFAULT
    }
}
