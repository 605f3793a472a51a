//! The `lens` table of a rig's camera.

use decouplegs_scene::lens::windshield::{angle_coefficients, angle_polynomial};
use decouplegs_scene::lens::{
    ANGLE_LIMIT_RAD, FTheta, FThetaReference, Fisheye, OpenCv, Windshield, WindshieldDirection,
};
use decouplegs_scene::{Invalid, Lens};
use serde::{Deserialize, Serialize};

/// A lens as it is written.
#[derive(Clone, Deserialize, Serialize)]
#[serde(tag = "model", rename_all = "kebab-case", deny_unknown_fields)]
pub(super) enum LensForm {
    #[serde(rename = "opencv")]
    OpenCv {
        /// k1 to k6; those left out are 0.
        #[serde(default)]
        radial: Vec<f64>,
        #[serde(default)]
        tangential: [f64; 2],
        #[serde(default)]
        thin_prism: [f64; 4],
    },
    #[serde(rename = "opencv-fisheye")]
    Fisheye {
        /// k1 to k4; those left out are 0.
        #[serde(default)]
        radial: Vec<f64>,
        max_angle_rad: Option<f64>,
    },
    FTheta {
        reference: ReferenceForm,
        /// Coefficients of the powers from 0; those left out are 0.
        #[serde(default)]
        pixel_distance_to_angle: Vec<f64>,
        #[serde(default)]
        angle_to_pixel_distance: Vec<f64>,
        max_angle_rad: f64,
        linear_cde: Option<[f64; 3]>,
    },
}

#[derive(Clone, Copy, Deserialize, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum ReferenceForm {
    PixelDistanceToAngle,
    AngleToPixelDistance,
}

/// `given` and zeros; a sentence where there are too many.
fn filled<const N: usize>(what: &str, given: &[f64]) -> Result<[f64; N], String> {
    if given.len() > N {
        return Err(format!(
            "'{what}' has {} coefficients, at most {N} are known",
            given.len()
        ));
    }
    Ok(std::array::from_fn(|index| {
        given.get(index).copied().unwrap_or(0.0)
    }))
}

impl LensForm {
    pub(super) fn lens(&self) -> Result<Lens, String> {
        Ok(match self {
            Self::OpenCv {
                radial,
                tangential,
                thin_prism,
            } => Lens::OpenCv(OpenCv {
                radial: filled("radial", radial)?,
                tangential: *tangential,
                thin_prism: *thin_prism,
            }),
            Self::Fisheye {
                radial,
                max_angle_rad,
            } => Lens::Fisheye(Fisheye {
                radial: filled("radial", radial)?,
                max_angle_rad: max_angle_rad.unwrap_or(ANGLE_LIMIT_RAD),
            }),
            Self::FTheta {
                reference,
                pixel_distance_to_angle,
                angle_to_pixel_distance,
                max_angle_rad,
                linear_cde,
            } => Lens::FTheta(FTheta {
                reference: match reference {
                    ReferenceForm::PixelDistanceToAngle => FThetaReference::PixelDistanceToAngle,
                    ReferenceForm::AngleToPixelDistance => FThetaReference::AngleToPixelDistance,
                },
                pixel_distance_to_angle: filled(
                    "pixel_distance_to_angle",
                    pixel_distance_to_angle,
                )?,
                angle_to_pixel_distance: filled(
                    "angle_to_pixel_distance",
                    angle_to_pixel_distance,
                )?,
                max_angle_rad: *max_angle_rad,
                linear_cde: linear_cde.unwrap_or([1.0, 0.0, 0.0]),
            }),
        })
    }

    /// `None` for a pinhole.
    pub(super) fn from_lens(lens: &Lens) -> Option<Self> {
        match lens {
            Lens::Pinhole => None,
            Lens::OpenCv(lens) => Some(Self::OpenCv {
                radial: lens.radial.to_vec(),
                tangential: lens.tangential,
                thin_prism: lens.thin_prism,
            }),
            Lens::Fisheye(lens) => Some(Self::Fisheye {
                radial: lens.radial.to_vec(),
                max_angle_rad: Some(lens.max_angle_rad),
            }),
            Lens::FTheta(lens) => Some(Self::FTheta {
                reference: match lens.reference {
                    FThetaReference::PixelDistanceToAngle => ReferenceForm::PixelDistanceToAngle,
                    FThetaReference::AngleToPixelDistance => ReferenceForm::AngleToPixelDistance,
                },
                pixel_distance_to_angle: lens.pixel_distance_to_angle.to_vec(),
                angle_to_pixel_distance: lens.angle_to_pixel_distance.to_vec(),
                max_angle_rad: lens.max_angle_rad,
                linear_cde: Some(lens.linear_cde),
            }),
        }
    }
}

/// A windshield as it is written: coefficients grouped by the power of the vertical angle.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WindshieldForm {
    direction: DirectionForm,
    horizontal: Vec<f64>,
    vertical: Vec<f64>,
}

#[derive(Clone, Copy, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
enum DirectionForm {
    Forward,
    Backward,
}

impl WindshieldForm {
    pub(super) fn windshield(&self) -> Result<Windshield, Invalid> {
        Ok(Windshield {
            direction: match self.direction {
                DirectionForm::Forward => WindshieldDirection::Forward,
                DirectionForm::Backward => WindshieldDirection::Backward,
            },
            horizontal: angle_polynomial(&self.horizontal)?,
            vertical: angle_polynomial(&self.vertical)?,
        })
    }

    pub(super) fn from_windshield(windshield: &Windshield) -> Self {
        Self {
            direction: match windshield.direction {
                WindshieldDirection::Forward => DirectionForm::Forward,
                WindshieldDirection::Backward => DirectionForm::Backward,
            },
            horizontal: angle_coefficients(&windshield.horizontal),
            vertical: angle_coefficients(&windshield.vertical),
        }
    }
}
