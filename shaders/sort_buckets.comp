#version 460
// Radix sort, last digits: sorts buckets of pairs front to back, by depth key, and by record where
// keys are equal.
//
// One workgroup per bucket. The algorithm depends on the number of pairs:
// - Up to FEW_PAIRS: each thread counts the pairs that come before its own.
// - Up to SHARED_PAIRS: the pairs are distributed over bins in shared memory, as many bins as
//   pairs. A depth slab gets as many bins as it has pairs. Each thread then counts within the bin
//   of its pair, which holds few.
// - More, which is always a single slab: the pairs are distributed over bins of the slab in global
//   memory, and each chunk of bins is sorted in shared memory. Two fallbacks handle many pairs of
//   almost one depth: a bitonic sort (Batcher, Sorting Networks and Their Applications, 1968) if a
//   bin holds more than BIN_PAIRS_MAX, and a radix sort in global memory, four bits per pass, if a
//   bin does not fit shared memory.
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

layout(set = 0, binding = 0, scalar) readonly buffer required_block { RequiredCounts required; };
layout(set = 0, binding = 1, scalar) readonly buffer buckets_block { Bucket buckets[]; };
layout(set = 0, binding = 2, std430) coherent buffer pairs_block { uvec2 pairs[]; }; // depth key, record
layout(set = 0, binding = 3, scalar) coherent buffer other_keys_block { uint other_keys[]; };       // scratch of long buckets
layout(set = 0, binding = 4, scalar) coherent buffer sorted_records_block { uint sorted_records[]; }; // the result

layout(set = 0, binding = 5, scalar) readonly buffer cameras_block { Camera cameras[]; };
layout(set = 0, binding = 6, scalar) readonly buffer slab_counts_block { uint slab_ends[]; }; // [coarse tile][slab]

#include "camera_of_bin.glsl"

layout(constant_id = 0) const bool RADIAL = false; // keys are of distances instead of depths

layout(push_constant, scalar) uniform push_block { uint pairs_max; uint camera_count; };

const uint SHARED_PAIRS = 2048u; // a power of two
shared uint shared_words[2u * SHARED_PAIRS]; // keys and then records of pairs, or the counts of a radix pass
shared uint bins[SHARED_PAIRS]; // pairs of each bin, then where it ends
shared uint longest_bin;
shared uint differing_keys;
shared uint differing_records;

bool stands_before(uint key, uint record, uint other_key, uint other_record) {
    return key < other_key || (key == other_key && record < other_record);
}

// Pairs of a bin above which comparing all with all takes longer than the bitonic sort.
const uint BIN_PAIRS_MAX = 128u;

// The bin of a key in its bucket: a slab's pairs are spread over as many bins, by their offset in
// the slab.
uint bin_of(uint key, Bucket bucket, float camera_depth, float key_scale) {
    uvec2 slab = slab_and_offset(key, camera_depth, key_scale);
    uint at = bucket.bin * SLABS + slab.x;
    uint begin = slab.x == 0u ? bucket.first_pair : slab_ends[at - 1u];
    uint count = slab_ends[at] - begin; // at most SHARED_PAIRS: the product fits 32 bits
    return min(begin - bucket.first_pair + (slab.y * count >> SLAB_SHIFT), bucket.pairs - 1u);
}

// The bin of a key where the bucket is one slab, which has as many bins as there is room for.
uint bin_in_slab(uint key, float camera_depth, float key_scale) {
    return slab_and_offset(key, camera_depth, key_scale).y / ((1u << SLAB_SHIFT) / SHARED_PAIRS);
}

void empty_bins(uint count, uint thread) {
    for (uint bin = thread; bin < count; bin += WORKGROUP_THREADS) {
        bins[bin] = 0u;
    }
    if (thread == 0u) {
        longest_bin = 0u;
    }
    barrier();
}

// Sums the bins' counts up, so that each bin holds where it begins, and finds the longest.
void sum_bins(uint count, uint thread) {
    uint run = (count + WORKGROUP_THREADS - 1u) / WORKGROUP_THREADS;
    uint begin = min(thread * run, count);
    uint end = min(begin + run, count);
    uint own = 0u;
    uint longest = 0u;
    for (uint bin = begin; bin < end; ++bin) {
        own += bins[bin];
        longest = max(longest, bins[bin]);
    }
    atomicMax(longest_bin, longest);
    uint total;
    uint sum = block_exclusive_sum(own, total);
    for (uint bin = begin; bin < end; ++bin) {
        uint counted = bins[bin];
        bins[bin] = sum;
        sum += counted;
    }
    barrier();
}

