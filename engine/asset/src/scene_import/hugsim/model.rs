//! Splats of HUGSIM's checkpoints: tuples of tensors, in the order of `GaussianModel.capture`.

use decouplegs_scene::{Pose, SplatCloud, sh};
use glam::{DQuat, DVec3};

use super::TURN;
use crate::DecodeError;
use crate::checkpoint::{Checkpoint, ModelTensors, Names, Node, plain_dc, rows};

/// Places of the tensors in a tuple. Place 0 holds the degree, place 4 the class logits.
const XYZ: usize = 1;
const DC: usize = 2;
const REST: usize = 3;
const SCALING: usize = 5;
const ROTATION: usize = 6;
const OPACITY: usize = 7;
/// Entries that each tuple has.
const ENTRIES: usize = 8;

/// Names of the tensors in messages.
const NAMES: Names = Names {
    means: "xyz",
    scales: "scaling",
    rotations: "rotation",
    opacities: "opacity",
    dc: "features_dc",
    rest: "features_rest",
};

/// Natural logarithm of the thickness of ground splats, 1 mm, whose files have two scales.
const LOG_THICKNESS: f32 = -6.907_755;

/// Entries of the checkpoint's tuple: the root, or the first entry of (tuple, iteration). None
/// where the checkpoint is of another trainer.
pub(super) fn parts<'t>(checkpoint: &'t Checkpoint<'_>) -> Option<Vec<&'t Node>> {
    let tree = &checkpoint.tree;
    let is_model = |node: &Node| {
        let entries: Vec<&Node> = tree.items(node).collect();
        entries.len() >= ENTRIES
            && matches!(entries[0], Node::Int(_))
            && matches!(entries[XYZ], Node::Tensor(_))
    };
    let root = tree.root();
    let inner = tree.items(root).next();
    let model = [Some(root), inner]
        .into_iter()
        .flatten()
        .find(|node| is_model(node))?;
    Some(tree.items(model).collect())
}

/// State of the network that corrects colors: the first dictionary after the tensors.
pub(super) fn appearance<'t>(checkpoint: &'t Checkpoint<'_>) -> Option<&'t Node> {
    let entries = parts(checkpoint)?;
    let is_state = |node: &&&Node| matches!(node, Node::Dictionary(_));
    entries[ENTRIES..].iter().find(is_state).copied()
}

/// Static splats and those of the ground, which not all checkpoints have, in our axes.
pub(super) fn background_and_ground(
    checkpoint: &Checkpoint<'_>,
) -> Result<(SplatCloud, Option<SplatCloud>), DecodeError> {
    let entries = parts(checkpoint).ok_or_else(not_hugsim)?;
    let background = turned(cloud(checkpoint, &entries)?);
    let tree = &checkpoint.tree;
    let ground = entries[ENTRIES..]
        .iter()
        .find(|node| tree.items(node).len() >= ENTRIES)
        .map(|node| cloud(checkpoint, &tree.items(node).collect::<Vec<_>>()).map(turned))
        .transpose()?;
    Ok((background, ground))
}

/// Splats of an actor, in the axes of its file, with colors in our world's frame.
pub(super) fn actor(checkpoint: &Checkpoint<'_>) -> Result<SplatCloud, DecodeError> {
    let entries = parts(checkpoint).ok_or_else(not_hugsim)?;
    let mut splats = cloud(checkpoint, &entries)?;
    let turn = sh::ShRotation::new(DQuat::from_mat3(&TURN));
    let stride = splats.rest_stride().max(1);
    for rest in splats.sh_rest.chunks_mut(stride) {
        turn.rotate(rest);
    }
    Ok(splats)
}

fn not_hugsim() -> DecodeError {
    DecodeError::Malformed(format!(
        "it is no tuple of {ENTRIES} entries or more that begins with a degree and means, as HUGSIM saves one"
    ))
}

fn turned(cloud: SplatCloud) -> SplatCloud {
    let turn = Pose::new(DQuat::from_mat3(&TURN), DVec3::ZERO);
    cloud.placed(&turn, true)
}

/// Splats of the tuple `entries`, in the axes of the file.
fn cloud(checkpoint: &Checkpoint<'_>, entries: &[&Node]) -> Result<SplatCloud, DecodeError> {
    let tensor = |at: usize, name: &str| checkpoint.tensor(entries[at], name);
    let tensors = ModelTensors {
        means: tensor(XYZ, NAMES.means)?,
        scales: tensor(SCALING, NAMES.scales)?,
        rotations: tensor(ROTATION, NAMES.rotations)?,
        opacities: tensor(OPACITY, NAMES.opacities)?,
        dc: tensor(DC, NAMES.dc)?,
        rest: tensor(REST, NAMES.rest)?,
    };
    if tensors.scales.shape().last() != Some(&2) {
        let scales = rows::<3>(&tensors.scales, NAMES.scales)?;
        return tensors.cloud(&NAMES, &scales, plain_dc);
    }
    let rotations = rows::<4>(&tensors.rotations, NAMES.rotations)?;
    let thin = vertical_axis(&rotations);
    let pairs = rows::<2>(&tensors.scales, NAMES.scales)?;
    let scales: Vec<[f32; 3]> = pairs.into_iter().map(|pair| flat(pair, thin)).collect();
    tensors.cloud(&NAMES, &scales, plain_dc)
}

/// Three scales of two: `thin` is the axis of the one that is absent.
fn flat([first, second]: [f32; 2], thin: usize) -> [f32; 3] {
    match thin {
        0 => [LOG_THICKNESS, first, second],
        1 => [first, LOG_THICKNESS, second],
        _ => [first, second, LOG_THICKNESS],
    }
}

/// Local axis (0 to 2) that is most vertical on average: the normal of ground splats. The file does
/// not say which of the three scales is absent.
fn vertical_axis(rotations_wxyz: &[[f32; 4]]) -> usize {
    let mut sums = [0.0; 3];
    for rotation in rotations_wxyz {
        let [w, x, y, z] = rotation.map(f64::from);
        let rotation = DQuat::from_xyzw(x, y, z, w);
        if !(rotation.is_finite() && rotation.length_squared() > 1e-12) {
            continue;
        }
        let rotation = rotation.normalize();
        for (sum, axis) in sums.iter_mut().zip([DVec3::X, DVec3::Y, DVec3::Z]) {
            // The source's y points down.
            *sum += (rotation * axis).y.abs();
        }
    }
    let largest = (0..3).max_by(|&a, &b| f64::total_cmp(&sums[a], &sums[b]));
    largest.unwrap_or(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_axis_of_flat_splats_is_the_vertical_one() {
        let half = std::f32::consts::FRAC_1_SQRT_2;
        assert_eq!(vertical_axis(&[[1.0, 0.0, 0.0, 0.0]]), 1);
        // A quarter turn about x brings z to the vertical, one about z brings x there.
        assert_eq!(vertical_axis(&[[half, half, 0.0, 0.0]]), 2);
        assert_eq!(vertical_axis(&[[half, 0.0, 0.0, half], [0.0; 4]]), 0);
        assert_eq!(flat([1.0, 2.0], 1), [1.0, LOG_THICKNESS, 2.0]);
    }

    #[test]
    fn the_world_is_turned_to_z_up() {
        assert_eq!(TURN * DVec3::Z, DVec3::X, "forward");
        assert_eq!(TURN * DVec3::X, DVec3::NEG_Y, "right");
        assert_eq!(TURN * DVec3::Y, DVec3::NEG_Z, "down");
    }
}
