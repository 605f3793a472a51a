#version 460
// Plans the lists of a frame whose lists of the background are kept: where the merged list of each
// coarse tile with splats of agents lies, in pieces for merge_lists, and which coarse tiles need not
// be blended.
//
// A coarse tile without agents keeps the list of the background where it is. If the image has been
// drawn so, from the same lists and without agents, the tile is not blended again: `drawn_alone`
// says that, by coarse tile of the image that is drawn into.
//
// One thread per coarse tile. Each workgroup adds up what stands before it by itself; no group
// waits for another.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#include "frame.glsl"

const uint WORKGROUP_THREADS = 256u;
layout(local_size_x = 256) in;
#include "block.glsl"

layout(set = 0, binding = 0, scalar) buffer required_block { RequiredCounts required; }; // those of the agents before
layout(set = 0, binding = 1, scalar) readonly buffer kept_required_block { RequiredCounts kept_required; }; // of the background
layout(set = 0, binding = 2, scalar) readonly buffer kept_lists_block { uvec2 kept_lists[]; };     // first pair and length
layout(set = 0, binding = 3, scalar) readonly buffer moving_lists_block { uvec2 moving_lists[]; };
layout(set = 0, binding = 4, scalar) writeonly buffer merged_lists_block { uvec2 merged_lists[]; };
layout(set = 0, binding = 5, scalar) writeonly buffer pieces_block { MergePiece pieces[]; };
layout(set = 0, binding = 6, scalar) writeonly buffer arguments_block { uvec3 arguments[]; };
layout(set = 0, binding = 7, scalar) buffer drawn_alone_block { uint drawn_alone[]; };

layout(push_constant, scalar) uniform push_block {
    uint bin_count;
    uint pairs_max; // merged lists begin here
    uint pieces_max;
    uint drawn_count; // coarse tiles of drawn_alone; 0 where all coarse tiles are blended
    uint drawn_holds; // 1 if drawn_alone is that of the image, 0 if nothing of it can be used
};

// Lists that a thread reads before it counts the first, so that the reads overlap.
const uint AHEAD = 4u;

uint merged_length(uint kept, uint moving) {
    return moving > 0u ? kept + moving : 0u;
}

uint pieces_of(uint length) {
    return length / MERGE_PAIRS + (length % MERGE_PAIRS > 0u ? 1u : 0u);
}

void main() {
    uint thread = block_thread();
    uint block_first = gl_WorkGroupID.x * WORKGROUP_THREADS;
    uint earlier_pairs = 0u;
    uint earlier_pieces = 0u;
    for (uint first = thread; first < block_first; first += AHEAD * WORKGROUP_THREADS) {
        uvec2 lengths[AHEAD];
        [[unroll]] for (uint next = 0u; next < AHEAD; ++next) {
            uint bin = min(first + next * WORKGROUP_THREADS, block_first - 1u);
            lengths[next] = uvec2(kept_lists[bin].y, moving_lists[bin].y);
        }
        [[unroll]] for (uint next = 0u; next < AHEAD; ++next) {
            bool real = first + next * WORKGROUP_THREADS < block_first;
            uint length = real ? merged_length(lengths[next].x, lengths[next].y) : 0u;
            earlier_pairs += length;
            earlier_pieces += pieces_of(length);
        }
    }
    uint pairs_before = block_sum(earlier_pairs);
    uint pieces_before = block_sum(earlier_pieces);

    uint bin = block_first + thread;
    bool real = bin < bin_count;
    uvec2 kept = real ? kept_lists[bin] : uvec2(0u);
    uvec2 moving = real ? moving_lists[bin] : uvec2(0u);
    uint length = merged_length(kept.y, moving.y);
    uint pair_total, piece_total;
    uint pair = pairs_before + block_exclusive_sum(length, pair_total);
    uint piece = pieces_before + block_exclusive_sum(pieces_of(length), piece_total);
    if (real) {
        bool alone = moving.y == 0u;
        bool in_image = false;
        if (bin < drawn_count) {
            in_image = alone && drawn_holds != 0u && drawn_alone[bin] != 0u;
            drawn_alone[bin] = alone ? 1u : 0u;
        }
        merged_lists[bin] = in_image ? uvec2(0u, NOT_BLENDED) : alone ? kept : uvec2(pairs_max + pair, length);
    }
    for (uint next = 0u; next < pieces_of(length); ++next) {
        if (piece + next < pieces_max) {
            pieces[piece + next] = MergePiece(bin, next);
        }
    }
    if (thread == 0u && gl_WorkGroupID.x == gl_NumWorkGroups.x - 1u) {
        uint of_background = wanted_pairs(kept_required);
        uint of_agents = wanted_pairs(required);
        uint pairs = of_agents > 0xffffffffu - of_background ? 0xffffffffu : of_background + of_agents;
        required.pairs_low = pairs & 0xffffu;
        required.pairs_high = pairs >> 16u;
        required.merges = pieces_before + piece_total;
        // What has no room is not merged: the host grows the buffers and draws again.
        arguments[ARGUMENTS_MERGE] = groups_for(pairs <= pairs_max ? pieces_before + piece_total : 0u);
    }
}