// Sorts the pairs in shared memory, of which there are as many as the power of two `size`.
void sort_bitonic(uint size, uint thread) {
    for (uint run = 2u; run <= size; run *= 2u) {
        for (uint apart = run / 2u; apart > 0u; apart /= 2u) {
            barrier();
            for (uint pair = thread; pair < size / 2u; pair += WORKGROUP_THREADS) {
                uint low = pair / apart * 2u * apart + pair % apart;
                uint high = low + apart;
                bool rising = (low & run) == 0u;
                uint low_key = shared_words[low], high_key = shared_words[high];
                uint low_record = shared_words[SHARED_PAIRS + low], high_record = shared_words[SHARED_PAIRS + high];
                if (stands_before(high_key, high_record, low_key, low_record) == rising) {
                    shared_words[low] = high_key;
                    shared_words[high] = low_key;
                    shared_words[SHARED_PAIRS + low] = high_record;
                    shared_words[SHARED_PAIRS + high] = low_record;
                }
            }
        }
    }
    barrier();
}

// Pairs that are sorted fastest by comparing all with all.
const uint FEW_PAIRS = 64u;

// Sorts up to as many pairs as there are threads, without shared memory.
void sort_few(uint first, uint count, uint thread) {
    if (thread < count) {
        uvec2 own = pairs[first + thread];
        uint rank = 0u;
        for (uint index = 0u; index < count; ++index) {
            uvec2 other = pairs[first + index];
            rank += stands_before(other.x, other.y, own.x, own.y) ? 1u : 0u;
        }
        sorted_records[first + rank] = own.y;
    }
}

// Sorts the `count` pairs in shared memory, and writes their records from `first` on. They lie
// there by bin: bins of the slab where `slab_bins`, else bins of the bucket. The ends of bins count
// from `binned_first` elements before the first pair.
void finish_in_shared_memory(Bucket bucket, uint first, uint count, uint binned_first, bool slab_bins, float camera_depth, float key_scale, uint thread) {
    if (longest_bin > BIN_PAIRS_MAX) {
        uint size = 1u;
        while (size < count) {
            size *= 2u;
        }
        for (uint index = count + thread; index < size; index += WORKGROUP_THREADS) {
            shared_words[index] = 0xffffffffu;
            shared_words[SHARED_PAIRS + index] = 0xffffffffu;
        }
        sort_bitonic(size, thread);
        for (uint index = thread; index < count; index += WORKGROUP_THREADS) {
            sorted_records[first + index] = shared_words[SHARED_PAIRS + index];
        }
        return;
    }
    for (uint index = thread; index < count; index += WORKGROUP_THREADS) {
        uint key = shared_words[index];
        uint record = shared_words[SHARED_PAIRS + index];
        uint bin = slab_bins ? bin_in_slab(key, camera_depth, key_scale) : bin_of(key, bucket, camera_depth, key_scale);
        uint begin = (bin == 0u ? 0u : bins[bin - 1u]) - binned_first;
        uint end = bins[bin] - binned_first;
        uint rank = begin;
        for (uint other = begin; other < end; ++other) {
            rank += stands_before(shared_words[other], shared_words[SHARED_PAIRS + other], key, record) ? 1u : 0u;
        }
        sorted_records[first + rank] = record;
    }
}

// Sorts a bucket that fits shared memory.
void sort_in_shared_memory(Bucket bucket, float camera_depth, float key_scale, uint thread) {
    uint first = bucket.first_pair;
    uint count = bucket.pairs;
    empty_bins(count, thread);
    for (uint index = thread; index < count; index += WORKGROUP_THREADS) {
        atomicAdd(bins[bin_of(pairs[first + index].x, bucket, camera_depth, key_scale)], 1u);
    }
    barrier();
    sum_bins(count, thread);
    for (uint index = thread; index < count; index += WORKGROUP_THREADS) {
        uvec2 pair = pairs[first + index];
        uint target = atomicAdd(bins[bin_of(pair.x, bucket, camera_depth, key_scale)], 1u);
        shared_words[target] = pair.x;
        shared_words[SHARED_PAIRS + target] = pair.y;
    }
    barrier();
    finish_in_shared_memory(bucket, first, count, 0u, false, camera_depth, key_scale, thread);
}

const uint DIGIT_BITS = 4u;
const uint DIGITS = 1u << DIGIT_BITS;

// Entries that a thread moves per round of its loops. Software drivers end all loops of a thread
// after 65,535 rounds in total.
const uint MOVED = 8u;

uint key_at(bool there, uint index) {
    return there ? other_keys[index] : pairs[index].x;
}

uint record_at(bool there, uint index) {
    return there ? sorted_records[index] : pairs[index].y;
}

uint digit_of(uint key, uint record, uint shift, bool by_key) {
    return (by_key ? key : record) >> shift & (DIGITS - 1u);
}

