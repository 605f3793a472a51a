//! Conversion between a coded cloud's arrays and the tensors of its file.

use decouplegs_scene::{CodedCloud, CodedSplat, sh};
use half::f16;
use safetensors::Dtype;

use super::container::{Container, Tensor};
use crate::{DecodeError, EncodeError};

/// The tensors of version 1, in the order in which they lie in the file: wider types first, so that
/// all are aligned.
pub(super) const NAMES: [&str; 7] = [
    "shapes",
    "codes",
    "levels",
    "colours",
    "positions",
    "opacities",
    "sizes",
];

/// Contents of the tensors.
pub(super) struct Arrays {
    pub(super) splats: Vec<CodedSplat>,
    pub(super) levels: Vec<usize>,
    pub(super) shapes: Vec<[f32; 6]>,
    /// `[entry][coefficient][rgb]` flattened over the first two.
    pub(super) colors: Vec<[f32; 3]>,
}

/// Value of a color coefficient after a write and a read: the nearest half float, ties to even;
/// infinite beyond 65519.
pub(super) fn stored(coefficient: f32) -> f32 {
    f16::from_f32(coefficient).to_f32()
}

/// Reads the tensors of an asset of the given degree.
pub(super) fn read(container: &Container, sh_degree: u8) -> Result<Arrays, DecodeError> {
    container.check_names(&NAMES)?;
    let (shapes, _) = container.rows("shapes", Dtype::F32, &[6])?;
    let (levels, _) = container.rows("levels", Dtype::U32, &[])?;
    let (colors, _) = container.rows(
        "colours",
        Dtype::F16,
        &[sh::coefficient_count(sh_degree), 3],
    )?;
    Ok(Arrays {
        splats: read_splats(container)?,
        levels: words(levels)
            .map(|word| u32::from_le_bytes(word) as usize)
            .collect(),
        shapes: shapes
            .as_chunks::<24>()
            .0
            .iter()
            .map(|row| rows_of(row, f32::from_le_bytes))
            .collect(),
        colors: colors
            .as_chunks::<6>()
            .0
            .iter()
            .map(|row| rows_of(row, |half| f16::from_le_bytes(half).to_f32()))
            .collect(),
    })
}

fn read_splats(container: &Container) -> Result<Vec<CodedSplat>, DecodeError> {
    let (positions, splats) = container.rows("positions", Dtype::U16, &[3])?;
    let (opacities, opacity_rows) = container.rows("opacities", Dtype::U8, &[])?;
    let (sizes, size_rows) = container.rows("sizes", Dtype::U8, &[])?;
    let (codes, code_rows) = container.rows("codes", Dtype::U32, &[])?;
    for (name, rows) in [
        ("opacities", opacity_rows),
        ("sizes", size_rows),
        ("codes", code_rows),
    ] {
        if rows != splats {
            let reason = format!(
                "tensor '{name}' has {rows} rows and 'positions' {splats}; expected one for each splat"
            );
            return Err(DecodeError::Malformed(reason));
        }
    }
    let rows = positions
        .as_chunks::<6>()
        .0
        .iter()
        .zip(opacities)
        .zip(sizes)
        .zip(words(codes));
    let splat =
        |(((&[a, b, c, d, e, f], &opacity), &size), codes): (((&[u8; 6], _), _), [u8; 4])| {
            CodedSplat([[a, b, c, d], [e, f, opacity, size], codes].map(u32::from_le_bytes))
        };
    Ok(rows.map(splat).collect())
}

/// `bytes` in fours; tensors have whole elements.
fn words(bytes: &[u8]) -> impl Iterator<Item = [u8; 4]> {
    bytes.as_chunks::<4>().0.iter().copied()
}

/// A row of `COUNT` values of `SIZE` bytes each.
fn rows_of<const COUNT: usize, const SIZE: usize>(
    row: &[u8],
    value: fn([u8; SIZE]) -> f32,
) -> [f32; COUNT] {
    let elements = row.as_chunks::<SIZE>().0;
    std::array::from_fn(|column| value(elements[column]))
}

/// The tensors of a cloud that passes its check.
///
/// # Errors
/// Returns an error if a color coefficient or a level has no code of its type.
pub(super) fn write(cloud: &CodedCloud) -> Result<Vec<Tensor>, EncodeError> {
    let colors = cloud.colors.as_flattened();
    if let Some(color) = colors.iter().find(|&&color| !stored(color).is_finite()) {
        return Err(EncodeError(format!(
            "a color coefficient of {color}; half floats end at {}",
            f16::MAX
        )));
    }
    let level_word = |&level: &usize| match u32::try_from(level) {
        Ok(level) => Ok(level.to_le_bytes()),
        Err(_) => Err(EncodeError(format!(
            "a level of {level} splats; at most {} fit",
            u32::MAX
        ))),
    };
    let levels: Vec<[u8; 4]> = cloud
        .levels
        .iter()
        .map(level_word)
        .collect::<Result<_, _>>()?;
    let (splats, coefficients) = (cloud.splats.len(), sh::coefficient_count(cloud.sh_degree));
    let bytes = || {
        cloud
            .splats
            .iter()
            .map(|splat| splat.0.map(u32::to_le_bytes))
    };
    let positions = bytes()
        .flat_map(|[[a, b, c, d], [e, f, ..], _]| [a, b, c, d, e, f])
        .collect();
    let shapes = cloud
        .shapes
        .as_flattened()
        .iter()
        .flat_map(|entry| entry.to_le_bytes())
        .collect();
    let halves = colors
        .iter()
        .flat_map(|&color| f16::from_f32(color).to_le_bytes())
        .collect();
    let tensor = |name, dtype, shape, bytes| Tensor {
        name,
        dtype,
        shape,
        bytes,
    };
    Ok(vec![
        tensor("shapes", Dtype::F32, vec![cloud.shapes.len(), 6], shapes),
        tensor(
            "codes",
            Dtype::U32,
            vec![splats],
            bytes().flat_map(|[_, _, codes]| codes).collect(),
        ),
        tensor(
            "levels",
            Dtype::U32,
            vec![levels.len()],
            levels.into_flattened(),
        ),
        tensor(
            "colours",
            Dtype::F16,
            vec![cloud.color_count(), coefficients, 3],
            halves,
        ),
        tensor("positions", Dtype::U16, vec![splats, 3], positions),
        tensor(
            "opacities",
            Dtype::U8,
            vec![splats],
            bytes().map(|[_, word, _]| word[2]).collect(),
        ),
        tensor(
            "sizes",
            Dtype::U8,
            vec![splats],
            bytes().map(|[_, word, _]| word[3]).collect(),
        ),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coefficients_are_rounded_to_the_nearest_half_ties_to_even() {
        // One step of a half float above 1 is 2^-10.
        let step = (-10f32).exp2();
        for (coefficient, expected) in [
            (1.0 + 0.49 * step, 1.0),
            (1.0 + 0.5 * step, 1.0),
            (1.0 + 0.51 * step, 1.0 + step),
            (1.0 + 1.5 * step, 1.0 + 2.0 * step),
            (-0.1, -0.099_975_586),
            (65_519.0, 65_504.0),
            (65_520.0, f32::INFINITY),
            (3e-8, 5.960_464_5e-8),
            (2.9e-8, 0.0),
        ] {
            assert_eq!(stored(coefficient), expected, "{coefficient}");
        }
        assert!(stored(f32::NAN).is_nan());
    }
}
