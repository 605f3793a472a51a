// A color in 64 bits: 19 per channel and an exponent of 7 that all three share. A channel is off by
// at most 2^-19 of the largest one, so by less than 1e-6 up to 1.0. Integers, and products with
// powers of two: every device finds the same code.

const uint COLOR_CHANNEL_BITS = 19u;
const uint COLOR_CHANNEL_MAX = (1u << COLOR_CHANNEL_BITS) - 1u;

// Exponents of an f32 that the code has: from 2^-95, below which digits are lost, to 2^32.
const uint COLOR_EXPONENT_MIN = 32u;
const uint COLOR_EXPONENT_MAX = 159u;
const float COLOR_MAX = 8589918208.0; // the largest code: (2^19 - 1) * 2^14

// The power of two with the exponent field `field` of an f32.
float power_of_two(uint field) {
    return uintBitsToFloat(field << 23u);
}

uvec2 pack_color(vec3 color) {
    color = clamp(color, vec3(0.0), vec3(COLOR_MAX));
    float largest = max(color.r, max(color.g, color.b));
    // The exponent of the largest channel after rounding to 19 binary digits, of its 24.
    uint exponent = clamp((floatBitsToUint(largest) + 16u) >> 23u, COLOR_EXPONENT_MIN, COLOR_EXPONENT_MAX);
    vec3 scaled = color * power_of_two(272u - exponent); // 2^18 over the exponent's power of two
    uvec3 code = min(uvec3(scaled + 0.5), uvec3(COLOR_CHANNEL_MAX));
    return uvec2(code.r | code.g << 19u, code.g >> 13u | code.b << 6u | (exponent - COLOR_EXPONENT_MIN) << 25u);
}

vec3 unpack_color(uvec2 code) {
    uint exponent = (code.y >> 25u) + COLOR_EXPONENT_MIN;
    uvec3 channels = uvec3(code.x, code.x >> 19u | code.y << 13u, code.y >> 6u) & COLOR_CHANNEL_MAX;
    return vec3(channels) * power_of_two(exponent - 18u);
}
