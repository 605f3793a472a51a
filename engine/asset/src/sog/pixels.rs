//! Conversion of pixels to splats.

use std::borrow::Cow;

use decouplegs_scene::{SplatCloud, sh};
use rayon::prelude::*;

use super::meta::{Meta, Rest};
use super::texture::Texture;
use crate::DecodeError;
use crate::activation::{normalized, scale_of_log};

/// Palette entries side by side in the image of the palette.
pub(super) const PALETTE_COLUMNS: usize = 64;
/// Alpha of a rotation whose component w was left out; x, y and z follow.
pub(super) const FIRST_TAG: u8 = 252;

/// The splats that `meta` describes, whose images `file` gives.
pub(super) fn unpack<'b>(
    meta: &Meta,
    file: impl Fn(&str) -> Result<Cow<'b, [u8]>, DecodeError>,
) -> Result<SplatCloud, DecodeError> {
    let count = meta.count as usize;
    // A row may be filled up, and whole rows: some writers make images square.
    let texture =
        |name: &str| Texture::decode(name, &file(name)?, meta.count, 2 * meta.count + (1 << 14));
    let (low, high) = (
        texture(&meta.means.files[0])?,
        texture(&meta.means.files[1])?,
    );
    let means = (0..count)
        .into_par_iter()
        .map(|splat| mean(meta, low.at(splat), high.at(splat)))
        .collect();
    drop((low, high));
    let quats = texture(&meta.quats.files[0])?;
    let rotations = (0..count)
        .into_par_iter()
        .map(|splat| rotation(quats.at(splat)))
        .collect();
    drop(quats);
    let scales = texture(&meta.scales.files[0])?;
    let scales = coded(
        &meta.scales.codebook,
        "scales",
        count,
        |splat| scales.at(splat),
        scale_of_log,
    )?;
    let colors = texture(&meta.sh0.files[0])?;
    let opacities = (0..count)
        .into_par_iter()
        .map(|splat| f32::from(colors.at(splat)[3]) / 255.0)
        .collect();
    let sh_dc = coded(
        &meta.sh0.codebook,
        "sh0",
        count,
        |splat| colors.at(splat),
        |value| value,
    )?;
    drop(colors);
    let (sh_degree, sh_rest) = match &meta.rest {
        Some(rest) if rest.bands > 0 => (rest.bands, coefficients(rest, count, file)?),
        _ => (0, Vec::new()),
    };
    Ok(SplatCloud {
        means,
        scales,
        rotations,
        opacities,
        sh_degree,
        sh_dc,
        sh_rest,
    })
}

fn mean(meta: &Meta, low: [u8; 4], high: [u8; 4]) -> [f32; 3] {
    std::array::from_fn(|axis| {
        let share = f64::from(u16::from_le_bytes([low[axis], high[axis]])) / 65_535.0;
        let (min, max) = (
            f64::from(meta.means.mins[axis]),
            f64::from(meta.means.maxs[axis]),
        );
        let logarithm = min + (max - min) * share;
        (logarithm.abs().exp_m1() * logarithm.signum()) as f32
    })
}

/// Three components of w, x, y, z over plus or minus 1/sqrt(2), in order; the one left out is the
/// largest. A tag that names none gives a rotation of nothing, which `SplatCloud::defect_of` tells.
fn rotation([a, b, c, tag]: [u8; 4]) -> [f32; 4] {
    let Some(largest) = tag.checked_sub(FIRST_TAG) else {
        return [0.0; 4];
    };
    let small = [a, b, c]
        .map(|code| (f32::from(code) / 255.0 * 2.0 - 1.0) * std::f32::consts::FRAC_1_SQRT_2);
    let left = (1.0 - small.iter().map(|q| q * q).sum::<f32>())
        .max(0.0)
        .sqrt();
    let mut small = small.into_iter();
    normalized(std::array::from_fn(|i| {
        if i == usize::from(largest) {
            left
        } else {
            small.next().unwrap_or(0.0)
        }
    }))
}

