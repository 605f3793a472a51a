//! Cameras in the vocabulary of USDZ packages (NVIDIA NCore, `docs/data/sensor_models.rst`):
//! `ftheta`, `opencv-pinhole`, `opencv-fisheye`.

mod read;

pub(crate) use read::read_rolling_camera_model;

use decouplegs_scene::lens::windshield::{Windshield, WindshieldDirection, angle_coefficients};
use decouplegs_scene::lens::{FTheta, FThetaReference, Fisheye, OpenCv};
use decouplegs_scene::{Intrinsics, Lens, ShutterDirection};
use serde_json::{Value, json};

/// Median time between start and end of an image, seconds, of `frames_us`, microseconds; `None`
/// where no image has such a time.
fn readout_s<'a>(frames_us: impl IntoIterator<Item = &'a [i64; 2]>) -> Option<f64> {
    let durations = frames_us
        .into_iter()
        .map(|[start_us, end_us]| end_us.saturating_sub(*start_us));
    let mut durations: Vec<i64> = durations.filter(|duration_us| *duration_us > 0).collect();
    durations.sort_unstable();
    let median = durations.get(durations.len() / 2)?;
    Some(*median as f64 * 1e-6)
}

/// Coefficients of a polynomial, the constant first.
const COEFFICIENTS: usize = 6;
/// Largest difference between two readings of one polynomial, pixels.
const SAME_PX: f64 = 1e-4;
/// Angles at which the polynomial is fitted.
const SAMPLES: usize = 64;
/// F-theta calibrations count pixels from the center of the first one, this engine from its corner.
const FTHETA_ORIGIN_PX: f64 = 0.5;

/// A camera as a package says it is: a pinhole becomes f-theta, which all readers of packages know
/// and AlpaSim's rectifier demands (`src/driver/src/alpasim_driver/rectification.py:485`); others
/// are as they are.
#[must_use]
pub fn packed_intrinsics(intrinsics: &Intrinsics) -> Intrinsics {
    match intrinsics.lens {
        Lens::Pinhole => {
            let lens = fitted(intrinsics);
            let [fx_px, fy_px] = lens.center_focal_px();
            Intrinsics {
                fx_px,
                fy_px,
                lens: Lens::FTheta(lens),
                ..*intrinsics
            }
        }
        _ => *intrinsics,
    }
}

/// The model of a camera, that of [`packed_intrinsics`].
pub(crate) fn model(intrinsics: &Intrinsics) -> Value {
    let principal_point = [intrinsics.cx_px, intrinsics.cy_px];
    let focal_length = [intrinsics.fx_px, intrinsics.fy_px];
    let (name, own) = match &intrinsics.lens {
        Lens::Pinhole => ("ftheta", f_theta(intrinsics, &fitted(intrinsics))),
        Lens::FTheta(lens) => ("ftheta", f_theta(intrinsics, lens)),
        Lens::OpenCv(OpenCv {
            radial,
            tangential,
            thin_prism,
        }) => (
            "opencv-pinhole",
            json!({
                "principal_point": principal_point,
                "focal_length": focal_length,
                "radial_coeffs": radial,
                "tangential_coeffs": tangential,
                "thin_prism_coeffs": thin_prism,
            }),
        ),
        Lens::Fisheye(Fisheye {
            radial,
            max_angle_rad,
        }) => (
            "opencv-fisheye",
            json!({
                "principal_point": principal_point,
                "focal_length": focal_length,
                "radial_coeffs": radial,
                "max_angle": max_angle_rad,
            }),
        ),
    };
    let mut parameters = own;
    parameters["resolution"] = json!([intrinsics.width_px, intrinsics.height_px]);
    parameters["shutter_type"] = json!(match intrinsics.shutter.direction() {
        ShutterDirection::Global => "GLOBAL",
        ShutterDirection::TopToBottom => "ROLLING_TOP_TO_BOTTOM",
        ShutterDirection::BottomToTop => "ROLLING_BOTTOM_TO_TOP",
        ShutterDirection::LeftToRight => "ROLLING_LEFT_TO_RIGHT",
        ShutterDirection::RightToLeft => "ROLLING_RIGHT_TO_LEFT",
    });
    let windshield = intrinsics.windshield.as_ref();
    parameters["external_distortion_parameters"] = windshield.map_or(Value::Null, bent);
    json!({"type": name, "parameters": parameters})
}

/// The parameters of a windshield, by the polynomials of the direction that is known.
fn bent(windshield: &Windshield) -> Value {
    let horizontal = angle_coefficients(&windshield.horizontal);
    let vertical = angle_coefficients(&windshield.vertical);
    let mut parameters = match windshield.direction {
        WindshieldDirection::Forward => json!({
            "reference_poly": "FORWARD",
            "horizontal_poly": horizontal,
            "vertical_poly": vertical,
        }),
        WindshieldDirection::Backward => json!({
            "reference_poly": "BACKWARD",
            "horizontal_poly_inverse": horizontal,
            "vertical_poly_inverse": vertical,
        }),
    };
    parameters["external_distortion_type"] = "bivariate-windshield".into();
    parameters
}

