#version 460
// Radix sort, last digits: sorts buckets of pairs front to back, by depth key, and by record where
// keys are equal.
//
// One workgroup per bucket, of up to SHARED_PAIRS pairs: longer ones were cut by split_slabs. Up to
// FEW_PAIRS, each thread counts the pairs that come before its own. More are distributed over bins
// in shared memory, as many bins as pairs: a depth slab gets as many bins as it has pairs, and a
// piece of a slab is spread from its least to its largest key. Each thread then counts within the
// bin of its pair, which holds few. Many pairs of almost one depth are sorted by a bitonic sort
// (Batcher, Sorting Networks and Their Applications, 1968), and more of them than SHARED_PAIRS by a
// radix sort in global memory, two bits per pass.
//
// Threads keep their pairs in registers, and bins and pairs lie in the same shared memory, one
// after the other: a device that gives an SM 48 KB of it holds five workgroups.
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
layout(set = 0, binding = 3, scalar) coherent buffer other_keys_block { uint other_keys[]; }; // of pieces of slabs
layout(set = 0, binding = 4, scalar) coherent buffer sorted_records_block { uint sorted_records[]; };  // of pieces before, the result behind

layout(set = 0, binding = 5, scalar) readonly buffer cameras_block { Camera cameras[]; };
layout(set = 0, binding = 6, scalar) readonly buffer slab_counts_block { uint slab_ends[]; }; // [coarse tile][slab]

#include "camera_of_bin.glsl"

layout(constant_id = 0) const bool RADIAL = false; // keys are of distances instead of depths

layout(push_constant, scalar) uniform push_block { uint pairs_max; uint camera_count; };

const uint OWN_PAIRS = SHARED_PAIRS / WORKGROUP_THREADS; // of a thread

shared uint shared_words[2u * SHARED_PAIRS]; // the bins' counts, then keys and behind them records of pairs
shared uint crowded; // 1 if a bin holds more than BIN_PAIRS_MAX
shared uint least_key;
shared uint largest_key;
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

// The bin of a key in a piece of a slab.
uint bin_in_piece(uint key, uint count) {
    float share = float(key - least_key) / (float(largest_key - least_key) + 1.0);
    return min(uint(share * float(count)), count - 1u);
}

