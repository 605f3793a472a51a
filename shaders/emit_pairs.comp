#version 460
// Writes a (macro tile, record) pair for every macro tile that a record reaches, records in depth order.
//
// The order of pairs within one record is free: they differ in their tile. The stable sort by tile that follows therefore
// gives the same lists whatever it is. Rows of macro tiles of records that cover many are shared out over the workgroup.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#include "frame.glsl"
#include "footprint.glsl"
#include "record.glsl"

const uint WORKGROUP_THREADS = 256u;
layout(local_size_x = 256) in;
#include "block.glsl"

layout(constant_id = 0) const uint SORT_BLOCK = 4096u;

layout(set = 0, binding = 0, scalar) readonly buffer cameras_block { Camera cameras[]; };
layout(set = 0, binding = 1, scalar) buffer needs_block { Needs needs; };
layout(set = 0, binding = 2, scalar) readonly buffer order_block { uint order[]; };
layout(set = 0, binding = 3, scalar) readonly buffer tile_counts_block { uint tile_counts[]; };
layout(set = 0, binding = 4, scalar) readonly buffer pair_counts_block { uint pair_counts[]; };
layout(set = 0, binding = 5, scalar) readonly buffer lists_block { ViewLists lists[]; };
layout(set = 0, binding = 6, std430) readonly buffer footprints_block { vec4 footprints[]; };
layout(set = 0, binding = 7, scalar) writeonly buffer bins_block { uint bins[]; };
layout(set = 0, binding = 8, scalar) writeonly buffer records_block { uint records[]; };
layout(set = 0, binding = 9, scalar) writeonly buffer arguments_block { uvec3 arguments[]; };
layout(set = 0, binding = 10, scalar) writeonly buffer segments_block { SortSegment segments[]; };

layout(push_constant, scalar) uniform push_block {
    uint camera_count;
    uint records_max;
    uint pairs_max;
};

// Records with more macro tiles than this are written by the whole workgroup, a row of macro tiles at a time.
const uint ALONE_MAX = 4u;

// By thread: the record it gave away, where the next of its pairs goes, and how many rows were given away before it.
shared uint shared_records[WORKGROUP_THREADS];
shared uint shared_cursors[WORKGROUP_THREADS];
shared uint shared_rows_before[WORKGROUP_THREADS];

// The camera of a record: records of the background lie by camera, and behind them those of the agents.
uint camera_of(uint record) {
    uint camera = 0u;
    bool moving = record >= lists[0].first_moving;
    for (uint next = 1u; next < camera_count; ++next) {
        uint first = moving ? lists[next].first_moving : lists[next].first_static;
        camera = first <= record ? next : camera;
    }
    return camera;
}

Footprint load_footprint(uint record) {
    return unpack_footprint(footprints[2u * record], footprints[2u * record + 1u]);
}

void write_row(Camera camera, uint record, uint row, ivec2 tiles, uint first) {
    for (int tile = tiles.x; tile <= tiles.y; ++tile) {
        uint place = first + uint(tile - tiles.x);
        if (place < pairs_max) {
            bins[place] = camera.first_bin + row * camera.macro_tiles.x + uint(tile);
            records[place] = record;
        }
    }
}

void write_alone(uint record, uint first) {
    Camera camera = cameras[camera_of(record)];
    Footprint splat = load_footprint(record);
    ivec2 rows = reached_macro_rows(splat, camera.size_px.y);
    for (int row = rows.x; row <= rows.y; ++row) {
        ivec2 tiles = reached_macro_tiles(splat, uint(row), camera.size_px);
        write_row(camera, record, uint(row), tiles, first);
        first += uint(tiles.y - tiles.x + 1);
    }
}

// The last thread that gave away rows before `row`, counted over the workgroup.
uint giver_of(uint row) {
    uint giver = 0u;
    for (uint step = WORKGROUP_THREADS / 2u; step > 0u; step /= 2u) {
        giver += shared_rows_before[giver + step] <= row ? step : 0u;
    }
    return giver;
}

// Writes the rows that the threads gave away, one thread a row. Which row of a record takes which places is free.
void write_together(uint row_total, uint thread) {
    for (uint given = thread; given < row_total; given += WORKGROUP_THREADS) {
        uint giver = giver_of(given);
        uint record = shared_records[giver];
        Camera camera = cameras[camera_of(record)];
        Footprint splat = load_footprint(record);
        uint row = uint(reached_macro_rows(splat, camera.size_px.y).x) + given - shared_rows_before[giver];
        ivec2 tiles = reached_macro_tiles(splat, row, camera.size_px);
        write_row(camera, record, row, tiles, atomicAdd(shared_cursors[giver], uint(tiles.y - tiles.x + 1)));
    }
}

uint macro_rows_of(uint record) {
    ivec2 rows = reached_macro_rows(load_footprint(record), cameras[camera_of(record)].size_px.y);
    return uint(rows.y - rows.x + 1);
}

uint saturating_sum(uint a, uint b) {
    return a > 0xffffffffu - b ? 0xffffffffu : a + b;
}

// Pairs of all earlier blocks, saturating: more than 2^32 pairs must not look like few. In halves, so that the sums of up
// to 65,536 blocks cannot wrap.
uint pairs_before(uint block, uint thread) {
    uint low = 0u;
    uint high = 0u;
    for (uint index = thread; index < block; index += WORKGROUP_THREADS) {
        low += pair_counts[index] & 0xffffu;
        high += pair_counts[index] >> 16u;
    }
    low = block_sum(low);
    high = block_sum(high);
    return high > 0xffffu ? 0xffffffffu : saturating_sum(high << 16u, low);
}

void main() {
    uint record_count = held(needs.records, records_max);
    uint block = group_index();
    uint first_place = block * PAIR_BLOCK;
    if (first_place >= record_count) {
        return;
    }
    uint thread = block_thread();
    uint before = pairs_before(block, thread);
    for (uint base = first_place; base < min(first_place + PAIR_BLOCK, record_count); base += WORKGROUP_THREADS) {
        bool real = base + thread < record_count;
        uint record = real ? order[base + thread] : 0u;
        uint count = real ? tile_counts[record] : 0u;
        uint total;
        uint first = before + block_exclusive_sum(count, total);
        before = saturating_sum(before, total);
        bool alone = count <= ALONE_MAX;
        uint row_total;
        uint rows_before = block_exclusive_sum(alone ? 0u : macro_rows_of(record), row_total);
        shared_records[thread] = record;
        shared_cursors[thread] = first;
        shared_rows_before[thread] = rows_before;
        barrier();
        if (alone && count > 0u) {
            write_alone(record, first);
        }
        write_together(row_total, thread);
        barrier(); // the shared lists are read to their end
    }
    if (first_place + PAIR_BLOCK >= record_count && thread == 0u) {
        uint pairs = min(before, pairs_max);
        needs.pairs = before;
        segments[0] = SortSegment(0u, pairs, 0u);
        arguments[ARGUMENTS_SORT_PAIRS] = groups_for((pairs + SORT_BLOCK - 1u) / SORT_BLOCK);
        arguments[ARGUMENTS_RANGES] = groups_for((pairs + PAIR_BLOCK - 1u) / PAIR_BLOCK);
    }
}
