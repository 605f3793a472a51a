//! Culling and projection of agents: `cull_agents.comp` and `project_agents.comp`.

use decouplegs_scene::{DepthOrder, Rules};
use glam::Vec3;

use super::agent::{agent_of_cluster, axes_of, unpack_splat};
use super::cull::VisibleBits;
use super::depth_key::{depth_key, scaled_depth};
use super::fog::in_fog;
use super::lens::{cluster_overlaps_any_lens, lens_of};
use super::projection::Variant;
use super::record::Record;
use super::rolling::{see_splat, swept};
use super::sh::{Stored, sh_color};
use super::shading::{shading_gain, shading_normal};
use super::visibility::splat_overlaps;
use super::write_record::{Records, code_of_mean};
use crate::layout::{
    AgentRecord, CLUSTER_SPLATS, CameraRecord, ClusterRecord, LensRecord, ShadingRecord,
};
use crate::sh_codec::words_of;
use crate::storage::Storage;

/// Words that bands 1 to 3 of a color take, one behind the other.
const COLOR_WORDS: usize = 24;

/// Agents of a frame and their shared assets, by the names of the kernels' buffers.
pub struct AgentInputs<'a> {
    /// Agents of the frame.
    pub agents: &'a [AgentRecord],
    /// Cameras as each agent sees them, `[agent][camera]`.
    pub agent_cameras: &'a [CameraRecord],
    /// One per camera of the frame, or none at all.
    pub lenses: &'a [LensRecord],
    /// Splats of the assets, packed.
    pub splats: &'a [[u32; 3]],
    /// Codebook of shapes.
    pub shapes: &'a [[f32; 6]],
    /// Number of cameras of the frame.
    pub camera_count: usize,
    /// Number of clusters of all agents.
    pub cluster_count: usize,
    /// Color of the air and extinction per meter; `None` for clear air.
    pub fog: Option<[f32; 4]>,
    /// Light on those that are shaded by normals.
    pub shadings: &'a [ShadingRecord],
}

/// Codebooks of colors: DC terms and bands of the assets, and of those in their light.
pub struct ColorCodebooks<'a> {
    /// DC terms of the assets.
    pub dc: &'a [[f32; 3]],
    /// Bands of the assets.
    pub bands: &'a [[u32; COLOR_WORDS]],
    /// DC terms of relit codebooks.
    pub relit_dc: &'a [[f32; 3]],
    /// Bands of relit codebooks.
    pub relit_bands: &'a [[u32; COLOR_WORDS]],
}

/// Visible splats of the agents.
pub struct ListedSplats<'a> {
    /// Visibility, as culling wrote it.
    pub visible_words: &'a [u32],
    /// First record of each `[camera][cluster]`, counted from `first_record`.
    pub offsets: &'a [u32],
    /// Number of the background's records.
    pub first_record: u32,
}

/// Culls the splats of all agents; clusters are counted over all agents.
pub fn cull_agents(
    input: &AgentInputs<'_>,
    asset_clusters: &[ClusterRecord],
    visible: &mut VisibleBits<'_>,
    variant: Variant,
) {
    let &AgentInputs {
        agents,
        agent_cameras,
        lenses,
        splats: coded_splats,
        shapes: coded_shapes,
        camera_count,
        cluster_count,
        ..
    } = input;
    visible.clear();
    for (agent_index, agent) in agents.iter().enumerate() {
        for own_splat in 0..agent.splat_count as usize {
            let own_cluster = own_splat / CLUSTER_SPLATS;
            let cluster = &asset_clusters[agent.first_bounds as usize + own_cluster];
            let coded = unpack_splat(coded_splats[agent.first_splat as usize + own_splat], agent);
            for camera_index in 0..camera_count {
                let camera = &agent_cameras[agent_index * camera_count + camera_index];
                let lens = lens_of(lenses, camera_index);
                if agent.cameras >> camera_index & 1 == 0
                    || !cluster_overlaps_any_lens(
                        &swept(cluster, camera),
                        camera,
                        lens,
                        variant.near_m,
                    )
                {
                    continue;
                }
                let seen = see_splat(
                    camera,
                    lens,
                    coded.mean_m,
                    axes_of(agent, &coded, coded_shapes),
                    coded.opacity,
                    variant,
                );
                if seen.drawn && splat_overlaps(&seen.splat, variant.squares_max, camera) {
                    let list =
                        camera_index * cluster_count + agent.first_cluster as usize + own_cluster;
                    visible.mark(list, own_splat % CLUSTER_SPLATS);
                }
            }
        }
    }
}

