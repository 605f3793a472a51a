#version 460
// Resolves a plane of medians, from what blending left instead of color.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#include "frame.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, std430) readonly buffer medians_block { vec4 medians[]; };  // of depth and range, and alpha
layout(set = 0, binding = 1, std430) writeonly buffer planes_block { uint planes[]; }; // all planes of all images

// The plane begins at word `first_word`.
layout(push_constant, scalar) uniform push_block { uint pixels; uint channel; uint first_word; };

void main() {
    uint pixel = group_index() * 256u + gl_LocalInvocationIndex;
    if (pixel >= pixels) {
        return;
    }
    // A median that was found has left no light.
    vec4 median = medians[pixel];
    planes[first_word + pixel] = floatBitsToUint(median.a == 1.0 ? median[channel] : 0.0);
}