// One stable pass of the radix sort, from one pair of buffers to the other. Each thread has a run
// of the bucket.
void pass_over_memory(uint first, uint count, uint thread, bool there, uint shift, bool by_key) {
    uint run = (count + WORKGROUP_THREADS - 1u) / WORKGROUP_THREADS;
    uint begin = min(thread * run, count);
    uint end = min(begin + run, count);
    // Counts lie by digit and then by thread: DIGITS * WORKGROUP_THREADS words.
    for (uint digit = 0u; digit < DIGITS; ++digit) {
        shared_words[digit * WORKGROUP_THREADS + thread] = 0u;
    }
    for (uint index = begin; index < end; index += MOVED) {
        [[unroll]] for (uint next = index; next < index + MOVED; ++next) {
            if (next < end) {
                uint at = digit_of(key_at(there, first + next), record_at(there, first + next), shift, by_key) * WORKGROUP_THREADS + thread;
                ++shared_words[at];
            }
        }
    }
    barrier();
    // Each thread sums a run of sixteen counts.
    uint first_count = thread * DIGITS;
    uint own = 0u;
    for (uint next = first_count; next < first_count + DIGITS; ++next) {
        own += shared_words[next];
    }
    uint total;
    uint sum = block_exclusive_sum(own, total);
    barrier();
    for (uint next = first_count; next < first_count + DIGITS; ++next) {
        uint counted = shared_words[next];
        shared_words[next] = sum;
        sum += counted;
    }
    barrier();
    for (uint index = begin; index < end; index += MOVED) {
        [[unroll]] for (uint next = index; next < index + MOVED; ++next) {
            if (next < end) {
                uint key = key_at(there, first + next);
                uint record = record_at(there, first + next);
                uint at = digit_of(key, record, shift, by_key) * WORKGROUP_THREADS + thread;
                uint target = first + shared_words[at]++;
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

// Sorts pairs of any number that lie in the first buffers, or where `there` in the others.
void sort_in_memory(uint first, uint count, uint thread, bool there) {
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
            keys_differ |= key_at(there, at) ^ key_at(there, first);
            records_differ |= record_at(there, at) ^ record_at(there, first);
        }
    }
    atomicOr(differing_keys, keys_differ);
    atomicOr(differing_records, records_differ);
    barrier();
    for (uint pass = 0u; pass < 64u / DIGIT_BITS; ++pass) {
        bool by_key = pass >= 32u / DIGIT_BITS;
        uint shift = pass % (32u / DIGIT_BITS) * DIGIT_BITS;
        if ((digit_of(differing_keys, differing_records, shift, by_key)) != 0u) {
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
}

// Pairs after which a chunk of bins ends with the next bin.
const uint CHUNK_PAIRS = SHARED_PAIRS / 2u;

// End of the first bin that ends at `pairs` or later.
uint bin_end_from(uint pairs) {
    uint low = 0u;
    [[unroll]] for (uint step = SHARED_PAIRS / 2u; step > 0u; step /= 2u) {
        low += bins[low + step - 1u] < pairs ? step : 0u;
    }
    return pairs == 0u ? 0u : bins[low];
}

// Sorts a bucket that is one slab and too long for shared memory.
void sort_slab(Bucket bucket, float camera_depth, float key_scale, uint thread) {
    uint first = bucket.first_pair;
    uint count = bucket.pairs;
    empty_bins(SHARED_PAIRS, thread);
    for (uint index = thread; index < count; index += WORKGROUP_THREADS) {
        atomicAdd(bins[bin_in_slab(pairs[first + index].x, camera_depth, key_scale)], 1u);
    }
    barrier();
    sum_bins(SHARED_PAIRS, thread);
    for (uint index = thread; index < count; index += WORKGROUP_THREADS) {
        uvec2 pair = pairs[first + index];
        uint target = first + atomicAdd(bins[bin_in_slab(pair.x, camera_depth, key_scale)], 1u);
        other_keys[target] = pair.x;
        sorted_records[target] = pair.y;
    }
    memoryBarrierBuffer();
    barrier();
    for (uint start = 0u; start < count; start += CHUNK_PAIRS) {
        uint begin = bin_end_from(start);
        uint end = bin_end_from(min(start + CHUNK_PAIRS, count));
        if (end - begin > SHARED_PAIRS) {
            sort_in_memory(first + begin, end - begin, thread, true);
            continue;
        }
        for (uint index = begin + thread; index < end; index += WORKGROUP_THREADS) {
            shared_words[index - begin] = other_keys[first + index];
            shared_words[SHARED_PAIRS + index - begin] = sorted_records[first + index];
        }
        barrier();
        finish_in_shared_memory(bucket, first + begin, end - begin, begin, true, camera_depth, key_scale, thread);
        barrier(); // shared memory is read to its end
    }
}

void main() {
    uint bucket_index = group_index();
    if (bucket_index >= required.buckets || wanted_pairs(required) > pairs_max) {
        return;
    }
    Bucket bucket = buckets[bucket_index];
    uint thread = block_thread();
    if (bucket.pairs <= FEW_PAIRS) {
        sort_few(bucket.first_pair, bucket.pairs, thread);
        return;
    }
    Camera camera = cameras[camera_of_bin(bucket.bin, camera_count)];
    float camera_depth = RADIAL ? 0.0 : camera.key_depth;
    if (bucket.pairs <= SHARED_PAIRS) {
        sort_in_shared_memory(bucket, camera_depth, camera.key_scale, thread);
    } else {
        sort_slab(bucket, camera_depth, camera.key_scale, thread);
    }
}
