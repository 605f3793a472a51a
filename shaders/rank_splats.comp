#version 460
// The place of each splat in the sorted order: what is kept of a direction.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#include "frame.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, scalar) readonly buffer values_block { uint values[]; };
layout(set = 0, binding = 1, scalar) writeonly buffer ranks_block { uint ranks[]; };

layout(push_constant, scalar) uniform push_block { uint splat_count; uint rank_set; };

void main() {
    uint rank = group_index() * 256u + gl_LocalInvocationIndex;
    if (rank < splat_count) {
        ranks[rank_set * splat_count + values[rank]] = rank;
    }
}
