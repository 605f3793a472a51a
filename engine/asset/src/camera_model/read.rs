//! Camera models of packages, read.

use decouplegs_scene::lens::windshield::angle_polynomial;
use decouplegs_scene::lens::{
    ANGLE_LIMIT_RAD, FTheta, FThetaReference, Fisheye, OpenCv, WindshieldDirection,
};
use decouplegs_scene::lens::{Lens, Windshield};
use decouplegs_scene::{Intrinsics, Shutter, ShutterDirection};
use serde::Deserialize;
use serde_json::Value;

use super::{FTHETA_ORIGIN_PX, pinhole_of, readout_s};

#[derive(Deserialize)]
struct Model {
    #[serde(rename = "type")]
    kind: String,
    parameters: Value,
}

/// Parameters of every model.
#[derive(Deserialize)]
struct Common {
    resolution: [u32; 2],
    principal_point: [f64; 2],
    #[serde(default)]
    shutter_type: Option<String>,
    #[serde(default)]
    external_distortion_parameters: Option<Value>,
}

#[derive(Deserialize)]
struct FThetaParameters {
    reference_poly: String,
    pixeldist_to_angle_poly: Vec<f64>,
    angle_to_pixeldist_poly: Vec<f64>,
    #[serde(default)]
    max_angle: Option<f64>,
    #[serde(default)]
    linear_cde: Option<[f64; 3]>,
}

#[derive(Deserialize)]
struct OpenCvParameters {
    focal_length: [f64; 2],
    #[serde(default)]
    radial_coeffs: Vec<f64>,
    #[serde(default)]
    tangential_coeffs: Vec<f64>,
    #[serde(default)]
    thin_prism_coeffs: Vec<f64>,
    #[serde(default)]
    max_angle: Option<f64>,
}

#[derive(Deserialize)]
struct WindshieldParameters {
    reference_poly: String,
    #[serde(default)]
    horizontal_poly: Vec<f64>,
    #[serde(default)]
    vertical_poly: Vec<f64>,
    #[serde(default)]
    horizontal_poly_inverse: Vec<f64>,
    #[serde(default)]
    vertical_poly_inverse: Vec<f64>,
}

/// Intrinsics of a camera model and the direction of its readout, whose duration the model does not
/// tell.
///
/// # Errors
/// A sentence that names the key at fault.
fn read_camera_model(model: &Value) -> Result<(Intrinsics, ShutterDirection), String> {
    let Model { kind, parameters } = read(model, "camera_model")?;
    let common: Common = read(&parameters, "parameters")?;
    let size_px = common.resolution;
    let center_px = common.principal_point;
    let intrinsics = match kind.as_str() {
        "ftheta" => {
            let lens = f_theta(read(&parameters, "parameters")?)?;
            let center_px = center_px.map(|center| center + FTHETA_ORIGIN_PX);
            let f_theta = Intrinsics {
                lens: Lens::FTheta(lens),
                ..Intrinsics::pinhole(size_px, lens.center_focal_px(), center_px)
            };
            pinhole_of(&f_theta).unwrap_or(f_theta)
        }
        "opencv-pinhole" => {
            let own: OpenCvParameters = read(&parameters, "parameters")?;
            let lens = OpenCv {
                radial: padded(&own.radial_coeffs, "radial_coeffs")?,
                tangential: padded(&own.tangential_coeffs, "tangential_coeffs")?,
                thin_prism: padded(&own.thin_prism_coeffs, "thin_prism_coeffs")?,
            };
            let is_plain = lens == OpenCv::default();
            Intrinsics {
                lens: if is_plain {
                    Lens::Pinhole
                } else {
                    Lens::OpenCv(lens)
                },
                ..Intrinsics::pinhole(size_px, own.focal_length, center_px)
            }
        }
        "opencv-fisheye" => {
            let own: OpenCvParameters = read(&parameters, "parameters")?;
            let lens = Fisheye {
                radial: padded(&own.radial_coeffs, "radial_coeffs")?,
                max_angle_rad: own.max_angle.unwrap_or(ANGLE_LIMIT_RAD),
            };
            Intrinsics {
                lens: Lens::Fisheye(lens),
                ..Intrinsics::pinhole(size_px, own.focal_length, center_px)
            }
        }
        other => {
            return Err(format!(
                "camera_model.type is {other:?}; expected \"ftheta\", \"opencv-pinhole\" or \"opencv-fisheye\""
            ));
        }
    };
    let distortion = common.external_distortion_parameters;
    let windshield = distortion
        .map(|distortion| windshield(&distortion))
        .transpose()?;
    let direction = match common.shutter_type.as_deref() {
        None | Some("GLOBAL" | "UNKNOWN") => ShutterDirection::Global,
        Some(name) => name
            .strip_prefix("ROLLING_")
            .and_then(|name| ShutterDirection::from_name(&name.to_lowercase()))
            .ok_or_else(|| format!("shutter_type is {name:?}; expected GLOBAL or ROLLING_TOP_TO_BOTTOM and its like"))?,
    };
    Ok((
        Intrinsics {
            windshield,
            ..intrinsics
        },
        direction,
    ))
}

