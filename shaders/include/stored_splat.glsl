// Splats of the background as they are stored; engine/render/src/storage.rs says how. The including
// kernel declares shapes and rotations.

layout(constant_id = 23) const bool COMPACT = false; // 120 bytes per splat of degree 3 instead of 152

const uint SCALE_BITS = 21u; // of a scale, beside those below
const uint SCALE_LOW_BITS = 2u;
const uint SCALE_BIAS = 28573696u; // pattern of 2^-18 as f32, without its lowest 5 bits
const uint OPACITY_BITS = 26u;
const uint OPACITY_BIAS = 998277248u; // pattern of the largest f32 below 1/255
const float COMPONENT_STEP = 6.7435012e-07; // 1/sqrt(2) / (2^20 - 1)

// `opacity_word` has the lowest bits of the scales above the opacity.
vec3 unpack_scales_m(uvec3 words, uint opacity_word) {
    uvec3 low = uvec3(opacity_word) >> (OPACITY_BITS + SCALE_LOW_BITS * uvec3(0u, 1u, 2u)) & ((1u << SCALE_LOW_BITS) - 1u);
    uvec3 codes = (words & ((1u << SCALE_BITS) - 1u)) << SCALE_LOW_BITS | low;
    return mix(uintBitsToFloat((codes + SCALE_BIAS) << 5u), vec3(0.0), equal(codes, uvec3(0u)));
}

// 0 where it is below 1/255: no pixel shows that.
float unpack_opacity(uint opacity_word) {
    uint code = opacity_word & ((1u << OPACITY_BITS) - 1u);
    return code == 0u ? 0.0 : uintBitsToFloat(code + OPACITY_BIAS);
}

// Unit quaternion, w first; the largest component is what the others leave.
vec4 unpack_rotation(uvec4 words) {
    uint first = words.x >> SCALE_BITS | (words.y >> SCALE_BITS & 0x3ffu) << 11u;
    uint second = words.z >> SCALE_BITS | (words.w >> SCALE_BITS & 0x3ffu) << 11u;
    vec3 others = COMPONENT_STEP * vec3(ivec3(first, second, words.w) << 11 >> 11);
    float left_out = sqrt(max(1.0 - dot(others, others), 0.0));
    uint left_out_axis = words.y >> 31u | words.w >> 31u << 1u;
    return left_out_axis == 0u   ? vec4(left_out, others)
           : left_out_axis == 1u ? vec4(others.x, left_out, others.yz)
           : left_out_axis == 2u ? vec4(others.xy, left_out, others.z)
                         : vec4(others, left_out);
}

// Axes of the splat, as long as its standard deviations (m), and its opacity.
mat3 load_axes(uint splat_index, out float opacity) {
    uvec4 words = shapes[splat_index];
    vec3 scales_m;
    vec4 rotation;
    if (COMPACT) {
        uint opacity_word = rotations[splat_index / 4u][splat_index % 4u];
        scales_m = unpack_scales_m(words.xyz, opacity_word);
        rotation = unpack_rotation(words);
        opacity = unpack_opacity(opacity_word);
    } else {
        scales_m = uintBitsToFloat(words.xyz);
        rotation = uintBitsToFloat(rotations[splat_index]);
        opacity = uintBitsToFloat(words.w);
    }
    mat3 axes = matrix_from_quaternion(rotation);
    return mat3(axes[0] * scales_m.x, axes[1] * scales_m.y, axes[2] * scales_m.z);
}
