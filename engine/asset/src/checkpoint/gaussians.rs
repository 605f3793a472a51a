//! Splats out of the tensors of one model.

use decouplegs_scene::{SplatCloud, sh};

use super::value::Node;
use super::{Checkpoint, Tensor};
use crate::DecodeError;
use crate::activation::{normalized, scale_of_log, sigmoid};

/// Names of a model's tensors in the files of one trainer.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Names {
    /// `[N, 3]`, meters.
    pub(crate) means: &'static str,
    /// `[N, 3]`, natural logarithms.
    pub(crate) scales: &'static str,
    /// `[N, 4]`, w, x, y, z of any length.
    pub(crate) rotations: &'static str,
    /// `[N]` or `[N, 1]`, logits.
    pub(crate) opacities: &'static str,
    /// `[N, 3]` or `[N, 1, 3]`.
    pub(crate) dc: &'static str,
    /// `[N, coefficients, 3]`: unlike in a PLY, the color is the inner index.
    pub(crate) rest: &'static str,
}

/// The splats of `model`, a dictionary of tensors called `names`. DC is given as `dc` makes it of
/// the tensor.
pub(crate) fn cloud_of(
    checkpoint: &Checkpoint<'_>,
    model: &Node,
    names: &Names,
    dc: impl Fn(&Tensor<'_>) -> Result<Vec<[f32; 3]>, DecodeError>,
) -> Result<SplatCloud, DecodeError> {
    let tensor = |name: &str| {
        let node = checkpoint.tree.get(model, name).ok_or_else(|| {
            let there: Vec<&str> = checkpoint.tree.keys(model).take(24).collect();
            DecodeError::Malformed(format!(
                "the model has no '{name}', only: {}",
                there.join(", ")
            ))
        })?;
        checkpoint.tensor(node, name)
    };
    let tensors = ModelTensors {
        means: tensor(names.means)?,
        scales: tensor(names.scales)?,
        rotations: tensor(names.rotations)?,
        opacities: tensor(names.opacities)?,
        dc: tensor(names.dc)?,
        rest: tensor(names.rest)?,
    };
    let scales = rows::<3>(&tensors.scales, names.scales)?;
    tensors.cloud(names, &scales, dc)
}

/// Tensors of one model, in whatever container its file holds them. Shapes are those of [`Names`].
pub(crate) struct ModelTensors<'a> {
    pub(crate) means: Tensor<'a>,
    pub(crate) scales: Tensor<'a>,
    pub(crate) rotations: Tensor<'a>,
    pub(crate) opacities: Tensor<'a>,
    pub(crate) dc: Tensor<'a>,
    pub(crate) rest: Tensor<'a>,
}

impl ModelTensors<'_> {
    /// The splats of these tensors, with the logarithms of scales given as `log_scales`; tensors
    /// are called by `names` in messages.
    pub(crate) fn cloud(
        &self,
        names: &Names,
        log_scales: &[[f32; 3]],
        dc: impl Fn(&Tensor<'_>) -> Result<Vec<[f32; 3]>, DecodeError>,
    ) -> Result<SplatCloud, DecodeError> {
        let means = rows::<3>(&self.means, names.means)?;
        let count = means.len();
        let same = |found: usize, name: &str| {
            let message = || format!("'{name}' has {found} rows for {count} means");
            if found == count {
                Ok(())
            } else {
                Err(DecodeError::Malformed(message()))
            }
        };
        same(log_scales.len(), names.scales)?;
        let rotations = rows::<4>(&self.rotations, names.rotations)?;
        same(rotations.len(), names.rotations)?;
        same(self.opacities.len(), names.opacities)?;
        let sh_dc = dc(&self.dc)?;
        same(sh_dc.len(), names.dc)?;
        let (sh_degree, sh_rest) = coefficients(&self.rest, names.rest, count)?;
        Ok(SplatCloud {
            means,
            scales: log_scales
                .iter()
                .map(|logarithms| logarithms.map(scale_of_log))
                .collect(),
            rotations: rotations.into_iter().map(normalized).collect(),
            opacities: self.opacities.f32s().map(sigmoid).collect(),
            sh_degree,
            sh_dc,
            sh_rest,
        })
    }
}

/// DC as `[N, 3]` or `[N, 1, 3]` holds it.
pub(crate) fn plain_dc(tensor: &Tensor<'_>) -> Result<Vec<[f32; 3]>, DecodeError> {
    rows::<3>(tensor, "the DC colors")
}

/// The rows of a tensor whose last dimension is `N` and whose others, but for the first, are 1.
pub(crate) fn rows<const N: usize>(
    tensor: &Tensor<'_>,
    what: &str,
) -> Result<Vec<[f32; N]>, DecodeError> {
    let shape = tensor.shape();
    let is_rows = shape.len() >= 2
        && shape.last() == Some(&N)
        && shape[1..shape.len() - 1].iter().all(|&size| size == 1);
    if !is_rows {
        return Err(DecodeError::Malformed(format!(
            "'{what}' has the shape {shape:?}, expected [splats, {N}]"
        )));
    }
    let mut values = tensor.f32s();
    let mut row = || std::array::from_fn(|_| values.next().unwrap_or_default());
    Ok((0..shape[0]).map(|_| row()).collect())
}

/// Degree and coefficients of `[N, coefficients, 3]`. Those of a fourth degree, which nothing here
/// evaluates, are left out.
fn coefficients(
    tensor: &Tensor<'_>,
    what: &str,
    count: usize,
) -> Result<(u8, Vec<[f32; 3]>), DecodeError> {
    let shape = tensor.shape();
    let wrong = || {
        DecodeError::Malformed(format!(
            "'{what}' has the shape {shape:?}, expected [{count}, 0, 3, 8, 15 or 24, 3]"
        ))
    };
    // A model without them is saved as [N, 0, 3].
    let &[rows, stored, channels] = shape else {
        return Err(wrong());
    };
    let degree: u8 = match stored {
        0 => 0,
        3 => 1,
        8 => 2,
        15 | 24 => sh::DEGREE_MAX,
        _ => return Err(wrong()),
    };
    if rows != count || channels != 3 {
        return Err(wrong());
    }
    let stride = sh::coefficient_count(degree) - 1;
    let mut values = tensor.f32s();
    let mut all = Vec::with_capacity(count * stride);
    for index in 0..count * stored {
        let coefficient = std::array::from_fn(|_| values.next().unwrap_or_default());
        if index % stored < stride {
            all.push(coefficient);
        }
    }
    Ok((degree, all))
}
