#version 460
// Sorted lists of coarse tiles, turned into one list of bits per fine tile of 8 x 8 beams; and the
// records of these lists beside the cells that they reach, so that both are read in order.
//
// A subgroup takes 32 pairs of a coarse tile's list at a time, or as many as it has lanes: each
// lane finds which fine tiles the cells of one record reach, and ballots turn that into one word
// per fine tile. LIST_GROUPS workgroups share a list.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#include "frame.glsl"

const uint THREADS = 256u;
layout(local_size_x = 256) in;

layout(constant_id = 5) const uint LANES = 32u; // of a subgroup: 4 to 64

layout(set = 0, binding = 0, scalar) readonly buffer cameras_block { Camera cameras[]; };
layout(set = 0, binding = 1, scalar) readonly buffer tile_lists_block { uvec2 tile_lists[]; }; // first pair and length
layout(set = 0, binding = 2, scalar) readonly buffer sorted_records_block { uint sorted_records[]; };
layout(set = 0, binding = 3, std430) readonly buffer footprints_block { uvec4 footprints[]; };
layout(set = 0, binding = 4, scalar) writeonly buffer tile_words_block { uint tile_words[]; };
layout(set = 0, binding = 5, scalar) writeonly buffer pairs_block { uvec2 pairs[]; }; // record and cells of each
layout(set = 0, binding = 6, scalar) buffer required_block { RequiredCounts required; };
#include "camera_of_bin.glsl"
#include "lidar_words.glsl"

layout(push_constant, scalar) uniform push_block {
    uint camera_count;
    uint bin_count;
    uint records_max;
    uint pairs_max;
};

// Workgroups of a list.
const uint LIST_GROUPS = 32u;

const uint SUBGROUPS = THREADS / LANES;
const uint ROUND = LANES < 32u ? LANES : 32u;
const uint PARTS = LANES < 32u ? 32u / LANES : 1u;       // of a word, a subgroup's lanes each
const uint WORDS_LISTED = LANES > 32u ? LANES / 32u : 1u; // by a subgroup at a time

// Fine tiles that the record of pair `pair` may reach, as bits row * 8 + column. None for a pair of
// another list.
uint reached_tiles(uvec2 list, uint pair, vec2 origin) {
    if (pair < list.x || pair >= list.x + list.y) {
        return 0u;
    }
    uint record = sorted_records[pair];
    const vec4 LAST = vec2(COARSE_WIDTH_PX - 1u, COARSE_HEIGHT_PX - 1u).xxyy;
    uvec4 cells = uvec4(clamp(uintBitsToFloat(footprints[2u * record]) - origin.xxyy, vec4(0.0), LAST));
    pairs[pair] = uvec2(record, pack_cells(cells));
    uvec4 tiles = cells / FINE_TILE_PX;
    uint columns = (2u << tiles.y) - (1u << tiles.x);
    uint mask = 0u;
    for (uint row = tiles.z; row <= tiles.w; ++row) {
        mask |= columns << (row * COARSE_COLUMNS);
    }
    return mask;
}

void main() {
    uint bin = group_index() / LIST_GROUPS;
    if (bin >= bin_count || !lists_have_room(records_max, pairs_max)) {
        return;
    }
    Camera camera = cameras[camera_of_bin(bin, camera_count)];
    uint coarse = bin - camera.first_bin;
    vec2 origin = vec2(uvec2(coarse % camera.coarse_tiles.x, coarse / camera.coarse_tiles.x) * uvec2(COARSE_WIDTH_PX, COARSE_HEIGHT_PX));
    uvec2 list = tile_lists[bin];
    uint end_word = (list.x + list.y + 31u) / 32u;
    if (group_index() % LIST_GROUPS == 0u && gl_LocalInvocationIndex == 0u) {
        atomicMax(required.longest, list.y);
    }
    uint lane = gl_SubgroupInvocationID;
    uint subgroup = group_index() % LIST_GROUPS * SUBGROUPS + gl_LocalInvocationIndex / LANES;
    for (uint word = list.x / 32u + subgroup * WORDS_LISTED; word < end_word; word += LIST_GROUPS * SUBGROUPS * WORDS_LISTED) {
        uint masks[PARTS];
        [[unroll]] for (uint part = 0u; part < PARTS; ++part) {
            masks[part] = reached_tiles(list, 32u * word + part * LANES + lane, origin);
        }
        [[unroll]] for (uint first_tile = 0u; first_tile < 32u; first_tile += ROUND) {
            uint kept = 0u;
            [[unroll]] for (uint tile = 0u; tile < ROUND; ++tile) {
                uint bits = 0u;
                [[unroll]] for (uint part = 0u; part < PARTS; ++part) {
                    uvec4 reaching = subgroupBallot((masks[part] >> (first_tile + tile) & 1u) != 0u);
                    bits |= (lane < 32u ? reaching.x : reaching.y) << (part * LANES % 32u);
                }
                kept = lane % 32u == tile ? bits : kept;
            }
            uint own_word = word + lane / 32u;
            if (own_word < end_word) {
                tile_words[place_of_word(own_word, bin, list, pairs_max) + first_tile + lane % 32u] = kept;
            }
        }
    }
}
