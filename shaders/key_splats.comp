#version 460
// The depth keys of all splats of the background along one camera's direction, seen or not, with their indices.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#include "frame.glsl"
#include "double_float.glsl"
#include "depth_key.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, scalar) readonly buffer cameras_block { Camera cameras[]; };
layout(set = 0, binding = 1, scalar) readonly buffer means_block { vec3 means_m[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer keys_block { uint keys[]; };
layout(set = 0, binding = 3, scalar) writeonly buffer values_block { uint values[]; };

layout(push_constant, scalar) uniform push_block { uint splat_count; uint camera; };

void main() {
    uint splat = group_index() * 256u + gl_LocalInvocationIndex;
    if (splat < splat_count) {
        keys[splat] = depth_key(scaled_depth(means_m[splat], cameras[camera]));
        values[splat] = splat;
    }
}
