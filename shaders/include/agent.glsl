// Agents: splats of 12 bytes over codebooks, in the asset's own frame. They are never expanded:
// each camera is moved into the agent's frame instead, so that neither a position nor a shape has
// to be turned.

struct Agent {
    vec3 row_x; // world from agent rotation, by rows: for colors that are meant in the world's frame
    vec3 row_y;
    vec3 row_z;
    vec3 box_min_m; // of the position grid
    vec3 box_step_m;
    vec3 dc_residual_step; // luma, orange, green
    float log2_size_min;
    float log2_size_step;
    uint first_cluster; // of this agent, among the clusters of all agents of the frame
    uint first_bounds; // of its level of detail, in the pool
    uint first_splat;
    uint splat_count;
    uint first_shape;
    uint first_color;
    uint cameras; // mask of the cameras that may see it, bit 0 for the first
    uint instance;
    uint colors_in_world; // 1: not turned with the agent
    uint colors_relit; // 1: its colors are those that were made for it, not the pool's
    uint shading; // by normals: 0 none, else 1 more than its place among those of the frame
    vec3 dc_residual_gain; // of what is added to the DC term of its colors
    vec3 velocity_mps;     // world axes
    vec3 turn_rad_per_s;   // rotation vector per second, its own axes
};

struct CodedSplat {
    vec3 mean_m;
    float opacity;
    float size;
    uint shape;
    uint color;
    vec3 dc_residual; // RGB
};

CodedSplat unpack_splat(uvec3 words, Agent agent) {
    CodedSplat splat;
    precise vec3 offset = vec3(words.x & 0xffffu, words.x >> 16u, words.y & 0xffffu) * agent.box_step_m;
    precise vec3 mean_m = agent.box_min_m + offset;
    splat.mean_m = mean_m;
    splat.opacity = float(words.y >> 16u & 0xffu) / 255.0;
    splat.size = exp2(agent.log2_size_min + float(words.y >> 24u) * agent.log2_size_step);
    splat.shape = words.z & 0x1ffu;
    splat.color = words.z >> 9u & 0x3ffu;
    vec3 residual = vec3(ivec3(words.z >> 19u & 0x1fu, words.z >> 24u & 0xfu, words.z >> 28u) - ivec3(16, 8, 8)) * agent.dc_residual_step;
    float rest = residual.x - residual.z;
    splat.dc_residual = vec3(rest + residual.y, residual.x + residual.z, rest - residual.y);
    return splat;
}
