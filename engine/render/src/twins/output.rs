//! Accumulation of a pixel and its output: `output.glsl`.

pub use decouplegs_shaders::constants::{
    COARSE_COLUMNS, FINE_TILE_PX, TRANSMITTANCE_FULL, TRANSMITTANCE_MEDIAN, TRANSMITTANCE_MIN,
};
use glam::Vec3;

use super::planes::{PLANES_EMPTY, PlaneSums, planes_over, write_planes};
use crate::Plane;
use crate::layout::{COARSE_HEIGHT_PX, COARSE_PIXELS, COARSE_WIDTH_PX, CameraRecord, FINE_TILES};

/// Position `[column, row]` in the coarse tile of the pixel at `index` of a partial result.
#[must_use]
pub fn pixel_offset(index: usize) -> [u32; 2] {
    let (right, left_place) = (
        (index / (COARSE_PIXELS / 2)) as u32,
        (index % (COARSE_PIXELS / 2)) as u32,
    );
    let (tile, block, lane) = (left_place / 32, left_place / 8 % 4, left_place % 8);
    let in_tile = [
        block % 2 * 4 + lane % 2 + 2 * right,
        block / 2 * 4 + lane / 2,
    ];
    [
        tile % COARSE_COLUMNS * FINE_TILE_PX + in_tile[0],
        tile / COARSE_COLUMNS * FINE_TILE_PX + in_tile[1],
    ]
}

/// Indices of the pixels of fine tile `tile`, in the order of a partial result: the left ones, then
/// the right ones.
pub fn pixels_of_tile(tile: usize) -> impl Iterator<Item = usize> {
    let half = COARSE_PIXELS / FINE_TILES / 2;
    let left = tile * half..(tile + 1) * half;
    left.clone()
        .chain(left.map(|index| index + COARSE_PIXELS / 2))
}

/// Accumulated color and transmittance of a pixel, front to back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pixel {
    /// Sum of weight times color.
    pub color: Vec3,
    /// Transmittance that remains for splats behind.
    pub transmittance: f32,
    /// Sums of the planes.
    pub planes: PlaneSums,
    /// Record in which half of the light is gone, once no more than that is left.
    pub median: u32,
}

/// A pixel that nothing was added to.
pub const PIXEL_EMPTY: Pixel = Pixel {
    color: Vec3::ZERO,
    transmittance: 1.0,
    planes: PLANES_EMPTY,
    median: 0,
};

/// The camera whose image coarse tile `bin` belongs to.
#[must_use]
pub fn camera_of_bin(cameras: &[CameraRecord], bin: u32) -> usize {
    (1..cameras.len()).fold(0, |camera, next| {
        if cameras[next].first_bin <= bin {
            next
        } else {
            camera
        }
    })
}

/// Top left pixel of a coarse tile.
#[must_use]
pub fn coarse_tile_origin(bin: u32, camera: &CameraRecord) -> [u32; 2] {
    let tile = bin - camera.first_bin;
    [
        tile % camera.coarse_tiles[0] * COARSE_WIDTH_PX,
        tile / camera.coarse_tiles[0] * COARSE_HEIGHT_PX,
    ]
}

/// Images in f32, of all cameras one after the other.
#[derive(Clone, Debug, PartialEq)]
pub struct Images {
    /// RGB over the sky, and alpha.
    pub images_f32: Vec<[f32; 4]>,
    /// All planes, one after the other.
    pub planes: Vec<u32>,
}

impl Images {
    /// Images of `pixels` pixels, black; the words of all planes are `word`.
    #[must_use]
    pub fn filled(pixels: usize, word: u32) -> Self {
        Self {
            images_f32: vec![[0.0; 4]; pixels],
            planes: vec![word; Plane::ALL.len() * pixels],
        }
    }

    /// Expected depth at `index`, meters.
    #[must_use]
    pub fn depth_m(&self, index: usize) -> f32 {
        f32::from_bits(self.plane(Plane::Depth)[index])
    }

    /// Words of `plane`, one per pixel.
    #[must_use]
    pub fn plane(&self, plane: Plane) -> &[u32] {
        let pixels = self.images_f32.len();
        &self.planes[plane as usize * pixels..][..pixels]
    }
}

/// Writes a pixel of `camera`'s image, if it lies in it.
pub fn write_pixel(
    images: &mut Images,
    camera: &CameraRecord,
    at: [u32; 2],
    pixel: &Pixel,
    sky: Vec3,
) {
    if at[0] >= camera.size_px[0] || at[1] >= camera.size_px[1] {
        return;
    }
    let index = (camera.first_pixel + at[1] * camera.size_px[0] + at[0]) as usize;
    let alpha = 1.0 - pixel.transmittance;
    images.images_f32[index] = (pixel.color + pixel.transmittance * sky)
        .extend(alpha)
        .to_array();
    let pixels = images.images_f32.len();
    write_planes(&mut images.planes, index, pixels, alpha, &pixel.planes);
}

/// RGBA as four bytes, clamped and rounded, red lowest.
#[must_use]
pub fn pack_unorm_4x8(value: [f32; 4]) -> u32 {
    u32::from_le_bytes(value.map(|channel| (channel.clamp(0.0, 1.0) * 255.0).round() as u8))
}

/// The pixel after `nearer`, then `farther` behind it. Its median is that of `nearer`.
#[must_use]
pub fn over(mut nearer: Pixel, farther: &Pixel) -> Pixel {
    let share = nearer.transmittance;
    nearer.color += share * farther.color;
    nearer.transmittance *= farther.transmittance;
    nearer.planes = planes_over(nearer.planes, share, &farther.planes);
    nearer
}
