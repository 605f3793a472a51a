#version 460
// Codebooks in the light of their agents: c' = T c + b for every coefficient of every color
// (DecoupleGS, section 3.4).
//
// One thread an entry. T and b are meant for colors as plain expansions: DC without the 0.5 that
// splats' colors add. Entries are written as sh.glsl reads them.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#include "frame.glsl"

layout(local_size_x = 256) in;

layout(constant_id = 2) const uint SH_DEGREE = 3u;

const uint COEFFICIENTS = 16u;
const uint COLOR_WORDS = 24u;

struct Relight {
    float gain[3 * COEFFICIENTS]; // T, [coefficient][rgb]
    float summand[3 * COEFFICIENTS]; // b
    uint first_color; // first color in the pool
    uint colors;
    uint first_relit; // index at which the first is written
    uint first_group; // workgroups of the records before it
};

layout(set = 0, binding = 0, scalar) readonly buffer relights_block { Relight relights[]; };
layout(set = 0, binding = 1, scalar) readonly buffer coded_dc_block { vec3 coded_dc[]; };
layout(set = 0, binding = 2, scalar) readonly buffer coded_bands_block { uint coded_bands[]; }; // 24 words a color
layout(set = 0, binding = 3, scalar) writeonly buffer relit_dc_block { vec3 relit_dc[]; };
layout(set = 0, binding = 4, scalar) writeonly buffer relit_bands_block { uint relit_bands[]; };

layout(push_constant, scalar) uniform push_block { uint relight_count; };

// 0.5 / Y0: what the DC term of a splat's color leaves out.
const float DC_SHIFT = 1.7724538509055159;

// The last whose workgroups begin at or before this one.
uint relight_of_group(uint group) {
    uint low = 0u;
    uint high = relight_count;
    while (high - low > 1u) {
        uint middle = (low + high) / 2u;
        if (relights[middle].first_group <= group) {
            low = middle;
        } else {
            high = middle;
        }
    }
    return low;
}

// The smallest normal f16 that is at least `value`, as bits.
uint f16_at_least(float value) {
    uint bits = floatBitsToUint(clamp(value, 6.103515625e-5, 65504.0));
    uint truncated = (((bits >> 23u) - 112u) << 10u) | (bits >> 13u & 0x3ffu);
    return truncated + uint((bits & 0x1fffu) != 0u);
}

// Half-word `index` of the words from `first` on, signed.
float half_word(uint first, uint index) {
    uint word = coded_bands[first + index / 2u];
    return float(index % 2u == 0u ? int(word << 16) >> 16 : int(word) >> 16);
}

// One band: `count` numbers behind a scale, from word `from` of the pool to word `to` of what is
// lit.
void relight_band(uint relight, uint first_coefficient, uint count, uint from, uint to) {
    float scale = unpackHalf2x16(coded_bands[from]).x / 32767.0;
    float lit[21];
    float largest = 0.0;
    for (uint number = 0u; number < count; ++number) {
        uint row = 3u * first_coefficient + number;
        lit[number] = relights[relight].gain[row] * (half_word(from, number + 1u) * scale) + relights[relight].summand[row];
        largest = max(largest, abs(lit[number]));
    }
    uint scale_bits = f16_at_least(largest);
    float fraction = 32767.0 / unpackHalf2x16(scale_bits).x;
    uint word = scale_bits;
    for (uint number = 0u; number < count; ++number) {
        uint code = uint(int(clamp(round(lit[number] * fraction), -32767.0, 32767.0))) & 0xffffu;
        if (number % 2u == 0u) {
            relit_bands[to + number / 2u] = word | code << 16u;
        } else {
            word = code;
        }
    }
    if (count % 2u == 0u) {
        relit_bands[to + count / 2u] = word;
    }
}

void main() {
    uint group = group_index();
    uint relight = relight_of_group(group);
    uint entry = (group - relights[relight].first_group) * gl_WorkGroupSize.x + gl_LocalInvocationIndex;
    if (entry >= relights[relight].colors) {
        return;
    }
    uint from = relights[relight].first_color + entry;
    uint to = relights[relight].first_relit + entry;
    vec3 gain = vec3(relights[relight].gain[0], relights[relight].gain[1], relights[relight].gain[2]);
    vec3 summand = vec3(relights[relight].summand[0], relights[relight].summand[1], relights[relight].summand[2]);
    relit_dc[to] = gain * (coded_dc[from] + DC_SHIFT) + summand - DC_SHIFT;
    if (SH_DEGREE >= 1u) {
        relight_band(relight, 1u, 9u, COLOR_WORDS * from, COLOR_WORDS * to);
    }
    if (SH_DEGREE >= 2u) {
        relight_band(relight, 4u, 15u, COLOR_WORDS * from + 5u, COLOR_WORDS * to + 5u);
    }
    if (SH_DEGREE >= 3u) {
        relight_band(relight, 9u, 21u, COLOR_WORDS * from + 13u, COLOR_WORDS * to + 13u);
    }
}
