//! Color correction of HUGSIM: a network from the pose of a camera to a matrix of colors.
//!
//! The layers are those of tiny-cuda-nn (Müller, "tiny-cuda-nn", 2021): frequencies of position
//! and spherical harmonics of direction, two hidden layers of 32 numbers with ReLU, no biases. It
//! computes in half precision, this code in f64.

use decouplegs_scene::Photometry;
use glam::DVec3;

use super::model;
use super::recording::View;
use crate::DecodeError;
use crate::checkpoint::{Checkpoint, Node};
use crate::scene_import::ImportedScene;

/// Numbers of a hidden layer.
const WIDTH: usize = 32;
/// Numbers that the network makes, and those of its last layer with padding.
const OUTPUTS: usize = 12;
const PADDED_OUTPUTS: usize = 16;
/// Layers are padded to multiples of this many inputs, with ones.
const PADDING: usize = 16;
/// Spherical harmonics of a direction: bands 0, 1 and 2.
const HARMONICS: usize = 9;
/// Frequencies of each coordinate. The file does not tell their number: 3 to 6 are possible for a
/// network of 48 inputs, and HUGSIM's configuration has 4.
const FREQUENCIES: usize = 4;
/// Meters that positions are divided by, and the factor of the network's numbers.
const POSITION_M: f64 = 60.0;
const GAIN: f64 = 0.1;

/// Three rows of three factors and an offset.
type Matrix = [[f64; 4]; 3];

/// Gives the scene's cameras the mean correction of their own images, and the scene that of all
/// images; with `image` that of one training image to all.
///
/// # Errors
/// Returns an error if the network's tensor is broken, or there is no such image.
pub(super) fn apply(
    checkpoint: &Checkpoint<'_>,
    (views, image): (&[View], Option<usize>),
    scene: &mut ImportedScene,
) -> Result<(), DecodeError> {
    let Some(state) = model::appearance(checkpoint) else {
        return Ok(());
    };
    let network = match Network::read(checkpoint, state)? {
        Ok(network) => network,
        Err(why) => {
            scene
                .notes
                .push(format!("the color network is left out: {why}"));
            return Ok(());
        }
    };
    let matrices: Vec<Matrix> = views
        .iter()
        .map(|view| {
            let pose = &view.source_from_camera;
            network.matrix(pose.translation, pose.rotation * DVec3::Z)
        })
        .collect();
    if let Some(image) = image {
        let matrix = matrices.get(image).ok_or_else(|| {
            DecodeError::Malformed(format!(
                "there are images 0 to {}; there is no image {image}",
                matrices.len() - 1
            ))
        })?;
        scene.photometry = photometry(*matrix)?;
        scene.notes.push(format!(
            "the color network corrects all images as it does training image {image}"
        ));
        return Ok(());
    }
    scene.photometry = photometry(mean(&matrices))?;
    let mut deviation: f64 = 0.0;
    for (camera, rig_camera) in scene.rig.cameras_mut().enumerate() {
        let of_camera = views.iter().zip(&matrices);
        let own: Vec<Matrix> = of_camera
            .filter(|(view, _)| view.camera == camera)
            .map(|(_, matrix)| *matrix)
            .collect();
        let of_all = mean(&own);
        rig_camera.intrinsics.photometry = photometry(of_all)?;
        let off = own.iter().map(|matrix| deviation_of(matrix, &of_all));
        deviation = off.fold(deviation, f64::max);
    }
    scene.notes.push(format!(
        "the color network corrects each camera by the mean of its images; single images deviate from it by up to {:.1} of 255 on gray; --image chooses one",
        255.0 * deviation
    ));
    Ok(())
}

/// Mean of matrices; the identity for none.
fn mean(matrices: &[Matrix]) -> Matrix {
    if matrices.is_empty() {
        return Photometry::IDENTITY.matrix;
    }
    let mut sum = Matrix::default();
    for matrix in matrices {
        for (sum, value) in sum.as_flattened_mut().iter_mut().zip(matrix.as_flattened()) {
            *sum += value;
        }
    }
    sum.map(|row| row.map(|value| value / matrices.len() as f64))
}

/// Largest difference that two corrections make to black, gray or white.
fn deviation_of(a: &Matrix, b: &Matrix) -> f64 {
    let of = |gray: f64, row: &[f64; 4]| gray * (row[0] + row[1] + row[2]) + row[3];
    let mut largest: f64 = 0.0;
    for gray in [0.0, 0.5, 1.0] {
        for (a, b) in a.iter().zip(b) {
            largest = largest.max((of(gray, a) - of(gray, b)).abs());
        }
    }
    largest
}

