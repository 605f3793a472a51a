// Structures shared by the stages of a frame. The host has them in engine/render/src/layout.rs; tests/stages/layout.rs compares the two.

// Splats a chunk; a chunk is culled as one and is one workgroup of cull and project.
const uint CHUNK_SPLATS = 256u;
const uint CHUNK_WORDS = CHUNK_SPLATS / 32u;

// A macro tile is what lists are made for: 8 x 4 render tiles of 8 x 8 pixels, one bit of a 32-bit mask each.
const uint RENDER_TILE_PX = 8u;
const uint MACRO_COLUMNS = 8u;
const uint MACRO_ROWS = 4u;
const uint MACRO_WIDTH_PX = RENDER_TILE_PX * MACRO_COLUMNS;
const uint MACRO_HEIGHT_PX = RENDER_TILE_PX * MACRO_ROWS;
const uint MACRO_PIXELS = MACRO_WIDTH_PX * MACRO_HEIGHT_PX;

struct Camera {
    vec3 row_x; // camera from world rotation, by rows
    vec3 row_y;
    vec3 row_z;
    vec3 row_z_low; // what rounding left of row_z: depths are ordered by both
    vec3 centre_high_m; // the camera's centre relative to the world's origin is centre_high_m + centre_low_m
    vec3 centre_low_m;
    vec2 focal_px;
    vec2 principal_px;
    vec2 slope_min; // x/z and y/z are kept inside these in the projection's Jacobian
    vec2 slope_max;
    uvec2 size_px;
    uvec2 macro_tiles;
    vec2 key_offset;  // what a depth relative to the world's origin has before it is scaled by key_scale, high and low part
    float key_scale;  // turns such a depth into one between -1 and 1, exactly: a power of two
    uint first_bin;   // bins of camera c are first_bin .. first_bin + macro_tiles.x * macro_tiles.y, row-major
    uint first_pixel; // where its picture begins in the output buffers
};

struct Chunk {
    vec3 centre_m; // of the box around the means
    vec3 half_extent_m;
    float reach_m; // longest standard deviation times cut-off radius (at least sqrt(3)) of any splat in it
};

// How many were wanted, whatever the capacity: the host grows the buffers that were too small and draws again.
struct Needs {
    uint records;    // visible (camera, splat)
    uint pairs;      // (macro tile, record)
    uint items;      // (macro tile, segment of its list)
    uint partials;   // items of macro tiles with more than one segment
    uint composites; // macro tiles with more than one segment
    uint longest;    // pairs of one macro tile, at most
};

// A count that has no room makes nothing: the host grows the buffers and draws again.
uint held(uint need, uint room) {
    return need > room ? 0u : need;
}

// Where the arguments of each indirect dispatch stand, in units of uvec3.
const uint ARGUMENTS_SORT_RECORDS = 0u;
const uint ARGUMENTS_PAIR_BLOCKS = 1u;
const uint ARGUMENTS_SORT_PAIRS = 2u;
const uint ARGUMENTS_RANGES = 3u;
const uint ARGUMENTS_BLEND = 4u;
const uint ARGUMENTS_COMPOSITE = 5u;
const uint ARGUMENTS_MERGE = 6u;
const uint ARGUMENTS_RESTORE = 7u;

// How a camera's background list comes into order.
const uint ORDER_SORTED = 0u;   // by the radix sort
const uint ORDER_KEPT = 1u;     // by the ranks that were found for this very direction, or for one that is near enough
const uint ORDER_REPAIRED = 2u; // by the ranks of a direction nearby, put right and proved

struct ViewOrder {
    uint path;
    uint rank_set; // whose ranks
};

// Where the records of a camera lie: background first, then agents, each in the order of their splats.
struct ViewLists {
    uint first_static;
    uint static_count;
    uint first_moving;
    uint moving_count;
    uint first_ordered; // where both together begin in the merged order
    uint first_block;   // of merge, counted over all cameras
};

// One list that the radix sort orders by itself, in place: places first to first + count - 1.
struct SortSegment {
    uint first;
    uint count;
    uint first_block; // of the sort, counted over all segments
};

// Records handled by one workgroup of count_pairs and emit_pairs, and pairs by one of find_ranges.
const uint PAIR_BLOCK = 1024u;

// Devices promise only 65535 groups along an axis.
const uint GROUPS_X_MAX = 65535u;

uvec3 groups_for(uint count) {
    return count <= GROUPS_X_MAX ? uvec3(count, 1u, 1u) : uvec3(GROUPS_X_MAX, (count + GROUPS_X_MAX - 1u) / GROUPS_X_MAX, 1u);
}

uint group_index() {
    return gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x;
}

// One (macro tile, segment) of work for blend.
struct Item {
    uint bin;
    uint first_pair;
    uint pairs;
    uint partial; // slot of its partial result, or NO_PARTIAL when it is its tile's only segment
    uint segment; // its place in its tile's list; the slots of those before it are the ones before its own
};
const uint NO_PARTIAL = 0xffffffffu;

// A macro tile whose partial results are to be joined.
struct Composite {
    uint bin;
    uint first_partial;
    uint partials;
};
