// What the front-to-back order goes by, finer than an f32 can say: 27 binary digits of a depth computed with 48.
//
// Of two splats on one pixel the nearer must come first, and captured scenes hold pairs that differ by less than the
// rounding of an f32 camera transform; drawing such a pair the wrong way round shows as a stain of their size.

// Sixteen steps between one f32 and the next; counted from the near plane's f32, so that 2^28 floats have room: depths up
// to 2^32 near planes. Farther ones share the last key and keep their index order.
const float STEPS = 16.0;

uint depth_key(vec2 depth_m) {
    uint places = floatBitsToUint(max(depth_m.x, NEAR_M)) - floatBitsToUint(NEAR_M);
    if (places >= 0x0ffffffeu) {
        return 0xffffffffu;
    }
    // The distance to the next float: 2^-23 of the power of two below depth_m.x.
    float place_m = uintBitsToFloat(floatBitsToUint(depth_m.x) & 0x7f800000u) * 1.1920929e-7;
    // At most half a place up or down; the first place counts from 8 so that down is never below 0. The nearest step, not
    // the one below: a depth that an f32 holds stands in the middle of its step, and what a rotation's last digit adds to
    // one of two equal depths leaves them tied.
    int step = int(floor(clamp(depth_m.y / place_m, -0.5, 0.5) * STEPS + 0.5));
    return (places << 4u) + uint(8 + step);
}

// The mean relative to the camera along one world axis.
vec2 axis_offset_m(float mean_m, float centre_high_m, float centre_low_m) {
    vec2 offset = two_sum(mean_m, -centre_high_m);
    return add_pairs(offset, vec2(-centre_low_m, 0.0));
}

vec2 depth_z_m(vec3 mean_m, Camera camera) {
    vec2 depth = vec2(0.0);
    for (int axis = 0; axis < 3; ++axis) {
        vec2 offset = axis_offset_m(mean_m[axis], camera.centre_high_m[axis], camera.centre_low_m[axis]);
        depth = add_pairs(depth, multiply_pairs(vec2(camera.row_z[axis], camera.row_z_low[axis]), offset));
    }
    return depth;
}

vec2 distance_m(vec3 mean_m, Camera camera) {
    vec2 squared = vec2(0.0);
    for (int axis = 0; axis < 3; ++axis) {
        vec2 offset = axis_offset_m(mean_m[axis], camera.centre_high_m[axis], camera.centre_low_m[axis]);
        squared = add_pairs(squared, multiply_pairs(offset, offset));
    }
    // One step of Newton's method on a rounded root: what the root left, over twice the root.
    float root = sqrt(squared.x);
    vec2 left = add_pairs(squared, -two_product(root, root));
    return root > 0.0 ? two_sum(root, 0.5 * (left.x + left.y) / root) : vec2(0.0);
}
