//! Cameras of messages as intrinsics, and back.

use decouplegs::scene::lens::windshield::{angle_coefficients, angle_polynomial};
use decouplegs::scene::lens::{
    ANGLE_LIMIT_RAD, FTheta, FThetaReference, Fisheye, Lens, OpenCv, Windshield,
    WindshieldDirection,
};
use decouplegs::scene::{Intrinsics, Shutter, ShutterDirection};
use tonic::Status;

use crate::wire::sensorsim::bivariate_windshield_model_parameters::ReferencePolynomial;
use crate::wire::sensorsim::camera_spec::{CameraParam, ExternalDistortion};
use crate::wire::sensorsim::ftheta_camera_param::PolynomialType;
use crate::wire::sensorsim::{
    BivariateWindshieldModelParameters, CameraSpec, FthetaCameraParam, LinearCde,
    OpenCvFisheyeCameraParam, OpenCvPinholeCameraParam, ShutterType,
};

/// F-theta calibrations count pixels from the center of the first one, images from its corner.
const FTHETA_ORIGIN_PX: f64 = 0.5;

/// Intrinsics of `spec` for images of `size_px` (width, height); at its own size if both are zero.
///
/// # Errors
/// INVALID_ARGUMENT with the name of the field that makes no sense.
pub fn intrinsics_of(
    spec: &CameraSpec,
    size_px: [u32; 2],
    field: &str,
) -> Result<Intrinsics, Status> {
    let asked = if size_px == [0, 0] {
        [spec.resolution_w, spec.resolution_h]
    } else {
        size_px
    };
    let own = if [spec.resolution_w, spec.resolution_h] == [0, 0] {
        asked
    } else {
        [spec.resolution_w, spec.resolution_h]
    };
    let windshield = spec
        .external_distortion
        .as_ref()
        .map(|ExternalDistortion::BivariateWindshieldModelParam(model)| windshield_of(model, field))
        .transpose()?;
    let intrinsics = match &spec.camera_param {
        Some(CameraParam::OpencvPinholeParam(pinhole)) => {
            of_pinhole(pinhole, own, &format!("{field}.opencv_pinhole_param"))?
        }
        Some(CameraParam::OpencvFisheyeParam(fisheye)) => {
            of_fisheye(fisheye, own, &format!("{field}.opencv_fisheye_param"))?
        }
        Some(CameraParam::FthetaParam(ftheta)) => {
            of_ftheta(ftheta, own, &format!("{field}.ftheta_param"))?
        }
        None => {
            return Err(Status::invalid_argument(format!(
                "{field}.camera_param is missing"
            )));
        }
    };
    let intrinsics = Intrinsics {
        windshield,
        ..intrinsics
    };
    intrinsics
        .check()
        .map_err(|reason| Status::invalid_argument(format!("{field}: {reason}")))?;
    let mut resized = intrinsics.resized(asked[0], asked[1]);
    if let Lens::FTheta(_) = intrinsics.lens {
        // AlpaSim's rectifier scales the number itself, which counts from the middle of the first
        // pixel (`src/driver/src/alpasim_driver/rectification.py:434`): half a pixel stays one.
        let scaled = |center_px: f64, from: u32, to: u32| {
            (center_px - FTHETA_ORIGIN_PX) * f64::from(to) / f64::from(from) + FTHETA_ORIGIN_PX
        };
        resized.cx_px = scaled(intrinsics.cx_px, own[0], asked[0]);
        resized.cy_px = scaled(intrinsics.cy_px, own[1], asked[1]);
    }
    resized.check().map_err(|reason| {
        Status::invalid_argument(format!("resolution_w and resolution_h: {reason}"))
    })?;
    Ok(resized)
}

/// The shutter of the camera in `field` of a message, which reads its image in `readout_s`.
///
/// # Errors
/// INVALID_ARGUMENT with the name of the field that makes no sense.
pub fn shutter_of(
    spec: &CameraSpec,
    readout_s: f64,
    intrinsics: &Intrinsics,
    field: &str,
) -> Result<Shutter, Status> {
    let direction = match spec.shutter_type() {
        ShutterType::Unknown | ShutterType::Global => return Ok(Shutter::GLOBAL),
        ShutterType::RollingTopToBottom => ShutterDirection::TopToBottom,
        ShutterType::RollingBottomToTop => ShutterDirection::BottomToTop,
        ShutterType::RollingLeftToRight => ShutterDirection::LeftToRight,
        ShutterType::RollingRightToLeft => ShutterDirection::RightToLeft,
    };
    let size_px = [intrinsics.width_px, intrinsics.height_px];
    let shutter = Shutter::new(direction, readout_s, size_px);
    let checked = shutter.check(size_px);
    checked.map_err(|reason| {
        Status::invalid_argument(format!("{field}.shutter_type with frame_end_us: {reason}"))
    })?;
    Ok(shutter)
}

