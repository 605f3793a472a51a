// Depth key of the front-to-back order, finer than an f32: 27 binary digits of a depth computed
// with 48.
//
// The depth is counted from the world's origin, along the camera's direction: f.p instead of f.(p -
// c), which differs by the same for all splats. So a key does not change when the camera moves
// without turning, and neither does the order.
//
// Of two splats on one pixel the nearer must come first, and captured scenes hold pairs that differ
// by less than the rounding of an f32 camera transform; drawing such a pair the wrong way round
// shows as a stain of their size.

// Sixteen steps between one f32 and the next, of fifteen powers of two; what is smaller is counted
// in steps of one size.
const float KEY_STEPS = 16.0;
const float KEY_FLOATS_FROM = 3.0517578125e-5; // 2^-15
const float KEY_LINEAR_STEPS = 4398046511104.0; // 2^42: as fine at 2^-15 as the floats there
const float KEY_LINEAR_STEP = 2.2737367544323206e-13; // 2^-42
const uint KEY_LINEAR_CODES = 134217728u; // 2^27

// The key of a depth that lies between -1 and 1.
uint depth_key(vec2 depth) {
    bool negative = depth.x < 0.0;
    vec2 size = negative ? -depth : depth;
    uint code;
    if (size.x < KEY_FLOATS_FROM) {
        float scaled = size.x * KEY_LINEAR_STEPS;
        float whole = floor(scaled);
        precise float rest = (scaled - whole) + size.y * KEY_LINEAR_STEPS;
        code = uint(max(int(whole) + int(floor(rest + 0.5)), 0));
    } else {
        uint ulps = floatBitsToUint(size.x) - floatBitsToUint(KEY_FLOATS_FROM);
        // The distance to the next float: 2^-23 of the power of two below.
        float ulp = uintBitsToFloat(floatBitsToUint(size.x) & 0x7f800000u) * 1.1920929e-7;
        // At most half an ulp up or down. The nearest step, not the one below: a depth that an f32
        // holds stands in the middle of its step, and what a rotation's last digit adds to one of
        // two equal depths leaves them tied.
        int part = int(floor(clamp(size.y / ulp, -0.5, 0.5) * KEY_STEPS + 0.5));
        code = min(KEY_LINEAR_CODES + uint(int(min(ulps, 0x07ffffffu) << 4u) + part), 0x7fffffffu);
    }
    return negative ? 0x80000000u - code : 0x80000000u + code;
}

// The depth, between -1 and 1, of a mean: background relative to the world's origin, or an agent's
// in its own frame.
vec2 scaled_depth(vec3 mean_m, Camera camera) {
    vec2 depth = camera.key_offset;
    for (int axis = 0; axis < 3; ++axis) {
        vec2 row = vec2(camera.row_z[axis], camera.row_z_low[axis]);
        depth = add_pairs(depth, multiply_pairs(row, vec2(mean_m[axis] * camera.key_scale, 0.0)));
    }
    return depth;
}

// A distance from the camera, scaled: it does not lose its sign, and only the camera's own
// position counts.
vec2 scaled_distance(vec3 mean_m, Camera camera) {
    vec2 squared = vec2(0.0);
    for (int axis = 0; axis < 3; ++axis) {
        vec2 offset = two_sum(mean_m[axis] * camera.key_scale, -camera.center_high_m[axis] * camera.key_scale);
        offset = add_pairs(offset, vec2(-camera.center_low_m[axis] * camera.key_scale, 0.0));
        squared = add_pairs(squared, multiply_pairs(offset, offset));
    }
    // One step of Newton's method on a rounded root: what the root left, over twice the root.
    float root = sqrt(squared.x);
    vec2 left = add_pairs(squared, -two_product(root, root));
    return root > 0.0 ? two_sum(root, 0.5 * (left.x + left.y) / root) : vec2(0.0);
}