/// The parameters of an f-theta lens.
fn f_theta(intrinsics: &Intrinsics, lens: &FTheta) -> Value {
    json!({
        "principal_point": [intrinsics.cx_px - FTHETA_ORIGIN_PX, intrinsics.cy_px - FTHETA_ORIGIN_PX],
        "reference_poly": match lens.reference {
            FThetaReference::PixelDistanceToAngle => "PIXELDIST_TO_ANGLE",
            FThetaReference::AngleToPixelDistance => "ANGLE_TO_PIXELDIST",
        },
        "pixeldist_to_angle_poly": lens.pixel_distance_to_angle,
        "angle_to_pixeldist_poly": lens.angle_to_pixel_distance,
        "max_angle": lens.max_angle_rad,
        "linear_cde": lens.linear_cde,
    })
}

/// A pinhole as f-theta: distance from the principal point against the angle from the axis, and
/// back, as polynomials of the fifth degree up to the farthest corner.
fn fitted(intrinsics: &Intrinsics) -> FTheta {
    let Intrinsics { fx_px, fy_px, .. } = *intrinsics;
    let [x_px, y_px] = farthest_px(intrinsics);
    let max_angle_rad = (x_px / fx_px).hypot(y_px / fy_px).atan();
    let angles: Vec<f64> = (0..SAMPLES)
        .map(|i| max_angle_rad * (i as f64 + 0.5) / SAMPLES as f64)
        .collect();
    let distances: Vec<f64> = angles.iter().map(|angle| fy_px * angle.tan()).collect();
    FTheta {
        reference: FThetaReference::AngleToPixelDistance,
        pixel_distance_to_angle: fit(&distances, &angles),
        angle_to_pixel_distance: fit(&angles, &distances),
        max_angle_rad,
        // Pixels are as wide as fx says where the polynomial says fy.
        linear_cde: [fx_px / fy_px, 0.0, 0.0],
    }
}

/// Distances along x and y from the principal point to the farthest corner of the image, pixels.
fn farthest_px(intrinsics: &Intrinsics) -> [f64; 2] {
    let farthest = |center: f64, size: u32| center.abs().max((f64::from(size) - center).abs());
    [
        farthest(intrinsics.cx_px, intrinsics.width_px),
        farthest(intrinsics.cy_px, intrinsics.height_px),
    ]
}

/// The pinhole that [`packed_intrinsics`] made `f_theta` of, if it did: splats near a camera are
/// drawn otherwise through a polynomial.
fn pinhole_of(f_theta: &Intrinsics) -> Option<Intrinsics> {
    let Lens::FTheta(lens) = f_theta.lens else {
        return None;
    };
    let [aspect, skew_x, skew_y] = lens.linear_cde;
    if !(aspect > 0.0 && skew_x == 0.0 && skew_y == 0.0) {
        return None;
    }
    let [x_px, y_px] = farthest_px(f_theta);
    let fy_px = (x_px / aspect).hypot(y_px) / lens.max_angle_rad.tan();
    let pinhole = Intrinsics {
        fx_px: aspect * fy_px,
        fy_px,
        lens: Lens::Pinhole,
        ..*f_theta
    };
    pinhole.check().ok()?;
    let again = fitted(&pinhole);
    let radius_px = |polynomial: &[f64; COEFFICIENTS], angle: f64| {
        polynomial.iter().rev().fold(0.0, |sum, c| sum * angle + c)
    };
    let is_same = (0..=SAMPLES).all(|step| {
        let angle = again.max_angle_rad * step as f64 / SAMPLES as f64;
        let [there, here] =
            [&lens, &again].map(|lens| radius_px(&lens.angle_to_pixel_distance, angle));
        (there - here).abs() < SAME_PX
    });
    (is_same && lens.reference == again.reference).then_some(pinhole)
}

