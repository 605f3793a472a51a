#version 460
// Where each macro tile's list begins in the sorted pairs. Every entry up to and including the one past the last is written.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#include "frame.glsl"

const uint WORKGROUP_THREADS = 256u;
layout(local_size_x = 256) in;

layout(set = 0, binding = 0, scalar) readonly buffer needs_block { Needs needs; };
layout(set = 0, binding = 1, scalar) readonly buffer bins_block { uint bins[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer range_firsts_block { uint range_firsts[]; };

layout(push_constant, scalar) uniform push_block { uint pairs_max; uint bin_count; };

void main() {
    uint pairs = min(needs.pairs, pairs_max);
    for (uint item = 0u; item < PAIR_BLOCK; item += WORKGROUP_THREADS) {
        uint place = group_index() * PAIR_BLOCK + item + gl_LocalInvocationIndex;
        if (place >= pairs) {
            return;
        }
        uint bin = bins[place];
        uint first = place == 0u ? 0u : bins[place - 1u] + 1u;
        for (uint empty = first; empty <= bin; ++empty) {
            range_firsts[empty] = place;
        }
        if (place == pairs - 1u) {
            for (uint empty = bin + 1u; empty <= bin_count; ++empty) {
                range_firsts[empty] = pairs;
            }
        }
    }
}
