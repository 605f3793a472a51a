#version 460
// Tile binning, second run: writes the (coarse tile, record) pairs to the stretches that
// plan_buckets gave to each coarse tile and depth slab.
//
// The order within a stretch is that of the atomics: sort_buckets makes it one order. The first
// workgroups take the large records, whose rows of coarse tiles are shared out over their threads;
// the others take the records whose reach is a word. Of those, the workgroup asks for the places of
// all pairs in one slab at once.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#include "frame.glsl"
#include "footprint.glsl"
#include "color_code.glsl"
#include "mean_px.glsl"
#include "record.glsl"
#include "double_float.glsl"
#include "depth_key.glsl"
#include "depth_slab.glsl"

const uint WORKGROUP_THREADS = PAIR_BLOCK;
layout(local_size_x = 256) in;
#include "block.glsl"

layout(set = 0, binding = 0, scalar) readonly buffer cameras_block { Camera cameras[]; };
layout(set = 0, binding = 1, scalar) readonly buffer required_block { RequiredCounts required; };
layout(set = 0, binding = 2, scalar) readonly buffer lists_block { ViewLists lists[]; };
layout(set = 0, binding = 3, scalar) readonly buffer keys_block { uint keys[]; };
layout(set = 0, binding = 4, std430) readonly buffer footprints_block { uvec4 footprints[]; };
layout(set = 0, binding = 5, scalar) buffer slab_counts_block { uint slab_counts[]; }; // [coarse tile][slab], the next index
layout(set = 0, binding = 6, scalar) readonly buffer reaches_block { uint reaches[]; };
layout(set = 0, binding = 7, scalar) readonly buffer large_records_block { uint large_records[]; };
layout(set = 0, binding = 8, std430) writeonly buffer pairs_block { uvec2 pairs[]; }; // depth key, record

layout(push_constant, scalar) uniform push_block {
    uint camera_count;
    uint records_max;
    uint pairs_max;
};

#include "bin_records.glsl"
#include "slab_hash.glsl"

// Pairs whose places are asked for before the first is written, so that the answers overlap.
const uint AHEAD = 4u;

shared uint shared_records[LARGE_BLOCK];
shared uint shared_rows_before[LARGE_BLOCK];

// The last record of the workgroup before which there are no more than `row` rows.
uint giver_of(uint row) {
    uint giver = 0u;
    [[unroll]] for (uint step = LARGE_BLOCK / 2u; step > 0u; step /= 2u) {
        giver += shared_rows_before[giver + step] <= row ? step : 0u;
    }
    return giver;
}

void write_pair(uint index, uint key, uint record) {
    if (index < pairs_max) {
        pairs[index] = uvec2(key, record); // one write: neighbors are written far apart
    }
}

void fill_large(uint first, uint end, uint thread) {
    uint own = first + thread;
    bool real = thread < LARGE_BLOCK && own < end;
    uint own_record = real ? large_records[own] : 0u;
    uint row_count = 0u;
    if (real) {
        Camera camera = cameras[camera_of(own_record)];
        ivec2 rows = rows_of(load_footprint(own_record, camera), camera);
        row_count = uint(rows.y - rows.x + 1);
    }
    uint row_total;
    uint rows_before = block_exclusive_sum(row_count, row_total);
    if (thread < LARGE_BLOCK) {
        shared_records[thread] = own_record;
        shared_rows_before[thread] = rows_before;
    }
    barrier();
    for (uint given = thread; given < row_total; given += WORKGROUP_THREADS) {
        uint giver = giver_of(given);
        uint record = shared_records[giver];
        Camera camera = cameras[camera_of(record)];
        Footprint splat = load_footprint(record, camera);
        uint key = keys[record];
        uint row = uint(rows_of(splat, camera).x) + given - shared_rows_before[giver];
        ivec2 tiles = tiles_of(splat, camera, row);
        uint at = (camera.first_bin + row * camera.coarse_tiles.x) * SLABS + slab_of(key, camera);
        for (int tile = tiles.x; tile <= tiles.y; tile += int(AHEAD)) {
            uint places[AHEAD];
            [[unroll]] for (int next = 0; next < int(AHEAD); ++next) {
                if (tile + next <= tiles.y) {
                    places[next] = atomicAdd(slab_counts[at + uint(tile + next) * SLABS], 1u);
                }
            }
            [[unroll]] for (int next = 0; next < int(AHEAD); ++next) {
                if (tile + next <= tiles.y) {
                    write_pair(places[next], key, record);
                }
            }
        }
    }
}

