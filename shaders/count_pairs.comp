#version 460
// Tile binning, first run: counts the (coarse tile, record) pairs of each coarse tile and depth
// slab.
//
// plan_buckets then gives each of them a stretch of the pair buffer, and fill_pairs fills it. A
// thread counts the coarse tiles of records with few rows and leaves a word with them, so that
// nobody needs to find them again. Records with more are listed, and their rows are shared out over
// the workgroup.
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
layout(set = 0, binding = 1, scalar) buffer required_block { RequiredCounts required; };
layout(set = 0, binding = 2, scalar) readonly buffer lists_block { ViewLists lists[]; };
layout(set = 0, binding = 3, scalar) readonly buffer keys_block { uint keys[]; };
layout(set = 0, binding = 4, std430) readonly buffer footprints_block { uvec4 footprints[]; };
layout(set = 0, binding = 5, scalar) buffer slab_counts_block { uint slab_counts[]; }; // [coarse tile][slab]
layout(set = 0, binding = 6, scalar) writeonly buffer reaches_block { uint reaches[]; };
layout(set = 0, binding = 7, scalar) writeonly buffer large_records_block { uint large_records[]; };

layout(push_constant, scalar) uniform push_block {
    uint camera_count;
    uint records_max;
};

#include "bin_records.glsl"
#include "slab_hash.glsl"

// Whether a record of the block has more coarse tiles than a reach holds, and by thread the rows of
// such records before the thread's own.
shared bool any_large;
shared uint rows_before_large[PAIR_BLOCK];
shared uint first_large; // of the block, in large_records

void count_row(Camera camera, uint slab, uint row, ivec2 tiles) {
    for (int tile = tiles.x; tile <= tiles.y; ++tile) {
        uint bin = camera.first_bin + row * camera.coarse_tiles.x + uint(tile);
        uint at = bin * SLABS + slab;
        uint slot = slot_of(at);
        if (slot == NO_SLOT) {
            atomicAdd(slab_counts[at], 1u);
        } else {
            atomicAdd(hash_counts[slot], 1u);
        }
    }
}

// Adds what the workgroup has counted. Every thread calls it, behind a barrier.
void add_hash(uint thread) {
    if (hash_counts[thread] > 0u) {
        atomicAdd(slab_counts[hash_slabs[thread]], hash_counts[thread]);
    }
}

// Counts the pairs of a record with few coarse tiles and returns its reach; REACH_LARGE where it
// has more, and then nothing is counted.
uint count_few(Footprint splat, Camera camera, uint key, ivec2 rows) {
    ivec2 tiles[REACH_ROWS];
    int first = 0x7fffffff;
    bool few = rows.y - rows.x < int(REACH_ROWS);
    if (!few) {
        return REACH_LARGE;
    }
    [[unroll]] for (uint row = 0u; row < REACH_ROWS; ++row) {
        tiles[row] = ivec2(0, -1);
        if (rows.x + int(row) <= rows.y) {
            tiles[row] = tiles_of(splat, camera, uint(rows.x) + row);
            bool some = tiles[row].x <= tiles[row].y;
            first = some && first == 0x7fffffff ? tiles[row].x : first;
            few = few && tiles[row].y - tiles[row].x < int(REACH_TILES_MAX);
            few = few && (!some || (tiles[row].x - first >= -REACH_LEFT && tiles[row].x - first < REACH_LEFT));
        }
    }
    if (first == 0x7fffffff) {
        return 0u; // no coarse tile at all
    }
    uint bin = camera.first_bin + uint(rows.x) * camera.coarse_tiles.x + uint(first);
    if (!few || bin >= REACH_BINS) {
        return REACH_LARGE;
    }
    uint slab = slab_of(key, camera);
    uint reach = bin;
    [[unroll]] for (uint row = 0u; row < REACH_ROWS; ++row) {
        if (tiles[row].x <= tiles[row].y) {
            reach |= uint(tiles[row].y - tiles[row].x + 1) << (16u + 3u * row);
            reach |= row > 0u ? uint(tiles[row].x - first + REACH_LEFT) << (22u + 3u * row) : 0u;
            count_row(camera, slab, uint(rows.x) + row, tiles[row]);
        }
    }
    return reach;
}

// The thread whose record has row `row` of the large records.
uint giver_of(uint row) {
    uint giver = 0u;
    [[unroll]] for (uint step = PAIR_BLOCK / 2u; step > 0u; step /= 2u) {
        giver += rows_before_large[giver + step] <= row ? step : 0u;
    }
    return giver;
}

// A large record in a word: 1, and from this bit on its rows. Words of a block are added up.
const uint LARGE_BITS = 9u;

// Lists the large records of the block and counts their pairs. `large` is the word of the thread's
// own record, or 0. Every thread calls it.
void count_large(uint first_record, uint large, uint thread) {
    uint total;
    uint before = block_exclusive_sum(large, total);
    uint count = total & ((1u << LARGE_BITS) - 1u);
    rows_before_large[thread] = before >> LARGE_BITS;
    if (thread == 0u) {
        first_large = atomicAdd(required.large, count);
    }
    barrier();
    if (large != 0u) {
        large_records[first_large + (before & ((1u << LARGE_BITS) - 1u))] = first_record + thread;
    }
    for (uint given = thread; given < total >> LARGE_BITS; given += WORKGROUP_THREADS) {
        uint giver = giver_of(given);
        uint record = first_record + giver;
        Camera camera = cameras[camera_of(record)];
        Footprint splat = load_footprint(record, camera);
        uint row = uint(rows_of(splat, camera).x) + given - rows_before_large[giver];
        count_row(camera, slab_of(keys[record], camera), row, tiles_of(splat, camera, row));
    }
}

void main() {
    uint first_record = required.first_binned + group_index() * PAIR_BLOCK;
    uint thread = block_thread();
    uint record = first_record + thread;
    uint large = 0u;
    if (thread == 0u) {
        any_large = false;
    }
    empty_hash(thread);
    barrier();
    if (record < held(required.records, records_max)) {
        Camera camera = cameras[camera_of(record)];
        Footprint splat = load_footprint(record, camera);
        ivec2 rows = rows_of(splat, camera);
        uint reach = count_few(splat, camera, keys[record], rows);
        reaches[record] = reach;
        if (reach == REACH_LARGE) {
            large = uint(rows.y - rows.x + 1) << LARGE_BITS | 1u;
            any_large = true;
        }
    }
    barrier();
    if (any_large) {
        count_large(first_record, large, thread);
        barrier();
    }
    add_hash(thread);
}
