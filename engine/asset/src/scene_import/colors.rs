//! Color corrections of checkpoints: matrices of three factors and an offset per channel.

use decouplegs_scene::Photometry;

use super::ImportedScene;
use crate::DecodeError;
use crate::checkpoint::{Checkpoint, Node};

/// Columns of a color matrix: three factors and an offset.
const COLUMNS: usize = 4;

/// Center of an image, in parts of its height and width.
const CENTER: [f64; 2] = [0.5, 0.5];

/// Correction of drivestudio (`Affine` in `models/modules.py`): the identity, and a matrix that two
/// layers make of an embedding per image. Views that were not trained on take the mean embedding.
///
/// # Errors
/// Returns an error if tensors are broken or do not fit together, or there is no such `image`.
pub(super) fn of_embeddings(
    checkpoint: &Checkpoint<'_>,
    (name, model): (&str, &Node),
    image: Option<usize>,
    scene: &mut ImportedScene,
) -> Result<(), DecodeError> {
    let there = |key: &str| checkpoint.tree.get(model, key).is_some();
    if !(there("embedding.weight") && there("decoder.0.weight") && there("decoder.2.weight")) {
        scene.notes.push(format!(
            "{name} is left out: it has no embedding and decoder as drivestudio writes them"
        ));
        return Ok(());
    }
    let embeddings = Table::read(checkpoint, model, "embedding.weight")?;
    let mut input = embeddings.chosen(name, image)?;
    let first = Linear::read(checkpoint, model, "decoder.0")?;
    let by_place = first.weights.columns == input.len() + CENTER.len();
    if by_place {
        input.extend(CENTER);
    }
    let mut hidden = first.applied(&input)?;
    hidden
        .iter_mut()
        .for_each(|value| *value = f64::max(*value, 0.0));
    let added = Linear::read(checkpoint, model, "decoder.2")?.applied(&hidden)?;
    let mut matrix = matrix_of(name, &added)?;
    for (channel, row) in matrix.iter_mut().enumerate() {
        row[channel] += 1.0;
    }
    let of = match image {
        Some(image) => format!("that of image {image}"),
        None => format!("that of the mean of {} embeddings", embeddings.rows()),
    };
    let place = match by_place {
        true => ", at the center of the image",
        false => "",
    };
    with_matrix(scene, name, matrix, &format!("{of}{place}"))
}

/// Correction of Street Gaussians (`affine_trans` in `lib/models/color_correction.py`): a matrix
/// per image or per camera. The file does not say which.
///
/// # Errors
/// Returns an error if the tensor is broken, or there is no such `image`.
pub(super) fn of_matrices(
    checkpoint: &Checkpoint<'_>,
    (name, model): (&str, &Node),
    image: Option<usize>,
    scene: &mut ImportedScene,
) -> Result<(), DecodeError> {
    const KEY: &str = "affine_trans";
    let tree = &checkpoint.tree;
    let saved = tree.get(model, "params").unwrap_or(model);
    if tree.get(saved, KEY).is_none() {
        let by_pose = tree.keys(saved).any(|key| key.starts_with(KEY));
        let why = match by_pose {
            true => "its network needs the poses of the cameras, which are in the data set",
            false => "it has no matrices",
        };
        scene.notes.push(format!("{name} is left out: {why}"));
        return Ok(());
    }
    let matrices = Table::read(checkpoint, saved, KEY)?;
    let matrix = matrix_of(name, &matrices.chosen(name, image)?)?;
    let of = match image {
        Some(image) => format!("matrix {image}"),
        None => format!(
            "the mean of {} matrices of images or cameras",
            matrices.rows()
        ),
    };
    with_matrix(scene, name, matrix, &of)
}

