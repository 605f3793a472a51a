//! Skies of checkpoints: cube maps behind the splats.

use decouplegs_scene::SkyMap;
use glam::DMat3;

use super::ImportedScene;
use crate::DecodeError;
use crate::checkpoint::{Checkpoint, Node};
use crate::memory::decoded_bytes_max;

/// Models in which a sky is looked for: the sky itself, and the parameters that trainers save
/// beside the state of their optimizer.
const INSIDE: &str = "params";

/// Rules by which a trainer adds its sky.
pub(super) struct SkyRules {
    /// Rotation from the world to the cube, by rows.
    pub sky_from_world: [[f64; 3]; 3],
    pub clamps: bool,
    pub clamps_splats: bool,
}

/// The sky of a model: its tensor of six square faces of RGB. `None` where it has none.
///
/// # Errors
/// Returns an error if the tensor is broken, too large, or not finite.
pub(super) fn sky_of(
    checkpoint: &Checkpoint<'_>,
    model: &Node,
    rules: &SkyRules,
) -> Result<Option<SkyMap>, DecodeError> {
    let tree = &checkpoint.tree;
    let models = [Some(model), tree.get(model, INSIDE)];
    for model in models.into_iter().flatten() {
        for key in tree.keys(model) {
            let Some(node) = tree
                .get(model, key)
                .filter(|node| matches!(node, Node::Tensor(_)))
            else {
                continue;
            };
            let tensor = checkpoint.tensor(node, key)?;
            let &[6, rows, columns, 3] = tensor.shape() else {
                continue;
            };
            let bytes = 12 * tensor.len() as u64;
            if rows != columns || bytes > decoded_bytes_max(checkpoint.file_bytes) {
                let reason = format!(
                    "'{key}' has faces of {rows} x {columns} texels; expected square ones, of the size of the file"
                );
                return Err(DecodeError::Malformed(reason));
            }
            let values: Vec<f32> = tensor.f32s().collect();
            let (texels, _) = values.as_chunks::<3>();
            // The rows of one are the columns of the other.
            let world_from_sky = DMat3::from_cols_array_2d(&rules.sky_from_world);
            let mut sky = SkyMap::new(rows, texels, world_from_sky)
                .map_err(|reason| DecodeError::Malformed(format!("'{key}': {reason}")))?;
            (sky.clamps, sky.clamps_splats) = (rules.clamps, rules.clamps_splats);
            return Ok(Some(sky));
        }
    }
    Ok(None)
}

/// Adds `sky` to `scene`, or says that it has none.
pub(super) fn with_sky(scene: &mut ImportedScene, name: &str, sky: Option<SkyMap>) {
    scene.notes.push(match &sky {
        Some(sky) => format!(
            "{name} is a cube of six faces of {n} x {n} texels: written as sky.exr",
            n = sky.face_texels()
        ),
        None => format!(
            "{name} is left out: it has no tensor of six square faces; set 'sky' in the scene file to a color like it"
        ),
    });
    scene.sky = sky;
}
