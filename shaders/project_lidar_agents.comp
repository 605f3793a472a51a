#version 460
// What project_lidar is for the background, for the splats of agents.
//
// Their records come behind those of the background, by sector, agent and splat.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#include "frame.glsl"
#include "footprint.glsl"
#include "projection.glsl"
#include "visibility.glsl"
#include "double_float.glsl"
#include "depth_key.glsl"
#include "agent.glsl"

layout(local_size_x = 256) in;
#include "agent_buffers.glsl"

layout(constant_id = 2) const bool WRITE = false; // the second run

layout(set = 0, binding = 4, scalar) buffer visible_words_block { uint visible_words[]; };
layout(set = 0, binding = 5, scalar) buffer visible_counts_block { uint visible_counts[]; };
layout(set = 0, binding = 6, scalar) readonly buffer offsets_block { uint offsets[]; };
layout(set = 0, binding = 7, scalar) readonly buffer asset_clusters_block { Cluster asset_clusters[]; };
layout(set = 0, binding = 8, scalar) readonly buffer coded_dc_block { vec3 coded_dc[]; };
layout(set = 0, binding = 9, scalar) readonly buffer static_offsets_block { uint static_offsets[]; }; // of the background
layout(set = 0, binding = 16, scalar) readonly buffer column_bounds_block { vec2 column_bounds[]; };
layout(set = 0, binding = 17, scalar) readonly buffer row_bounds_block { vec2 row_bounds[]; };
#include "lidar.glsl"
layout(set = 0, binding = 15, scalar) readonly buffer sectors_block { Sector sectors[]; };
#include "lidar_record.glsl"

layout(push_constant, scalar) uniform push_block {
    uint agent_count;
    uint camera_count;
    uint cluster_count;
    uint records_max;
    uint static_lists; // of the background: how many records it has stands behind them
};

#include "visible_words.glsl"
#include "reached_sectors.glsl"

bool reaches_sector(Agent agent, uint agent_index, uint own_cluster, uint camera_index) {
    Cluster cluster = asset_clusters[agent.first_bounds + own_cluster];
    Camera camera = agent_cameras[agent_index * camera_count + camera_index];
    float farthest_m = length(cluster.center_m) + length(cluster.half_extent_m);
    float speed_mps = length(camera.frame_velocity_mps) + length(camera.frame_turn_rad_per_s) * farthest_m;
    return any_cell(cluster_cells(cluster, camera, sectors[camera_index], speed_mps));
}

// Finds the sectors whose beams may meet the cluster, a thread each. Every thread of the workgroup
// calls it. Clusters behind the agent's end only fill up their number: no box, no splats.
void find_sectors(Agent agent, uint agent_index, uint own_cluster, uint thread) {
    if (thread == 0u) {
        reached_sectors = 0u;
    }
    clear_words(thread);
    bool seen = thread < camera_count && (agent.cameras >> thread & 1u) != 0u && own_cluster * CLUSTER_SPLATS < agent.splat_count;
    if (seen && reaches_sector(agent, agent_index, own_cluster, thread)) {
        atomicOr(reached_sectors, 1u << thread);
    }
    barrier();
}

int visible_rank(uint first_word, uint bit) {
    VISIBLE_RANK(visible_words, first_word, bit);
}

void write_records(Agent agent, uint agent_index, uint cluster_index, uint own_splat) {
    for (uint sectors_left = reached_sectors; sectors_left != 0u; sectors_left &= sectors_left - 1u) {
        uint camera_index = uint(findLSB(sectors_left));
        uint list = camera_index * cluster_count + cluster_index;
        int rank = visible_rank(list * CLUSTER_WORDS, gl_LocalInvocationIndex);
        uint slot = static_offsets[static_lists] + offsets[list] + uint(rank);
        if (rank < 0 || slot >= records_max) {
            continue; // the need is known: the host grows the buffer and traces again
        }
        CodedSplat coded = unpack_splat(coded_splats[agent.first_splat + own_splat], agent);
        Camera camera = agent_cameras[agent_index * camera_count + camera_index];
        LidarSplat seen;
        vec3 turning_mps = cross(camera.frame_turn_rad_per_s, coded.mean_m);
        ivec4 cells = see_from_lidar(camera, sectors[camera_index], coded.mean_m, axes_of(agent, coded), coded.opacity, turning_mps, seen);
        vec3 dc = coded_dc[agent.first_color + coded.color] + agent.dc_residual_gain * coded.dc_residual;
        write_lidar_record(slot, seen, cells, intensity_of(dc), agent.instance);
        keys[slot] = depth_key(scaled_distance(coded.mean_m, camera));
    }
}

void main() {
    uint cluster_index = group_index();
    if (cluster_index >= cluster_count) {
        return;
    }
    uint thread = gl_LocalInvocationIndex;
    uint agent_index = agent_of_cluster(cluster_index, agent_count);
    Agent agent = agents[agent_index];
    uint own_cluster = cluster_index - agent.first_cluster;
    uint own_splat = own_cluster * CLUSTER_SPLATS + thread;
    if (WRITE) {
        find_marked_sectors(cluster_index, thread);
        if (own_splat < agent.splat_count) {
            write_records(agent, agent_index, cluster_index, own_splat);
        }
        return;
    }
    find_sectors(agent, agent_index, own_cluster, thread);
    if (own_splat < agent.splat_count) {
        CodedSplat coded = unpack_splat(coded_splats[agent.first_splat + own_splat], agent);
        mat3 axes = axes_of(agent, coded);
        for (uint sectors_left = reached_sectors; sectors_left != 0u; sectors_left &= sectors_left - 1u) {
            uint camera_index = uint(findLSB(sectors_left));
            Camera camera = agent_cameras[agent_index * camera_count + camera_index];
            LidarSplat seen;
            vec3 turning_mps = cross(camera.frame_turn_rad_per_s, coded.mean_m);
            if (any_cell(see_from_lidar(camera, sectors[camera_index], coded.mean_m, axes, coded.opacity, turning_mps, seen))) {
                set_visible(camera_index, thread);
            }
        }
    }
    store_words(cluster_index, thread);
}
