#version 460
// Where each (camera, chunk) begins in the list of records: an exclusive sum over the counts, in one dispatch.
//
// Each workgroup adds up everything before its block by itself: the counts are few (one for 256 splats), the reads are
// coalesced and wait for nothing, and no group waits for another, which Vulkan gives no right to (no forward-progress
// guarantee). The last group knows the total and sets up what depends on it.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#include "frame.glsl"

const uint WORKGROUP_THREADS = 256u;
layout(local_size_x = 256) in;
#include "block.glsl"

layout(constant_id = 0) const uint SORT_BLOCK = 4096u; // keys a workgroup of the sort takes

layout(set = 0, binding = 0, scalar) readonly buffer counts_block { uint counts[]; };
layout(set = 0, binding = 1, scalar) writeonly buffer firsts_block { uint firsts[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer needs_block { Needs needs; };
layout(set = 0, binding = 3, scalar) writeonly buffer arguments_block { uvec3 arguments[]; };

layout(push_constant, scalar) uniform push_block { uint count; uint records_max; };

const uint SCAN_BLOCK = 1024u;

void main() {
    uint block = group_index();
    uint first = block * SCAN_BLOCK;
    if (first >= count) {
        return;
    }
    uint thread = block_thread();
    uint sum = 0u;
    for (uint index = thread; index < first; index += WORKGROUP_THREADS) {
        sum += counts[index];
    }
    uint before = block_sum(sum);

    uint end = min(first + SCAN_BLOCK, count);
    for (uint base = first; base < end; base += WORKGROUP_THREADS) {
        uint index = base + thread;
        uint total;
        uint offset = block_exclusive_sum(index < end ? counts[index] : 0u, total);
        if (index < end) {
            firsts[index] = before + offset;
        }
        before += total;
    }
    if (end == count && thread == 0u) {
        uint records = min(before, records_max);
        needs.records = before;
        arguments[ARGUMENTS_SORT_RECORDS] = groups_for((records + SORT_BLOCK - 1u) / SORT_BLOCK);
        arguments[ARGUMENTS_PAIR_BLOCKS] = groups_for((records + PAIR_BLOCK - 1u) / PAIR_BLOCK);
    }
}