/// The windshield of the camera in `field` of a message, by the polynomials that it refers to.
fn windshield_of(
    model: &BivariateWindshieldModelParameters,
    field: &str,
) -> Result<Windshield, Status> {
    let (direction, horizontal, vertical) = match model.reference_poly() {
        ReferencePolynomial::Forward => (
            WindshieldDirection::Forward,
            &model.horizontal_poly,
            &model.vertical_poly,
        ),
        ReferencePolynomial::Backward => (
            WindshieldDirection::Backward,
            &model.horizontal_poly_inverse,
            &model.vertical_poly_inverse,
        ),
    };
    let polynomial = |coefficients: &[f64]| {
        angle_polynomial(coefficients).map_err(|reason| {
            Status::invalid_argument(format!("{field}.external_distortion: {reason}"))
        })
    };
    Ok(Windshield {
        direction,
        horizontal: polynomial(horizontal)?,
        vertical: polynomial(vertical)?,
    })
}

/// The windshield as a message: the polynomials of the direction that is known.
fn windshield_message(windshield: &Windshield) -> ExternalDistortion {
    let horizontal = angle_coefficients(&windshield.horizontal);
    let vertical = angle_coefficients(&windshield.vertical);
    let message = match windshield.direction {
        WindshieldDirection::Forward => BivariateWindshieldModelParameters {
            reference_poly: ReferencePolynomial::Forward.into(),
            horizontal_poly: horizontal,
            vertical_poly: vertical,
            ..Default::default()
        },
        WindshieldDirection::Backward => BivariateWindshieldModelParameters {
            reference_poly: ReferencePolynomial::Backward.into(),
            horizontal_poly_inverse: horizontal,
            vertical_poly_inverse: vertical,
            ..Default::default()
        },
    };
    ExternalDistortion::BivariateWindshieldModelParam(message)
}

/// `values` and zeros behind them.
fn padded<const N: usize>(values: &[f64], field: &str) -> Result<[f64; N], Status> {
    if values.len() > N {
        let count = values.len();
        return Err(Status::invalid_argument(format!(
            "{field}: {count} coefficients, at most {N} are known"
        )));
    }
    Ok(std::array::from_fn(|place| {
        values.get(place).copied().unwrap_or(0.0)
    }))
}

fn of_pinhole(
    pinhole: &OpenCvPinholeCameraParam,
    size_px: [u32; 2],
    field: &str,
) -> Result<Intrinsics, Status> {
    let lens = OpenCv {
        radial: padded(&pinhole.radial_coeffs, &format!("{field}.radial_coeffs"))?,
        tangential: padded(
            &pinhole.tangential_coeffs,
            &format!("{field}.tangential_coeffs"),
        )?,
        thin_prism: padded(
            &pinhole.thin_prism_coeffs,
            &format!("{field}.thin_prism_coeffs"),
        )?,
    };
    let focal_px = [pinhole.focal_length_x, pinhole.focal_length_y];
    let center_px = [pinhole.principal_point_x, pinhole.principal_point_y];
    Ok(Intrinsics {
        lens: if lens == OpenCv::default() {
            Lens::Pinhole
        } else {
            Lens::OpenCv(lens)
        },
        ..Intrinsics::pinhole(size_px, focal_px, center_px)
    })
}

fn of_fisheye(
    fisheye: &OpenCvFisheyeCameraParam,
    size_px: [u32; 2],
    field: &str,
) -> Result<Intrinsics, Status> {
    let radial = padded(&fisheye.radial_coeffs, &format!("{field}.radial_coeffs"))?;
    let max_angle_rad = if fisheye.max_angle == 0.0 {
        ANGLE_LIMIT_RAD
    } else {
        fisheye.max_angle
    };
    let focal_px = [fisheye.focal_length_x, fisheye.focal_length_y];
    let center_px = [fisheye.principal_point_x, fisheye.principal_point_y];
    Ok(Intrinsics {
        lens: Lens::Fisheye(Fisheye {
            radial,
            max_angle_rad,
        }),
        ..Intrinsics::pinhole(size_px, focal_px, center_px)
    })
}

