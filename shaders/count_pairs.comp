#version 460
// How many (macro tile, record) pairs each block of depth-sorted records makes.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#include "frame.glsl"

const uint WORKGROUP_THREADS = 256u;
layout(local_size_x = 256) in;
#include "block.glsl"

layout(set = 0, binding = 0, scalar) readonly buffer needs_block { Needs needs; };
layout(set = 0, binding = 1, scalar) readonly buffer order_block { uint order[]; };
layout(set = 0, binding = 2, scalar) readonly buffer tile_counts_block { uint tile_counts[]; };
layout(set = 0, binding = 3, scalar) writeonly buffer pair_counts_block { uint pair_counts[]; };

layout(push_constant, scalar) uniform push_block { uint records_max; };

void main() {
    uint records = held(needs.records, records_max);
    uint block = group_index();
    if (block * PAIR_BLOCK >= records) {
        return;
    }
    uint sum = 0u;
    for (uint item = 0u; item < PAIR_BLOCK; item += WORKGROUP_THREADS) {
        uint place = block * PAIR_BLOCK + item + gl_LocalInvocationIndex;
        sum += place < records ? tile_counts[order[place]] : 0u;
    }
    uint total = block_sum(sum);
    if (gl_LocalInvocationIndex == 0u) {
        pair_counts[block] = total;
    }
}
