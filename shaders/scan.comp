#version 460
// Prefix sum (exclusive scan) over a list of counts, and their total behind the last, in one
// dispatch.
//
// Each workgroup adds up everything before its block by itself: the counts are few (one for 256
// splats), the reads are coalesced and wait for nothing, and no group waits for another, which
// Vulkan gives no right to (no forward-progress guarantee).
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
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
const uint OWN_COUNTS = SCAN_BLOCK / WORKGROUP_THREADS; // of a thread
const uint AHEAD = 16u; // counts that a thread reads before it adds the first, so that the reads overlap

void main() {
    uint block = group_index();
    uint first = block * SCAN_BLOCK;
    if (first >= count && block > 0u) {
        return;
    }
    uint thread = block_thread();
    uint sum = 0u;
    for (uint base = thread; base < first; base += AHEAD * WORKGROUP_THREADS) {
        uint ahead[AHEAD];
        [[unroll]] for (uint next = 0u; next < AHEAD; ++next) {
            uint index = base + next * WORKGROUP_THREADS;
            ahead[next] = counts[min(index, first - 1u)];
            ahead[next] = index < first ? ahead[next] : 0u;
        }
        [[unroll]] for (uint next = 0u; next < AHEAD; ++next) {
            sum += ahead[next];
        }
    }
    uint before = block_sum(sum);

    uint end = min(first + SCAN_BLOCK, count);
    uint own[OWN_COUNTS];
    uint own_sum = 0u;
    [[unroll]] for (uint next = 0u; next < OWN_COUNTS; ++next) {
        uint index = first + thread * OWN_COUNTS + next;
        own[next] = index < end ? counts[index] : 0u;
        own_sum += own[next];
    }
    uint total;
    uint offset = before + block_exclusive_sum(own_sum, total);
    [[unroll]] for (uint next = 0u; next < OWN_COUNTS; ++next) {
        uint index = first + thread * OWN_COUNTS + next;
        if (index < end) {
            offsets[index] = offset;
        }
        offset += own[next];
    }
    if (end == count && thread == 0u) {
        offsets[count] = before + total;
    }
}