fn of_ftheta(
    ftheta: &FthetaCameraParam,
    size_px: [u32; 2],
    field: &str,
) -> Result<Intrinsics, Status> {
    let reference = match (
        ftheta.reference_poly(),
        ftheta.pixeldist_to_angle_poly.is_empty(),
    ) {
        (PolynomialType::PixeldistToAngle, _) | (PolynomialType::Unknown, false) => {
            FThetaReference::PixelDistanceToAngle
        }
        (PolynomialType::AngleToPixeldist, _) | (PolynomialType::Unknown, true) => {
            FThetaReference::AngleToPixelDistance
        }
    };
    let lens = FTheta {
        reference,
        pixel_distance_to_angle: padded(
            &ftheta.pixeldist_to_angle_poly,
            &format!("{field}.pixeldist_to_angle_poly"),
        )?,
        angle_to_pixel_distance: padded(
            &ftheta.angle_to_pixeldist_poly,
            &format!("{field}.angle_to_pixeldist_poly"),
        )?,
        max_angle_rad: if ftheta.max_angle == 0.0 {
            ANGLE_LIMIT_RAD
        } else {
            ftheta.max_angle
        },
        linear_cde: ftheta.linear_cde.as_ref().map_or([1.0, 0.0, 0.0], |cde| {
            [cde.linear_c, cde.linear_d, cde.linear_e]
        }),
    };
    let lens_checked = Lens::FTheta(lens);
    // Focal lengths at the center come from the polynomials, which must be sound for that.
    lens_checked
        .check()
        .map_err(|reason| Status::invalid_argument(format!("{field}: {reason}")))?;
    let center_px = [ftheta.principal_point_x, ftheta.principal_point_y]
        .map(|point_px| point_px + FTHETA_ORIGIN_PX);
    Ok(Intrinsics {
        lens: lens_checked,
        ..Intrinsics::pinhole(size_px, lens.center_focal_px(), center_px)
    })
}

/// `intrinsics` as a message, for the camera called `logical_id`.
#[must_use]
pub fn spec_of(intrinsics: &Intrinsics, logical_id: &str) -> CameraSpec {
    let camera_param = match &intrinsics.lens {
        Lens::Pinhole => {
            CameraParam::OpencvPinholeParam(pinhole_of(intrinsics, &OpenCv::default()))
        }
        Lens::OpenCv(lens) => CameraParam::OpencvPinholeParam(pinhole_of(intrinsics, lens)),
        Lens::Fisheye(lens) => CameraParam::OpencvFisheyeParam(OpenCvFisheyeCameraParam {
            principal_point_x: intrinsics.cx_px,
            principal_point_y: intrinsics.cy_px,
            focal_length_x: intrinsics.fx_px,
            focal_length_y: intrinsics.fy_px,
            radial_coeffs: lens.radial.to_vec(),
            max_angle: lens.max_angle_rad,
        }),
        Lens::FTheta(lens) => CameraParam::FthetaParam(FthetaCameraParam {
            principal_point_x: intrinsics.cx_px - FTHETA_ORIGIN_PX,
            principal_point_y: intrinsics.cy_px - FTHETA_ORIGIN_PX,
            reference_poly: match lens.reference {
                FThetaReference::PixelDistanceToAngle => PolynomialType::PixeldistToAngle,
                FThetaReference::AngleToPixelDistance => PolynomialType::AngleToPixeldist,
            }
            .into(),
            pixeldist_to_angle_poly: lens.pixel_distance_to_angle.to_vec(),
            angle_to_pixeldist_poly: lens.angle_to_pixel_distance.to_vec(),
            max_angle: lens.max_angle_rad,
            linear_cde: Some(LinearCde {
                linear_c: lens.linear_cde[0],
                linear_d: lens.linear_cde[1],
                linear_e: lens.linear_cde[2],
            }),
        }),
    };
    CameraSpec {
        camera_param: Some(camera_param),
        external_distortion: intrinsics.windshield.as_ref().map(windshield_message),
        logical_id: logical_id.to_owned(),
        resolution_h: intrinsics.height_px,
        resolution_w: intrinsics.width_px,
        shutter_type: match intrinsics.shutter.direction() {
            ShutterDirection::Global => ShutterType::Global,
            ShutterDirection::TopToBottom => ShutterType::RollingTopToBottom,
            ShutterDirection::BottomToTop => ShutterType::RollingBottomToTop,
            ShutterDirection::LeftToRight => ShutterType::RollingLeftToRight,
            ShutterDirection::RightToLeft => ShutterType::RollingRightToLeft,
        }
        .into(),
        ..CameraSpec::default()
    }
}

