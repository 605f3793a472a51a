#version 460
// Gives each coarse tile a stretch of the pair buffer and cuts it into buckets, which are sorted
// one by one.
//
// One workgroup per coarse tile. The position of a tile's stretch depends on the order in which
// workgroups run; its content does not. A bucket is a run of neighboring depth slabs. It ends with
// the slab in which the running count of pairs passes a multiple of BUCKET_PAIRS. A slab of
// BUCKET_PAIRS or more is a bucket by itself. So a bucket has fewer than twice BUCKET_PAIRS pairs,
// or is one slab. It may be empty. Slabs of more than SHARED_PAIRS pairs are listed from the end of
// the list of buckets: split_slabs cuts them into pieces, and these become buckets.
//
// The workgroup that is done last knows how many workgroups the sort needs.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#include "frame.glsl"
#include "double_float.glsl"
#include "depth_key.glsl"
#include "depth_slab.glsl"

const uint WORKGROUP_THREADS = 256u;
layout(local_size_x = 256) in;
#include "block.glsl"

layout(set = 0, binding = 0, scalar) buffer required_block { RequiredCounts required; };
// Pairs, then the first pair, of four slabs each.
layout(set = 0, binding = 1, std430) buffer slab_counts_block { uvec4 slab_counts[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer tile_lists_block { uvec2 tile_lists[]; }; // first pair and length
layout(set = 0, binding = 3, scalar) writeonly buffer buckets_block { Bucket buckets[]; };
layout(set = 0, binding = 4, scalar) writeonly buffer arguments_block { uvec3 arguments[]; };

layout(push_constant, scalar) uniform push_block { uint bin_count; uint buckets_max; uint pairs_max; uint records_max; };

const uint SLABS_PER_THREAD = SLABS / WORKGROUP_THREADS; // four, a uvec4

shared uint first_pair;
shared uint first_bucket;

// Buckets that end where a slab begins or ends.
uint ends_at(uint index, uint count) {
    uint by_itself = count >= BUCKET_PAIRS ? 1u : 0u;
    return by_itself + (index / BUCKET_PAIRS != (index + count) / BUCKET_PAIRS ? 1u : 0u);
}

shared uint subgroup_largest[WORKGROUP_THREADS / 4u];

// The largest `value` of the threads before this one, or 0; `largest` is that of all. Every thread
// of the workgroup calls it, once.
uint block_exclusive_max(uint value, out uint largest) {
    uint before = subgroupExclusiveMax(value);
    uint own = subgroupMax(value);
    if (subgroupElect()) {
        subgroup_largest[gl_SubgroupID] = own;
    }
    barrier();
    largest = 0u;
    for (uint subgroup = 0u; subgroup < gl_NumSubgroups; ++subgroup) {
        before = subgroup < gl_SubgroupID ? max(before, subgroup_largest[subgroup]) : before;
        largest = max(largest, subgroup_largest[subgroup]);
    }
    return before;
}

// Lists the bucket `bucket` of a coarse tile, from `begin` to before `end` of the tile's pairs.
void list_bucket(uint bin, uint bucket, uint begin, uint end) {
    uint pairs = end - begin;
    if (pairs > SHARED_PAIRS) {
        uint parts = slab_parts(pairs);
        uint from_end = atomicAdd(required.long_slabs, parts);
        atomicAdd(required.pieces, pairs / BUCKET_PAIRS + parts);
        for (uint part = 0u; part < parts && from_end + part < buckets_max; ++part) {
            buckets[buckets_max - 1u - from_end - part] = Bucket(first_pair + begin, pairs, bin, part);
        }
        pairs = 0u;
    }
    if (first_bucket + bucket < buckets_max) {
        buckets[first_bucket + bucket] = Bucket(first_pair + begin, pairs, bin, 0u);
    }
}

// The dispatches of fill_pairs and the sort, once all coarse tiles are planned. Counts are read as
// they were added up, by atomics.
void plan_sort() {
    RequiredCounts found;
    found.pairs_low = atomicAdd(required.pairs_low, 0u);
    found.pairs_high = atomicAdd(required.pairs_high, 0u);
    bool fits = wanted_pairs(found) <= pairs_max;
    uint long_slabs = atomicAdd(required.long_slabs, 0u);
    uint buckets = atomicAdd(required.buckets, 0u) + atomicAdd(required.pieces, 0u);
    uint records = binned_records(required.records, required.first_binned, records_max);
    uint blocks = (records + PAIR_BLOCK - 1u) / PAIR_BLOCK + (required.large + LARGE_BLOCK - 1u) / LARGE_BLOCK;
    arguments[ARGUMENTS_FILL] = groups_for(fits ? blocks : 0u);
    arguments[ARGUMENTS_SPLIT] = groups_for(fits ? long_slabs : 0u);
    arguments[ARGUMENTS_SORT] = groups_for(fits ? buckets : 0u);
}

void main() {
    uint bin = group_index();
    if (bin >= bin_count) {
        return;
    }
    uint thread = block_thread();
    uint first_word = (bin * SLABS + thread * SLABS_PER_THREAD) / 4u;
    uvec4 counts = slab_counts[first_word];
    uint own = counts.x + counts.y + counts.z + counts.w;
    uint total;
    uint before = block_exclusive_sum(own, total);
    uint own_ends = 0u;
    uint last_end = 0u;
    uint index = before;
    [[unroll]] for (uint slab = 0u; slab < SLABS_PER_THREAD; ++slab) {
        uint end_count = ends_at(index, counts[slab]);
        own_ends += end_count;
        index += counts[slab];
        last_end = end_count > 0u ? index : last_end;
    }
    uint end_total;
    uint bucket = block_exclusive_sum(own_ends, end_total);
    uint all_last_end;
    uint begin = block_exclusive_max(last_end, all_last_end);
    if (thread == 0u) {
        first_pair = atomicAdd(required.pairs, total);
        atomicAdd(required.pairs_low, total & 0xffffu);
        atomicAdd(required.pairs_high, total >> 16u);
        first_bucket = atomicAdd(required.buckets, end_total + (total > all_last_end ? 1u : 0u));
        tile_lists[bin] = uvec2(first_pair, total);
    }
    barrier();
    index = before;
    [[unroll]] for (uint slab = 0u; slab < SLABS_PER_THREAD; ++slab) {
        uint count = counts[slab];
        uint end_count = ends_at(index, count);
        if (end_count == 2u) {
            list_bucket(bin, bucket++, begin, index);
            begin = index;
        }
        counts[slab] = first_pair + index;
        index += count;
        if (end_count > 0u) {
            list_bucket(bin, bucket++, begin, index);
            begin = index;
        }
    }
    slab_counts[first_word] = counts;
    if (thread == WORKGROUP_THREADS - 1u && total > begin) {
        list_bucket(bin, bucket, begin, total);
    }
    memoryBarrierBuffer(); // the atomics of all threads
    barrier();
    if (thread == 0u && atomicAdd(required.planned, 1u) == bin_count - 1u) {
        memoryBarrierBuffer();
        plan_sort();
    }
}
