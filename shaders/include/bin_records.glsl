// Coarse tiles that a record reaches: shared by count_pairs and fill_pairs.
//
// Included where cameras, lists, keys and footprints are bound, behind the push constant
// `camera_count`.

layout(constant_id = 1) const bool RADIAL = false; // keys are of distances instead of depths
layout(constant_id = 2) const bool LIDAR = false;  // records have ranges of columns and rows instead of footprints

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

// Coarse tiles [x, y] of a row that a record reaches; empty when x > y.
ivec2 tiles_of(Footprint splat, Camera camera, uint row) {
    return LIDAR ? ivec2(splat.mean_px) / int(COARSE_WIDTH_PX) : reached_coarse_tiles(splat, row, camera.size_px);
}

uint slab_of(uint key, Camera camera) {
    return slab_and_offset(key, RADIAL ? 0.0 : camera.key_depth, camera.key_scale).x;
}

// The reach of a record that has few coarse tiles, in a word: count_pairs finds it, and fill_pairs
// reads it instead of the footprint. From the lowest bit: the bin of its first coarse tile in the
// first row (16 bits); the number of coarse tiles in each of three rows (3 bits each); how far the
// second and the third row begin to the right of the first, plus REACH_LEFT (3 bits each).
const uint REACH_ROWS = 3u;
const uint REACH_TILES_MAX = 7u; // of a row
const int REACH_LEFT = 4;
const uint REACH_BINS = 65536u;
const uint REACH_LARGE = 0x80000000u; // the record has more: it is in the list of large records

uint reach_tiles(uint reach, uint row) {
    return reach >> (16u + 3u * row) & 7u;
}

// First bin of a row of the reach, where rows of coarse tiles are `columns` long.
uint reach_bin(uint reach, uint row, uint columns) {
    uint right = row == 0u ? uint(REACH_LEFT) : reach >> (22u + 3u * row) & 7u;
    return (reach & 0xffffu) + row * columns + right - uint(REACH_LEFT);
}
