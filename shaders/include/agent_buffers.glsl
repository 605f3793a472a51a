// Buffers that both kernels over agents read.

layout(set = 0, binding = 0, scalar) readonly buffer agents_block { Agent agents[]; };
layout(set = 0, binding = 1, scalar) readonly buffer agent_cameras_block { Camera agent_cameras[]; }; // [agent][camera]
layout(set = 0, binding = 2, scalar) readonly buffer coded_splats_block { uvec3 coded_splats[]; };
layout(set = 0, binding = 3, std430) readonly buffer coded_shapes_block { vec4 coded_shapes[]; }; // 2 per shape: 6 numbers, 2 unused

// The last agent whose clusters begin at or before this one.
uint agent_of_cluster(uint cluster, uint agent_count) {
    uint low = 0u;
    uint high = agent_count;
    while (high - low > 1u) {
        uint middle = (low + high) / 2u;
        if (agents[middle].first_cluster <= cluster) {
            low = middle;
        } else {
            high = middle;
        }
    }
    return low;
}

// Columns whose products with themselves sum to the covariance, in the agent's frame.
mat3 axes_of(Agent agent, CodedSplat splat) {
    uint first = 2u * (agent.first_shape + splat.shape);
    vec4 low = coded_shapes[first], high = coded_shapes[first + 1u];
    float xx = low.x, yx = low.y, yy = low.z;
    float zx = low.w, zy = high.x, zz = high.y;
    return splat.size * mat3(xx, yx, zx, 0.0, yy, zy, 0.0, 0.0, zz);
}
