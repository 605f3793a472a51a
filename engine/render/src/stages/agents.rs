//! Culling and projection of agents.

use decouplegs_gpu::{Buffer, Gpu, GpuError, Kernel, MemoryKind, Recorder};
use decouplegs_scene::{DepthOrder, Fog, Rules};

use super::{CameraVariant, PURPOSE, Projected, RelitColors, Visible, least_response};
use crate::asset_pool::PoolBuffers;
use crate::capacity::groups_for;
use crate::interfaces::{cull_agents, project_agents};
use crate::layout::{
    AgentRecord, CameraRecord, LensRecord, ShadingRecord, fog_vector, near_m, response_squares_max,
};
use crate::plane::{Plane, Planes};

/// The agents of a frame on the device.
pub struct AgentBuffers {
    /// One record an agent that some camera may see.
    pub agents: Buffer<AgentRecord>,
    /// The rig as each of them sees it, `[agent][camera]`.
    pub cameras: Buffer<CameraRecord>,
    /// The rig's lenses, read where some camera is no pinhole.
    pub lenses: Buffer<LensRecord>,
    /// Light on those that are shaded by normals.
    pub shadings: Buffer<ShadingRecord>,
    /// Visible agents' splats.
    pub visible: Visible,
    /// Visible splats before each `[camera][cluster]` of the agents, and their total.
    pub offsets: Buffer<u32>,
}

impl AgentBuffers {
    /// Buffers for `counts` of each.
    ///
    /// # Errors
    /// Returns an error if the device is out of memory.
    pub fn new(gpu: &Gpu, counts: AgentCounts) -> Result<Self, GpuError> {
        let AgentCounts {
            agents,
            cameras,
            clusters,
            shadings,
        } = counts;
        Ok(Self {
            agents: gpu.buffer("agents", PURPOSE, agents, MemoryKind::Device)?,
            cameras: gpu.buffer(
                "agent_cameras",
                PURPOSE,
                agents * cameras,
                MemoryKind::Device,
            )?,
            lenses: gpu.buffer("agent_lenses", PURPOSE, cameras, MemoryKind::Device)?,
            shadings: gpu.buffer("shadings", PURPOSE, shadings, MemoryKind::Device)?,
            visible: Visible::new(gpu, cameras, clusters)?,
            offsets: gpu.buffer(
                "agent_offsets",
                PURPOSE,
                cameras * clusters + 1,
                MemoryKind::Device,
            )?,
        })
    }
}

/// Counts of a frame; the buffers may have more capacity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AgentCounts {
    /// Agents that some camera may see.
    pub agents: usize,
    /// Cameras of the rig.
    pub cameras: usize,
    /// Clusters of all those agents.
    pub clusters: usize,
    /// Agents that are shaded by normals.
    pub shadings: usize,
}

/// Specialization of the agents' kernels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AgentVariant {
    /// Degree of their colors.
    pub sh_degree: u8,
    /// True if records have labels.
    pub labels: bool,
    /// True if some agents are relit.
    pub relit: bool,
    /// True if some agents are shaded by normals.
    pub shaded: bool,
    /// Kind of cameras.
    pub cameras: CameraVariant,
    /// Planes whose attributes and depths records hold.
    pub planes: Planes,
    /// True if there is fog.
    pub fog: bool,
}

/// `cull_agents.comp`.
pub struct CullAgents {
    kernel: Kernel<cull_agents::Module>,
}

impl CullAgents {
    /// The stage for images of the given rules and `cameras`.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(gpu: &Gpu, rules: &Rules, cameras: CameraVariant) -> Result<Self, GpuError> {
        let (least_response, least_response_squares) = least_response(response_squares_max(rules));
        let constants = cull_agents::Constants {
            near_m: near_m(rules),
            antialias: rules.antialias,
            lenses: cameras.lenses,
            rolling: cameras.rolling,
            least_response,
            least_response_squares,
        };
        Ok(Self {
            kernel: gpu.kernel(&constants)?,
        })
    }

    /// Marks what is visible of the agents, and returns it.
    pub fn record<'a>(
        &self,
        recorder: &mut Recorder,
        pool: &PoolBuffers,
        buffers: &'a AgentBuffers,
        counts: AgentCounts,
    ) -> &'a Visible {
        let push = cull_agents::Push {
            agent_count: counts.agents as u32,
            camera_count: counts.cameras as u32,
            cluster_count: counts.clusters as u32,
        };
        let bindings = cull_agents::Bindings {
            agents: buffers.agents.bound(),
            agent_cameras: buffers.cameras.bound(),
            coded_splats: pool.splats.bound(),
            coded_shapes: pool.shapes.bound().cast(),
            asset_clusters: pool.clusters.bound(),
            visible_words: buffers.visible.words.bound(),
            visible_counts: buffers.visible.counts.bound(),
            lenses: buffers.lenses.bound(),
        };
        recorder.dispatch(&self.kernel, bindings, push, groups_for(counts.clusters));
        &buffers.visible
    }
}

