//! Culling and projection of agents.

use bytemuck::bytes_of;
use decouplegs_gpu::{Buffer, Constant, Gpu, GpuError, Kernel, MemoryKind, Recorder};
use decouplegs_scene::{DepthOrder, Fog, Rules};

use super::project::depths_constant;
use super::{
    CameraVariant, PURPOSE, Projected, RelitColors, Visible, kernel, least_response, push_constants,
};
use crate::asset_pool::PoolBuffers;
use crate::capacity::groups_for;
use crate::layout::{
    AgentRecord, CameraRecord, LensRecord, ShadingRecord, fog_vector, near_m, response_squares_max,
};
use crate::plane::Planes;

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

push_constants! {
    struct CullPush {
        agent_count: u32,
        camera_count: u32,
        cluster_count: u32,
    }
}

push_constants! {
    struct ProjectPush {
        agent_count: u32,
        camera_count: u32,
        cluster_count: u32,
        records_max: u32,
        static_lists: u32,
        flow_interval_s: f32,
        fog: [f32; 4],
    }
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
    kernel: Kernel,
}

impl CullAgents {
    /// The stage for images of the given rules and `cameras`.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(gpu: &Gpu, rules: &Rules, cameras: CameraVariant) -> Result<Self, GpuError> {
        let [lenses, rolling] = cameras.constants();
        let [least, squares] = least_response(response_squares_max(rules));
        let constants = [
            ("NEAR_M", Constant::F32(near_m(rules))),
            ("ANTIALIAS", Constant::Bool(rules.antialias)),
            lenses,
            rolling,
            least,
            squares,
        ];
        Ok(Self {
            kernel: kernel::<CullPush>(gpu, &decouplegs_shaders::CULL_AGENTS, &constants)?,
        })
    }

    /// Marks what is visible of the agents.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        pool: &PoolBuffers,
        buffers: &AgentBuffers,
        counts: AgentCounts,
    ) {
        let push = CullPush {
            agent_count: counts.agents as u32,
            camera_count: counts.cameras as u32,
            cluster_count: counts.clusters as u32,
        };
        let bound = [
            ("agents", buffers.agents.binding()),
            ("agent_cameras", buffers.cameras.binding()),
            ("coded_splats", pool.splats.binding()),
            ("coded_shapes", pool.shapes.binding()),
            ("asset_clusters", pool.clusters.binding()),
            ("visible_words", buffers.visible.words.binding()),
            ("visible_counts", buffers.visible.counts.binding()),
            ("lenses", buffers.lenses.binding()),
        ];
        recorder.dispatch(
            &self.kernel,
            &bound,
            bytes_of(&push),
            groups_for(counts.clusters),
        );
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
    kernel: Kernel,
}

impl ProjectAgents {
    /// The stage for images of the given rules and agents of the given kind.
    ///
    /// # Errors
    /// Returns an error if the driver refuses the kernel.
    pub fn new(gpu: &Gpu, rules: &Rules, variant: AgentVariant) -> Result<Self, GpuError> {
        let [lenses, rolling] = variant.cameras.constants();
        let constants = [
            ("NEAR_M", Constant::F32(near_m(rules))),
            ("ANTIALIAS", Constant::Bool(rules.antialias)),
            ("SH_DEGREE", Constant::U32(u32::from(variant.sh_degree))),
            ("RADIAL", Constant::Bool(rules.order == DepthOrder::Radial)),
            ("LABELS", Constant::Bool(variant.labels)),
            ("RELIT", Constant::Bool(variant.relit)),
            ("SHADED", Constant::Bool(variant.shaded)),
            lenses,
            rolling,
            ("FOG", Constant::Bool(variant.fog)),
            depths_constant(variant.planes),
        ];
        let attributes = variant.planes.attribute_constants();
        let constants: Vec<_> = constants.into_iter().chain(attributes).collect();
        Ok(Self {
            kernel: kernel::<ProjectPush>(gpu, &decouplegs_shaders::PROJECT_AGENTS, &constants)?,
        })
    }

    /// Writes a record for every visible splat of the agents behind those of the background, whose
    /// `static_lists` lists begin at `static_offsets`, and its depth key.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        agents: SeenAgents<'_>,
        static_offsets: &Buffer<u32>,
        static_lists: usize,
        projected: &Projected,
    ) {
        let SeenAgents {
            pool,
            buffers,
            relit,
            counts,
            fog,
            flow_interval_s,
        } = agents;
        let push = ProjectPush {
            agent_count: counts.agents as u32,
            camera_count: counts.cameras as u32,
            cluster_count: counts.clusters as u32,
            records_max: projected.room() as u32,
            static_lists: static_lists as u32,
            flow_interval_s,
            fog: fog_vector(fog),
        };
        let bound = [
            ("agents", buffers.agents.binding()),
            ("agent_cameras", buffers.cameras.binding()),
            ("coded_splats", pool.splats.binding()),
            ("coded_shapes", pool.shapes.binding()),
            ("visible_words", buffers.visible.words.binding()),
            ("offsets", buffers.offsets.binding()),
            ("coded_dc", pool.color_dc.binding()),
            ("coded_bands", pool.color_bands.binding()),
            ("static_offsets", static_offsets.binding()),
            ("relit_dc", relit.dc.binding()),
            ("relit_bands", relit.bands.binding()),
            ("shadings", buffers.shadings.binding()),
            ("footprints", projected.footprints.binding()),
            ("labels", projected.labels.binding()),
            ("attributes", projected.attributes.binding()),
            ("depths", projected.depths.binding()),
            ("keys", projected.keys.binding()),
            ("lenses", buffers.lenses.binding()),
        ];
        recorder.dispatch(
            &self.kernel,
            &bound,
            bytes_of(&push),
            groups_for(counts.clusters),
        );
    }
}