// Sums the bins' counts up, so that each bin holds where it begins, and finds out whether one is
// crowded.
void sum_bins(uint count, uint thread) {
    uint first = thread * OWN_PAIRS;
    uint counted[OWN_PAIRS];
    uint own = 0u;
    uint longest = 0u;
    [[unroll]] for (uint next = 0u; next < OWN_PAIRS; ++next) {
        counted[next] = shared_words[first + next]; // zero behind the last bin
        own += counted[next];
        longest = max(longest, counted[next]);
    }
    if (longest > BIN_PAIRS_MAX) {
        crowded = 1u;
    }
    uint total;
    uint sum = block_exclusive_sum(own, total);
    [[unroll]] for (uint next = 0u; next < OWN_PAIRS; ++next) {
        shared_words[first + next] = sum;
        sum += counted[next];
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

// Sorts up to FEW_PAIRS pairs.
void sort_few(uint first, uint count, uint thread) {
    uvec2 own;
    if (thread < count) {
        own = pairs[first + thread];
        shared_words[thread] = own.x;
        shared_words[FEW_PAIRS + thread] = own.y;
    }
    barrier();
    if (thread < count) {
        uint rank = 0u;
        for (uint index = 0u; index < count; ++index) {
            rank += stands_before(shared_words[index], shared_words[FEW_PAIRS + index], own.x, own.y) ? 1u : 0u;
        }
        sorted_records[first + rank] = own.y;
    }
}

// Pairs that a thread moves per round of its loops. Software drivers end all loops of a thread
// after 65,535 rounds in total.
const uint MOVED = 8u;

const uint DIGIT_BITS = 2u;
const uint DIGITS = 1u << DIGIT_BITS;

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
        shared_words[digit * WORKGROUP_THREADS + thread] = 0u;
    }
    for (uint index = begin; index < end; index += MOVED) {
        [[unroll]] for (uint next = index; next < index + MOVED; ++next) {
            if (next < end) {
                uint digit = digit_of(key_at(there, first + next), record_at(there, first + next), shift, by_key);
                ++shared_words[digit * WORKGROUP_THREADS + thread];
            }
        }
    }
    barrier();
    uint counts[DIGITS];
    uint own = 0u;
    [[unroll]] for (uint next = 0u; next < DIGITS; ++next) {
        counts[next] = shared_words[thread * DIGITS + next];
        own += counts[next];
    }
    uint total;
    uint sum = block_exclusive_sum(own, total);
    [[unroll]] for (uint next = 0u; next < DIGITS; ++next) {
        shared_words[thread * DIGITS + next] = sum;
        sum += counts[next];
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

// Sorts a bucket in shared memory.
void sort_in_shared_memory(Bucket bucket, bool piece, float camera_depth, float key_scale, uint thread) {
    uint first = bucket.first_pair;
    uint count = bucket.pairs;
    uvec2 own[OWN_PAIRS];
    [[unroll]] for (uint next = 0u; next < OWN_PAIRS; ++next) {
        uint at = first + min(thread + next * WORKGROUP_THREADS, count - 1u); // reads without branches overlap
        own[next] = piece ? uvec2(other_keys[at], sorted_records[at]) : pairs[at];
    }
    [[unroll]] for (uint next = 0u; next < OWN_PAIRS; ++next) {
        shared_words[thread + next * WORKGROUP_THREADS] = 0u;
    }
    if (thread == 0u) {
        crowded = 0u;
        least_key = 0xffffffffu;
        largest_key = 0u;
    }
    barrier();
    if (piece) {
        uint least = own[0].x;
        uint largest = own[0].x;
        [[unroll]] for (uint next = 1u; next < OWN_PAIRS; ++next) {
            least = min(least, own[next].x);
            largest = max(largest, own[next].x);
        }
        least = subgroupMin(least);
        largest = subgroupMax(largest);
        if (subgroupElect()) {
            atomicMin(least_key, least);
            atomicMax(largest_key, largest);
        }
        barrier();
    }
    uint bins[OWN_PAIRS];
    uint ranks[OWN_PAIRS]; // in the bin
    [[unroll]] for (uint next = 0u; next < OWN_PAIRS; ++next) {
        bins[next] = piece ? bin_in_piece(own[next].x, count) : bin_of(own[next].x, bucket, camera_depth, key_scale);
    }
    [[unroll]] for (uint next = 0u; next < OWN_PAIRS; ++next) {
        if (thread + next * WORKGROUP_THREADS < count) {
            ranks[next] = atomicAdd(shared_words[bins[next]], 1u);
        }
    }
    barrier();
    sum_bins(count, thread);
    uint begins[OWN_PAIRS];
    uint ends[OWN_PAIRS];
    [[unroll]] for (uint next = 0u; next < OWN_PAIRS; ++next) {
        begins[next] = shared_words[bins[next]];
        ends[next] = bins[next] + 1u < count ? shared_words[bins[next] + 1u] : count;
    }
    barrier(); // the bins are read
    [[unroll]] for (uint next = 0u; next < OWN_PAIRS; ++next) {
        if (thread + next * WORKGROUP_THREADS < count) {
            uint target = begins[next] + ranks[next];
            shared_words[target] = own[next].x;
            shared_words[SHARED_PAIRS + target] = own[next].y;
        }
    }
    bool sort_all = crowded != 0u;
    barrier();
    if (sort_all) {
        uint size = 1u;
        while (size < count) {
            size *= 2u;
        }
        for (uint index = count + thread; index < size; index += WORKGROUP_THREADS) {
            shared_words[index] = 0xffffffffu;
            shared_words[SHARED_PAIRS + index] = 0xffffffffu;
        }
        sort_bitonic(size, thread);
    } else {
        [[unroll]] for (uint next = 0u; next < OWN_PAIRS; ++next) {
            uint rank = begins[next];
            if (ends[next] > rank + 1u && thread + next * WORKGROUP_THREADS < count) {
                for (uint other = begins[next]; other < ends[next]; ++other) {
                    rank += stands_before(shared_words[other], shared_words[SHARED_PAIRS + other], own[next].x, own[next].y) ? 1u : 0u;
                }
            }
            ranks[next] = rank;
        }
        barrier(); // the records are read
        [[unroll]] for (uint next = 0u; next < OWN_PAIRS; ++next) {
            if (thread + next * WORKGROUP_THREADS < count) {
                shared_words[SHARED_PAIRS + ranks[next]] = own[next].y;
            }
        }
        barrier();
    }
    for (uint index = thread; index < count; index += WORKGROUP_THREADS) {
        sorted_records[first + index] = shared_words[SHARED_PAIRS + index]; // neighbors are written together
    }
}

void main() {
    uint bucket_index = group_index();
    if (bucket_index >= required.buckets || wanted_pairs(required) > pairs_max) {
        return;
    }
    Bucket bucket = buckets[bucket_index];
    uint thread = block_thread();
    bool piece = bucket.bin == NO_BIN;
    if (bucket.pairs <= FEW_PAIRS && !piece) {
        sort_few(bucket.first_pair, bucket.pairs, thread);
    } else if (bucket.pairs <= SHARED_PAIRS) {
        Camera camera = cameras[camera_of_bin(piece ? 0u : bucket.bin, camera_count)];
        sort_in_shared_memory(bucket, piece, RADIAL ? 0.0 : camera.key_depth, camera.key_scale, thread);
    } else if (piece) {
        sort_in_memory(bucket.first_pair, bucket.pairs, thread);
    }
}
