//! Placement of meshes by the nodes of a scene.

use glam::{DAffine3, DMat4, DQuat, DVec3};

use super::document::{Document, Node};
use crate::DecodeError;

/// Every mesh that the scene shows, and world from mesh. A mesh may be shown often, a node stands
/// in one place.
pub(super) fn shown_meshes(document: &Document) -> Result<Vec<(usize, DAffine3)>, DecodeError> {
    let mut visited = vec![false; document.nodes.len()];
    let mut shown = Vec::new();
    let mut open: Vec<(usize, DAffine3)> = document
        .roots()
        .into_iter()
        .map(|root| (root, DAffine3::IDENTITY))
        .collect();
    // A stack gives the last first.
    open.reverse();
    while let Some((index, parent)) = open.pop() {
        let node = document
            .nodes
            .get(index)
            .ok_or_else(|| DecodeError::Malformed(format!("there is no node {index}")))?;
        if std::mem::replace(&mut visited[index], true) {
            return Err(DecodeError::Malformed(format!(
                "node {index} is below two others, or below itself"
            )));
        }
        let world = parent * local(node, index)?;
        if let Some(mesh) = node.mesh {
            shown.push((mesh, world));
        }
        open.extend(node.children.iter().rev().map(|&child| (child, world)));
    }
    Ok(shown)
}

/// Parent from node.
fn local(node: &Node, index: usize) -> Result<DAffine3, DecodeError> {
    let transform = match &node.matrix {
        Some(matrix) => DAffine3::from_mat4(DMat4::from_cols_array(matrix)),
        None => {
            let rotation = DQuat::from_array(node.rotation);
            // glTF wants unit length; what has no direction turns nothing.
            let rotation = if rotation.length_squared() > 1e-12 {
                rotation.normalize()
            } else {
                DQuat::IDENTITY
            };
            let scale = DVec3::from_array(node.scale);
            DAffine3::from_scale_rotation_translation(
                scale,
                rotation,
                DVec3::from_array(node.translation),
            )
        }
    };
    if transform.is_finite() && transform.matrix3.determinant() != 0.0 {
        Ok(transform)
    } else {
        Err(DecodeError::Malformed(format!(
            "the transform of node {index} is not finite, or flattens what it shows"
        )))
    }
}
