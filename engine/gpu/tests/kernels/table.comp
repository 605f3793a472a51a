#version 460
// values[i] = table[i % 16] * 2, for i < 64: table is a uniform buffer.
#extension GL_EXT_scalar_block_layout : require
layout(local_size_x = 64) in;
layout(scalar, binding = 0) uniform Table { int table[16]; };
layout(scalar, binding = 1) writeonly buffer Values { int values[]; };

void main() {
    uint i = gl_GlobalInvocationID.x;
    values[i] = table[i % 16u] * 2;
}