fn f_theta(own: FThetaParameters) -> Result<FTheta, String> {
    let reference = match own.reference_poly.as_str() {
        "PIXELDIST_TO_ANGLE" => FThetaReference::PixelDistanceToAngle,
        "ANGLE_TO_PIXELDIST" => FThetaReference::AngleToPixelDistance,
        other => {
            return Err(format!(
                "reference_poly is {other:?}; expected \"PIXELDIST_TO_ANGLE\" or \"ANGLE_TO_PIXELDIST\""
            ));
        }
    };
    Ok(FTheta {
        reference,
        pixel_distance_to_angle: padded(&own.pixeldist_to_angle_poly, "pixeldist_to_angle_poly")?,
        angle_to_pixel_distance: padded(&own.angle_to_pixeldist_poly, "angle_to_pixeldist_poly")?,
        max_angle_rad: own.max_angle.unwrap_or(ANGLE_LIMIT_RAD),
        linear_cde: own.linear_cde.unwrap_or([1.0, 0.0, 0.0]),
    })
}

/// A bivariate windshield, whose parameters may stand behind `parameters`.
fn windshield(distortion: &Value) -> Result<Windshield, String> {
    let field = "external_distortion_parameters";
    let own = distortion.get("parameters").unwrap_or(distortion);
    let own: WindshieldParameters = read(own, field)?;
    let (direction, horizontal, vertical) = match own.reference_poly.as_str() {
        "FORWARD" => (
            WindshieldDirection::Forward,
            own.horizontal_poly,
            own.vertical_poly,
        ),
        "BACKWARD" => (
            WindshieldDirection::Backward,
            own.horizontal_poly_inverse,
            own.vertical_poly_inverse,
        ),
        other => {
            return Err(format!(
                "{field}.reference_poly is {other:?}; expected \"FORWARD\" or \"BACKWARD\""
            ));
        }
    };
    let polynomial = |coefficients: &[f64]| {
        angle_polynomial(coefficients).map_err(|reason| format!("{field}: {reason}"))
    };
    Ok(Windshield {
        direction,
        horizontal: polynomial(&horizontal)?,
        vertical: polynomial(&vertical)?,
    })
}

fn read<T: serde::de::DeserializeOwned>(value: &Value, field: &str) -> Result<T, String> {
    T::deserialize(value).map_err(|error| format!("{field}: {error}"))
}

/// `values` and zeros behind them.
fn padded<const N: usize>(values: &[f64], field: &str) -> Result<[f64; N], String> {
    if values.len() > N {
        let count = values.len();
        return Err(format!(
            "{field}: {count} coefficients; at most {N} are known"
        ));
    }
    let at = |place: usize| values.get(place).copied().unwrap_or(0.0);
    Ok(std::array::from_fn(at))
}

