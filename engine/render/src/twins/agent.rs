//! Splats of an agent as they are unpacked: `agent.glsl` and `agent_buffers.glsl`.

use decouplegs_scene::codebook::rgb_from_ycocg;
use glam::{Mat3, Vec3, vec3};

use crate::layout::AgentRecord;

/// A splat of an agent, in the agent's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnpackedSplat {
    /// Mean position.
    pub mean_m: [f32; 3],
    /// Peak alpha.
    pub opacity: f32,
    /// Factor on its shape.
    pub size: f32,
    /// Entry of its asset's shapes.
    pub shape: u32,
    /// Entry of its asset's colors.
    pub color: u32,
    /// Residual that is added to that entry's DC term, RGB.
    pub dc_residual: Vec3,
}

/// The splat in three words, fields as [`decouplegs_scene::CodedSplat`] says.
#[must_use]
pub fn unpack_splat([xy, z_opacity_size, codes]: [u32; 3], agent: &AgentRecord) -> UnpackedSplat {
    let position = [xy & 0xffff, xy >> 16, z_opacity_size & 0xffff];
    let residual = [
        (codes >> 19 & 0x1f) as i32 - 16,
        (codes >> 24 & 0xf) as i32 - 8,
        (codes >> 28) as i32 - 8,
    ];
    let size_code = (z_opacity_size >> 24) as f32;
    UnpackedSplat {
        mean_m: std::array::from_fn(|axis| {
            agent.box_min_m[axis] + position[axis] as f32 * agent.box_step_m[axis]
        }),
        opacity: (z_opacity_size >> 16 & 0xff) as f32 / 255.0,
        size: (agent.log2_size_min + size_code * agent.log2_size_step).exp2(),
        shape: codes & 0x1ff,
        color: codes >> 9 & 0x3ff,
        dc_residual: rgb_from_ycocg(std::array::from_fn(|axis| {
            residual[axis] as f32 * agent.dc_residual_step[axis]
        }))
        .into(),
    }
}

/// The agent that cluster `cluster` of a frame belongs to: the last whose clusters begin at or
/// before it.
#[must_use]
pub fn agent_of_cluster(cluster: u32, agents: &[AgentRecord]) -> usize {
    agents
        .iter()
        .rposition(|agent| agent.first_cluster <= cluster)
        .unwrap_or(0)
}

/// Columns whose products with themselves sum to the covariance, in the agent's frame: the splat's
/// triangular factor.
#[must_use]
pub fn axes_of(agent: &AgentRecord, splat: &UnpackedSplat, coded_shapes: &[[f32; 6]]) -> Mat3 {
    let [xx, yx, yy, zx, zy, zz] = coded_shapes[(agent.first_shape + splat.shape) as usize];
    splat.size * Mat3::from_cols(vec3(xx, yx, zx), vec3(0.0, yy, zy), vec3(0.0, 0.0, zz))
}
