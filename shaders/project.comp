#version 460
// Footprint, depth key and colour of every visible (camera, splat), at the place that the scan gave it.
//
// One workgroup a chunk, one thread a splat, all cameras: attributes are read once. Records of a camera are in splat order,
// so that a stable sort by depth breaks ties by splat index. Also counts the macro tiles of each record.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#include "frame.glsl"
#include "footprint.glsl"
#include "projection.glsl"
#include "double_float.glsl"
#include "depth_key.glsl"
#include "record.glsl"
#include "sh.glsl"

layout(local_size_x = 256) in;

layout(constant_id = 3) const bool RADIAL = false;    // order by distance instead of z
layout(constant_id = 4) const bool INSTANCES = false; // splats belong to instances, and these are asked for

layout(set = 0, binding = 0, scalar) readonly buffer cameras_block { Camera cameras[]; };
layout(set = 0, binding = 1, scalar) readonly buffer means_block { vec3 means_m[]; };
layout(set = 0, binding = 2, scalar) readonly buffer shapes_block { vec4 shapes[]; };
layout(set = 0, binding = 3, scalar) readonly buffer rotations_block { vec4 rotations[]; };
layout(set = 0, binding = 4, scalar) readonly buffer visible_words_block { uint visible_words[]; };
layout(set = 0, binding = 5, scalar) readonly buffer firsts_block { uint firsts[]; };
layout(set = 0, binding = 10, scalar) readonly buffer instances_block { uint instances[]; }; // two 16-bit ids a word
layout(set = 0, binding = 11, std430) writeonly buffer footprints_block { vec4 footprints[]; }; // two a record
layout(set = 0, binding = 12, std430) writeonly buffer colours_block { vec4 colours[]; };
layout(set = 0, binding = 13, scalar) writeonly buffer keys_block { uint keys[]; };
layout(set = 0, binding = 14, scalar) writeonly buffer tile_counts_block { uint tile_counts[]; };

layout(push_constant, scalar) uniform push_block { uint splat_count; uint camera_count; uint chunk_count; uint records_max; };

uint count_macro_tiles(Footprint splat, Camera camera) {
    uint count = 0u;
    ivec2 rows = reached_macro_rows(splat, camera.size_px.y);
    for (int row = rows.x; row <= rows.y; ++row) {
        ivec2 tiles = reached_macro_tiles(splat, uint(row), camera.size_px);
        count += uint(tiles.y - tiles.x + 1);
    }
    return count;
}

// The thread's place among the visible splats of its chunk, or -1 when it is not one of them.
int visible_rank(uint first_word, uint thread) {
    uint word = visible_words[first_word + thread / 32u];
    if ((word >> (thread % 32u) & 1u) == 0u) {
        return -1;
    }
    int rank = bitCount(word & ((1u << (thread % 32u)) - 1u));
    for (uint earlier = 0u; earlier < thread / 32u; ++earlier) {
        rank += bitCount(visible_words[first_word + earlier]);
    }
    return rank;
}

void main() {
    uint chunk_index = group_index();
    uint thread = gl_LocalInvocationIndex;
    uint splat_index = chunk_index * CHUNK_SPLATS + thread;
    if (splat_index >= splat_count) {
        return;
    }
    bool loaded = false;
    vec3 mean_m;
    float opacity;
    mat3 axes;
    for (uint camera_index = 0u; camera_index < camera_count; ++camera_index) {
        uint list = camera_index * chunk_count + chunk_index;
        int rank = visible_rank(list * CHUNK_WORDS, thread);
        if (rank < 0) {
            continue;
        }
        uint slot = firsts[list] + uint(rank);
        if (slot >= records_max) {
            continue; // the need is known: the host grows the buffer and draws again
        }
        if (!loaded) {
            mean_m = means_m[splat_index];
            vec4 shape = shapes[splat_index];
            opacity = shape.w;
            axes = matrix_from_quaternion(rotations[splat_index]);
            axes[0] *= shape.x;
            axes[1] *= shape.y;
            axes[2] *= shape.z;
            loaded = true;
        }
        Camera camera = cameras[camera_index];
        vec3 offset = from_camera_m(mean_m, camera);
        vec3 t = vec3(dot(camera.row_x, offset), dot(camera.row_y, offset), dot(camera.row_z, offset));
        Record record;
        project_splat(camera, t, axes, opacity, record.splat);
        record.depth_m = RADIAL ? length(offset) : t.z;
        record.instance = INSTANCES ? instances[splat_index / 2u] >> (16u * (splat_index % 2u)) & 0xffffu : 0u;
        footprints[2u * slot] = pack_record_low(record);
        footprints[2u * slot + 1u] = pack_record_high(record);
        colours[slot] = vec4(sh_colour(splat_index, splat_count, normalize(offset)), 0.0);
        keys[slot] = depth_key(RADIAL ? distance_m(mean_m, camera) : depth_z_m(mean_m, camera));
        tile_counts[slot] = count_macro_tiles(record.splat, camera);
    }
}