/// `d` of the agent's frame in the world's.
fn turned(agent: &AgentRecord, d: Vec3) -> Vec3 {
    [agent.row_x, agent.row_y, agent.row_z]
        .map(|row| Vec3::from_array(row).dot(d))
        .into()
}

/// The DC and the bands of a color, as [`sh_color`] takes those of a single splat.
fn stored<'a>(dc: &'a [u32; 3], bands: &'a [u32; COLOR_WORDS]) -> Stored<'a> {
    let (band1, rest) = bands.split_at(words_of(1));
    let (band2, band3) = rest.split_at(words_of(2));
    Stored {
        storage: Storage::Exact,
        sh_dc: dc,
        sh_bands: [band1, band2, band3],
    }
}

/// Writes a record, its color and depth key for every visible bit, as far as `records` have
/// capacity, behind the records of the background.
pub fn project_agents(
    input: &AgentInputs<'_>,
    codebooks: &ColorCodebooks<'_>,
    listed: &ListedSplats<'_>,
    records: &mut Records<'_>,
    rules: &Rules,
    sh_degree: usize,
) {
    let &AgentInputs {
        agents,
        agent_cameras,
        lenses,
        splats: coded_splats,
        shapes: coded_shapes,
        camera_count,
        cluster_count,
        fog,
        shadings,
    } = input;
    let variant = Variant::for_rules(rules);
    let radial = rules.order == DepthOrder::Radial;
    let records_max = records.labels.len();
    let visible = |list: usize, index: usize| {
        listed.visible_words[(list * CLUSTER_SPLATS + index) / 32] >> (index % 32) & 1 == 1
    };
    for camera_index in 0..camera_count {
        for cluster_index in 0..cluster_count {
            let list = camera_index * cluster_count + cluster_index;
            let agent_index = agent_of_cluster(cluster_index as u32, agents);
            let agent = &agents[agent_index];
            let camera = &agent_cameras[agent_index * camera_count + camera_index];
            let first_slot = (listed.first_record + listed.offsets[list]) as usize;
            let seen = (0..CLUSTER_SPLATS).filter(|&index| visible(list, index));
            for (slot, index) in (first_slot..records_max).zip(seen) {
                let own_splat =
                    (cluster_index - agent.first_cluster as usize) * CLUSTER_SPLATS + index;
                let coded =
                    unpack_splat(coded_splats[agent.first_splat as usize + own_splat], agent);
                let axes = axes_of(agent, &coded, coded_shapes);
                let lens = lens_of(lenses, camera_index);
                let seen = see_splat(camera, lens, coded.mean_m, axes, coded.opacity, variant);
                let d = seen.offset_m.normalize();
                let d = if agent.colors_in_world != 0 {
                    turned(agent, d)
                } else {
                    d
                };
                let entry = (agent.first_color + coded.color) as usize;
                let (dc_of, bands_of) = if agent.colors_relit != 0 {
                    (codebooks.relit_dc, codebooks.relit_bands)
                } else {
                    (codebooks.dc, codebooks.bands)
                };
                let residual = Vec3::from_array(agent.dc_residual_gain) * coded.dc_residual;
                let dc = (Vec3::from_array(dc_of[entry]) + residual).to_array();
                let dc = dc.map(f32::to_bits);
                let color = sh_color(&stored(&dc, &bands_of[entry]), 0, 1, d, sh_degree);
                let color = match agent.shading {
                    0 => color,
                    place => {
                        let shading = &shadings[place as usize - 1];
                        let mean_m = Vec3::from_array(coded.mean_m);
                        let normal = shading_normal(shading, axes, mean_m);
                        color * shading_gain(shading, normal, mean_m)
                    }
                };
                let color = match fog {
                    Some(fog) => in_fog(color, seen.offset_m.length(), fog),
                    None => color,
                };
                let record = Record {
                    splat: seen.splat,
                    mean: code_of_mean(camera, lens, coded.mean_m, seen.splat.mean_px),
                    color,
                    depth_m: if radial {
                        seen.offset_m.length()
                    } else {
                        seen.t.z
                    },
                    instance: agent.instance,
                };
                let key = depth_key(scaled_depth(coded.mean_m, camera, radial));
                records.write(slot, &record, key);
            }
        }
    }
}
