#version 460
// Buffers of several shapes, for reflection: an array of structures, a block with a counter, a bare
// structure.
#extension GL_EXT_scalar_block_layout : require
layout(local_size_x = 8, local_size_y = 4, local_size_z = 2) in;
struct Item { vec3 mean; uint id; vec2 extent; };
layout(scalar, binding = 5) readonly buffer Items { Item items[]; };
layout(scalar, binding = 1) buffer Counted { uint count; float weights[4]; uint ids[]; } counted;
layout(scalar, binding = 3) writeonly buffer Whole { Item item; };
layout(scalar, push_constant) uniform Push { vec3 origin; uint count; mat3x4 turn; } push;

void main() {
    uint i = gl_LocalInvocationIndex;
    if (i >= push.count) return;
    counted.ids[i] = items[i].id + uint(push.origin.x + push.turn[2].w) + counted.count + uint(counted.weights[0]);
    if (i == 0) item = items[0];
}
