#version 460
// Tile binning: a (coarse tile, record) pair for every coarse tile that a record reaches, by depth
// slab.
//
// Run twice. The first run counts the pairs of each coarse tile and depth slab. plan_buckets then
// gives each of them a stretch of the pair buffer, and the second run fills it. The order within a
// stretch is that of the atomics: sort_buckets makes it one order. Rows of coarse tiles of records
// that have many are shared out over the workgroup.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
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

const uint WORKGROUP_THREADS = 256u;
layout(local_size_x = 256) in;
#include "block.glsl"

layout(constant_id = 0) const bool FILL = false;   // the second run
layout(constant_id = 1) const bool RADIAL = false; // keys are of distances instead of depths
layout(constant_id = 2) const bool LIDAR = false;  // records have ranges of columns and rows instead of footprints

layout(set = 0, binding = 0, scalar) readonly buffer cameras_block { Camera cameras[]; };
layout(set = 0, binding = 1, scalar) readonly buffer required_block { RequiredCounts required; };
layout(set = 0, binding = 2, scalar) readonly buffer lists_block { ViewLists lists[]; };
layout(set = 0, binding = 3, scalar) readonly buffer keys_block { uint keys[]; };
layout(set = 0, binding = 4, std430) readonly buffer footprints_block { uvec4 footprints[]; };
layout(set = 0, binding = 5, scalar) buffer slab_counts_block { uint slab_counts[]; }; // [coarse tile][slab]; for FILL, the next index
layout(set = 0, binding = 6, std430) writeonly buffer pairs_block { uvec2 pairs[]; }; // depth key, record

layout(push_constant, scalar) uniform push_block {
    uint camera_count;
    uint records_max;
    uint pairs_max;
};

// Records with more rows of coarse tiles than this are binned by the whole workgroup, one thread
// per row.
const uint ALONE_ROWS_MAX = 2u;

// By thread: the record it gave away, and how many rows were given away before it.
shared uint shared_records[WORKGROUP_THREADS];
shared uint shared_rows_before[WORKGROUP_THREADS];

// The camera of a record: records of the background lie by camera, and behind them those of the
// agents.
uint camera_of(uint record) {
    uint camera = 0u;
    bool moving = record >= lists[0].first_moving;
    for (uint next = 1u; next < camera_count; ++next) {
        uint first = moving ? lists[next].first_moving : lists[next].first_static;
        camera = first <= record ? next : camera;
    }
    return camera;
}

// A LiDAR's record has its first and last column and row in place of mean, slope and rate.
Footprint load_footprint(uint record, Camera camera) {
    uvec4 low = footprints[2u * record];
    Footprint splat = unpack_footprint(low, footprints[2u * record + 1u], camera.mean_shift);
    splat.mean_px = LIDAR ? uintBitsToFloat(low.xy) : splat.mean_px;
    return splat;
}

// Rows of coarse tiles [x, y] that a record reaches; empty when x > y.
ivec2 rows_of(Footprint splat, Camera camera) {
    return LIDAR ? ivec2(splat.slope, splat.rate_x) / int(COARSE_HEIGHT_PX) : reached_coarse_rows(splat, camera.size_px.y);
}

void bin_row(Camera camera, Footprint splat, uint record, uint key, uint row) {
    uint slab = slab_and_offset(key, RADIAL ? 0.0 : camera.key_depth, camera.key_scale).x;
    ivec2 tiles = LIDAR ? ivec2(splat.mean_px) / int(COARSE_WIDTH_PX) : reached_coarse_tiles(splat, row, camera.size_px);
    for (int tile = tiles.x; tile <= tiles.y; ++tile) {
        uint bin = camera.first_bin + row * camera.coarse_tiles.x + uint(tile);
        uint index = atomicAdd(slab_counts[bin * SLABS + slab], 1u);
        if (FILL && index < pairs_max) {
            pairs[index] = uvec2(key, record); // one write: neighbors are written far apart
        }
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

void main() {
    uint record_count = held(required.records, records_max);
    if (FILL && wanted_pairs(required) > pairs_max) {
        return; // the need is known: the host grows the buffer and draws again
    }
    uint first_record = group_index() * PAIR_BLOCK;
    uint end_record = min(first_record + PAIR_BLOCK, record_count);
    uint thread = block_thread();
    for (uint base = first_record; base < end_record; base += WORKGROUP_THREADS) {
        bool real = base + thread < end_record;
        uint record = real ? base + thread : first_record;
        Camera camera = cameras[camera_of(record)];
        Footprint splat = load_footprint(record, camera);
        ivec2 rows = rows_of(splat, camera);
        uint row_count = real ? uint(rows.y - rows.x + 1) : 0u;
        bool alone = row_count <= ALONE_ROWS_MAX;
        uint row_total;
        shared_rows_before[thread] = block_exclusive_sum(alone ? 0u : row_count, row_total);
        shared_records[thread] = record;
        barrier();
        if (alone) {
            for (uint row = 0u; row < row_count; ++row) {
                bin_row(camera, splat, record, keys[record], uint(rows.x) + row);
            }
        }
        for (uint given = thread; given < row_total; given += WORKGROUP_THREADS) {
            uint giver = giver_of(given);
            uint giver_record = shared_records[giver];
            Camera giver_camera = cameras[camera_of(giver_record)];
            Footprint giver_splat = load_footprint(giver_record, giver_camera);
            uint row = uint(rows_of(giver_splat, giver_camera).x) + given - shared_rows_before[giver];
            bin_row(giver_camera, giver_splat, giver_record, keys[giver_record], row);
        }
        barrier(); // the shared lists are read to their end
    }
}
