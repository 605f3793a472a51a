#version 460
// Splats of the background that beams of a LiDAR may meet, by sector, and their records.
//
// Run twice, one workgroup per cluster, one thread per splat. The first run sets a bit per (sector,
// splat) and counts them per cluster. After the prefix sum, the second run writes a record for each
// bit.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#include "frame.glsl"
#include "footprint.glsl"
#include "projection.glsl"
#include "visibility.glsl"
#include "double_float.glsl"
#include "depth_key.glsl"

layout(local_size_x = 256) in;

layout(constant_id = 2) const bool WRITE = false;     // the second run
layout(constant_id = 4) const bool INSTANCES = false; // splats belong to instances

layout(set = 0, binding = 0, scalar) readonly buffer cameras_block { Camera cameras[]; };
layout(set = 0, binding = 1, scalar) readonly buffer means_block { vec3 means_m[]; };
layout(set = 0, binding = 2, scalar) readonly buffer shapes_block { uvec4 shapes[]; };
layout(set = 0, binding = 3, scalar) readonly buffer rotations_block { uvec4 rotations[]; };
layout(set = 0, binding = 4, scalar) buffer visible_words_block { uint visible_words[]; };
layout(set = 0, binding = 5, scalar) buffer visible_counts_block { uint visible_counts[]; };
layout(set = 0, binding = 6, scalar) readonly buffer offsets_block { uint offsets[]; };
layout(set = 0, binding = 7, scalar) readonly buffer clusters_block { Cluster clusters[]; };
layout(set = 0, binding = 8, scalar) readonly buffer sh_dc_block { uint sh_dc[]; };
layout(set = 0, binding = 9, scalar) readonly buffer instances_block { uint instances[]; }; // two 16-bit ids a word
layout(set = 0, binding = 16, scalar) readonly buffer column_bounds_block { vec2 column_bounds[]; };
layout(set = 0, binding = 17, scalar) readonly buffer row_bounds_block { vec2 row_bounds[]; };
#include "lidar.glsl"
layout(set = 0, binding = 15, scalar) readonly buffer sectors_block { Sector sectors[]; };
#include "lidar_record.glsl"

layout(push_constant, scalar) uniform push_block {
    uint splat_count;
    uint camera_count;
    uint cluster_count;
    uint records_max;
};

#include "visible_words.glsl"
#include "reached_sectors.glsl"
#include "stored_splat.glsl"
#include "sh_coding.glsl"
#include "stored_dc.glsl"

// Finds the sectors whose beams may meet the cluster, a thread each. Every thread of the workgroup
// calls it.
void find_sectors(Cluster cluster, uint thread) {
    if (thread == 0u) {
        reached_sectors = 0u;
    }
    clear_words(thread);
    if (thread < camera_count && any_cell(cluster_cells(cluster, cameras[thread], sectors[thread], 0.0))) {
        atomicOr(reached_sectors, 1u << thread);
    }
    barrier();
}

int visible_rank(uint first_word, uint bit) {
    VISIBLE_RANK(visible_words, first_word, bit);
}

void write_records(uint cluster_index, uint splat_index) {
    for (uint sectors_left = reached_sectors; sectors_left != 0u; sectors_left &= sectors_left - 1u) {
        uint camera_index = uint(findLSB(sectors_left));
        uint list = camera_index * cluster_count + cluster_index;
        int rank = visible_rank(list * CLUSTER_WORDS, gl_LocalInvocationIndex);
        uint slot = offsets[list] + uint(rank);
        if (rank < 0 || slot >= records_max) {
            continue; // the need is known: the host grows the buffer and traces again
        }
        vec3 mean_m = means_m[splat_index];
        float opacity;
        mat3 axes = load_axes(splat_index, opacity);
        LidarSplat seen;
        ivec4 cells = see_from_lidar(cameras[camera_index], sectors[camera_index], mean_m, axes, opacity, vec3(0.0), seen);
        uint instance = INSTANCES ? instances[splat_index / 2u] >> (16u * (splat_index % 2u)) & 0xffffu : 0u;
        write_lidar_record(slot, seen, cells, intensity_of(load_dc(splat_index)), instance);
        keys[slot] = depth_key(scaled_distance(mean_m, cameras[camera_index]));
    }
}

void main() {
    uint cluster_index = group_index();
    if (cluster_index >= cluster_count) {
        return;
    }
    uint thread = gl_LocalInvocationIndex;
    uint splat_index = cluster_index * CLUSTER_SPLATS + thread;
    if (WRITE) {
        find_marked_sectors(cluster_index, thread);
        if (splat_index < splat_count) {
            write_records(cluster_index, splat_index);
        }
        return;
    }
    find_sectors(clusters[cluster_index], thread);
    if (splat_index < splat_count) {
        vec3 mean_m = means_m[splat_index];
        float opacity;
        mat3 axes = load_axes(splat_index, opacity);
        for (uint sectors_left = reached_sectors; sectors_left != 0u; sectors_left &= sectors_left - 1u) {
            uint camera_index = uint(findLSB(sectors_left));
            LidarSplat seen;
            if (any_cell(see_from_lidar(cameras[camera_index], sectors[camera_index], mean_m, axes, opacity, vec3(0.0), seen))) {
                set_visible(camera_index, thread);
            }
        }
    }
    store_words(cluster_index, thread);
}