fn pinhole_of(intrinsics: &Intrinsics, lens: &OpenCv) -> OpenCvPinholeCameraParam {
    OpenCvPinholeCameraParam {
        principal_point_x: intrinsics.cx_px,
        principal_point_y: intrinsics.cy_px,
        focal_length_x: intrinsics.fx_px,
        focal_length_y: intrinsics.fy_px,
        radial_coeffs: lens.radial.to_vec(),
        tangential_coeffs: lens.tangential.to_vec(),
        thin_prism_coeffs: lens.thin_prism.to_vec(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lenses() -> [Lens; 4] {
        let ftheta = FTheta {
            reference: FThetaReference::AngleToPixelDistance,
            pixel_distance_to_angle: [0.0, 1.0 / 400.0, 0.0, 0.0, 0.0, 0.0],
            angle_to_pixel_distance: [0.0, 400.0, 1.0, -8.0, 0.0, 0.0],
            max_angle_rad: 1.2,
            linear_cde: [1.001, 0.0, 0.0],
        };
        [
            Lens::Pinhole,
            Lens::OpenCv(OpenCv {
                radial: [-0.1, 0.01, 0.0, 0.0, 0.0, 0.0],
                tangential: [0.001, -0.001],
                ..OpenCv::default()
            }),
            Lens::Fisheye(Fisheye {
                radial: [0.01, -0.002, 0.0, 0.0],
                max_angle_rad: 1.3,
            }),
            Lens::FTheta(ftheta),
        ]
    }

    #[test]
    fn cameras_survive_the_wire_and_are_scaled_to_the_size_asked_for() {
        for lens in lenses() {
            let mut own = Intrinsics {
                cx_px: 300.5,
                lens,
                ..Intrinsics::from_horizontal_fov(640, 360, 1.1)
            };
            if let Lens::FTheta(ftheta) = lens {
                [own.fx_px, own.fy_px] = ftheta.center_focal_px();
            }
            let spec = spec_of(&own, "front");
            assert_eq!(intrinsics_of(&spec, [0, 0], "k").unwrap(), own);
            let mut resized = own.resized(320, 90);
            if let Lens::FTheta(_) = lens {
                // 300 and 179.5 px of 640 x 360 from the middle of the first pixel.
                [resized.cx_px, resized.cy_px] = [150.0 + 0.5, 0.25 * 179.5 + 0.5];
            }
            assert_eq!(intrinsics_of(&spec, [320, 90], "k").unwrap(), resized);
            let unsized_spec = CameraSpec {
                resolution_h: 0,
                resolution_w: 0,
                ..spec
            };
            assert_eq!(intrinsics_of(&unsized_spec, [640, 360], "k").unwrap(), own);
            assert!(
                intrinsics_of(&unsized_spec, [0, 0], "k")
                    .unwrap_err()
                    .message()
                    .contains("0x0")
            );
        }
    }

    #[test]
    fn lenses_that_are_none_are_refused_by_the_name_of_their_field() {
        let own = Intrinsics::from_horizontal_fov(640, 360, 1.1);
        let mut spec = spec_of(&own, "front");
        let Some(CameraParam::OpencvPinholeParam(pinhole)) = &mut spec.camera_param else {
            panic!("{spec:?}")
        };
        pinhole.radial_coeffs = vec![0.0; 7];
        assert!(
            intrinsics_of(&spec, [0, 0], "k")
                .unwrap_err()
                .message()
                .contains("k.opencv_pinhole_param.radial_coeffs")
        );
        spec.camera_param = Some(CameraParam::FthetaParam(FthetaCameraParam::default()));
        assert!(
            intrinsics_of(&spec, [0, 0], "k")
                .unwrap_err()
                .message()
                .contains("k.ftheta_param")
        );
    }
    #[test]
    fn windshields_survive_the_wire_and_nonsense_is_refused() {
        let mut windshield = Windshield::straight();
        windshield.horizontal[0][0] = 0.01;
        windshield.vertical[1][1] = -0.02;
        for direction in [WindshieldDirection::Forward, WindshieldDirection::Backward] {
            let own = Intrinsics {
                windshield: Some(Windshield {
                    direction,
                    ..windshield
                }),
                ..Intrinsics::from_horizontal_fov(640, 360, 1.1)
            };
            let mut spec = spec_of(&own, "front");
            assert_eq!(intrinsics_of(&spec, [0, 0], "k").unwrap(), own);
            let Some(ExternalDistortion::BivariateWindshieldModelParam(model)) =
                &mut spec.external_distortion
            else {
                panic!("{spec:?}")
            };
            model.vertical_poly = vec![0.0; 4];
            model.vertical_poly_inverse = vec![0.0; 4];
            let refused = intrinsics_of(&spec, [0, 0], "k").unwrap_err();
            assert!(
                refused.message().contains("k.external_distortion"),
                "{refused}"
            );
        }
    }
}
