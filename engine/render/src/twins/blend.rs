//! Blends one segment of one coarse tile's list, front to back: `blend.comp`.

use decouplegs_scene::Rules;
use glam::Vec3;

use super::footprint::{Footprint, center_of, log2_alpha, log2_alpha_min};
use super::output::{
    PIXEL_EMPTY, Pixel, TRANSMITTANCE_MEDIAN, camera_of_bin, coarse_tile_origin, pixel_offset,
};
use super::planes::add_to_planes;
use super::record::{load_color, load_footprint};
use crate::layout::{BlendItem, COARSE_PIXELS, CameraRecord, NO_PARTIAL, response_squares_max};
use crate::stages::PixelEnd;

/// Adds one splat, whose alpha is not too small, to a pixel. `full`: the pixel takes no more; the
/// splat at which it ends makes it so.
fn blend_pixel(
    pixel: &mut Pixel,
    full: &mut bool,
    log2_alpha: f32,
    record: u32,
    color: Vec3,
    [depth_m, instance]: [u32; 2],
    alpha_max: f32,
    end: PixelEnd,
) {
    if *full {
        return;
    }
    let alpha = log2_alpha.exp2().min(alpha_max);
    let left = pixel.transmittance * (1.0 - alpha);
    *full = end.stop_limit().is_some_and(|limit| left <= limit);
    if *full && end != PixelEnd::Inclusive {
        return;
    }
    if pixel.transmittance > TRANSMITTANCE_MEDIAN {
        pixel.median = record;
    }
    let weight = pixel.transmittance * alpha;
    pixel.color += weight * color;
    pixel.transmittance -= weight;
    add_to_planes(&mut pixel.planes, weight, f32::from_bits(depth_m), instance);
}

/// The pixels of the item's coarse tile, by their index in a partial result ([`pixel_offset`]).
/// Every record meets every pixel: the kernel's lists may leave out nothing that counts. Positions
/// are relative to the coarse tile.
///
/// `before` is what composite left to be finished, for the pass that finishes it: only pixels whose
/// transmittance is negative there take part. In results of cut lists, a negative transmittance
/// says that the pixel ends in this segment.
#[must_use]
pub fn blend(
    cameras: &[CameraRecord],
    item: &BlendItem,
    records: &[u32],
    footprints: &[[u32; 4]],
    labels: &[[u32; 2]],
    rules: &Rules,
    end: PixelEnd,
    before: Option<&[Pixel]>,
) -> Vec<Pixel> {
    let camera = &cameras[camera_of_bin(cameras, item.bin)];
    let mut pixels = before.map_or_else(|| vec![PIXEL_EMPTY; COARSE_PIXELS], <[Pixel]>::to_vec);
    let mut full: Vec<bool> = pixels
        .iter()
        .map(|pixel| before.is_some() && pixel.transmittance >= 0.0)
        .collect();
    let takes_no_part = full.clone();
    pixels
        .iter_mut()
        .for_each(|pixel| pixel.transmittance = pixel.transmittance.abs());
    // Later segments do not know what lies before them.
    let end = match before.is_some() || item.segment == 0 {
        true => end,
        false => PixelEnd::Full,
    };
    let (alpha_max, squares_max) = (rules.alpha_max as f32, response_squares_max(rules));
    let splats: Vec<_> = listed(item, records, footprints, camera)
        .map(|(record, footprint)| {
            let (index, color) = (record as usize, load_color(footprints, record as usize));
            (record, footprint, color, labels[index])
        })
        .collect();
    for (index, (pixel, full)) in pixels.iter_mut().zip(&mut full).enumerate() {
        let [x, y] = pixel_offset(index);
        let center = center_of(x, y);
        for (record, footprint, color, label) in &splats {
            let log2_alpha = log2_alpha(footprint, center);
            if log2_alpha >= log2_alpha_min(footprint, squares_max) {
                blend_pixel(
                    pixel, full, log2_alpha, *record, *color, *label, alpha_max, end,
                );
            }
        }
    }
    for (index, pixel) in pixels.iter_mut().enumerate() {
        if item.partial != NO_PARTIAL && full[index] && !takes_no_part[index] {
            pixel.transmittance = -pixel.transmittance;
        }
    }
    pixels
}

/// The records of `item`, and their footprints relative to its coarse tile.
fn listed<'a>(
    item: &BlendItem,
    records: &'a [u32],
    footprints: &'a [[u32; 4]],
    camera: &'a CameraRecord,
) -> impl Iterator<Item = (u32, Footprint)> + 'a {
    let origin = coarse_tile_origin(item.bin, camera);
    let records = &records[item.first_pair as usize..][..item.pairs as usize];
    records.iter().map(move |&record| {
        let footprint = load_footprint(footprints, record as usize, camera.mean_shift, origin);
        (record, footprint)
    })
}

/// Records in which half of the light is gone, by pixel of the item's coarse tile. `before` is the
/// transmittance before the item, negated; pixels for which it is positive take no part.
#[must_use]
pub fn finish_medians(
    cameras: &[CameraRecord],
    item: &BlendItem,
    records: &[u32],
    footprints: &[[u32; 4]],
    rules: &Rules,
    before: &[f32],
) -> Vec<Option<u32>> {
    let camera = &cameras[camera_of_bin(cameras, item.bin)];
    let (alpha_max, squares_max) = (rules.alpha_max as f32, response_squares_max(rules));
    let splats: Vec<_> = listed(item, records, footprints, camera).collect();
    let median = |(index, before): (usize, &f32)| {
        let [x, y] = pixel_offset(index);
        let center = center_of(x, y);
        let (mut transmittance, mut median) = (-before, (*before < 0.0).then_some(0));
        for (record, footprint) in &splats {
            let log2_alpha = log2_alpha(footprint, center);
            let is_blended = log2_alpha >= log2_alpha_min(footprint, squares_max);
            if transmittance > TRANSMITTANCE_MEDIAN && is_blended {
                median = Some(*record);
                transmittance -= transmittance * log2_alpha.exp2().min(alpha_max);
            }
        }
        median
    };
    before.iter().enumerate().map(median).collect()
}
