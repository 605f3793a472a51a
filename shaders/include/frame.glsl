// Structures shared by the stages of a frame. The host has them in engine/render/src/layout.rs;
// tests/stages/layout.rs compares the two.

// Splats a cluster; a cluster is culled as one and is one workgroup of cull and project.
const uint CLUSTER_SPLATS = 256u;
const uint CLUSTER_WORDS = CLUSTER_SPLATS / 32u;

// A coarse tile is what lists are made for: 8 x 4 fine tiles of 8 x 8 pixels, one bit of a 32-bit
// mask each.
const uint FINE_TILE_PX = 8u;
const uint COARSE_COLUMNS = 8u;
const uint COARSE_ROWS = 4u;
const uint COARSE_WIDTH_PX = FINE_TILE_PX * COARSE_COLUMNS;
const uint COARSE_HEIGHT_PX = FINE_TILE_PX * COARSE_ROWS;
const uint COARSE_PIXELS = COARSE_WIDTH_PX * COARSE_HEIGHT_PX;

struct Camera {
    vec3 row_x; // camera from world rotation, by rows
    vec3 row_y;
    vec3 row_z;
    vec3 row_z_low; // what rounding left of row_z: depths are ordered by both
    vec3 center_high_m; // the camera's center relative to the world's origin is center_high_m + center_low_m
    vec3 center_low_m;
    vec3 row_x_coarse; // in steps of 2^-11; mean_px.glsl says what for
    vec3 row_y_coarse;
    vec3 row_z_coarse;
    vec3 row_x_fine; // what that left of the row
    vec3 row_y_fine;
    vec3 row_z_fine;
    vec2 focal_px;
    vec2 principal_px;
    vec2 focal_coarse_px; // in steps of 2^(18 - mean_shift) px
    vec2 focal_fine_px;
    vec2 principal_coarse_px; // likewise
    vec2 principal_fine_px;
    uint mean_shift; // means are stored in steps of 2^-mean_shift px
    vec2 slope_min; // x/z and y/z are kept inside these in the projection's Jacobian
    vec2 slope_max;
    uvec2 size_px;
    uvec2 coarse_tiles;
    vec2 key_offset;  // what a depth relative to the world's origin has before it is scaled by key_scale, high and low part
    float key_scale;  // turns such a depth into one between -1 and 1, exactly: a power of two
    float key_depth;  // the camera's own depth relative to the world's origin, scaled
    uint first_bin;   // bins of camera c are first_bin .. first_bin + coarse_tiles.x * coarse_tiles.y, row-major
    uint first_pixel; // where its image begins in the output buffers
    vec3 turn_rad_per_s;       // rotation vector of the camera while the image is exposed, camera axes
    vec3 frame_turn_rad_per_s; // of the splats' frame, in its own axes
    vec3 frame_velocity_mps;   // of the splats' frame relative to the camera, camera axes
    float shutter_first_s;     // time of exposure at pixel coordinates (0, 0), relative to that of the pose
    vec2 shutter_s_per_px;     // its increase per pixel; zero where nothing moves or all is exposed at once
};

// Cameras of a frame, at most.
const uint CAMERAS_MAX = 32u;

struct Cluster {
    vec3 center_m; // of the box around the means
    vec3 half_extent_m;
    float splat_radius_m; // longest standard deviation times cut-off radius (at least sqrt(3)) of any splat in it
};

// Required counts, whatever the capacity: the host grows the buffers that were too small and
// renders again.
struct RequiredCounts {
    uint records;    // visible (camera, splat)
    uint pairs;      // (coarse tile, record); more than 2^32 wrap: see wanted_pairs
    uint pairs_low;  // sum of the lower 16 bits of each coarse tile's number of pairs
    uint pairs_high; // sum of the upper 16 bits of each coarse tile's number of pairs
    uint large;      // records with more coarse tiles than a reach holds
    uint buckets;    // of pairs, sorted one by one
    uint long_slabs; // depth slabs that are cut into pieces before they are sorted
    uint pieces;     // of those, at most; they become buckets too
    uint planned;    // coarse tiles whose buckets are planned
    uint items;      // (coarse tile, segment of its list)
    uint partials;   // items of coarse tiles with more than one segment
    uint composites; // coarse tiles with more than one segment
    uint longest;    // pairs of one coarse tile, at most
    uint tiles;      // fine tiles with partial results, at most in any blending of the frame
    uint next_tile;  // fine tiles with partial results in the blending that runs; zero before it
    uint first_binned; // record from which on records are binned: the first of the agents where lists of the background are kept
    uint merges;     // pieces of merged lists
};

// Pairs that were wanted; what an u32 cannot hold is its largest value. Sums of up to 65,536 coarse
// tiles' halves cannot wrap.
uint wanted_pairs(RequiredCounts required) {
    uint high = required.pairs_high + (required.pairs_low >> 16u);
    return high > 0xffffu ? 0xffffffffu : high << 16u | (required.pairs_low & 0xffffu);
}

