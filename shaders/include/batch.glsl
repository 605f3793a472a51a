// Records of a batch by fine tile, and the few that a subgroup blends next.
//
// Included by blend.comp, whose buffers it reads.
//
// All of it together is less than a fourth of 48 KB: what NVIDIA gives a multiprocessor in Vulkan.

const uint SUBGROUPS = THREADS / LANES;
const uint SHARES = LEFT_PIXELS / LANES; // of a coarse tile, for a subgroup each: two pixels per lane

// Records that are listed by fine tile at a time. An odd number of words keeps tiles out of each
// other's memory bank.
const uint BATCH = 992u;
const uint BATCH_WORDS = BATCH / 32u;

const uint ROUND = LANES < 32u ? LANES : 32u; // records that a subgroup reads together
const uint PARTS = LANES < 32u ? 32u / LANES : 1u; // of a word, a subgroup's lanes each
const uint WORDS_LISTED = LANES > 32u ? LANES / 32u : 1u; // by a subgroup at a time

// Pixels of a share.
const uvec2 SHARE_PX = uvec2(LANES > 32u ? 16u : LANES > 8u ? 8u : 4u, LANES > 16u ? 8u : LANES > 4u ? 4u : 2u);

// Records that a subgroup blends next, a place per lane. The exponent of a record at (x, y),
// relative to the fine tile: log2_share - (x * slants.x + y * slants.y + slants.z)^2
// - (y * rate_y + slants.w)^2. `tones` is rate_y, log2_share, red and green: the opacity over
// ALPHA_MAX, and colors times ALPHA_MAX. All else of a record stays in the registers of the lane
// that read it.
shared vec4 place_slants[THREADS];
shared vec4 place_tones[THREADS];

// Records of each fine tile, one bit each.
shared uint tile_records[32][BATCH_WORDS];

shared uint drawn_tiles; // fine tiles with records in the segment

// Fine tiles of the coarse tile at `origin` that the splat can reach, as bits row * 8 + column.
uint reached_fine_tiles(Footprint splat, uvec2 origin, uvec2 size_px) {
    uint mask = 0u;
    ivec2 rows = max(reached_rows(splat, size_px.y) - int(origin.y), ivec2(0, -1));
    rows = min(rows, int(COARSE_HEIGHT_PX) - 1) / int(FINE_TILE_PX);
    Edges edges = edges_of(splat);
    for (int row = rows.x; row <= rows.y; ++row) {
        float top = float(origin.y + uint(row) * FINE_TILE_PX);
        ivec2 columns = reached_columns(splat, edges, top + 0.5, top + float(FINE_TILE_PX) - 0.5, size_px.x) - int(origin.x);
        if (columns.x > columns.y || columns.y < 0 || columns.x >= int(COARSE_WIDTH_PX)) {
            continue;
        }
        uint first = uint(max(columns.x, 0)) / FINE_TILE_PX;
        uint last = min(uint(columns.y) / FINE_TILE_PX, COARSE_COLUMNS - 1u);
        mask |= ((2u << last) - (1u << first)) << (uint(row) * COARSE_COLUMNS);
    }
    return mask;
}

// Fine tiles that entry `entry` of the batch can reach; none behind its end. The batch has `count`
// records, from entry `first` of the lists on.
uint listed_tiles(uint first, uint count, uint entry, uvec2 origin, uvec2 size_px, uint mean_shift) {
    if (entry >= count) {
        return 0u;
    }
    uint record = records[first + entry];
    return reached_fine_tiles(unpack_footprint(footprints[2u * record], footprints[2u * record + 1u], mean_shift), origin, size_px);
}

// Word `lane` of the transposed bits of 32 lanes: bit b of lane l becomes bit l of lane b. Every
// lane calls it.
uint transposed(uint bits, uint lane) {
    [[unroll]] for (uint step = 16u; step > 0u; step /= 2u) {
        uint low = 0xffffffffu / ((1u << step) + 1u); // bits whose number lacks the step
        uint other = subgroupShuffleXor(bits, step);
        bits = (lane & step) == 0u ? (bits & low) | (other & low) << step : (bits & ~low) | (other >> step & low);
    }
    return bits;
}

