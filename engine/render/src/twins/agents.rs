//! Culling and projection of agents: `cull_agents.comp` and `project_agents.comp`.

use glam::Vec3;

use super::agent::{agent_of_cluster, axes_of, unpack_splat};
use super::depth_key::{depth_key, scaled_depth};
use super::lens::{cluster_overlaps_any_lens, lens_of, project_splat_seen};
use super::projection::{Variant, from_camera_m, to_camera_axes};
use super::record::Record;
use super::sh::{Stored, sh_color};
use super::visibility::splat_overlaps;
use super::write_record::write_record;
use crate::layout::{AgentRecord, CLUSTER_SPLATS, CameraRecord, ClusterRecord, LensRecord};
use crate::sh_codec::words_of;

const CLUSTER_WORDS: usize = CLUSTER_SPLATS / 32;

/// Words that bands 1 to 3 of a color take, one behind the other.
const COLOR_WORDS: usize = 24;

/// Writes one bit per splat of the agents, `[camera][cluster][8 words]`, and the count a
/// `[camera][cluster]`; clusters are counted over all agents. Cameras are `[agent][camera]`.
pub fn cull_agents(
    agents: &[AgentRecord],
    agent_cameras: &[CameraRecord],
    coded_splats: &[[u32; 3]],
    coded_shapes: &[[f32; 6]],
    asset_clusters: &[ClusterRecord],
    visible_words: &mut [u32],
    visible_counts: &mut [u32],
    lenses: &[LensRecord],
    camera_count: usize,
    cluster_count: usize,
    variant: Variant,
) {
    visible_words.fill(0);
    visible_counts.fill(0);
    for (agent_index, agent) in agents.iter().enumerate() {
        for own_splat in 0..agent.splat_count as usize {
            let own_cluster = own_splat / CLUSTER_SPLATS;
            let cluster = &asset_clusters[agent.first_bounds as usize + own_cluster];
            let coded = unpack_splat(coded_splats[agent.first_splat as usize + own_splat], agent);
            for camera_index in 0..camera_count {
                let camera = &agent_cameras[agent_index * camera_count + camera_index];
                let lens = lens_of(lenses, camera_index);
                if agent.cameras >> camera_index & 1 == 0
                    || !cluster_overlaps_any_lens(cluster, camera, lens, variant.near_m)
                {
                    continue;
                }
                let t = to_camera_axes(camera, from_camera_m(coded.mean_m, camera));
                let (splat, drawn) = project_splat_seen(
                    camera,
                    lens,
                    t,
                    axes_of(agent, &coded, coded_shapes),
                    coded.opacity,
                    variant,
                );
                if drawn && splat_overlaps(&splat, camera) {
                    let list =
                        camera_index * cluster_count + agent.first_cluster as usize + own_cluster;
                    visible_words[list * CLUSTER_WORDS + own_splat % CLUSTER_SPLATS / 32] |=
                        1 << (own_splat % 32);
                    visible_counts[list] += 1;
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
fn stored<'a>(dc: &'a [[f32; 3]; 1], bands: &'a [u32; COLOR_WORDS]) -> Stored<'a> {
    let (band1, rest) = bands.split_at(words_of(1));
    let (band2, band3) = rest.split_at(words_of(2));
    Stored {
        sh_dc: dc,
        sh_bands: [band1, band2, band3],
    }
}

/// Writes a record, its color and depth key for every bit of `visible_words`, as far as there is
/// room: behind the records of the background, of which there are `static_offsets[static_lists]`,
/// the first of each `[camera][cluster]` at `offsets`.
pub fn project_agents(
    agents: &[AgentRecord],
    agent_cameras: &[CameraRecord],
    coded_splats: &[[u32; 3]],
    coded_shapes: &[[f32; 6]],
    visible_words: &[u32],
    offsets: &[u32],
    coded_dc: &[[f32; 3]],
    coded_bands: &[[u32; COLOR_WORDS]],
    static_offsets: &[u32],
    relit_dc: &[[f32; 3]],
    relit_bands: &[[u32; COLOR_WORDS]],
    footprints: &mut [[f32; 4]],
    colors: &mut [[f32; 4]],
    keys: &mut [u32],
    lenses: &[LensRecord],
    camera_count: usize,
    cluster_count: usize,
    static_lists: usize,
    variant: Variant,
    sh_degree: usize,
    radial: bool,
) {
    let records_max = colors.len();
    let visible = |list: usize, place: usize| {
        visible_words[(list * CLUSTER_SPLATS + place) / 32] >> (place % 32) & 1 == 1
    };
    for camera_index in 0..camera_count {
        for cluster_index in 0..cluster_count {
            let list = camera_index * cluster_count + cluster_index;
            let agent_index = agent_of_cluster(cluster_index as u32, agents);
            let agent = &agents[agent_index];
            let camera = &agent_cameras[agent_index * camera_count + camera_index];
            let first_slot = (static_offsets[static_lists] + offsets[list]) as usize;
            let seen = (0..CLUSTER_SPLATS).filter(|&place| visible(list, place));
            for (slot, place) in (first_slot..records_max).zip(seen) {
                let own_splat =
                    (cluster_index - agent.first_cluster as usize) * CLUSTER_SPLATS + place;
                let coded =
                    unpack_splat(coded_splats[agent.first_splat as usize + own_splat], agent);
                let offset = from_camera_m(coded.mean_m, camera);
                let t = to_camera_axes(camera, offset);
                let (splat, _) = project_splat_seen(
                    camera,
                    lens_of(lenses, camera_index),
                    t,
                    axes_of(agent, &coded, coded_shapes),
                    coded.opacity,
                    variant,
                );
                let record = Record {
                    splat,
                    depth_m: if radial { offset.length() } else { t.z },
                    instance: agent.instance,
                };
                let d = offset.normalize();
                let d = if agent.colors_in_world != 0 {
                    turned(agent, d)
                } else {
                    d
                };
                let entry = (agent.first_color + coded.color) as usize;
                let (dc_of, bands_of) = if agent.colors_relit != 0 {
                    (relit_dc, relit_bands)
                } else {
                    (coded_dc, coded_bands)
                };
                let residual = Vec3::from_array(agent.dc_residual_gain) * coded.dc_residual;
                let dc = [(Vec3::from_array(dc_of[entry]) + residual).to_array()];
                let color = sh_color(&stored(&dc, &bands_of[entry]), 0, 1, d, sh_degree);
                write_record(slot, &record, color, footprints, colors);
                keys[slot] = depth_key(scaled_depth(coded.mean_m, camera, radial));
            }
        }
    }
}