/// Three values per splat, each an index into `codebook`.
fn coded(
    codebook: &[f32],
    what: &str,
    count: usize,
    pixel: impl Fn(usize) -> [u8; 4] + Sync,
    value: impl Fn(f32) -> f32 + Sync,
) -> Result<Vec<[f32; 3]>, DecodeError> {
    let values: Vec<f32> = codebook.iter().map(|&entry| value(entry)).collect();
    let of = |splat: usize| {
        let [r, g, b, _] = pixel(splat);
        let at = |code: u8| values.get(usize::from(code)).copied();
        Some([at(r)?, at(g)?, at(b)?])
    };
    let all: Option<Vec<[f32; 3]>> = (0..count).into_par_iter().map(of).collect();
    all.ok_or_else(|| {
        DecodeError::Malformed(format!(
            "a splat names an entry of {what}.codebook, which has only {}",
            codebook.len()
        ))
    })
}

/// The coefficients after DC of all splats.
fn coefficients<'b>(
    rest: &Rest,
    count: usize,
    file: impl Fn(&str) -> Result<Cow<'b, [u8]>, DecodeError>,
) -> Result<Vec<[f32; 3]>, DecodeError> {
    let stride = sh::coefficient_count(rest.bands) - 1;
    let rows = (rest.count as usize).div_ceil(PALETTE_COLUMNS);
    let wanted = (PALETTE_COLUMNS * stride * rows) as u64;
    let palette = Texture::decode(&rest.files[0], &file(&rest.files[0])?, wanted, 2 * wanted)?;
    if palette.width != PALETTE_COLUMNS * stride || palette.height < rows {
        return Err(DecodeError::Malformed(format!(
            "the palette of shN is {} x {} pixels, expected {} x {rows}",
            palette.width,
            palette.height,
            PALETTE_COLUMNS * stride
        )));
    }
    let labels = Texture::decode(
        &rest.files[1],
        &file(&rest.files[1])?,
        count as u64,
        2 * count as u64 + (1 << 14),
    )?;
    let outside = |what: &str| {
        DecodeError::Malformed(format!(
            "a splat names an entry of {what} that is not there"
        ))
    };
    let mut all = vec![[0.0; 3]; count * stride];
    all.par_chunks_mut(stride)
        .enumerate()
        .try_for_each(|(splat, coefficients)| {
            let [low, high, ..] = labels.at(splat);
            let label = usize::from(u16::from_le_bytes([low, high]));
            if label as u64 >= rest.count {
                return Err(outside("the palette of shN"));
            }
            // The entry's first pixel: entries lie row by row, each of `stride` pixels.
            let first = label / PALETTE_COLUMNS * palette.width + label % PALETTE_COLUMNS * stride;
            for (k, coefficient) in coefficients.iter_mut().enumerate() {
                let [r, g, b, _] = palette.at(first + k);
                for (channel, code) in coefficient.iter_mut().zip([r, g, b]) {
                    *channel = *rest
                        .codebook
                        .get(usize::from(code))
                        .ok_or_else(|| outside("shN.codebook"))?;
                }
            }
            Ok(())
        })?;
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_component_that_a_tag_names_was_left_out() {
        let middle = [128, 128, 128];
        for (largest, tag) in (252..=255).enumerate() {
            let q = rotation([middle[0], middle[1], middle[2], tag]);
            assert!(q[largest] > 0.999, "{tag}: {q:?}");
        }
        let [w, x, y, z] = rotation([255, 128, 128, 253]);
        assert!(
            (w - std::f32::consts::FRAC_1_SQRT_2).abs() < 0.01 && (x - w).abs() < 0.01,
            "{w} {x} {y} {z}"
        );
        assert_eq!(rotation([128, 128, 128, 17]), [0.0; 4]);
    }
}
