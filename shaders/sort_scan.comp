#version 460
// Second of three kernels of a radix sort pass: where each block's keys of a digit begin among all keys of that digit.
//
// One workgroup a (digit, segment); the counts become their exclusive sums in place, and the digit's total is written beside.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#include "frame.glsl"
#include "sort.glsl"
#include "block.glsl"

layout(set = 0, binding = 1, scalar) buffer histograms_block { uint histograms[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer digit_totals_block { uint digit_totals[]; }; // [segment][digit]

void main() {
    uint digit = gl_WorkGroupID.x;
    SortSegment segment = segments[gl_WorkGroupID.y];
    if (segment.count == 0u) {
        return;
    }
    uint blocks = sort_blocks(segment.count);
    uint counter = first_counter(segment, digit);
    uint thread = block_thread();
    uint before = 0u;
    for (uint base = 0u; base < blocks; base += WORKGROUP_THREADS) {
        uint block = base + thread;
        uint total;
        uint offset = block_exclusive_sum(block < blocks ? histograms[counter + block] : 0u, total);
        if (block < blocks) {
            histograms[counter + block] = before + offset;
        }
        before += total;
    }
    if (thread == 0u) {
        digit_totals[gl_WorkGroupID.y * RADIX + digit] = before;
    }
}
