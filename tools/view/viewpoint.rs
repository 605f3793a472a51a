//! Sizes of images, and points under their pixels.

use decouplegs::scene::{Camera, Intrinsics, Pose, RayMap};
use glam::{DVec2, DVec3};
use serde_json::{Value, json};

/// Point at `at`, shares of the image, on the level `z_m` of the world; `None` where the ray does
/// not come down to it within a kilometer.
pub fn point_at_height(camera: &Camera, at: [f64; 2], z_m: f64) -> Option<DVec3> {
    const FAR_M: f64 = 1000.0;
    let k = &camera.intrinsics;
    let pixel = DVec2::from(at) * DVec2::new(k.width_px.into(), k.height_px.into());
    let ray = RayMap::new(k).unproject(pixel)?;
    let pose = &camera.world_from_camera;
    let (from, ray) = (pose.translation, pose.rotation * ray);
    let far_m = (z_m - from.z) / ray.z;
    (far_m > 0.0 && far_m < FAR_M).then(|| from + far_m * ray)
}

/// A pose as the page reads it.
pub fn pose_json(pose: &Pose) -> Value {
    json!({"position_m": pose.translation.to_array(), "rotation": pose.rotation.to_array()})
}

/// `own` made smaller, in its shape, until it fits into `pane_px`.
pub fn fitted(own: &Intrinsics, pane_px: [u32; 2]) -> Intrinsics {
    let share = |pane_px: u32, own_px: u32| f64::from(pane_px) / f64::from(own_px);
    let scale = share(pane_px[0], own.width_px).min(share(pane_px[1], own.height_px));
    scaled(own, scale)
}

/// `own` times `scale`, where that is below 1.
pub fn scaled(own: &Intrinsics, scale: f64) -> Intrinsics {
    if scale >= 1.0 {
        return *own;
    }
    let side = |side_px: u32| ((f64::from(side_px) * scale).round() as u32).max(1);
    own.resized(side(own.width_px), side(own.height_px))
}
