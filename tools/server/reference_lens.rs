//! Lenses that a request leaves to a camera of the scene, as clients of NuRec do.

use std::sync::Arc;

use tonic::Status;

use crate::scene_registry::{SceneRegistry, metadata_of};
use decouplegs_alpasim::camera_spec::spec_of;
use decouplegs_alpasim::wire::sensorsim::camera_spec::CameraParam;
use decouplegs_alpasim::wire::sensorsim::{CameraSpec, FthetaCameraParam, RgbRenderRequest};

/// `request` with the polynomials of the scene's camera of the same `logical_id`, if its f-theta
/// lens has none. CARLA's example asks for cameras of other sizes this way
/// (`dict_to_camera_spec` of `PythonAPI/examples/nvidia/nurec/nurec_integration.py` at 25b0043).
/// The view is as wide as that of the scene's camera: pixel distances go by the width.
///
/// # Errors
/// Returns the errors of reading the scene.
pub async fn with_reference_lens(
    registry: &Arc<SceneRegistry>,
    mut request: RgbRenderRequest,
) -> Result<RgbRenderRequest, Status> {
    let Some(spec) = &mut request.camera_intrinsics else {
        return Ok(request);
    };
    let width_px = spec.resolution_w;
    let Some(CameraParam::FthetaParam(lens)) = &mut spec.camera_param else {
        return Ok(request);
    };
    if !lens.pixeldist_to_angle_poly.is_empty() || !lens.angle_to_pixeldist_poly.is_empty() {
        return Ok(request);
    }
    let metadata = metadata_of(registry, request.scene_id.clone()).await?;
    let named = metadata
        .rig
        .cameras()
        .find(|camera| camera.name == spec.logical_id);
    if let Some(camera) = named {
        complete(lens, width_px, &spec_of(&camera.intrinsics, &camera.name));
    }
    Ok(request)
}

/// Fills in what `lens`, of an image `width_px` wide, does not tell.
fn complete(lens: &mut FthetaCameraParam, width_px: u32, reference: &CameraSpec) {
    let Some(CameraParam::FthetaParam(known)) = &reference.camera_param else {
        return;
    };
    let scale = f64::from(width_px) / f64::from(reference.resolution_w.max(1));
    if !scale.is_normal() {
        return;
    }
    let powers = |coefficients: &[f64]| -> Vec<f64> {
        let power = |(degree, value): (usize, &f64)| value / scale.powi(degree as i32);
        coefficients.iter().enumerate().map(power).collect()
    };
    lens.reference_poly = known.reference_poly;
    lens.pixeldist_to_angle_poly = powers(&known.pixeldist_to_angle_poly);
    let distances = known.angle_to_pixeldist_poly.iter();
    lens.angle_to_pixeldist_poly = distances.map(|value| value * scale).collect();
    if lens.max_angle == 0.0 || lens.max_angle > known.max_angle {
        lens.max_angle = known.max_angle;
    }
    if lens.linear_cde.is_none() {
        lens.linear_cde = known.linear_cde;
    }
}
