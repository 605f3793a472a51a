//! Splats of the background as they are stored: `stored_splat.glsl`.

use crate::storage::{CompactShape, Storage};

/// Scales (m) with opacity, and unit quaternion, of splat `splat`.
#[must_use]
pub fn load_shape(
    storage: Storage,
    shapes: &[[u32; 4]],
    rotations: &[[u32; 4]],
    splat: usize,
) -> ([f32; 4], [f32; 4]) {
    match storage {
        Storage::Exact => (
            shapes[splat].map(f32::from_bits),
            rotations[splat].map(f32::from_bits),
        ),
        Storage::Compact => {
            let code = CompactShape {
                shape: shapes[splat],
                opacity: rotations[splat / 4][splat % 4],
            };
            code.unpack()
        }
    }
}
