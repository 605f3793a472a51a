// Depth slabs: coarse tiles' lists are cut by them before they are sorted. A slab is a function of
// the depth key that never falls, so that the order of slabs and the order of keys agree.
//
// Requires depth_key.glsl.

// 64 slabs per doubling of the depth, from 1/16 m to 4 km. What is nearer or farther is in the
// first or the last.
const uint SLABS = 1024u;
const uint SLAB_SHIFT = 17u; // keeps six digits of an f32's fraction
const float SLAB_FIRST_M = 0.0625;

// A depth whose key is `key`, or less by a step of the key. It never falls with the key.
float depth_of_key(uint key) {
    bool negative = key < 0x80000000u;
    uint code = negative ? 0x80000000u - key : key - 0x80000000u;
    float size = code < KEY_LINEAR_CODES
        ? float(code) * KEY_LINEAR_STEP // a product is rounded correctly everywhere, a quotient is not
        : uintBitsToFloat(floatBitsToUint(KEY_FLOATS_FROM) + (code - KEY_LINEAR_CODES >> 4u));
    return negative ? -size : size;
}

// The slab of a depth key, and its offset in it from 0 to 2^SLAB_SHIFT - 1, where the camera has
// the depth `camera_depth`, scaled as keys are by `key_scale`. Both together never fall with the
// key.
uvec2 slab_and_offset(uint key, float camera_depth, float key_scale) {
    precise float distance = depth_of_key(key) - camera_depth;
    float first = SLAB_FIRST_M * key_scale;
    uint bits = floatBitsToUint(max(distance, first));
    uint slab = (bits >> SLAB_SHIFT) - (floatBitsToUint(first) >> SLAB_SHIFT);
    uint last_place = (1u << SLAB_SHIFT) - 1u;
    return slab < SLABS ? uvec2(slab, bits & last_place) : uvec2(SLABS - 1u, last_place);
}