fn photometry(matrix: Matrix) -> Result<Photometry, DecodeError> {
    let photometry = Photometry {
        matrix,
        ..Photometry::IDENTITY
    };
    photometry
        .check()
        .map_err(|reason| DecodeError::Malformed(format!("the color network: {reason}")))?;
    Ok(photometry)
}

/// Weights of the network: a row per output, layer after layer.
struct Network {
    weights: Vec<f64>,
    inputs: usize,
}

impl Network {
    /// Network of a state dictionary, or the reason why it is of another kind.
    fn read(
        checkpoint: &Checkpoint<'_>,
        state: &Node,
    ) -> Result<Result<Self, String>, DecodeError> {
        let tree = &checkpoint.tree;
        let Some(key) = tree.keys(state).find(|key| key.ends_with("params")) else {
            return Ok(Err("its state has no 'params'".into()));
        };
        let Some(node) = tree.get(state, key) else {
            return Ok(Err("its state has no 'params'".into()));
        };
        let tensor = checkpoint.tensor(node, key)?;
        let inputs = (3 * 2 * FREQUENCIES + HARMONICS).next_multiple_of(PADDING);
        let expected = WIDTH * inputs + WIDTH * WIDTH + PADDED_OUTPUTS * WIDTH;
        if tensor.len() != expected {
            return Ok(Err(format!(
                "it has {} numbers; a network of {inputs} inputs, two layers of {WIDTH} and {PADDED_OUTPUTS} outputs has {expected}",
                tensor.len()
            )));
        }
        let weights: Vec<f64> = tensor.f64s().collect();
        if !weights.iter().all(|weight| weight.is_finite()) {
            return Ok(Err("it has numbers that are not finite".into()));
        }
        Ok(Ok(Self { weights, inputs }))
    }

    /// Correction of a camera at `position_m` that looks along `forward`, both in the axes of the
    /// source. Colors are rows there, c W + b, and columns here.
    fn matrix(&self, position_m: DVec3, forward: DVec3) -> Matrix {
        let mut values = frequencies(position_m / POSITION_M);
        values.extend(harmonics(forward));
        values.resize(self.inputs, 1.0);
        let (first, rest) = self.weights.split_at(WIDTH * self.inputs);
        let (second, last) = rest.split_at(WIDTH * WIDTH);
        let rectified = |values: Vec<f64>| -> Vec<f64> {
            values.into_iter().map(|value| value.max(0.0)).collect()
        };
        let hidden = rectified(product(first, &values));
        let hidden = rectified(product(second, &hidden));
        let out: Vec<f64> = product(last, &hidden)
            .into_iter()
            .take(OUTPUTS)
            .map(|value| GAIN * value)
            .collect();
        let mut matrix = Photometry::IDENTITY.matrix;
        for (channel, row) in matrix.iter_mut().enumerate() {
            for (from, factor) in row.iter_mut().take(3).enumerate() {
                *factor += out[3 * from + channel];
            }
            row[3] = out[9 + channel];
        }
        matrix
    }
}

/// Product of a matrix of rows and a column.
fn product(rows: &[f64], column: &[f64]) -> Vec<f64> {
    let of_row = |row: &[f64]| row.iter().zip(column).map(|(a, b)| a * b).sum();
    rows.chunks(column.len()).map(of_row).collect()
}

/// Sines and cosines of each coordinate at frequencies that double.
fn frequencies(point: DVec3) -> Vec<f64> {
    let mut values = Vec::with_capacity(3 * 2 * FREQUENCIES + HARMONICS);
    for coordinate in point.to_array() {
        for frequency in 0..FREQUENCIES {
            let angle = coordinate * f64::from(1u32 << frequency) * std::f64::consts::PI;
            values.extend([angle.sin(), angle.cos()]);
        }
    }
    values
}

/// Spherical harmonics as tiny-cuda-nn evaluates them: it takes coordinates of 0 to 1 and stretches
/// them to -1 to 1, also where they are -1 to 1 already, as here.
fn harmonics(direction: DVec3) -> [f64; HARMONICS] {
    let DVec3 { x, y, z } = direction * 2.0 - 1.0;
    [
        0.282_094_791_773_878_14,
        -0.488_602_511_902_919_9 * y,
        0.488_602_511_902_919_9 * z,
        -0.488_602_511_902_919_9 * x,
        1.092_548_430_592_079_2 * x * y,
        -1.092_548_430_592_079_2 * y * z,
        0.946_174_695_757_560_1 * z * z - 0.315_391_565_252_520_05,
        -1.092_548_430_592_079_2 * x * z,
        0.546_274_215_296_039_6 * (x * x - y * y),
    ]
}
