// Records staged in shared memory, and for each 4x4 block of pixels the list of those that can
// reach it.
//
// Included by blend.comp, whose buffers it reads.

const uint SUBGROUPS = THREADS / LANES;
const uint SHARES = LEFT_PIXELS / LANES; // of a coarse tile, for a subgroup each: two pixels per lane

const uint BATCH_WORDS = BATCH / 32u;

// Index of a record that adds nothing to any pixel. No constant of its own: reflection would call
// BATCH by its name.
#define NO_RECORD BATCH

// Lanes that share a block: two pixels each. Subgroups of four lanes have blocks of half the
// height.
const uint BLOCK_LANES = LANES < 8u ? LANES : 8u;
const uint BLOCKS = LANES / BLOCK_LANES; // of a subgroup
const uint ROUND = LANES < 32u ? LANES : 32u; // records that are examined together
const uint PARTS = LANES < 32u ? 32u / LANES : 1u; // of a word, a subgroup's lanes each
const uint WORDS_STAGED = LANES > 32u ? LANES / 32u : 1u; // by a subgroup at a time

// Entries of a block's list: as many as shared memory allows, a multiple of four and more than a
// round.
const uint LIST_ROOM = 6u * BLOCK_LANES;
const uint LISTS = THREADS / BLOCK_LANES;

// The exponent of a record at (x, y), relative to the coarse tile: log2_opacity - (x * slants.x + y
// * slants.y + slants.z)^2
// - (y * rate_y + slants.w)^2. `tones` is rate_y, log2_opacity, red and green.
shared vec4 batch_slants[BATCH + 1u];
shared vec4 batch_tones[BATCH + 1u];
shared float batch_blues[BATCH + 1u];
shared float batch_depths[DEPTH ? BATCH + 1u : 1u];
shared uint batch_instances[INSTANCE || CONTRIBUTIONS ? BATCH + 1u : 1u];

// Records of each fine tile, one bit each. A word more than needed keeps tiles out of each other's
// memory bank.
shared uint tile_records[32][BATCH_WORDS + 1u];

// The lists of blocks.
shared uint list_entries[LISTS * LIST_ROOM];

// Fine tiles of the coarse tile at `origin` that the splat can reach, as bits row * 8 + column.
uint reached_fine_tiles(Footprint splat, uvec2 origin, uvec2 size_px) {
    uint mask = 0u;
    ivec2 rows = max(reached_rows(splat, size_px.y) - int(origin.y), ivec2(0, -1));
    rows = min(rows, int(COARSE_HEIGHT_PX) - 1) / int(FINE_TILE_PX);
    for (int row = rows.x; row <= rows.y; ++row) {
        float top = float(origin.y + uint(row) * FINE_TILE_PX);
        ivec2 columns = reached_columns(splat, top + 0.5, top + float(FINE_TILE_PX) - 0.5, size_px.x) - int(origin.x);
        if (columns.x > columns.y || columns.y < 0 || columns.x >= int(COARSE_WIDTH_PX)) {
            continue;
        }
        uint first = uint(max(columns.x, 0)) / FINE_TILE_PX;
        uint last = min(uint(columns.y) / FINE_TILE_PX, COARSE_COLUMNS - 1u);
        mask |= ((2u << last) - (1u << first)) << (uint(row) * COARSE_COLUMNS);
    }
    return mask;
}

// Stages record `entry` of `count`, which begin at entry `first` of the lists; returns the fine
// tiles that it can reach.
uint stage_record(uint first, uint count, uint entry, uvec2 origin, uvec2 size_px, uint mean_shift) {
    if (entry >= count) {
        return 0u;
    }
    uint record = records[first + entry];
    uvec4 low = footprints[2u * record];
    uvec4 high = footprints[2u * record + 1u];
    Footprint splat = unpack_footprint(low, high, mean_shift);
    vec3 color = ATTRIBUTES ? attributes[record] : unpack_record_color(high);
    vec2 mean = unpack_mean(low.xy, origin, mean_shift);
    float sheared_x = mean.x - splat.slope * mean.y;
    batch_slants[entry] = vec4(splat.rate_x, -splat.slope * splat.rate_x, -sheared_x * splat.rate_x, -mean.y * splat.rate_y);
    batch_tones[entry] = vec4(splat.rate_y, splat.log2_opacity, color.rg);
    batch_blues[entry] = color.b;
    if (DEPTH) {
        batch_depths[entry] = uintBitsToFloat(labels[record].x);
    }
    if (INSTANCE || CONTRIBUTIONS) {
        batch_instances[entry] = labels[record].y;
    }
    return reached_fine_tiles(splat, origin, size_px);
}

// Stages `count` records, which begin at entry `first` of the lists, and lists them by fine tile. A
// barrier must follow.
//
// A subgroup takes 32 records at a time, or as many as it has lanes: their masks are turned into
// one word per tile by ballots.
void stage_records(uint first, uint count, uvec2 origin, uvec2 size_px, uint mean_shift) {
    uint lane = gl_SubgroupInvocationID;
    uint words = (count + 31u) / 32u;
    for (uint word = gl_LocalInvocationIndex / LANES * WORDS_STAGED; word < words; word += SUBGROUPS * WORDS_STAGED) {
        uint masks[PARTS];
        [[unroll]] for (uint part = 0u; part < PARTS; ++part) {
            masks[part] = stage_record(first, count, 32u * word + part * LANES + lane, origin, size_px, mean_shift);
        }
        [[unroll]] for (uint first_tile = 0u; first_tile < 32u; first_tile += ROUND) {
            uint kept = 0u;
            [[unroll]] for (uint tile = 0u; tile < ROUND; ++tile) {
                uint bits = 0u;
                [[unroll]] for (uint part = 0u; part < PARTS; ++part) {
                    uvec4 reaching = subgroupBallot((masks[part] >> (first_tile + tile) & 1u) != 0u);
                    bits |= (lane < 32u ? reaching.x : reaching.y) << (part * LANES % 32u);
                }
                kept = lane % 32u == tile ? bits : kept;
            }
            if (word + lane / 32u < words) {
                tile_records[first_tile + lane % 32u][word + lane / 32u] = kept;
            }
        }
    }
}

