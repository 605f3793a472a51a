//! Nodes of the levels of detail of a background.

use bytemuck::{Pod, Zeroable};
use decouplegs_scene::DetailNode;

/// `DetailNode` of `detail.glsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct NodeRecord {
    /// Center of a ball that holds all splats below the node.
    pub center_m: [f32; 3],
    /// Radius of the ball.
    pub radius_m: f32,
    /// Distance of splats that were merged.
    pub error_m: f32,
    /// Index of the parent, or `u32::MAX`.
    pub parent: u32,
}

impl From<&DetailNode> for NodeRecord {
    fn from(node: &DetailNode) -> Self {
        Self {
            center_m: node.center_m,
            radius_m: node.radius_m,
            error_m: node.error_m,
            parent: node.parent,
        }
    }
}
