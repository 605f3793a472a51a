//! gsplat's own trainer: `{"step": ..., "splats": {...}}`, and nerfstudio's, which trains by it.

use decouplegs_scene::SplatCloud;

use super::Checkpoint;
use super::gaussians::{Names, cloud_of, plain_dc};
use super::value::Node;
use crate::DecodeError;

const NAMES: Names = Names {
    means: "means",
    scales: "scales",
    rotations: "quats",
    opacities: "opacities",
    dc: "sh0",
    rest: "shN",
};

/// nerfstudio's splatfacto, which keeps the state of the whole pipeline in one dictionary.
const SPLATFACTO: Names = Names {
    means: "_model.gauss_params.means",
    scales: "_model.gauss_params.scales",
    rotations: "_model.gauss_params.quats",
    opacities: "_model.gauss_params.opacities",
    dc: "_model.gauss_params.features_dc",
    rest: "_model.gauss_params.features_rest",
};

/// The splats of the checkpoint.
pub(super) fn cloud(checkpoint: &Checkpoint<'_>) -> Result<SplatCloud, DecodeError> {
    let (tree, root) = (&checkpoint.tree, checkpoint.tree.root());
    if let Some(splats) = tree.get(root, "splats") {
        if tree.get(splats, NAMES.dc).is_none() && tree.get(splats, "features").is_some() {
            let message = "its colors come from a network (trained with app_opt), not from spherical harmonics; train without it";
            return Err(DecodeError::Unsupported(message.into()));
        }
        return cloud_of(checkpoint, splats, &NAMES, plain_dc);
    }
    if let Some(pipeline) = tree
        .get(root, "pipeline")
        .filter(|pipeline| tree.get(pipeline, SPLATFACTO.means).is_some())
    {
        return cloud_of(checkpoint, pipeline, &SPLATFACTO, plain_dc);
    }
    if tree.get(root, "models").is_some() || tree.get(root, "background").is_some() {
        let message = "it holds a background and models that move (drivestudio or Street Gaussians); \
                    `decouplegs convert FILE FOLDER` makes a scene of it";
        return Err(DecodeError::Unsupported(message.into()));
    }
    let found = match root {
        Node::Dictionary(_) => format!(
            "a dictionary of {}",
            tree.keys(root).take(12).collect::<Vec<_>>().join(", ")
        ),
        other => other.kind().to_owned(),
    };
    Err(DecodeError::Unsupported(format!(
        "expected a checkpoint of gsplat with 'splats', found {found}; export a .ply with its trainer"
    )))
}
