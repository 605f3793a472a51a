//! Coded clouds of splats of every kind that is hard for a stage.

use decouplegs::scene::shape::{PrincipalAxes, triangular_factor};
use decouplegs::scene::{Bounds, CodedCloud, CodedSplat, ShFrame, SplatCodes};

use super::super::Random;

/// Binary logarithm of the smallest size of the hard clouds, and of the ratio between two: sizes
/// from a quarter of a millimeter to 16 m.
const LOG2_SIZE: [f32; 2] = [-12.0, 16.0 / 255.0];

/// Needles, discs, balls, points and ordinary shapes.
fn hard_shapes(random: &mut Random) -> Vec<[f32; 6]> {
    let shape = |i: usize| {
        let rotation: [f32; 4] = std::array::from_fn(|_| random.between(-1.0, 1.0));
        let scales = match i % 8 {
            0 => [1.0, 1e-5, 1e-5],
            1 => [1.0, 0.7, 1e-6],
            2 => [1.0; 3],
            3 => [0.0; 3],
            _ => std::array::from_fn(|_| random.across_scales(0.01, 1.0)),
        };
        triangular_factor(&PrincipalAxes { scales, rotation }).map(|entry| entry as f32)
    };
    (0..512).map(shape).collect()
}

/// A cloud of all 512 shapes and 1024 colors, splats at the corners of its box and anywhere in it,
/// invisible, at the edge of being so, and opaque.
pub fn hard_cloud(levels: Vec<usize>, seed: u64) -> CodedCloud {
    let mut random = Random(seed);
    let splat = |i: usize| -> CodedSplat {
        let corner = |axis: usize| if i >> (4 + axis) & 1 == 0 { 0 } else { 65_535 };
        let codes = SplatCodes {
            position: std::array::from_fn(|axis| {
                if i % 16 == 5 {
                    corner(axis)
                } else {
                    random.below(65_536) as u16
                }
            }),
            opacity: match i % 32 {
                0 => 0,
                1 => 1,
                2..8 => 255,
                _ => 2 + random.below(254) as u8,
            },
            size: if i % 16 == 6 {
                255
            } else {
                random.below(240) as u8
            },
            shape: (i % 512) as u16,
            color: (i % 1024) as u16,
            dc_residual: [
                random.below(32) as i8 - 16,
                random.below(16) as i8 - 8,
                random.below(16) as i8 - 8,
            ],
        };
        codes.into()
    };
    let splats = (0..levels.iter().sum()).map(splat).collect();
    let mut random = Random(seed + 1);
    CodedCloud {
        bounds: Bounds {
            min: [-2.2, -0.9, -0.75],
            max: [2.2, 0.9, 0.75],
        },
        log2_size_min: LOG2_SIZE[0],
        log2_size_step: LOG2_SIZE[1],
        dc_residual_step: [0.03, 0.02, 0.02],
        splats,
        levels,
        shapes: hard_shapes(&mut random),
        sh_degree: 3,
        colors: (0..1024 * 16)
            .map(|_| std::array::from_fn(|_| random.between(-0.3, 0.3)))
            .collect(),
        sh_frame: ShFrame::Canonical,
        dims_m: [4.4, 1.8, 1.5],
    }
}
