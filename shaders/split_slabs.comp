#version 460
// Radix sort, between the depth slabs and the last digits: cuts slabs that are too long for
// sort_buckets into pieces that are not.
//
// One workgroup per slab. Its pairs are distributed over SLAB_BINS bins by their offset in the
// slab, into the other buffers, and runs of bins become buckets. A bin that is too long by itself,
// which is many pairs of almost one depth, is sorted here: a radix sort in global memory, two bits
// per pass.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#include "frame.glsl"
#include "double_float.glsl"
#include "depth_key.glsl"
#include "depth_slab.glsl"

// As many as the device allows, up to SLAB_BINS: a long slab is the work of one workgroup.
layout(constant_id = 1) const uint WORKGROUP_THREADS = 256u; // a power of two
layout(local_size_x_id = 1) in;
#include "block.glsl"

layout(set = 0, binding = 0, scalar) buffer required_block { RequiredCounts required; };
layout(set = 0, binding = 1, scalar) buffer buckets_block { Bucket buckets[]; };
layout(set = 0, binding = 2, std430) coherent buffer pairs_block { uvec2 pairs[]; }; // depth key, record
layout(set = 0, binding = 3, scalar) coherent buffer other_keys_block { uint other_keys[]; };
layout(set = 0, binding = 4, scalar) coherent buffer sorted_records_block { uint sorted_records[]; };

layout(set = 0, binding = 5, scalar) readonly buffer cameras_block { Camera cameras[]; };

#include "camera_of_bin.glsl"

layout(constant_id = 0) const bool RADIAL = false; // keys are of distances instead of depths

layout(push_constant, scalar) uniform push_block { uint pairs_max; uint buckets_max; uint camera_count; };

const uint SLAB_BINS = 1024u;
const uint OWN_BINS = SLAB_BINS / WORKGROUP_THREADS; // of a thread

// Pairs that a thread moves per round of its loops: their reads overlap. Software drivers end all
// loops of a thread after 65,535 rounds in total.
const uint MOVED = 8u;

const uint DIGIT_BITS = 2u;
const uint DIGITS = 1u << DIGIT_BITS;

shared uint bins[SLAB_BINS]; // pairs of each bin, then where it ends
shared uint digit_places[DIGITS * WORKGROUP_THREADS]; // counts of a radix pass, by digit and thread
shared uint differing_keys;
shared uint differing_records;
shared uint overfull; // 1 if a run of bins does not fit a bucket

// The bin of a key in its slab.
uint bin_of(uint key, float camera_depth, float key_scale) {
    return slab_and_offset(key, camera_depth, key_scale).y / ((1u << SLAB_SHIFT) / SLAB_BINS);
}

uint key_at(bool there, uint index) {
    return there ? other_keys[index] : pairs[index].x;
}

uint record_at(bool there, uint index) {
    return there ? sorted_records[index] : pairs[index].y;
}

uint digit_of(uint key, uint record, uint shift, bool by_key) {
    return (by_key ? key : record) >> shift & (DIGITS - 1u);
}

// One pass of a stable radix sort in global memory, from the first buffers to the others, or where
// `there` back. Each thread takes a run of pairs.
void pass_over_memory(uint first, uint count, uint thread, bool there, uint shift, bool by_key) {
    uint run = (count + WORKGROUP_THREADS - 1u) / WORKGROUP_THREADS;
    uint begin = min(thread * run, count);
    uint end = min(begin + run, count);
    for (uint digit = 0u; digit < DIGITS; ++digit) {
        digit_places[digit * WORKGROUP_THREADS + thread] = 0u;
    }
    for (uint index = begin; index < end; index += MOVED) {
        [[unroll]] for (uint next = index; next < index + MOVED; ++next) {
            if (next < end) {
                uint digit = digit_of(key_at(there, first + next), record_at(there, first + next), shift, by_key);
                ++digit_places[digit * WORKGROUP_THREADS + thread];
            }
        }
    }
    barrier();
    uint counts[DIGITS];
    uint own = 0u;
    [[unroll]] for (uint next = 0u; next < DIGITS; ++next) {
        counts[next] = digit_places[thread * DIGITS + next];
        own += counts[next];
    }
    uint total;
    uint sum = block_exclusive_sum(own, total);
    [[unroll]] for (uint next = 0u; next < DIGITS; ++next) {
        digit_places[thread * DIGITS + next] = sum;
        sum += counts[next];
    }
    barrier();
    for (uint index = begin; index < end; index += MOVED) {
        [[unroll]] for (uint next = index; next < index + MOVED; ++next) {
            if (next < end) {
                uint key = key_at(there, first + next);
                uint record = record_at(there, first + next);
                uint at = digit_of(key, record, shift, by_key) * WORKGROUP_THREADS + thread;
                uint target = first + digit_places[at]++;
                if (there) {
                    pairs[target] = uvec2(key, record);
                } else {
                    other_keys[target] = key;
                    sorted_records[target] = record;
                }
            }
        }
    }
    memoryBarrierBuffer();
    barrier();
}

