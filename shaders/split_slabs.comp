#version 460
// Radix sort, between the depth slabs and the last digits: cuts slabs that are too long for
// sort_buckets into pieces that are not.
//
// Pairs are distributed over SLAB_BINS bins by their offset in the slab, into the other buffers,
// and runs of bins become buckets. Several workgroups share a slab of very many pairs, a range of
// bins each: reading all of them is cheap, and writing them far apart is not.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#include "frame.glsl"
#include "double_float.glsl"
#include "depth_key.glsl"
#include "depth_slab.glsl"

// A power of two, up to SLAB_BINS.
layout(constant_id = 1) const uint WORKGROUP_THREADS = 256u;
layout(local_size_x_id = 1) in;
#include "block.glsl"

layout(set = 0, binding = 0, scalar) buffer required_block { RequiredCounts required; };
layout(set = 0, binding = 1, scalar) buffer buckets_block { Bucket buckets[]; };
layout(set = 0, binding = 2, std430) readonly buffer pairs_block { uvec2 pairs[]; }; // depth key, record
layout(set = 0, binding = 3, scalar) writeonly buffer other_keys_block { uint other_keys[]; };
layout(set = 0, binding = 4, scalar) writeonly buffer sorted_records_block { uint sorted_records[]; };

layout(set = 0, binding = 5, scalar) readonly buffer cameras_block { Camera cameras[]; };

#include "camera_of_bin.glsl"

layout(constant_id = 0) const bool RADIAL = false; // keys are of distances instead of depths

layout(push_constant, scalar) uniform push_block { uint pairs_max; uint buckets_max; uint camera_count; };

const uint SLAB_BINS = 1024u;
const uint OWN_BINS = SLAB_BINS / WORKGROUP_THREADS; // of a thread

// Pairs that a thread moves per round of its loops: their reads overlap. Software drivers end all
// loops of a thread after 65,535 rounds in total.
const uint MOVED = 8u;

shared uint bins[SLAB_BINS]; // pairs of each bin, then where it ends

// The bin of a key in its slab.
uint bin_of(uint key, float camera_depth, float key_scale) {
    return slab_and_offset(key, camera_depth, key_scale).y / ((1u << SLAB_SHIFT) / SLAB_BINS);
}

// Sums the bins' counts up, so that each bin holds where it begins; returns their sum.
uint sum_bins(uint thread) {
    uint counted[OWN_BINS];
    uint own = 0u;
    [[unroll]] for (uint next = 0u; next < OWN_BINS; ++next) {
        counted[next] = bins[thread * OWN_BINS + next];
        own += counted[next];
    }
    uint total;
    uint sum = block_exclusive_sum(own, total);
    [[unroll]] for (uint next = 0u; next < OWN_BINS; ++next) {
        bins[thread * OWN_BINS + next] = sum;
        sum += counted[next];
    }
    barrier();
    return total;
}

// End of the first bin that ends at `pairs` or later.
uint bin_end_from(uint pairs) {
    uint low = 0u;
    [[unroll]] for (uint step = SLAB_BINS / 2u; step > 0u; step /= 2u) {
        low += bins[low + step - 1u] < pairs ? step : 0u;
    }
    return pairs == 0u ? 0u : bins[low];
}

void main() {
    uint slab_index = group_index();
    if (slab_index >= required.long_slabs || wanted_pairs(required) > pairs_max || slab_index >= buckets_max) {
        return;
    }
    // From the end of the list: see plan_buckets.
    Bucket slab = buckets[buckets_max - 1u - slab_index];
    uint thread = block_thread();
    Camera camera = cameras[camera_of_bin(slab.bin, camera_count)];
    float camera_depth = RADIAL ? 0.0 : camera.key_depth;
    uint slab_first = slab.first_pair;
    uint slab_count = slab.pairs;
    uint range = SLAB_BINS / slab_parts(slab_count);
    uint first_bin = slab.part * range;
    [[unroll]] for (uint next = 0u; next < OWN_BINS; ++next) {
        bins[thread * OWN_BINS + next] = 0u;
    }
    barrier();
    uint below = 0u; // pairs of the bins before
    for (uint index = thread; index < slab_count; index += MOVED * WORKGROUP_THREADS) {
        uint keys[MOVED];
        [[unroll]] for (uint next = 0u; next < MOVED; ++next) {
            keys[next] = pairs[slab_first + min(index + next * WORKGROUP_THREADS, slab_count - 1u)].x;
        }
        [[unroll]] for (uint next = 0u; next < MOVED; ++next) {
            uint bin = bin_of(keys[next], camera_depth, camera.key_scale);
            bool real = index + next * WORKGROUP_THREADS < slab_count;
            below += real && bin < first_bin ? 1u : 0u;
            if (real && bin - first_bin < range) {
                atomicAdd(bins[bin - first_bin], 1u);
            }
        }
    }
    uint first = slab_first + block_sum(below); // waits for all threads
    uint count = sum_bins(thread);
    for (uint index = thread; index < slab_count; index += MOVED * WORKGROUP_THREADS) {
        uvec2 moved[MOVED];
        [[unroll]] for (uint next = 0u; next < MOVED; ++next) {
            moved[next] = pairs[slab_first + min(index + next * WORKGROUP_THREADS, slab_count - 1u)];
        }
        [[unroll]] for (uint next = 0u; next < MOVED; ++next) {
            uint bin = bin_of(moved[next].x, camera_depth, camera.key_scale) - first_bin;
            if (index + next * WORKGROUP_THREADS < slab_count && bin < range) {
                uint target = first + atomicAdd(bins[bin], 1u);
                other_keys[target] = moved[next].x;
                sorted_records[target] = moved[next].y;
            }
        }
    }
    barrier();
    uint pieces = (count + BUCKET_PAIRS - 1u) / BUCKET_PAIRS;
    for (uint piece = thread; piece < pieces; piece += WORKGROUP_THREADS) {
        uint begin = bin_end_from(piece * BUCKET_PAIRS);
        uint end = bin_end_from(min((piece + 1u) * BUCKET_PAIRS, count));
        if (end > begin) {
            uint bucket = atomicAdd(required.buckets, 1u);
            if (bucket + required.long_slabs < buckets_max) {
                buckets[bucket] = Bucket(first + begin, end - begin, NO_BIN, 0u);
            }
        }
    }
}