/// Applies `matrix` to all images of `scene`.
fn with_matrix(
    scene: &mut ImportedScene,
    name: &str,
    matrix: [[f64; COLUMNS]; 3],
    of: &str,
) -> Result<(), DecodeError> {
    let photometry = Photometry {
        matrix,
        ..Photometry::IDENTITY
    };
    photometry
        .check()
        .map_err(|reason| DecodeError::Malformed(format!("'{name}': {reason}")))?;
    scene.photometry = photometry;
    scene.notes.push(format!(
        "{name} corrects colors: {of} is the photometry of the scene; --image chooses another"
    ));
    Ok(())
}

fn matrix_of(name: &str, values: &[f64]) -> Result<[[f64; COLUMNS]; 3], DecodeError> {
    match values.as_chunks::<COLUMNS>() {
        (&[red, green, blue], []) => Ok([red, green, blue]),
        _ => Err(DecodeError::Malformed(format!(
            "'{name}' makes {} numbers; expected the 12 of a color matrix",
            values.len()
        ))),
    }
}

/// A tensor as rows of numbers: its first dimension, and all others.
struct Table {
    values: Vec<f64>,
    columns: usize,
}

impl Table {
    /// # Errors
    /// Returns an error if the tensor is absent, broken, empty or not finite.
    fn read(checkpoint: &Checkpoint<'_>, model: &Node, key: &str) -> Result<Self, DecodeError> {
        let node = checkpoint
            .tree
            .get(model, key)
            .ok_or_else(|| DecodeError::Malformed(format!("there is no '{key}'")))?;
        let tensor = checkpoint.tensor(node, key)?;
        let values: Vec<f64> = tensor.f64s().collect();
        let rows = tensor.shape().first().copied().unwrap_or(0);
        if values.is_empty() || !values.iter().all(|value| value.is_finite()) {
            return Err(DecodeError::Malformed(format!(
                "'{key}' has the shape {:?}; expected rows of finite numbers",
                tensor.shape()
            )));
        }
        Ok(Self {
            columns: values.len() / rows,
            values,
        })
    }

    fn rows(&self) -> usize {
        self.values.len() / self.columns
    }

    /// Row `image` of the table called `name`; the mean of all rows if `None`.
    fn chosen(&self, name: &str, image: Option<usize>) -> Result<Vec<f64>, DecodeError> {
        let mut rows = self.values.chunks(self.columns);
        let Some(image) = image else {
            let mut sum = vec![0.0; self.columns];
            for row in rows {
                sum.iter_mut()
                    .zip(row)
                    .for_each(|(sum, value)| *sum += value);
            }
            return Ok(sum
                .into_iter()
                .map(|sum| sum / self.rows() as f64)
                .collect());
        };
        rows.nth(image).map(<[f64]>::to_vec).ok_or_else(|| {
            DecodeError::Malformed(format!(
                "'{name}' has corrections of images 0 to {}; there is no image {image}",
                self.rows() - 1
            ))
        })
    }
}

/// A linear layer: a row of weights and a bias per output.
struct Linear {
    weights: Table,
    biases: Table,
}

impl Linear {
    fn read(checkpoint: &Checkpoint<'_>, model: &Node, layer: &str) -> Result<Self, DecodeError> {
        let [weights, biases] = ["weight", "bias"]
            .map(|part| Table::read(checkpoint, model, &format!("{layer}.{part}")));
        let (weights, biases) = (weights?, biases?);
        if biases.values.len() != weights.rows() {
            return Err(DecodeError::Malformed(format!(
                "'{layer}' has {} biases for {} rows of weights",
                biases.values.len(),
                weights.rows()
            )));
        }
        Ok(Self { weights, biases })
    }

    fn applied(&self, input: &[f64]) -> Result<Vec<f64>, DecodeError> {
        if self.weights.columns != input.len() {
            return Err(DecodeError::Malformed(format!(
                "a layer of the color correction takes {} numbers; found {}",
                self.weights.columns,
                input.len()
            )));
        }
        let output = |(row, bias): (&[f64], &f64)| {
            let products = row.iter().zip(input).map(|(weight, value)| weight * value);
            bias + products.sum::<f64>()
        };
        let rows = self.weights.values.chunks(self.weights.columns);
        Ok(rows.zip(&self.biases.values).map(output).collect())
    }
}
