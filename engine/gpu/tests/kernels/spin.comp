#version 460
// Work that takes a while: push.rounds steps of a linear congruential generator on each of
// push.count values.
#extension GL_EXT_scalar_block_layout : require
layout(local_size_x = 64) in;
layout(scalar, binding = 0) buffer Values { uint values[]; };
layout(scalar, push_constant) uniform Push { uint count; uint rounds; } push;

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= push.count) return;
    uint value = values[i];
    for (uint round = 0; round < push.rounds; ++round) value = value * 1664525u + 1013904223u;
    values[i] = value;
}
