#version 460
// Tile binning, second run: writes the (coarse tile, record) pairs to the stretches that
// plan_buckets gave to each coarse tile and depth slab.
//
// The order within a stretch is that of the atomics: sort_buckets makes it one order. The first
// workgroups take the large records, whose rows of coarse tiles are shared out over their threads;
// the others take the records whose reach is a word.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#include "frame.glsl"
#include "footprint.glsl"
#include "color_code.glsl"
#include "record.glsl"
#include "double_float.glsl"
#include "depth_key.glsl"
#include "depth_slab.glsl"

const uint WORKGROUP_THREADS = 256u;
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
        ivec2 rows = rows_of(load_footprint(own_record), cameras[camera_of(own_record)]);
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
        Footprint splat = load_footprint(record);
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

void fill_few(uint record) {
    uint reach = reaches[record];
    uint key = keys[record];
    Camera camera = cameras[camera_of(record)];
    if ((reach & REACH_LARGE) != 0u) {
        return;
    }
    uint slab = slab_of(key, camera);
    uint columns = camera.coarse_tiles.x;
    uint second = reach_tiles(reach, 0u);
    uint third = second + reach_tiles(reach, 1u);
    uint count = third + reach_tiles(reach, 2u);
    uint first_bin = reach_bin(reach, 0u, columns);
    uint second_bin = reach_bin(reach, 1u, columns) - second;
    uint third_bin = reach_bin(reach, 2u, columns) - third;
    for (uint pair = 0u; pair < count; pair += AHEAD) {
        uint places[AHEAD];
        [[unroll]] for (uint next = 0u; next < AHEAD; ++next) {
            uint index = pair + next;
            uint bin = index + (index < second ? first_bin : index < third ? second_bin : third_bin);
            if (index < count) {
                places[next] = atomicAdd(slab_counts[bin * SLABS + slab], 1u);
            }
        }
        [[unroll]] for (uint next = 0u; next < AHEAD; ++next) {
            if (pair + next < count) {
                write_pair(places[next], key, record);
            }
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
    uint first_record = (group - large_groups) * PAIR_BLOCK;
    uint end_record = min(first_record + PAIR_BLOCK, held(required.records, records_max));
    for (uint record = first_record + thread; record < end_record; record += WORKGROUP_THREADS) {
        fill_few(record);
    }
}
