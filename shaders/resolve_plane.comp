#version 460
// Resolves a plane: means of an attribute over the blended splats of each pixel, from the sums that
// blending left instead of color, or medians, where blending left the median itself.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#include "frame.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, std430) readonly buffer sums_block { vec4 sums[]; };     // weighted sum of the attribute, and alpha
layout(set = 0, binding = 1, std430) writeonly buffer planes_block { uint planes[]; }; // all planes of all images

// The plane begins at word `first_word`, `channels` words per pixel.
layout(push_constant, scalar) uniform push_block { uint pixels; uint channels; uint first_word; uint median; };

void main() {
    uint pixel = group_index() * 256u + gl_LocalInvocationIndex;
    if (pixel >= pixels) {
        return;
    }
    vec4 sum = sums[pixel];
    for (uint channel = 0u; channel < channels; ++channel) {
        float mean = sum.a > 0.0 ? sum[channel] / sum.a : 0.0;
        // A median that was found has left no light.
        float value = median == 0u ? mean : sum.a == 1.0 ? sum[channel] : 0.0;
        planes[first_word + pixel * channels + channel] = floatBitsToUint(value);
    }
}