// Lists `count` records, which begin at entry `first` of the lists, by fine tile. A barrier must
// follow.
//
// A subgroup takes 32 records at a time, or as many as it has lanes: their masks are turned into
// one word per tile, where there are 32 lanes by exchanges, else by ballots.
void list_records(uint first, uint count, uvec2 origin, uvec2 size_px, uint mean_shift) {
    uint lane = gl_SubgroupInvocationID;
    uint words = (count + 31u) / 32u;
    uint drawn = 0u;
    for (uint word = gl_LocalInvocationIndex / LANES * WORDS_LISTED; word < words; word += SUBGROUPS * WORDS_LISTED) {
        uint masks[PARTS];
        [[unroll]] for (uint part = 0u; part < PARTS; ++part) {
            masks[part] = listed_tiles(first, count, 32u * word + part * LANES + lane, origin, size_px, mean_shift);
        }
        if (LANES == 32u) {
            uint kept = transposed(masks[0], lane);
            tile_records[lane][word] = kept;
            drawn |= subgroupBallot(kept != 0u).x;
            continue;
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
            uvec4 some = subgroupBallot(kept != 0u);
            drawn |= (some.x | some.y) << first_tile;
        }
    }
    if (lane == 0u) {
        atomicOr(drawn_tiles, drawn);
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

// A record as its pixels need it, relative to a fine tile.
struct Staged {
    vec4 slants;
    vec4 tones;
    float blue;
    float depth_m; // where it is asked for
    uint instance; // likewise
    uint record; // where attributes or medians are asked for
};

// Record `record` relative to the pixel `origin` of the image.
Staged read_record(uint record, uvec2 origin, uint mean_shift) {
    uvec4 low = footprints[2u * record];
    uvec4 high = footprints[2u * record + 1u];
    vec4 rest = uintBitsToFloat(uvec4(low.zw, high.xy)); // slope, rates, log2 of the opacity
    vec3 color = ALPHA_MAX * unpack_record_color(high);
    vec2 mean = unpack_mean(low.xy, origin, mean_shift);
    float sheared_x = mean.x - rest.x * mean.y;
    Staged staged = Staged(vec4(rest.y, -rest.x * rest.y, -sheared_x * rest.y, -mean.y * rest.z), vec4(rest.z, rest.w - LOG2_ALPHA_MAX, color.rg), color.b, 0.0, 0u, record);
    if (DEPTH || INSTANCE || CONTRIBUTIONS) {
        uvec2 label = labels[record];
        staged.depth_m = uintBitsToFloat(label.x);
        staged.instance = label.y;
    }
    return staged;
}

// Puts what the subgroup's lanes have read where all of them can see it. A subgroup barrier must
// follow.
void place_record(uint place, Staged own) {
    place_slants[place] = own.slants;
    place_tones[place] = own.tones;
}

// The record that lane `lane` has read and placed: `own` is what each lane has read.
Staged placed_record(uint first_place, uint lane, Staged own) {
    own.slants = place_slants[first_place + lane];
    own.tones = place_tones[first_place + lane];
    own.blue = subgroupShuffle(own.blue, lane);
    if (DEPTH) {
        own.depth_m = subgroupShuffle(own.depth_m, lane);
    }
    if (INSTANCE || CONTRIBUTIONS) {
        own.instance = subgroupShuffle(own.instance, lane);
    }
    if (ATTRIBUTE_VECTORS > 0u || MEDIANS) {
        own.record = subgroupShuffle(own.record, lane);
    }
    return own;
}

// True if the record may reach the share whose first pixel lies at `corner` of its fine tile. The
// exponent is a sum of squares of two linear functions: a share whose bounds of the two lie too far
// from zero is not reached.
bool reaches_share(Staged staged, vec2 corner) {
    vec2 half_size = 0.5 * vec2(SHARE_PX) - 0.5; // from the middle to the outermost pixels
    vec2 middle = corner + 0.5 * vec2(SHARE_PX);
    float u_extent = half_size.x * abs(staged.slants.x) + half_size.y * abs(staged.slants.y);
    float v_extent = half_size.y * abs(staged.tones.x);
    float u = max(abs(middle.x * staged.slants.x + (middle.y * staged.slants.y + staged.slants.z)) - u_extent, 0.0);
    float v = max(abs(middle.y * staged.tones.x + staged.slants.w) - v_extent, 0.0);
    return u * u + v * v <= squared_radius(staged.tones.y + LOG2_ALPHA_MAX) + SQUARED_RADIUS_SLACK;
}

// log2(alpha / ALPHA_MAX) of a record at two pixels, the second two columns to the right of the
// first, whose center is `at`.
vec2 log2_shares(vec4 slants, vec4 tones, vec2 at) {
    float u = at.x * slants.x + (at.y * slants.y + slants.z);
    float u_right = u + 2.0 * slants.x;
    float v = at.y * tones.x + slants.w;
    float exponent = tones.y - v * v;
    return vec2(exponent - u * u, exponent - u_right * u_right);
}
