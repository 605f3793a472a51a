//! Cameras of messages as intrinsics, and back.

use decouplegs::scene::Intrinsics;
use tonic::Status;

use crate::wire::sensorsim::camera_spec::CameraParam;
use crate::wire::sensorsim::{CameraSpec, OpenCvPinholeCameraParam, ShutterType};

/// What `spec` projects, sampled at `width_px` x `height_px`; at its own size where both are zero.
///
/// # Errors
/// INVALID_ARGUMENT with the name of the field that makes no sense, UNIMPLEMENTED for lenses that cannot be drawn.
pub fn intrinsics_of(spec: &CameraSpec, [width_px, height_px]: [u32; 2], field: &str) -> Result<Intrinsics, Status> {
    let asked = if [width_px, height_px] == [0, 0] { [spec.resolution_w, spec.resolution_h] } else { [width_px, height_px] };
    let own = if [spec.resolution_w, spec.resolution_h] == [0, 0] { asked } else { [spec.resolution_w, spec.resolution_h] };
    if spec.external_distortion.is_some() {
        return Err(Status::unimplemented(format!("{field}.external_distortion: windshields cannot be drawn")));
    }
    let intrinsics = match &spec.camera_param {
        Some(CameraParam::OpencvPinholeParam(pinhole)) => pinhole_of(pinhole, own, field)?,
        Some(CameraParam::OpencvFisheyeParam(_)) => {
            return Err(Status::unimplemented(format!("{field}.opencv_fisheye_param: fisheye lenses cannot be drawn")));
        }
        Some(CameraParam::FthetaParam(_)) => {
            return Err(Status::unimplemented(format!("{field}.ftheta_param: f-theta lenses cannot be drawn")));
        }
        None => return Err(Status::invalid_argument(format!("{field}.camera_param is missing"))),
    };
    intrinsics.check().map_err(|reason| Status::invalid_argument(format!("{field}: {reason}")))?;
    let resized = intrinsics.resized(asked[0], asked[1]);
    resized.check().map_err(|reason| Status::invalid_argument(format!("resolution_w and resolution_h: {reason}")))?;
    Ok(resized)
}

fn pinhole_of(pinhole: &OpenCvPinholeCameraParam, own_px: [u32; 2], field: &str) -> Result<Intrinsics, Status> {
    let OpenCvPinholeCameraParam { radial_coeffs, tangential_coeffs, thin_prism_coeffs, .. } = pinhole;
    let mut bends = radial_coeffs.iter().chain(tangential_coeffs).chain(thin_prism_coeffs);
    if bends.any(|coefficient| *coefficient != 0.0) {
        return Err(Status::unimplemented(format!("{field}.opencv_pinhole_param: distortion cannot be drawn")));
    }
    Ok(Intrinsics {
        width_px: own_px[0],
        height_px: own_px[1],
        fx_px: pinhole.focal_length_x,
        fy_px: pinhole.focal_length_y,
        cx_px: pinhole.principal_point_x,
        cy_px: pinhole.principal_point_y,
    })
}

/// `intrinsics` as a message, for the camera called `logical_id`.
#[must_use]
pub fn spec_of(intrinsics: &Intrinsics, logical_id: &str) -> CameraSpec {
    CameraSpec {
        camera_param: Some(CameraParam::OpencvPinholeParam(OpenCvPinholeCameraParam {
            principal_point_x: intrinsics.cx_px,
            principal_point_y: intrinsics.cy_px,
            focal_length_x: intrinsics.fx_px,
            focal_length_y: intrinsics.fy_px,
            radial_coeffs: vec![0.0; 6],
            tangential_coeffs: vec![0.0; 2],
            thin_prism_coeffs: vec![0.0; 4],
        })),
        logical_id: logical_id.to_owned(),
        resolution_h: intrinsics.height_px,
        resolution_w: intrinsics.width_px,
        shutter_type: ShutterType::Global.into(),
        ..CameraSpec::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pinholes_survive_the_wire_and_are_scaled_to_the_size_asked_for() {
        let own = Intrinsics { cx_px: 300.5, ..Intrinsics::from_horizontal_fov(640, 360, 1.1) };
        let spec = spec_of(&own, "front");
        assert_eq!(intrinsics_of(&spec, [0, 0], "k").unwrap(), own);
        assert_eq!(intrinsics_of(&spec, [320, 90], "k").unwrap(), own.resized(320, 90));
        let unsized_spec = CameraSpec { resolution_h: 0, resolution_w: 0, ..spec };
        assert_eq!(intrinsics_of(&unsized_spec, [640, 360], "k").unwrap(), own);
        assert!(intrinsics_of(&unsized_spec, [0, 0], "k").unwrap_err().message().contains("0x0"));
    }
}
