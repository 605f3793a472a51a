#version 460
// How many visible splats each stretch of 256 ranks of a kept order holds.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#include "frame.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, scalar) readonly buffer rank_words_block { uint rank_words[]; };
layout(set = 0, binding = 1, scalar) writeonly buffer rank_counts_block { uint rank_counts[]; };

layout(push_constant, scalar) uniform push_block { uint count; };

void main() {
    uint chunk = group_index() * 256u + gl_LocalInvocationIndex;
    if (chunk >= count) {
        return;
    }
    uint sum = 0u;
    for (uint word = 0u; word < CHUNK_WORDS; ++word) {
        sum += bitCount(rank_words[chunk * CHUNK_WORDS + word]);
    }
    rank_counts[chunk] = sum;
}
