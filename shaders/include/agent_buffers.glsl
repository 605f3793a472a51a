// Buffers that both kernels over agents read.

layout(set = 0, binding = 0, scalar) readonly buffer agents_block { Agent agents[]; };
layout(set = 0, binding = 1, scalar) readonly buffer agent_cameras_block { Camera agent_cameras[]; }; // [agent][camera]
layout(set = 0, binding = 2, scalar) readonly buffer coded_splats_block { uvec3 coded_splats[]; };
layout(set = 0, binding = 3, scalar) readonly buffer coded_shapes_block { float coded_shapes[]; }; // 6 a shape

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
    uint first = 6u * (agent.first_shape + splat.shape);
    float xx = coded_shapes[first], yx = coded_shapes[first + 1u], yy = coded_shapes[first + 2u];
    float zx = coded_shapes[first + 3u], zy = coded_shapes[first + 4u], zz = coded_shapes[first + 5u];
    return splat.size * mat3(xx, yx, zx, 0.0, yy, zy, 0.0, 0.0, zz);
}
