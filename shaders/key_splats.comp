#version 460
// The depth keys of all splats of the background along one camera's direction, seen or not: a set
// of the persistent key buffer.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#include "frame.glsl"
#include "double_float.glsl"
#include "depth_key.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, scalar) readonly buffer cameras_block { Camera cameras[]; };
layout(set = 0, binding = 1, scalar) readonly buffer means_block { vec3 means_m[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer kept_keys_block { uint kept_keys[]; }; // [set][splat]

layout(push_constant, scalar) uniform push_block { uint splat_count; uint camera; uint key_set; };

void main() {
    uint splat = group_index() * 256u + gl_LocalInvocationIndex;
    if (splat < splat_count) {
        kept_keys[key_set * splat_count + splat] = depth_key(scaled_depth(means_m[splat], cameras[camera]));
    }
}
