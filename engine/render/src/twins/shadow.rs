//! Shadows on the ground: `shadow.glsl`, and which clusters they may lie on: `cull_shadows.comp`.

use glam::Vec3;

use crate::layout::{ClusterRecord, ShadowRecord};

fn from_shadow_m(position_m: [f32; 3], shadow: &ShadowRecord) -> Vec3 {
    (Vec3::from_array(position_m) - Vec3::from_array(shadow.center_high_m))
        - Vec3::from_array(shadow.center_low_m)
}

/// Share of the light that remains for a splat with its mean at `mean_m`.
#[must_use]
pub fn shadow_factor(shadow: &ShadowRecord, mean_m: [f32; 3]) -> f32 {
    let offset = from_shadow_m(mean_m, shadow);
    if Vec3::from_array(shadow.normal).dot(offset).abs() > shadow.slab_m {
        return 1.0;
    }
    let [x, y] =
        [shadow.along, shadow.across].map(|axis| Vec3::from_array(axis).dot(offset).powi(2));
    let radius = (x * x + y * y).sqrt().sqrt();
    if radius > shadow.cutoff {
        return 1.0;
    }
    let radius = (0..shadow.sharpness).fold(radius, |radius, _| radius * radius);
    (1.0 - shadow.strength * (-shadow.log2_decay * radius).exp2()).clamp(0.0, 1.0)
}

/// True if the box of a cluster's means reaches into the slab of ground that the shadow lies on.
#[must_use]
pub fn shadow_overlaps(shadow: &ShadowRecord, cluster: &ClusterRecord) -> bool {
    let center = from_shadow_m(cluster.center_m, shadow);
    let half_extent = Vec3::from_array(cluster.half_extent_m);
    let wide = half_extent + 1e-5 * (center.abs().element_sum() + half_extent.element_sum());
    let within = |axis: [f32; 3], limit: f32| {
        let axis = Vec3::from_array(axis);
        axis.dot(center).abs() <= axis.abs().dot(wide) + limit
    };
    cluster.splat_radius_m >= 0.0
        && within(shadow.normal, shadow.slab_m)
        && within(shadow.along, shadow.cutoff)
        && within(shadow.across, shadow.cutoff)
}
