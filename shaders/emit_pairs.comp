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
layout(set = 0, binding = 5, scalar) readonly buffer firsts_block { uint firsts[]; };
layout(set = 0, binding = 6, std430) readonly buffer footprints_block { vec4 footprints[]; };
layout(set = 0, binding = 7, scalar) writeonly buffer bins_block { uint bins[]; };
layout(set = 0, binding = 8, scalar) writeonly buffer records_block { uint records[]; };
layout(set = 0, binding = 9, scalar) writeonly buffer arguments_block { uvec3 arguments[]; };

layout(push_constant, scalar) uniform push_block {
    uint camera_count;
    uint chunk_count;
    uint records_max;
    uint pairs_max;
};

// Records with more macro tiles than this are written by the whole workgroup.
const uint ALONE_MAX = 12u;

shared uint shared_count;
shared uint shared_records[WORKGROUP_THREADS];
shared uint shared_firsts[WORKGROUP_THREADS];
shared uint shared_cursor;

// Records are ordered by camera: the last camera whose records begin at or before this one.
uint camera_of(uint record) {
    uint camera = 0u;
    for (uint next = 1u; next < camera_count; ++next) {
        camera = firsts[next * chunk_count] <= record ? next : camera;
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

void write_together(uint record, uint first, uint thread) {
    if (thread == 0u) {
        shared_cursor = first;
    }
    barrier();
    Camera camera = cameras[camera_of(record)];
    Footprint splat = load_footprint(record);
    ivec2 rows = reached_macro_rows(splat, camera.size_px.y);
    for (int row = rows.x + int(thread); row <= rows.y; row += int(WORKGROUP_THREADS)) {
        ivec2 tiles = reached_macro_tiles(splat, uint(row), camera.size_px);
        uint place = atomicAdd(shared_cursor, uint(tiles.y - tiles.x + 1));
        write_row(camera, record, uint(row), tiles, place);
    }
    barrier();
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
    uint record_count = min(needs.records, records_max);
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
        if (thread == 0u) {
            shared_count = 0u;
        }
        barrier();
        if (count > ALONE_MAX) {
            uint slot = atomicAdd(shared_count, 1u);
            shared_records[slot] = record;
            shared_firsts[slot] = first;
        } else if (count > 0u) {
            write_alone(record, first);
        }
        barrier();
        for (uint slot = 0u; slot < shared_count; ++slot) {
            write_together(shared_records[slot], shared_firsts[slot], thread);
        }
        barrier();
    }
    if (first_place + PAIR_BLOCK >= record_count && thread == 0u) {
        uint pairs = min(before, pairs_max);
        needs.pairs = before;
        arguments[ARGUMENTS_SORT_PAIRS] = groups_for((pairs + SORT_BLOCK - 1u) / SORT_BLOCK);
        arguments[ARGUMENTS_RANGES] = groups_for((pairs + PAIR_BLOCK - 1u) / PAIR_BLOCK);
    }
}
