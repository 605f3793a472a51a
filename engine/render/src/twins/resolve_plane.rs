//! Means of an attribute by pixel: `resolve_plane.comp`.

/// Values of a plane of `channels` per pixel, from weighted sums and alpha.
#[must_use]
pub fn resolve_plane(sums: &[[f32; 4]], channels: usize) -> Vec<f32> {
    let mean = |sum: &[f32; 4], channel: usize| match sum[3] > 0.0 {
        true => sum[channel] / sum[3],
        false => 0.0,
    };
    sums.iter()
        .flat_map(|sum| (0..channels).map(move |channel| mean(sum, channel)))
        .collect()
}
