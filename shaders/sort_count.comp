#version 460
// First of three kernels of a radix sort pass: how often each digit stands in each block of keys.
//
// Reduce-then-scan (Merrill and Grimshaw, High Performance and Scalable Radix Sorting, 2011): no group waits for another.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#include "frame.glsl"
#include "sort.glsl"

layout(set = 0, binding = 1, scalar) readonly buffer keys_in_block { uint keys_in[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer histograms_block { uint histograms[]; }; // [segment][digit][block]

layout(push_constant, scalar) uniform push_block { uint segment_count; uint shift; };

shared uint histogram[RADIX];

void main() {
    uint group = group_index();
    SortSegment segment = segments[segment_of(group, segment_count)];
    uint block = group - segment.first_block;
    if (block >= sort_blocks(segment.count)) {
        return;
    }
    for (uint digit = gl_LocalInvocationIndex; digit < RADIX; digit += WORKGROUP_THREADS) {
        histogram[digit] = 0u;
    }
    barrier();
    uint first = block * WORKGROUP_THREADS * ITEMS;
    for (uint item = 0u; item < ITEMS; ++item) {
        uint index = first + item * WORKGROUP_THREADS + gl_LocalInvocationIndex;
        if (index < segment.count) {
            atomicAdd(histogram[keys_in[segment.first + index] >> shift & (RADIX - 1u)], 1u);
        }
    }
    barrier();
    for (uint digit = gl_LocalInvocationIndex; digit < RADIX; digit += WORKGROUP_THREADS) {
        histograms[first_counter(segment, digit) + block] = histogram[digit];
    }
}
