#version 460
// Cuts each coarse tile's list into segments that are blended side by side, and plans how their
// results are joined.
//
// One tile may hold a hundred times the average list; blended by one workgroup it would set the
// frame's time. Over is associative, (C, T) o (C', T') = (C + T C', T T'), so segments need not
// wait for each other. A tile's segments depend on its own list alone, so its pixels do not change
// with what else is drawn.
//
// Items are ordered in waves, segment 0 of every tile before segment 1 of any, then segments 2 and
// 3, then 4 to 7 and so on, so that a segment mostly starts when those before it are done and can
// leave out what they have covered.
//
// A tile whose pixels are in the image already, of length NOT_BLENDED, has no segment.
//
// One thread per tile and wave. Each workgroup adds up what stands before it by itself; no group
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

layout(constant_id = 0) const uint SEGMENT_PAIRS = 1024u; // 0xffffffff: never cut, blend each list in one run

layout(set = 0, binding = 0, scalar) buffer required_block { RequiredCounts required; };
layout(set = 0, binding = 1, scalar) readonly buffer tile_lists_block { uvec2 tile_lists[]; }; // first pair and length
layout(set = 0, binding = 2, scalar) writeonly buffer items_block { BlendItem items[]; };
layout(set = 0, binding = 3, scalar) writeonly buffer composites_block { Composite composites[]; };
layout(set = 0, binding = 4, scalar) writeonly buffer arguments_block { uvec3 arguments[]; };

layout(push_constant, scalar) uniform push_block {
    uint bin_count;
    uint pairs_max;
    uint items_max;
    uint partials_max;
    uint composites_max;
};

// Workgroups that share the joining of one coarse tile, or of a part of its pixels.
const uint COMPOSITE_GROUPS = COARSE_PIXELS / 256u;

// Lists that a thread reads before it counts the first, so that the reads overlap.
const uint AHEAD = 4u;

shared uint longest_list;

// Of each thread: its first item among those of the workgroup, and its list, first partial result
// and number of segments.
shared uint own_items[WORKGROUP_THREADS];
shared uvec4 own_lists[WORKGROUP_THREADS];

uint segments_of(uint length) {
    return length == NOT_BLENDED ? 0u : max(1u, length / SEGMENT_PAIRS + (length % SEGMENT_PAIRS > 0u ? 1u : 0u));
}

// First segment of a wave: 0, 1, 2, 4, 8 ...
uint wave_first(uint wave) {
    return wave == 0u ? 0u : 1u << (wave - 1u);
}

void main() {
    uint thread = block_thread();
    uint block_first = gl_WorkGroupID.x * WORKGROUP_THREADS;
    uint first_segment = wave_first(gl_WorkGroupID.y);
    uint end_segment = wave_first(gl_WorkGroupID.y + 1u);
    uint earlier_items = 0u;    // of earlier waves, and of earlier tiles in this one
    uint earlier_partials = 0u; // of earlier tiles
    uint earlier_composites = 0u; // of earlier tiles, which are cut into more than one segment
    if (thread == 0u) {
        longest_list = 0u;
    }
    barrier();
    uint longest = 0u;
    for (uint first = thread; first < bin_count; first += AHEAD * WORKGROUP_THREADS) {
        uint lengths[AHEAD];
        [[unroll]] for (uint next = 0u; next < AHEAD; ++next) {
            lengths[next] = tile_lists[min(first + next * WORKGROUP_THREADS, bin_count - 1u)].y;
        }
        [[unroll]] for (uint next = 0u; next < AHEAD; ++next) {
            uint bin = first + next * WORKGROUP_THREADS;
            uint segments = bin < bin_count ? segments_of(lengths[next]) : 0u;
            bool earlier = bin < block_first;
            longest = max(longest, lengths[next] == NOT_BLENDED ? 0u : lengths[next]);
            earlier_items += min(segments, earlier ? end_segment : first_segment);
            earlier_partials += earlier && segments > 1u ? segments : 0u;
            earlier_composites += earlier && segments > 1u ? composite_runs(segments) : 0u;
        }
    }
    atomicMax(longest_list, longest);
    uint items_before = block_sum(earlier_items);
    uint partials_before = block_sum(earlier_partials);
    uint composites_before = block_sum(earlier_composites);

    uint bin = block_first + thread;
    bool real = bin < bin_count;
    uvec2 list = real ? tile_lists[bin] : uvec2(0u);
    uint length = list.y;
    uint segments = real ? segments_of(length) : 0u;
    bool cut = segments > 1u;
    uint wave_end = min(segments, end_segment);
    uint item_total, partial_total, composite_total;
    uint item = items_before + block_exclusive_sum(wave_end - min(first_segment, wave_end), item_total);
    uint partial = partials_before + block_exclusive_sum(cut ? segments : 0u, partial_total);
    uint composite = composites_before + block_exclusive_sum(cut ? composite_runs(segments) : 0u, composite_total);

    // One list may have most of the segments: the threads share them.
    own_items[thread] = item - items_before;
    own_lists[thread] = uvec4(list, cut ? partial : NO_PARTIAL, segments);
    barrier();
    for (uint next = thread; next < item_total && items_before + next < items_max; next += WORKGROUP_THREADS) {
        uint giver = 0u; // the last thread whose first item is not behind this one
        [[unroll]] for (uint step = WORKGROUP_THREADS / 2u; step > 0u; step /= 2u) {
            giver += own_items[giver + step] <= next ? step : 0u;
        }
        uvec4 given = own_lists[giver];
        uint segment = first_segment + next - own_items[giver];
        uint taken = segment * SEGMENT_PAIRS;
        // Without room for the partial result any slot is valid: the image is rendered again.
        uint slot = given.z == NO_PARTIAL ? NO_PARTIAL : min(given.z + segment, partials_max - 1u);
        items[items_before + next] = BlendItem(block_first + giver, given.x + taken, segment + 1u < given.w ? SEGMENT_PAIRS : given.y - taken, slot, segment);
    }
    if (cut && first_segment == 0u) {
        for (uint part = 0u; part < composite_runs(segments); ++part) {
            if (composite + part < composites_max) {
                composites[composite + part] = Composite(bin, partial, segments, part);
            }
        }
    }
    if (thread == 0u && gl_WorkGroupID.xy == gl_NumWorkGroups.xy - 1u) {
        uint all_items = items_before + item_total;
        uint all_partials = partials_before + partial_total;
        uint all_composites = composites_before + composite_total;
        uint pairs = wanted_pairs(required);
        required.pairs = pairs;
        required.items = all_items;
        required.partials = all_partials;
        required.composites = all_composites;
        required.longest = longest_list; // block_sum has waited for all threads
        // Items without room are not rendered: the host grows the buffers and renders again.
        arguments[ARGUMENTS_BLEND] = groups_for(pairs <= pairs_max ? min(all_items, items_max) : 0u);
        arguments[ARGUMENTS_COMPOSITE] = groups_for(all_partials <= partials_max && pairs <= pairs_max ? all_composites * COMPOSITE_GROUPS : 0u);
    }
}