/// The polynomial without a constant that is nearest to `to` at `from`, least squares.
fn fit(from: &[f64], to: &[f64]) -> [f64; COEFFICIENTS] {
    const UNKNOWNS: usize = COEFFICIENTS - 1;
    // Between 0 and 1, where powers are of a size.
    let scale = from.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    let mut normal = [[0.0; UNKNOWNS + 1]; UNKNOWNS];
    for (&x, &y) in from.iter().zip(to) {
        let powers: [f64; UNKNOWNS] = std::array::from_fn(|k| (x / scale).powi(k as i32 + 1));
        for (row, power) in normal.iter_mut().zip(powers) {
            for (cell, other) in row.iter_mut().zip(powers.into_iter().chain([y])) {
                *cell += power * other;
            }
        }
    }
    for pivot in 0..UNKNOWNS {
        let best = (pivot..UNKNOWNS)
            .max_by(|&a, &b| normal[a][pivot].abs().total_cmp(&normal[b][pivot].abs()))
            .unwrap_or(pivot);
        normal.swap(pivot, best);
        let head = normal[pivot];
        for (row, values) in normal.iter_mut().enumerate() {
            if row != pivot {
                let factor = values[pivot] / head[pivot];
                values
                    .iter_mut()
                    .zip(head)
                    .for_each(|(value, head)| *value -= factor * head);
            }
        }
    }
    let mut coefficients = [0.0; COEFFICIENTS];
    for (k, row) in normal.iter().enumerate() {
        coefficients[k + 1] = row[UNKNOWNS] / row[k] / scale.powi(k as i32 + 1);
    }
    coefficients
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs_scene::Shutter;

    fn usual() -> Intrinsics {
        let square = Intrinsics::from_horizontal_fov(1600, 900, 1.0);
        Intrinsics {
            fx_px: 1266.4,
            fy_px: 1266.4,
            cx_px: 816.3,
            cy_px: 491.5,
            ..square
        }
    }

    #[test]
    fn a_usual_camera_is_told_to_a_fraction_of_a_pixel() {
        let model = model(&usual());
        let parameters = &model["parameters"];
        let polynomial = |name: &str, x: f64| -> f64 {
            parameters[name]
                .as_array()
                .unwrap()
                .iter()
                .rev()
                .fold(0.0, |sum, c| sum * x + c.as_f64().unwrap())
        };
        let angle_max = parameters["max_angle"].as_f64().unwrap();
        for step in 0..=100 {
            let angle = angle_max * f64::from(step) / 100.0;
            let distance_px = 1266.4 * angle.tan();
            assert!(
                (polynomial("angle_to_pixeldist_poly", angle) - distance_px).abs() < 0.05,
                "{angle}"
            );
            assert!(
                (polynomial("pixeldist_to_angle_poly", distance_px) - angle).abs() < 5e-5,
                "{angle}"
            );
        }
        assert_eq!(
            parameters["principal_point"],
            json!([815.8, 491.0]),
            "counted from the center of the first pixel"
        );
    }

    #[test]
    fn cameras_are_served_as_packages_say_they_are() {
        let packed = packed_intrinsics(&usual());
        assert!(packed.check().is_ok() && matches!(packed.lens, Lens::FTheta(_)));
        assert_eq!(model(&packed), model(&usual()));
        assert_eq!(packed_intrinsics(&packed), packed);
    }

    #[test]
    fn each_lens_has_its_type_and_its_parameters() {
        let of = |lens: Lens| model(&Intrinsics { lens, ..usual() });
        let tangential = [0.001, -0.002];
        let open_cv = of(Lens::OpenCv(OpenCv {
            radial: [-0.3, 0.1, 0.0, 0.0, 0.0, 0.0],
            tangential,
            ..OpenCv::default()
        }));
        assert_eq!(open_cv["type"], "opencv-pinhole");
        assert_eq!(
            open_cv["parameters"]["principal_point"],
            json!([816.3, 491.5]),
            "counted from the corner of the image"
        );
        assert_eq!(
            open_cv["parameters"]["tangential_coeffs"],
            json!(tangential)
        );
        assert_eq!(open_cv["parameters"]["radial_coeffs"][0], -0.3);
        let fisheye = of(Lens::Fisheye(Fisheye {
            radial: [0.01, 0.0, 0.0, 0.0],
            max_angle_rad: 1.2,
        }));
        assert_eq!(
            (&fisheye["type"], &fisheye["parameters"]["max_angle"]),
            (&json!("opencv-fisheye"), &json!(1.2))
        );
        assert_eq!(
            fisheye["parameters"]["focal_length"],
            json!([1266.4, 1266.4])
        );
        let lens = FTheta {
            reference: FThetaReference::PixelDistanceToAngle,
            ..fitted(&usual())
        };
        let f_theta = of(Lens::FTheta(lens));
        assert_eq!(
            f_theta["parameters"]["reference_poly"],
            "PIXELDIST_TO_ANGLE"
        );
        assert_eq!(
            f_theta["parameters"]["angle_to_pixeldist_poly"],
            json!(lens.angle_to_pixel_distance)
        );
        for model in [open_cv, fisheye, f_theta] {
            assert_eq!(model["parameters"]["resolution"], json!([1600, 900]));
            assert_eq!(model["parameters"]["shutter_type"], "GLOBAL");
        }
        let rolling = Intrinsics {
            shutter: Shutter::new(ShutterDirection::RightToLeft, 0.03, [1600, 900]),
            ..usual()
        };
        let parameters = &model(&rolling)["parameters"];
        assert_eq!(parameters["shutter_type"], "ROLLING_RIGHT_TO_LEFT");
    }
}
