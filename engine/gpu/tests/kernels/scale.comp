#version 460
// target_values[i] = source_values[i] * FACTOR + push.add, for i < push.count.
#extension GL_EXT_scalar_block_layout : require
layout(local_size_x_id = 0) in;
layout(constant_id = 0) const uint GROUP_SIZE = 64;
layout(constant_id = 1) const uint FACTOR = 2;
layout(constant_id = 2) const bool NEGATE = false;
layout(constant_id = 3) const float UNUSED_SCALE = 1.0;

layout(scalar, binding = 0) readonly buffer Source { int source_values[]; };
layout(scalar, binding = 1) writeonly buffer Target { int target_values[]; };
layout(scalar, push_constant) uniform Push { uint count; int add; } push;

void main() {
    uint i = gl_WorkGroupID.x * GROUP_SIZE + gl_LocalInvocationIndex;
    if (i >= push.count) return;
    int value = source_values[i] * int(FACTOR) + push.add;
    // A comparison of constants: compilers fold it into a specialization constant operation.
    if (NEGATE && FACTOR > 1u) value = -value;
    target_values[i] = value + int(UNUSED_SCALE - UNUSED_SCALE);
}