// Sorts pairs of any number that lie in the other buffers.
void sort_in_memory(uint first, uint count, uint thread) {
    if (thread == 0u) {
        differing_keys = 0u;
        differing_records = 0u;
    }
    barrier();
    uint keys_differ = 0u;
    uint records_differ = 0u;
    for (uint index = thread; index < count; index += MOVED * WORKGROUP_THREADS) {
        [[unroll]] for (uint next = 0u; next < MOVED; ++next) {
            uint at = first + min(index + next * WORKGROUP_THREADS, count - 1u);
            keys_differ |= other_keys[at] ^ other_keys[first];
            records_differ |= sorted_records[at] ^ sorted_records[first];
        }
    }
    atomicOr(differing_keys, keys_differ);
    atomicOr(differing_records, records_differ);
    barrier();
    bool there = true;
    for (uint pass = 0u; pass < 64u / DIGIT_BITS; ++pass) {
        bool by_key = pass >= 32u / DIGIT_BITS;
        uint shift = pass % (32u / DIGIT_BITS) * DIGIT_BITS;
        if (digit_of(differing_keys, differing_records, shift, by_key) != 0u) {
            pass_over_memory(first, count, thread, there, shift, by_key);
            there = !there;
        }
    }
    if (!there) {
        for (uint index = thread; index < count; index += MOVED * WORKGROUP_THREADS) {
            [[unroll]] for (uint next = 0u; next < MOVED; ++next) {
                uint at = index + next * WORKGROUP_THREADS;
                if (at < count) {
                    sorted_records[first + at] = pairs[first + at].y;
                }
            }
        }
    }
    barrier(); // digit places and differences are read to their end
}

// Sums the bins' counts up, so that each bin holds where it begins.
void sum_bins(uint thread) {
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
    uint first = slab.first_pair;
    uint count = slab.pairs;
    [[unroll]] for (uint next = 0u; next < OWN_BINS; ++next) {
        bins[thread * OWN_BINS + next] = 0u;
    }
    if (thread == 0u) {
        overfull = 0u;
    }
    barrier();
    for (uint index = thread; index < count; index += MOVED * WORKGROUP_THREADS) {
        uint keys[MOVED];
        [[unroll]] for (uint next = 0u; next < MOVED; ++next) {
            keys[next] = pairs[first + min(index + next * WORKGROUP_THREADS, count - 1u)].x;
        }
        [[unroll]] for (uint next = 0u; next < MOVED; ++next) {
            if (index + next * WORKGROUP_THREADS < count) {
                atomicAdd(bins[bin_of(keys[next], camera_depth, camera.key_scale)], 1u);
            }
        }
    }
    barrier();
    sum_bins(thread);
    for (uint index = thread; index < count; index += MOVED * WORKGROUP_THREADS) {
        uvec2 moved[MOVED];
        [[unroll]] for (uint next = 0u; next < MOVED; ++next) {
            moved[next] = pairs[first + min(index + next * WORKGROUP_THREADS, count - 1u)];
        }
        [[unroll]] for (uint next = 0u; next < MOVED; ++next) {
            if (index + next * WORKGROUP_THREADS < count) {
                uint target = first + atomicAdd(bins[bin_of(moved[next].x, camera_depth, camera.key_scale)], 1u);
                other_keys[target] = moved[next].x;
                sorted_records[target] = moved[next].y;
            }
        }
    }
    memoryBarrierBuffer();
    barrier();
    uint pieces = (count + BUCKET_PAIRS - 1u) / BUCKET_PAIRS;
    for (uint piece = thread; piece < pieces; piece += WORKGROUP_THREADS) {
        uint begin = bin_end_from(piece * BUCKET_PAIRS);
        uint end = bin_end_from(min((piece + 1u) * BUCKET_PAIRS, count));
        if (end - begin > SHARED_PAIRS) {
            overfull = 1u;
        } else if (end > begin) {
            uint bucket = atomicAdd(required.buckets, 1u);
            if (bucket + required.long_slabs < buckets_max) {
                buckets[bucket] = Bucket(first + begin, end - begin, NO_BIN);
            }
        }
    }
    barrier();
    if (overfull == 0u) {
        return;
    }
    for (uint piece = 0u; piece < pieces; ++piece) {
        uint begin = bin_end_from(piece * BUCKET_PAIRS);
        uint end = bin_end_from(min((piece + 1u) * BUCKET_PAIRS, count));
        if (end - begin > SHARED_PAIRS) {
            sort_in_memory(first + begin, end - begin, thread);
        }
    }
}