// Writes the record that adds nothing.
void stage_no_record() {
    batch_slants[NO_RECORD] = vec4(0.0);
    batch_tones[NO_RECORD] = vec4(0.0, -1e3, 0.0, 0.0); // log2 of an alpha far below 1/255
    batch_blues[NO_RECORD] = 0.0;
    if (DEPTH) {
        batch_depths[NO_RECORD] = 0.0;
    }
    if (INSTANCE || CONTRIBUTIONS) {
        batch_instances[NO_RECORD] = 0u;
    }
}

// The records of a fine tile, or of the two that a subgroup of 64 lanes has: word `word`.
uint tile_word(uint tile, uint word, uint words) {
    uint bits = word < words ? tile_records[tile][word] : 0u;
    if (LANES > 32u) {
        bits |= word < words ? tile_records[tile + 1u][word] : 0u;
    }
    return bits;
}

// Index of the set bit of `bits` that has `rank` others below it.
uint place_of_bit(uint bits, uint rank) {
    uint index = 0u;
    [[unroll]] for (uint step = 16u; step > 0u; step /= 2u) {
        uint below = uint(bitCount(bits >> index & ((1u << step) - 1u)));
        bool above = rank >= below;
        rank -= above ? below : 0u;
        index += above ? step : 0u;
    }
    return index;
}

// Record `rank` of those whose bits the lanes hold: `bits` of each, and how many bits lie in the
// lanes before. Every lane calls it.
uint record_of_rank(uint rank, uint bits, uint before) {
    uint holder = 0u;
    [[unroll]] for (uint step = LANES / 2u; step > 0u; step /= 2u) {
        holder += subgroupShuffle(before, holder + step) <= rank ? step : 0u;
    }
    uint held = subgroupShuffle(bits, holder);
    return 32u * holder + place_of_bit(held, rank - subgroupShuffle(before, holder));
}

// Blocks of the subgroup whose first pixel is `first_index` that a record may reach, as bits. The
// exponent is a sum of squares of two linear functions: a block whose bounds of the two lie too far
// from zero is not reached.
uint reached_blocks(uint entry, uint first_index) {
    vec4 slants = batch_slants[entry];
    vec4 tones = batch_tones[entry];
    vec2 half_size = vec2(1.5, 0.25 * float(BLOCK_LANES) - 0.5); // from the middle of a block to its outermost pixels
    float u_extent = half_size.x * abs(slants.x) + half_size.y * abs(slants.y);
    float v_extent = half_size.y * abs(tones.x);
    float limit = tones.y + LOG2_255 + SQUARED_RADIUS_SLACK;
    uint blocks = 0u;
    [[unroll]] for (uint block = 0u; block < BLOCKS; ++block) {
        vec2 middle = vec2(pixel_offset(first_index + block * BLOCK_LANES)) + 0.5 + half_size;
        float u = max(abs(middle.x * slants.x + (middle.y * slants.y + slants.z)) - u_extent, 0.0);
        float v = max(abs(middle.y * tones.x + slants.w) - v_extent, 0.0);
        blocks |= u * u + v * v <= limit ? 1u << block : 0u;
    }
    return blocks;
}

// A staged record, as blending reads it.
struct Staged {
    vec4 slants;
    vec4 tones;
    float blue;
    float depth_m; // where it is asked for
    uint instance; // likewise
};

Staged staged_record(uint entry) {
    Staged staged = Staged(batch_slants[entry], batch_tones[entry], batch_blues[entry], 0.0, 0u);
    if (DEPTH) {
        staged.depth_m = batch_depths[entry];
    }
    if (INSTANCE || CONTRIBUTIONS) {
        staged.instance = batch_instances[entry];
    }
    return staged;
}

// The record that `lane` has.
Staged record_of_lane(Staged own, uint lane) {
    own.slants = subgroupShuffle(own.slants, lane);
    own.tones = subgroupShuffle(own.tones, lane);
    own.blue = subgroupShuffle(own.blue, lane);
    if (DEPTH) {
        own.depth_m = subgroupShuffle(own.depth_m, lane);
    }
    if (INSTANCE || CONTRIBUTIONS) {
        own.instance = subgroupShuffle(own.instance, lane);
    }
    return own;
}

// log2(alpha) of a record at two pixels, the second two columns to the right of the first, whose
// center is `at`.
vec2 log2_alphas(vec4 slants, vec4 tones, vec2 at) {
    float u = at.x * slants.x + (at.y * slants.y + slants.z);
    float u_right = u + 2.0 * slants.x;
    float v = at.y * tones.x + slants.w;
    float exponent = tones.y - v * v;
    return vec2(exponent - u * u, exponent - u_right * u_right);
}
