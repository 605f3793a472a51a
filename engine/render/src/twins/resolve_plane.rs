//! Means and medians of an attribute by pixel: `resolve_plane.comp`.

use crate::plane::Plane;

/// Values of `plane`, from weighted sums and alpha.
#[must_use]
pub fn resolve_plane(sums: &[[f32; 4]], plane: Plane) -> Vec<f32> {
    let value = |sum: &[f32; 4], channel: usize| match (plane.is_median(), sum[3]) {
        (true, 1.0) => sum[channel],
        (false, alpha) if alpha > 0.0 => sum[channel] / alpha,
        _ => 0.0,
    };
    sums.iter()
        .flat_map(|sum| (0..plane.channels()).map(move |channel| value(sum, channel)))
        .collect()
}
