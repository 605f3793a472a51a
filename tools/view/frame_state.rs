//! State that goes with the images of an update, as JSON.

use std::time::Duration;

use decouplegs::render::FrameStatistics;
use decouplegs::scene::lens::FThetaReference;
use decouplegs::scene::{Camera, Intrinsics, Lens, RayMap};
use serde_json::{Value, json};

use crate::protocol::Pane;
use crate::viewpoint::pose_json;

/// Quality of JPEG while something moves.
pub const QUALITY_MOVING: u8 = 75;

/// Words on how the images were made: in `reduced` size while something moves; otherwise exact, and
/// whether they are those of a log, if it has any.
pub fn badge(reduced: Option<f64>, is_logged: Option<bool>) -> String {
    match (reduced, is_logged) {
        (None, None) => "exact".into(),
        (None, Some(true)) => "exact, same bits as the log".into(),
        (None, Some(false)) => "exact, other bits than the log".into(),
        (Some(1.0), _) => format!("JPEG {QUALITY_MOVING}"),
        (Some(scale), _) => format!("1/{} size while moving", 1.0 / scale),
    }
}

/// Camera of a pane as the page projects by it.
pub fn pane_json(pane: &Pane, camera: &Camera) -> Value {
    let mut json = camera_json(camera);
    json["stream"] = pane.stream.into();
    json["source"] = pane.source.into();
    json["pose"] = pose_json(&camera.world_from_camera);
    json
}

/// Image of a camera as the page projects by it, wherever the camera stands.
pub fn camera_json(camera: &Camera) -> Value {
    let k = &camera.intrinsics;
    json!({
        "size_px": [k.width_px, k.height_px],
        "focal_px": [k.fx_px, k.fy_px],
        "center_px": [k.cx_px, k.cy_px],
        "lens": lens_json(k),
    })
}

/// Lens as the page projects by it; null for pinholes. A windshield is left out: boxes behind one
/// are off by its refraction.
fn lens_json(k: &Intrinsics) -> Value {
    let mut json = match k.lens {
        Lens::Pinhole => return Value::Null,
        Lens::OpenCv(lens) => json!({
            "kind": "opencv",
            "radial": lens.radial,
            "tangential": lens.tangential,
            "thin_prism": lens.thin_prism,
        }),
        Lens::Fisheye(lens) => json!({"kind": "fisheye", "radial": lens.radial}),
        Lens::FTheta(lens) => json!({
            "kind": "ftheta",
            "follows_pixel_distance": lens.reference == FThetaReference::PixelDistanceToAngle,
            "pixel_distance_to_angle": lens.pixel_distance_to_angle,
            "angle_to_pixel_distance": lens.angle_to_pixel_distance,
            "linear_cde": lens.linear_cde,
        }),
    };
    json["limit_rad"] = RayMap::new(k).limit_rad().into();
    json
}

/// Times of an image, milliseconds: on the device in all and by stage, on the host, and for
/// encoding; counts of what was drawn.
pub fn times_json(statistics: &[FrameStatistics], rendered: Duration, all: Duration) -> Value {
    let ms = |duration: Duration| 1e3 * duration.as_secs_f64();
    let gpu: Duration = statistics.iter().map(|frame| frame.gpu_time).sum();
    let mut stages: Vec<(&str, f64)> = Vec::new();
    for stage in statistics.iter().flat_map(|frame| &frame.stages) {
        let stage_ms = 1e-6 * stage.duration_ns as f64;
        match stages.iter_mut().find(|(name, _)| *name == stage.name) {
            Some((_, sum_ms)) => *sum_ms += stage_ms,
            None => stages.push((stage.name, stage_ms)),
        }
    }
    let count = |of: fn(&FrameStatistics) -> u32| -> u64 {
        statistics.iter().map(|frame| u64::from(of(frame))).sum()
    };
    json!({
        "gpu": ms(gpu),
        "render": ms(rendered),
        "encode": ms(all - rendered),
        "stages": stages,
        "splats": count(|frame| frame.required.records),
        "pairs": count(|frame| frame.required.pairs),
    })
}
