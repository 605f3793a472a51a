//! Medians of depth or range by pixel: `resolve_plane.comp`.

use crate::plane::Plane;

/// Values of `plane`, from medians of depth and range, and alpha.
#[must_use]
pub fn resolve_plane(medians: &[[f32; 4]], plane: Plane) -> Vec<f32> {
    let channel = usize::from(plane == Plane::RangeMedian);
    let value = |median: &[f32; 4]| {
        if median[3] == 1.0 {
            median[channel]
        } else {
            0.0
        }
    };
    medians.iter().map(value).collect()
}