// Pairs of a record whose places are asked for by the workgroup; those of more coarse tiles are
// asked for by the thread.
const uint TOGETHER = 2u;

// Place of a pair among those of the workgroup in its slot: the slot, and above it the rank.
const uint NO_TICKET = 0xffffffffu;

// The slab of the pair `pair` of a reach, as an index in slab_counts.
uint slab_of_pair(uint reach, uint pair, uint columns, uint slab) {
    uint second = reach_tiles(reach, 0u);
    uint third = second + reach_tiles(reach, 1u);
    uint bin = pair < second ? reach_bin(reach, 0u, columns) + pair
        : pair < third ? reach_bin(reach, 1u, columns) + pair - second
        : reach_bin(reach, 2u, columns) + pair - third;
    return bin * SLABS + slab;
}

// Writes the pairs of the thread's record, if there is one. Every thread calls it.
void fill_few(uint record, bool real, uint thread) {
    empty_hash(thread);
    barrier();
    uint reach = real ? reaches[record] : 0u;
    bool few = (reach & REACH_LARGE) == 0u;
    uint count = few ? reach_tiles(reach, 0u) + reach_tiles(reach, 1u) + reach_tiles(reach, 2u) : 0u;
    uint key = real ? keys[record] : 0u;
    uint tickets[TOGETHER];
    [[unroll]] for (uint pair = 0u; pair < TOGETHER; ++pair) {
        tickets[pair] = NO_TICKET;
    }
    if (count > 0u) {
        Camera camera = cameras[camera_of(record)];
        uint slab = slab_of(key, camera);
        uint columns = camera.coarse_tiles.x;
        [[unroll]] for (uint pair = 0u; pair < TOGETHER; ++pair) {
            if (pair < count) {
                uint at = slab_of_pair(reach, pair, columns, slab);
                uint slot = slot_of(at);
                if (slot == NO_SLOT) {
                    write_pair(atomicAdd(slab_counts[at], 1u), key, record);
                } else {
                    tickets[pair] = atomicAdd(hash_counts[slot], 1u) << HASH_BITS | slot;
                }
            }
        }
        for (uint pair = TOGETHER; pair < count; ++pair) {
            write_pair(atomicAdd(slab_counts[slab_of_pair(reach, pair, columns, slab)], 1u), key, record);
        }
    }
    barrier();
    if (hash_counts[thread] > 0u) {
        hash_counts[thread] = atomicAdd(slab_counts[hash_slabs[thread]], hash_counts[thread]);
    }
    barrier();
    [[unroll]] for (uint pair = 0u; pair < TOGETHER; ++pair) {
        if (tickets[pair] != NO_TICKET) {
            write_pair(hash_counts[tickets[pair] & (HASH_SLOTS - 1u)] + (tickets[pair] >> HASH_BITS), key, record);
        }
    }
}

void main() {
    if (wanted_pairs(required) > pairs_max) {
        return; // the need is known: the host grows the buffer and draws again
    }
    uint thread = block_thread();
    uint large = required.large;
    uint large_groups = (large + LARGE_BLOCK - 1u) / LARGE_BLOCK;
    uint group = group_index();
    if (group < large_groups) {
        fill_large(group * LARGE_BLOCK, large, thread);
        return;
    }
    uint record = required.first_binned + (group - large_groups) * PAIR_BLOCK + thread;
    fill_few(record, record < held(required.records, records_max), thread);
}