// A count that has no room makes nothing: the host grows the buffers and draws again.
uint held(uint need, uint room) {
    return need > room ? 0u : need;
}

// Records that are binned, of `records` those from `first_binned` on; none where not all have room.
uint binned_records(uint records, uint first_binned, uint records_max) {
    return records > records_max ? 0u : records - first_binned;
}

// Offsets of the arguments of each indirect dispatch, in units of uvec3.
const uint ARGUMENTS_PAIR_BLOCKS = 0u;
const uint ARGUMENTS_BLEND = 1u;
const uint ARGUMENTS_COMPOSITE = 2u;
const uint ARGUMENTS_SPLIT = 3u;
const uint ARGUMENTS_SORT = 4u;
const uint ARGUMENTS_FILL = 5u;
const uint ARGUMENTS_MERGE = 6u;

// First records of a camera: the background's lie before those of agents, each in the order of
// their splats.
struct ViewLists {
    uint first_static;
    uint first_moving;
};

// Records handled by one workgroup of count_pairs and fill_pairs, one by each thread.
const uint PAIR_BLOCK = 256u;

// Of records with many coarse tiles, those handled by one workgroup of fill_pairs. A power of two.
const uint LARGE_BLOCK = 32u;

// Pairs after which a bucket ends with the next depth slab.
const uint BUCKET_PAIRS = 512u;

// Pairs of a bucket, at most: those that sort_buckets has room for. A power of two.
const uint SHARED_PAIRS = 1024u;

// A run of one coarse tile's pairs that is sorted by itself.
struct Bucket {
    uint first_pair;
    uint pairs;
    uint bin;  // its coarse tile, or NO_BIN where it is a piece of a depth slab
    uint part; // of a slab that is cut, one of slab_parts
};
const uint NO_BIN = 0xffffffffu;

// Pairs of a long depth slab for which a workgroup more is worth it, up to SLAB_PARTS_MAX: each
// reads the whole slab and moves its part.
const uint SLAB_PART_PAIRS = 4096u;
const uint SLAB_PARTS_MAX = 16u;

// Workgroups that cut a slab, a power of two.
uint slab_parts(uint pairs) {
    uint parts = 1u;
    while (parts * SLAB_PART_PAIRS < pairs && parts < SLAB_PARTS_MAX) {
        parts *= 2u;
    }
    return parts;
}

// A run of one coarse tile's merged list: entries from piece * MERGE_PAIRS on.
struct MergePiece {
    uint bin;
    uint piece;
};

// Entries of a piece, at most.
const uint MERGE_PAIRS = 1024u;

// Length of the list of a coarse tile that is not blended: its pixels are in the image already.
const uint NOT_BLENDED = 0xffffffffu;

// A camera whose direction has no kept keys.
const uint NO_KEY_SET = 0xffffffffu;

// Devices promise only 65535 groups along an axis.
const uint GROUPS_X_MAX = 65535u;

uvec3 groups_for(uint count) {
    return count <= GROUPS_X_MAX ? uvec3(count, 1u, 1u) : uvec3(GROUPS_X_MAX, (count + GROUPS_X_MAX - 1u) / GROUPS_X_MAX, 1u);
}

uint group_index() {
    return gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x;
}

// One (coarse tile, segment) of work for blend.
struct BlendItem {
    uint bin;
    uint first_pair;
    uint pairs;
    uint partial; // slot of its partial result, or NO_PARTIAL when it is its tile's only segment
    uint segment; // its index in its tile's list; the slots of those before it are the ones before its own
};
const uint NO_PARTIAL = 0xffffffffu;

// Fine tiles of a segment that have a partial result, as bits: the first of them has index `first`
// among the results of all segments, and the others follow. A fine tile without one adds nothing,
// or lies behind others that are full.
struct PartialTiles {
    uint first;
    uint tiles;
};

// A coarse tile whose partial results are to be joined, or a part of its pixels.
struct Composite {
    uint bin;
    uint first_partial;
    uint partials;
    uint part; // of composite_runs(partials)
};

// Segments of a coarse tile that one thread joins, where there are not more than
// COMPOSITE_RUNS_MAX times as many.
const uint COMPOSITE_RUN = 16u;
const uint COMPOSITE_RUNS_MAX = 16u;

// Runs into which the segments of a coarse tile are divided: a power of two. They are joined side
// by side, so there are as many threads for each pixel, and as many parts of the coarse tile's
// pixels.
uint composite_runs(uint partials) {
    uint runs = 1u;
    while (runs * COMPOSITE_RUN < partials && runs < COMPOSITE_RUNS_MAX) {
        runs *= 2u;
    }
    return runs;
}