/// Agents that are projected.
#[derive(Clone, Copy)]
pub struct SeenAgents<'a> {
    /// Assets of the agents.
    pub pool: &'a PoolBuffers,
    /// The agents, the cameras as each of them has them, and what is visible.
    pub buffers: &'a AgentBuffers,
    /// Colors of those that are relit.
    pub relit: &'a RelitColors,
    /// Counts of them.
    pub counts: AgentCounts,
    /// The world's fog.
    pub fog: Option<&'a Fog>,
    /// Interval of optical flow, where it is asked for, seconds.
    pub flow_interval_s: f32,
}

/// `project_agents.comp`.
pub struct ProjectAgents {
    kernel: Kernel<project_agents::Module>,
}

impl ProjectAgents {
    /// The stage for images of the given rules and agents of the given kind.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(gpu: &Gpu, rules: &Rules, variant: AgentVariant) -> Result<Self, GpuError> {
        let writes = |plane| variant.planes.contains(plane);
        let constants = project_agents::Constants {
            near_m: near_m(rules),
            antialias: rules.antialias,
            sh_degree: u32::from(variant.sh_degree),
            radial: rules.order == DepthOrder::Radial,
            labels: variant.labels,
            relit: variant.relit,
            shaded: variant.shaded,
            lenses: variant.cameras.lenses,
            rolling: variant.cameras.rolling,
            fog: variant.fog,
            depths: variant.planes.has_medians(),
            range: writes(Plane::Range),
            normal: writes(Plane::Normal),
            flow_forward: writes(Plane::FlowForward),
            flow_backward: writes(Plane::FlowBackward),
            scene_flow: writes(Plane::SceneFlow),
        };
        Ok(Self {
            kernel: gpu.kernel(&constants)?,
        })
    }

    /// Writes a record for every visible splat of the agents behind those of the background, whose
    /// `static_lists` lists begin at `static_offsets`, and its depth key. Returns `projected`.
    pub fn record<'a>(
        &self,
        recorder: &mut Recorder,
        agents: SeenAgents<'_>,
        static_offsets: &Buffer<u32>,
        static_lists: usize,
        projected: &'a Projected,
    ) -> &'a Projected {
        let SeenAgents {
            pool,
            buffers,
            relit,
            counts,
            fog,
            flow_interval_s,
        } = agents;
        let push = project_agents::Push {
            agent_count: counts.agents as u32,
            camera_count: counts.cameras as u32,
            cluster_count: counts.clusters as u32,
            records_max: projected.room() as u32,
            static_lists: static_lists as u32,
            flow_interval_s,
            fog: fog_vector(fog),
        };
        let bindings = project_agents::Bindings {
            agents: buffers.agents.bound(),
            agent_cameras: buffers.cameras.bound(),
            coded_splats: pool.splats.bound(),
            coded_shapes: pool.shapes.bound().cast(),
            visible_words: buffers.visible.words.bound(),
            offsets: buffers.offsets.bound(),
            coded_dc: pool.color_dc.bound(),
            coded_bands: pool.color_bands.bound().cast(),
            static_offsets: static_offsets.bound(),
            relit_dc: relit.dc.bound(),
            relit_bands: relit.bands.bound().cast(),
            shadings: buffers.shadings.bound(),
            footprints: projected.footprints.bound(),
            labels: projected.labels.bound(),
            attributes: projected.attributes.bound(),
            depths: projected.depths.bound(),
            keys: projected.keys.bound(),
            lenses: buffers.lenses.bound(),
        };
        recorder.dispatch(&self.kernel, bindings, push, groups_for(counts.clusters));
        projected
    }
}
