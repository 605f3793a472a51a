//! Conservative frustum culling of boxes and splats: `visibility.glsl`.

pub(super) use decouplegs_shaders::constants::DILATION_RADIUS_PX;
use glam::{Vec2, Vec3, vec2};

use super::footprint::{Footprint, reached_coarse_rows, reached_coarse_tiles};
use super::projection::from_camera_m;
use crate::layout::{CameraRecord, ClusterRecord};

/// The largest value of dot(normal, p) over the cluster's box, p relative to the camera.
pub(super) fn farthest(cluster: &ClusterRecord, center: Vec3, normal: Vec3) -> f32 {
    normal.dot(center) + normal.abs().dot(Vec3::from_array(cluster.half_extent_m))
}

/// True if a splat of the cluster may overlap the camera's image.
#[must_use]
pub fn cluster_overlaps(cluster: &ClusterRecord, camera: &CameraRecord, near_m: f32) -> bool {
    let center = from_camera_m(cluster.center_m, camera);
    let limit = Vec2::from_array(camera.slope_min)
        .abs()
        .max(Vec2::from_array(camera.slope_max).abs());
    let spread = vec2(
        (1.0 + limit.x * limit.x).sqrt(),
        (1.0 + limit.y * limit.y).sqrt(),
    );
    let half_extent = Vec3::from_array(cluster.half_extent_m);
    let slack =
        1e-5 * (center.abs().element_sum() + half_extent.element_sum() + cluster.splat_radius_m);
    let radius = cluster.splat_radius_m * spread + slack;
    let [focal, principal] = [camera.focal_px, camera.principal_px].map(Vec2::from_array);
    let size = vec2(camera.size_px[0] as f32, camera.size_px[1] as f32);
    let low = (principal + DILATION_RADIUS_PX) / focal;
    let high = (size - principal + DILATION_RADIUS_PX) / focal;
    let [row_x, row_y, row_z] = [camera.row_x, camera.row_y, camera.row_z].map(Vec3::from_array);
    farthest(cluster, center, row_z) + slack >= near_m
        && farthest(cluster, center, row_x + low.x * row_z) + radius.x >= 0.0
        && farthest(cluster, center, -row_x + high.x * row_z) + radius.x >= 0.0
        && farthest(cluster, center, row_y + low.y * row_z) + radius.y >= 0.0
        && farthest(cluster, center, -row_y + high.y * row_z) + radius.y >= 0.0
}

/// True if the splat may overlap a coarse tile of the camera.
#[must_use]
pub fn splat_overlaps(splat: &Footprint, squares_max: f32, camera: &CameraRecord) -> bool {
    let [first, last] = reached_coarse_rows(splat, squares_max, camera.size_px[1]);
    (first..=last).any(|row| {
        let [left, right] = reached_coarse_tiles(splat, squares_max, row as u32, camera.size_px);
        left <= right
    })
}
