//! The TOML form of photometric calibrations.

use decouplegs_scene::Photometry;
use decouplegs_scene::photometry::{ColorCurve, Response, Vignetting};
use serde::{Deserialize, Serialize};

/// Stages that are left out leave colors as they are.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PhotometryForm {
    #[serde(default)]
    exposure_ev: f64,
    #[serde(default)]
    curve: CurveForm,
    #[serde(skip_serializing_if = "Option::is_none")]
    vignetting: Option<VignettingForm>,
    #[serde(skip_serializing_if = "Option::is_none")]
    balance: Option<[[f64; 3]; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    matrix: Option<[[f64; 4]; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    gamma: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    response: Option<ResponseForm>,
}

#[derive(Clone, Copy, Default, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
enum CurveForm {
    #[default]
    Display,
    Linear,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct VignettingForm {
    center_px: CenterForm,
    radius_px: [f64; 2],
    rgb: [[f64; 3]; 3],
}

/// One center, or one of each channel.
#[derive(Clone, Copy, Deserialize, Serialize)]
#[serde(untagged)]
enum CenterForm {
    One([f64; 2]),
    OfChannels([[f64; 2]; 3]),
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct ResponseForm {
    toe: [f64; 3],
    shoulder: [f64; 3],
    gamma: [f64; 3],
    center: [f64; 3],
}

impl PhotometryForm {
    /// The calibration; not checked.
    pub(super) fn photometry(&self) -> Photometry {
        let identity = Photometry::IDENTITY;
        let vignetting = |form: &VignettingForm| Vignetting {
            center_px: match form.center_px {
                CenterForm::One(center_px) => [center_px; 3],
                CenterForm::OfChannels(centers_px) => centers_px,
            },
            radius_px: form.radius_px,
            rgb: form.rgb,
        };
        let response = |form: &ResponseForm| Response {
            toe: form.toe,
            shoulder: form.shoulder,
            gamma: form.gamma,
            center: form.center,
        };
        Photometry {
            exposure_ev: self.exposure_ev,
            curve: match self.curve {
                CurveForm::Display => ColorCurve::Display,
                CurveForm::Linear => ColorCurve::Linear,
            },
            vignetting: self.vignetting.as_ref().map(vignetting),
            balance: self.balance,
            matrix: self.matrix.unwrap_or(identity.matrix),
            gamma: self.gamma.unwrap_or(identity.gamma),
            response: self.response.as_ref().map(response),
        }
    }

    /// The form of `photometry`; `None` for the identity.
    pub(super) fn from_photometry(photometry: &Photometry) -> Option<Self> {
        let identity = Photometry::IDENTITY;
        let vignetting = |vignetting: Vignetting| VignettingForm {
            center_px: match vignetting.center_px {
                [red, green, blue] if red == green && green == blue => CenterForm::One(red),
                centers_px => CenterForm::OfChannels(centers_px),
            },
            radius_px: vignetting.radius_px,
            rgb: vignetting.rgb,
        };
        let response = |response: Response| ResponseForm {
            toe: response.toe,
            shoulder: response.shoulder,
            gamma: response.gamma,
            center: response.center,
        };
        (*photometry != identity).then(|| Self {
            exposure_ev: photometry.exposure_ev,
            curve: match photometry.curve {
                ColorCurve::Display => CurveForm::Display,
                ColorCurve::Linear => CurveForm::Linear,
            },
            vignetting: photometry.vignetting.map(vignetting),
            balance: photometry.balance,
            matrix: (photometry.matrix != identity.matrix).then_some(photometry.matrix),
            gamma: (photometry.gamma != identity.gamma).then_some(photometry.gamma),
            response: photometry.response.map(response),
        })
    }
}
