//! Color of a splat from its spherical harmonics as they are stored: `sh.glsl`.

use glam::{Vec3, vec3};

use crate::sh_codec;
use crate::storage::Storage;

/// Coefficients of splats on the device, by plane of words (word `w` of splat `i` is at `w *
/// splat_count + i`), but for exact DC: three f32 a splat.
#[derive(Clone, Copy, Debug)]
pub struct Stored<'a> {
    /// Storage of the coefficients.
    pub storage: Storage,
    /// DC coefficients.
    pub sh_dc: &'a [u32],
    /// Bands 1, 2 and 3; those above the degree that is evaluated are not read.
    pub sh_bands: [&'a [u32]; 3],
}

impl Stored<'_> {
    /// DC coefficients of a splat.
    #[must_use]
    pub fn dc(&self, splat: usize, splat_count: usize) -> Vec3 {
        match self.storage {
            Storage::Exact => Vec3::from_array(std::array::from_fn(|k| {
                f32::from_bits(self.sh_dc[3 * splat + k])
            })),
            Storage::Compact => Vec3::from_array(self.band(0, splat, splat_count)[0]),
        }
    }

    fn band(&self, band: usize, splat: usize, splat_count: usize) -> Vec<[f32; 3]> {
        let planes = match band {
            0 => self.sh_dc,
            _ => self.sh_bands[band - 1],
        };
        let words: Vec<u32> = (0..self.storage.sh_words(band))
            .map(|word| planes[word * splat_count + splat])
            .collect();
        let bits = self.storage.sh_bits(band).unwrap_or(sh_codec::EXACT_BITS);
        sh_codec::decode_band(&words, 2 * band + 1, bits)
    }
}

/// The splat's color seen along the unit vector `d`, from the camera to the splat.
#[must_use]
pub fn sh_color(
    stored: &Stored<'_>,
    splat: usize,
    splat_count: usize,
    d: Vec3,
    sh_degree: usize,
) -> Vec3 {
    let mut color = 0.282_094_8 * stored.dc(splat, splat_count) + 0.5;
    for band in 1..=sh_degree {
        let coefficients = stored.band(band, splat, splat_count);
        for (coefficient, basis) in coefficients.iter().zip(band_basis(band, d)) {
            color += basis * Vec3::from_array(*coefficient);
        }
    }
    color.max(Vec3::ZERO)
}

/// The basis functions of a band, in the order of its coefficients.
fn band_basis(band: usize, d: Vec3) -> Vec<f32> {
    let Vec3 { x, y, z } = d;
    let Vec3 {
        x: xx,
        y: yy,
        z: zz,
    } = vec3(x * x, y * y, z * z);
    match band {
        1 => vec![-0.488_602_5 * y, 0.488_602_5 * z, -0.488_602_5 * x],
        2 => vec![
            1.092_548_5 * x * y,
            -1.092_548_5 * y * z,
            0.315_391_57 * (2.0 * zz - xx - yy),
            -1.092_548_5 * x * z,
            0.546_274_2 * (xx - yy),
        ],
        _ => vec![
            -0.590_043_6 * y * (3.0 * xx - yy),
            2.890_611_4 * x * y * z,
            -0.457_045_8 * y * (4.0 * zz - xx - yy),
            0.373_176_34 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
            -0.457_045_8 * x * (4.0 * zz - xx - yy),
            1.445_305_7 * z * (xx - yy),
            -0.590_043_6 * x * (xx - 3.0 * yy),
        ],
    }
}
