//! Writes splats as a bundle.

use std::io::Write;
use std::path::Path;

use decouplegs_scene::SplatCloud;
use rayon::prelude::*;

use super::codebook::{fit, nearest};
use super::meta::{Coded, Means, Meta, PALETTE_MAX, Plain, Rest};
use super::palette::{self, Palette};
use super::pixels::{FIRST_TAG, PALETTE_COLUMNS};
use super::{META, NAME, texture};
use crate::activation::{log_of_scale, normalized};
use crate::zip::StoredZip;
use crate::{AssetError, EncodeError, write_atomically};

/// A scale of zero has no logarithm; this one nobody sees.
const LOG_SCALE_MIN: f32 = -30.0;

/// Rows of an image whose pixels are filled column by column. The encoder predicts a pixel from the
/// one above: neighbors in space are put one below the other.
const BAND_ROWS: usize = 64;

/// `cloud` as the bytes of a bundle, and the indices of its splats in the order of the file.
///
/// # Errors
/// Returns an error if a splat is defective ([`SplatCloud::defect_of`]) or when there is none.
pub fn encode(cloud: &SplatCloud) -> Result<(Vec<u8>, Vec<u32>), EncodeError> {
    if cloud.is_empty() {
        return Err(EncodeError("there is no splat to write".into()));
    }
    if let Some(first) = (0..cloud.len())
        .into_par_iter()
        .find_first(|&splat| cloud.defect_of(splat).is_some())
    {
        return Err(EncodeError(format!(
            "splat {first} is not finite or has no rotation; drop such splats before writing"
        )));
    }
    let count = cloud.len();
    // Rows of a multiple of four pixels in an image that is about square.
    let width = ((count as f64).sqrt() / 4.0).ceil() as usize * 4;
    let order = file_order(cloud, width);
    let mut images: Vec<Image> = Vec::new();
    let mut add = |name, pixels: Vec<[u8; 4]>| {
        let pixels = order.par_iter().map(|&splat| pixels[splat as usize]);
        images.push(Image {
            name,
            pixels: pixels.collect(),
            width,
        });
    };
    let (means, low, high) = means(cloud);
    add("means_l.webp", low);
    add("means_u.webp", high);
    let rotations = cloud.rotations.par_iter();
    let rotations = rotations.map(|&rotation| packed_rotation(rotation));
    add("quats.webp", rotations.collect());
    let logarithms: Vec<[f32; 3]> = cloud
        .scales
        .par_iter()
        .map(|scale| scale.map(|scale| log_of_scale(scale).max(LOG_SCALE_MIN)))
        .collect();
    let scales = fit(logarithms.as_flattened().iter().copied());
    add("scales.webp", indices(&scales, &logarithms));
    let sh0 = fit(cloud.sh_dc.as_flattened().iter().copied());
    let mut colors = indices(&sh0, &cloud.sh_dc);
    colors
        .par_iter_mut()
        .zip(&cloud.opacities)
        .for_each(|(pixel, opacity)| pixel[3] = (opacity * 255.0).round() as u8);
    add("sh0.webp", colors);
    let rest = (cloud.sh_degree > 0).then(|| rest(cloud, &order, width, &mut images));
    let one = |name: &str| [name.to_owned()];
    let meta = Meta {
        version: 2,
        count: count as u64,
        means,
        scales: Coded {
            codebook: scales,
            files: one("scales.webp"),
        },
        quats: Plain {
            files: one("quats.webp"),
        },
        sh0: Coded {
            codebook: sh0,
            files: one("sh0.webp"),
        },
        rest,
    };
    Ok((bundle(&meta, images)?, order))
}

/// Writes `cloud` to `path`, atomically. Returns the indices of its splats in the order of the
/// file.
///
/// # Errors
/// Returns the errors of [`encode`], and an error if the operating system refuses to write.
pub fn write(path: &Path, cloud: &SplatCloud) -> Result<Vec<u32>, AssetError> {
    let (bytes, order) = encode(cloud).map_err(|source| AssetError::Encode {
        path: path.to_owned(),
        format: NAME,
        source,
    })?;
    write_atomically(path, |file| file.write_all(&bytes))?;
    Ok(order)
}

/// An image of a bundle before it is encoded.
struct Image {
    name: &'static str,
    pixels: Vec<[u8; 4]>,
    width: usize,
}

/// Splats of `cloud` by their pixels in images of `width` columns: neighbors in space stand one
/// below the other, in bands of [`BAND_ROWS`].
fn file_order(cloud: &SplatCloud, width: usize) -> Vec<u32> {
    let mut pixels: Vec<u32> = (0..cloud.len() as u32).collect();
    pixels.par_sort_unstable_by_key(|&pixel| {
        let (row, column) = (pixel as usize / width, pixel as usize % width);
        (row / BAND_ROWS, column, row % BAND_ROWS)
    });
    let mut order = vec![0; cloud.len()];
    for (pixel, splat) in pixels.into_iter().zip(cloud.spatial_order()) {
        order[pixel as usize] = splat;
    }
    order
}

