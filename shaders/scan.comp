#version 460
// Prefix sum (exclusive scan) over a list of counts, and their total behind the last, in one
// dispatch.
//
// Each workgroup adds up everything before its block by itself: the counts are few (one for 256
// splats), the reads are coalesced and wait for nothing, and no group waits for another, which
// Vulkan gives no right to (no forward-progress guarantee).
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#include "frame.glsl"

const uint WORKGROUP_THREADS = 256u;
layout(local_size_x = 256) in;
#include "block.glsl"

layout(set = 0, binding = 0, scalar) readonly buffer counts_block { uint counts[]; };
layout(set = 0, binding = 1, scalar) writeonly buffer offsets_block { uint offsets[]; };

layout(push_constant, scalar) uniform push_block { uint count; };

const uint SCAN_BLOCK = 1024u;

void main() {
    uint block = group_index();
    uint first = block * SCAN_BLOCK;
    if (first >= count && block > 0u) {
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
            offsets[index] = before + offset;
        }
        before += total;
    }
    if (end == count && thread == 0u) {
        offsets[count] = before;
    }
}