/// Reads a camera's `model` as [`read_camera_model`] does; its shutter, where it rolls, takes as
/// long as the images `frames_us`, microseconds, in the median.
///
/// # Errors
/// A sentence that names the key at fault, or says that no image tells how long the shutter takes.
pub(crate) fn read_rolling_camera_model<'a>(
    model: &Value,
    frames_us: impl IntoIterator<Item = &'a [i64; 2]>,
) -> Result<Intrinsics, String> {
    let (mut intrinsics, direction) = read_camera_model(model)?;
    if direction != ShutterDirection::Global {
        let readout_s = readout_s(frames_us).ok_or_else(|| {
            format!(
                "its shutter is {}, and no frame has a start and an end",
                direction.name()
            )
        })?;
        let size_px = [intrinsics.width_px, intrinsics.height_px];
        intrinsics.shutter = Shutter::new(direction, readout_s, size_px);
    }
    intrinsics.check().map_err(|reason| reason.to_string())?;
    Ok(intrinsics)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera_model::{model, packed_intrinsics};
    use decouplegs_scene::Shutter;

    #[test]
    fn what_a_package_says_of_a_camera_is_read_again() {
        let square = Intrinsics::from_horizontal_fov(1600, 900, 1.0);
        let open_cv = OpenCv {
            radial: [0.1, -0.02, 0.0, 0.0, 0.0, 0.0],
            tangential: [1e-3, 2e-3],
            thin_prism: [1e-4, 0.0, 0.0, 0.0],
        };
        let lenses = [
            Lens::Pinhole,
            Lens::OpenCv(open_cv),
            Lens::Fisheye(Fisheye {
                radial: [0.01, 0.0, -1e-3, 0.0],
                max_angle_rad: 1.2,
            }),
        ];
        for lens in lenses {
            for direction in ShutterDirection::ALL {
                let intrinsics = Intrinsics {
                    lens,
                    shutter: Shutter::new(direction, 0.02, [1600, 900]),
                    ..square
                };
                let (mut read, found) = read_camera_model(&model(&intrinsics)).unwrap();
                assert_eq!(found, direction);
                read.shutter = intrinsics.shutter;
                if lens == Lens::Pinhole {
                    assert_eq!(read.lens, Lens::Pinhole);
                    assert!((read.fx_px - intrinsics.fx_px).abs() < 1e-6);
                    (read.fx_px, read.fy_px) = (intrinsics.fx_px, intrinsics.fy_px);
                }
                assert_eq!(read, intrinsics, "{lens:?}");
            }
        }
    }

    #[test]
    fn a_lens_that_is_nearly_a_pinhole_stays_what_it_is() {
        let intrinsics = Intrinsics::from_horizontal_fov(1600, 900, 1.0);
        let mut value = model(&intrinsics);
        let polynomial = &mut value["parameters"]["angle_to_pixeldist_poly"];
        polynomial[2] = (polynomial[2].as_f64().unwrap() + 0.1).into();
        let (read, _) = read_camera_model(&value).unwrap();
        assert!(matches!(read.lens, Lens::FTheta(_)));
        let wide = packed_intrinsics(&intrinsics);
        let f_theta = read_camera_model(&model(&wide)).unwrap().0;
        assert_eq!(f_theta.lens, Lens::Pinhole, "of a pinhole");
    }

    #[test]
    fn windshields_are_read() {
        let mut value = model(&Intrinsics::from_horizontal_fov(64, 48, 1.0));
        value["parameters"]["external_distortion_parameters"] = serde_json::json!({
            "type": "bivariate-windshield",
            "parameters": {
                "reference_poly": "FORWARD",
                "horizontal_poly": [0.001, 1.01, 0.0],
                "vertical_poly": [0.002, 0.0, 0.99],
            },
        });
        let (read, _) = read_camera_model(&value).unwrap();
        let found = read.windshield.unwrap();
        assert_eq!(found.direction, WindshieldDirection::Forward);
        assert_eq!(
            found.horizontal,
            angle_polynomial(&[0.001, 1.01, 0.0]).unwrap()
        );
        // Written, it is read as it was.
        for direction in [WindshieldDirection::Forward, WindshieldDirection::Backward] {
            let bent = Intrinsics {
                windshield: Some(Windshield { direction, ..found }),
                ..read
            };
            let (again, _) = read_camera_model(&model(&bent)).unwrap();
            assert_eq!(again.windshield, bent.windshield);
        }
    }

    #[test]
    fn unknown_models_are_refused_by_name() {
        let mut value = model(&Intrinsics::from_horizontal_fov(64, 48, 1.0));
        for (key, wrong) in [
            ("shutter_type", serde_json::json!("ROLLING_DIAGONALLY")),
            ("reference_poly", serde_json::json!("NEITHER")),
            (
                "pixeldist_to_angle_poly",
                serde_json::json!([0, 1, 2, 3, 4, 5, 6]),
            ),
            ("resolution", serde_json::json!([64])),
        ] {
            let mut wrong_value = value.clone();
            wrong_value["parameters"][key] = wrong;
            let error = read_camera_model(&wrong_value).unwrap_err();
            assert!(error.contains(key) || error.contains("length"), "{error}");
        }
        value["type"] = "spherical".into();
        assert!(read_camera_model(&value).unwrap_err().contains("spherical"));
    }
}
