#version 460
// Third of three kernels of a radix sort pass: moves each key and its value to its place. Stable.
//
// Each subgroup takes a run of consecutive keys and finds, by ballots, which of its lanes hold the same digit; counters a
// (subgroup, digit) carry the rank from one step of the run to the next. Right for subgroups of 4 to 64 lanes.
//
// The block is put in order in shared memory first, so that keys of one digit leave as one run of neighbours.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require
#include "frame.glsl"
#include "sort.glsl"
#include "block.glsl"

layout(set = 0, binding = 1, scalar) readonly buffer histograms_block { uint histograms[]; };
layout(set = 0, binding = 2, scalar) readonly buffer digit_totals_block { uint digit_totals[]; };
layout(set = 0, binding = 3, scalar) readonly buffer keys_in_block { uint keys_in[]; };
layout(set = 0, binding = 4, scalar) readonly buffer values_in_block { uint values_in[]; };
layout(set = 0, binding = 5, scalar) writeonly buffer keys_out_block { uint keys_out[]; };
layout(set = 0, binding = 6, scalar) writeonly buffer values_out_block { uint values_out[]; };

layout(push_constant, scalar) uniform push_block { uint segment_count; uint shift; };

const uint SUBGROUPS_MAX = 8u;
const uint ITEMS_MAX = 16u;
shared uint counters[SUBGROUPS_MAX * RADIX];
shared uint steps_to_output[RADIX]; // what turns a place in the ordered block into one in the output, by digit
shared uint ordered_keys[WORKGROUP_THREADS * ITEMS];
shared uint ordered_values[WORKGROUP_THREADS * ITEMS];

// The lanes whose digit equals this lane's.
uvec2 lanes_with_same_digit(uint digit) {
    uvec2 lanes = subgroupBallot(true).xy;
    for (uint bit = 0u; bit < RADIX_BITS; ++bit) {
        bool set = (digit >> bit & 1u) != 0u;
        uvec2 ballot = subgroupBallot(set).xy;
        lanes &= set ? ballot : ~ballot;
    }
    return lanes;
}

uint count_bits(uvec2 lanes) {
    return bitCount(lanes.x) + bitCount(lanes.y);
}

uint lowest_bit(uvec2 lanes) {
    return lanes.x != 0u ? findLSB(lanes.x) : 32u + findLSB(lanes.y);
}

// The key's rank among the keys of its digit in the subgroup's run so far; advances the run's counter.
uint rank_in_run(uint digit) {
    uvec2 lanes = lanes_with_same_digit(digit);
    uint rank = count_bits(lanes & gl_SubgroupLtMask.xy);
    uint counter = gl_SubgroupID * RADIX + digit;
    uint earlier = 0u;
    if (rank == 0u) {
        earlier = counters[counter];
        counters[counter] = earlier + count_bits(lanes);
    }
    earlier = subgroupShuffle(earlier, lowest_bit(lanes));
    // The next step's leader of this digit may be another lane.
    subgroupMemoryBarrierShared();
    subgroupBarrier();
    return earlier + rank;
}

// Turns the counters into the places where each (subgroup, digit) begins in the ordered block.
void place_counters(SortSegment segment, uint segment_index, uint block, uint thread) {
    uint before = segment.first; // keys of lower digits, in the output
    uint local_before = 0u;      // in the block
    for (uint base = 0u; base < RADIX; base += WORKGROUP_THREADS) {
        uint digit = base + thread;
        bool real = digit < RADIX;
        uint count = 0u;
        for (uint subgroup = 0u; real && subgroup < gl_NumSubgroups; ++subgroup) {
            count += counters[subgroup * RADIX + digit];
        }
        uint total, local_total;
        uint place = before + block_exclusive_sum(real ? digit_totals[segment_index * RADIX + digit] : 0u, total);
        uint local = local_before + block_exclusive_sum(count, local_total);
        before += total;
        local_before += local_total;
        if (real) {
            steps_to_output[digit] = place + histograms[first_counter(segment, digit) + block] - local;
            for (uint subgroup = 0u; subgroup < gl_NumSubgroups; ++subgroup) {
                uint own = counters[subgroup * RADIX + digit];
                counters[subgroup * RADIX + digit] = local;
                local += own;
            }
        }
    }
}

void main() {
    uint group = group_index();
    uint segment_index = segment_of(group, segment_count);
    SortSegment segment = segments[segment_index];
    uint block = group - segment.first_block;
    if (block >= sort_blocks(segment.count)) {
        return;
    }
    uint thread = block_thread();
    for (uint counter = thread; counter < gl_NumSubgroups * RADIX; counter += WORKGROUP_THREADS) {
        counters[counter] = 0u;
    }
    barrier();

    uint first = block * WORKGROUP_THREADS * ITEMS + gl_SubgroupID * gl_SubgroupSize * ITEMS + gl_SubgroupInvocationID;
    uint keys[ITEMS_MAX];
    uint ranks[ITEMS_MAX];
    for (uint item = 0u; item < ITEMS; ++item) {
        uint index = first + item * gl_SubgroupSize;
        // Beyond the end: the highest digit, behind every key there is, never written.
        keys[item] = index < segment.count ? keys_in[segment.first + index] : 0xffffffffu;
        ranks[item] = rank_in_run(keys[item] >> shift & (RADIX - 1u));
    }
    barrier();
    place_counters(segment, segment_index, block, thread);
    barrier();
    for (uint item = 0u; item < ITEMS; ++item) {
        uint index = first + item * gl_SubgroupSize;
        if (index < segment.count) {
            uint place = counters[gl_SubgroupID * RADIX + (keys[item] >> shift & (RADIX - 1u))] + ranks[item];
            ordered_keys[place] = keys[item];
            ordered_values[place] = values_in[segment.first + index];
        }
    }
    barrier();
    uint block_keys = min(WORKGROUP_THREADS * ITEMS, segment.count - block * WORKGROUP_THREADS * ITEMS);
    for (uint place = gl_LocalInvocationIndex; place < block_keys; place += WORKGROUP_THREADS) {
        uint key = ordered_keys[place];
        uint output_place = place + steps_to_output[key >> shift & (RADIX - 1u)];
        keys_out[output_place] = key;
        values_out[output_place] = ordered_values[place];
    }
}
