#version 460
// Merges the kept list of the background with that of the agents, in coarse tiles that have both or
// agents alone: by depth key, and by record where keys are equal. Records of the background come
// before those of agents, so that the result is what one sort of both gives.
//
// One workgroup per piece of a merged list. It finds how many entries of the background come before
// the piece and how many before its end (merge path: Odeh, Green, Mwassi, Shmueli, Birk, 2012):
// each half of the workgroup searches one of the two, with as many entries at a time as it has
// threads, because reads that wait for each other take longest. Then it reads the entries of the
// piece, and each finds its place among those of the other list in shared memory.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#include "frame.glsl"

const uint WORKGROUP_THREADS = 256u;
layout(local_size_x = 256) in;

layout(set = 0, binding = 0, scalar) readonly buffer required_block { RequiredCounts required; };
layout(set = 0, binding = 1, scalar) readonly buffer kept_lists_block { uvec2 kept_lists[]; };     // first pair and length
layout(set = 0, binding = 2, scalar) readonly buffer moving_lists_block { uvec2 moving_lists[]; };
layout(set = 0, binding = 3, scalar) readonly buffer merged_lists_block { uvec2 merged_lists[]; };
layout(set = 0, binding = 4, scalar) readonly buffer pieces_block { MergePiece pieces[]; };
layout(set = 0, binding = 5, scalar) readonly buffer moving_records_block { uint moving_records[]; };
layout(set = 0, binding = 6, scalar) readonly buffer keys_block { uint keys[]; }; // of records
layout(set = 0, binding = 7, scalar) buffer sorted_records_block { uint sorted_records[]; }; // kept lists, merged ones behind

layout(push_constant, scalar) uniform push_block { uint pieces_max; };

const uint HALF_THREADS = WORKGROUP_THREADS / 2u;
const uint OWN_PAIRS = MERGE_PAIRS / WORKGROUP_THREADS; // of a thread

shared uint shared_keys[MERGE_PAIRS]; // of the background's entries, then of the agents'
shared uint true_counts[2];

// Number of background entries among the first `entries` of the merged list, for the first half of
// the workgroup, and likewise for the second: each gives its own number, and gets both. Every
// thread of the workgroup calls it.
uvec2 kept_before(uvec2 kept, uvec2 moving, uvec2 entries) {
    uint thread = gl_LocalInvocationIndex;
    uint half_index = thread / HALF_THREADS;
    // The number lies between low and high.
    uvec2 low = entries - min(entries, moving.yy);
    uvec2 high = min(entries, kept.yy);
    while (any(lessThan(low, high))) {
        uvec2 stride = (high - low + HALF_THREADS - 1u) / HALF_THREADS;
        if (thread < 2u) {
            true_counts[thread] = 0u;
        }
        barrier();
        uint own = low[half_index] + (thread % HALF_THREADS + 1u) * stride[half_index] - 1u;
        if (stride[half_index] > 0u && own < high[half_index]) {
            uint kept_key = keys[sorted_records[kept.x + own]];
            uint moving_key = keys[moving_records[moving.x + entries[half_index] - own - 1u]];
            if (kept_key <= moving_key) {
                atomicAdd(true_counts[half_index], 1u);
            }
        }
        barrier();
        uvec2 trues = uvec2(true_counts[0], true_counts[1]);
        low += trues * stride;
        high = min(high, low + max(stride, uvec2(1u)) - 1u);
        barrier(); // the counts are read
    }
    return low;
}

// Entries of shared_keys in first .. first + count, which rise, whose key is less than `key`, or
// not more where `equal`.
uint entries_before(uint first, uint count, uint key, bool equal) {
    uint low = 0u;
    uint high = count;
    while (low < high) {
        uint middle = (low + high) / 2u;
        uint other = shared_keys[first + middle];
        bool before = other < key || (equal && other == key);
        low = before ? middle + 1u : low;
        high = before ? high : middle;
    }
    return low;
}

void main() {
    uint index = group_index();
    if (index >= min(required.merges, pieces_max)) {
        return;
    }
    MergePiece piece = pieces[index];
    uvec2 kept = kept_lists[piece.bin];
    uvec2 moving = moving_lists[piece.bin];
    uvec2 merged = merged_lists[piece.bin];
    uint first = piece.piece * MERGE_PAIRS;
    uint end = min(first + MERGE_PAIRS, merged.y);
    uvec2 kept_range = kept_before(kept, moving, uvec2(first, end));
    uint kept_count = kept_range.y - kept_range.x;
    uint count = end - first;
    uint first_moving = moving.x + first - kept_range.x;

    uint thread = gl_LocalInvocationIndex;
    uint records[OWN_PAIRS];
    [[unroll]] for (uint next = 0u; next < OWN_PAIRS; ++next) {
        uint at = min(thread + next * WORKGROUP_THREADS, count - 1u); // reads without branches overlap
        records[next] = at < kept_count ? sorted_records[kept.x + kept_range.x + at] : moving_records[first_moving + at - kept_count];
    }
    uint own_keys[OWN_PAIRS];
    [[unroll]] for (uint next = 0u; next < OWN_PAIRS; ++next) {
        own_keys[next] = keys[records[next]];
    }
    [[unroll]] for (uint next = 0u; next < OWN_PAIRS; ++next) {
        uint at = thread + next * WORKGROUP_THREADS;
        if (at < count) {
            shared_keys[at] = own_keys[next];
        }
    }
    barrier();
    [[unroll]] for (uint next = 0u; next < OWN_PAIRS; ++next) {
        uint at = thread + next * WORKGROUP_THREADS;
        if (at < count) {
            bool moves = at >= kept_count;
            // Ties: background first.
            uint place = moves ? at - kept_count + entries_before(0u, kept_count, own_keys[next], true)
                : at + entries_before(kept_count, count - kept_count, own_keys[next], false);
            sorted_records[merged.x + first + place] = records[next];
        }
    }
}