fn bundle(meta: &Meta, images: Vec<Image>) -> Result<Vec<u8>, EncodeError> {
    let failed = |error: std::io::Error| EncodeError(error.to_string());
    let encoded: Vec<(&str, Vec<u8>)> = images
        .into_par_iter()
        .map(|image| Ok((image.name, texture::encode(image.pixels, image.width)?)))
        .collect::<Result<_, EncodeError>>()?;
    let mut zip = StoredZip::new(Vec::new());
    for (name, bytes) in encoded {
        zip.add(name, &bytes).map_err(failed)?;
    }
    let text = serde_json::to_vec(meta).map_err(|error| EncodeError(format!("{META}: {error}")))?;
    zip.add(META, &text).map_err(failed)?;
    zip.finish().map_err(failed)
}

/// The extent of the means' logarithms, and the low and the high bytes of where each lies in it.
fn means(cloud: &SplatCloud) -> (Means, Vec<[u8; 4]>, Vec<[u8; 4]>) {
    let logarithm = |x: f32| f64::from(x).abs().ln_1p() * f64::from(x).signum();
    let mut mins = [f32::INFINITY; 3];
    let mut maxs = [f32::NEG_INFINITY; 3];
    for mean in &cloud.means {
        for axis in 0..3 {
            mins[axis] = mins[axis].min(logarithm(mean[axis]) as f32);
            maxs[axis] = maxs[axis].max(logarithm(mean[axis]) as f32);
        }
    }
    let code = |x: f32, axis: usize| {
        let (min, max) = (f64::from(mins[axis]), f64::from(maxs[axis]));
        let share = if max > min {
            (logarithm(x) - min) / (max - min)
        } else {
            0.0
        };
        ((share * 65_535.0).round().clamp(0.0, 65_535.0) as u16).to_le_bytes()
    };
    let codes: Vec<[[u8; 2]; 3]> = cloud
        .means
        .par_iter()
        .map(|mean| std::array::from_fn(|axis| code(mean[axis], axis)))
        .collect();
    let bytes = |which: usize| {
        codes
            .iter()
            .map(|[x, y, z]| [x[which], y[which], z[which], 255])
            .collect()
    };
    let files = ["means_l.webp", "means_u.webp"].map(String::from);
    (Means { mins, maxs, files }, bytes(0), bytes(1))
}

fn packed_rotation(rotation: [f32; 4]) -> [u8; 4] {
    let q = normalized(rotation);
    let largest = (0..4).fold(
        0,
        |best, i| if q[i].abs() > q[best].abs() { i } else { best },
    );
    // -q is the same rotation: the largest component is made positive.
    let sign = if q[largest] < 0.0 { -1.0 } else { 1.0 };
    let mut small = (0..4).filter(|&i| i != largest).map(|i| {
        let share = (q[i] * sign * std::f32::consts::SQRT_2 + 1.0) * 0.5;
        (share * 255.0).round().clamp(0.0, 255.0) as u8
    });
    let mut next = || small.next().unwrap_or(0);
    [next(), next(), next(), FIRST_TAG + largest as u8]
}

/// A pixel of codes for each triple.
fn indices(codebook: &[f32], values: &[[f32; 3]]) -> Vec<[u8; 4]> {
    let pixel = |&[a, b, c]: &[f32; 3]| {
        [
            nearest(codebook, a),
            nearest(codebook, b),
            nearest(codebook, c),
            255,
        ]
    };
    values.par_iter().map(pixel).collect()
}

/// Adds the images of the coefficients after DC: a palette with an entry for each splat, or for
/// splats that are alike where there are more than it has entries.
fn rest(cloud: &SplatCloud, order: &[u32], width: usize, images: &mut Vec<Image>) -> Rest {
    let values = cloud.sh_rest.as_flattened();
    let stride = 3 * cloud.rest_stride();
    let Palette { entries, labels } = palette::fit(values, stride, order, PALETTE_MAX as usize);
    let codebook = fit(entries.iter().copied());
    images.push(Image {
        name: "shN_centroids.webp",
        pixels: indices(&codebook, entries.as_chunks().0),
        width: PALETTE_COLUMNS * cloud.rest_stride(),
    });
    let label = |&splat: &u32| {
        let [low, high] = labels[splat as usize].to_le_bytes();
        [low, high, 0, 255]
    };
    images.push(Image {
        name: "shN_labels.webp",
        pixels: order.par_iter().map(label).collect(),
        width,
    });
    let names = ["shN_centroids.webp", "shN_labels.webp"].map(String::from);
    Rest {
        count: (entries.len() / stride) as u64,
        bands: cloud.sh_degree,
        codebook,
        files: names,
    }
}
