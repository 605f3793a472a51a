// What blend knows of the records that it has at hand: a batch of them, staged in shared memory.
//
// Included by blend.comp, whose buffers it reads.

const uint BATCH = BLEND_THREADS;
const uint BATCH_WORDS = BATCH / 32u;

// The exponent of a record at (x, y), relative to the macro tile: log2_opacity - (x * slants.x + y * slants.y + slants.z)^2
// - (y * fades.x + slants.w)^2, log2_opacity being fades.y.
shared vec4 batch_slants[BATCH];
shared vec2 batch_fades[BATCH];
shared vec4 batch_colours[BATCH]; // and depth
shared uint batch_instances[INSTANCE || CONTRIBUTIONS ? BATCH : 1u];
shared uint batch_tiles[BATCH];            // render tiles each record of the batch can reach
shared uint tile_records[32][BATCH_WORDS]; // the same by render tile

// Render tiles of the macro tile at `origin` that the splat can reach, as bits row * 8 + column.
uint reached_render_tiles(Footprint splat, uvec2 origin, uvec2 size_px) {
    uint mask = 0u;
    ivec2 rows = max(reached_rows(splat, size_px.y) - int(origin.y), ivec2(0, -1));
    rows = min(rows, int(MACRO_HEIGHT_PX) - 1) / int(RENDER_TILE_PX);
    for (int row = rows.x; row <= rows.y; ++row) {
        float top = float(origin.y + uint(row) * RENDER_TILE_PX);
        ivec2 columns = reached_columns(splat, top + 0.5, top + float(RENDER_TILE_PX) - 0.5, size_px.x) - int(origin.x);
        if (columns.x > columns.y || columns.y < 0 || columns.x >= int(MACRO_WIDTH_PX)) {
            continue;
        }
        uint first = uint(max(columns.x, 0)) / RENDER_TILE_PX;
        uint last = min(uint(columns.y) / RENDER_TILE_PX, MACRO_COLUMNS - 1u);
        mask |= ((2u << last) - (1u << first)) << (uint(row) * MACRO_COLUMNS);
    }
    return mask;
}

void load_batch(uint first, uint count, uint thread, uvec2 origin, uvec2 size_px) {
    uint tiles = 0u;
    if (thread < count) {
        uint record = records[first + thread];
        vec4 low = footprints[2u * record];
        vec4 high = footprints[2u * record + 1u];
        Footprint splat = unpack_footprint(low, high);
        tiles = reached_render_tiles(splat, origin, size_px);
        vec2 mean = splat.mean_px - vec2(origin);
        float sheared_x = mean.x - splat.slope * mean.y;
        batch_slants[thread] = vec4(splat.rate_x, -splat.slope * splat.rate_x, -sheared_x * splat.rate_x, -mean.y * splat.rate_y);
        batch_fades[thread] = vec2(splat.rate_y, splat.log2_opacity);
        batch_colours[thread] = vec4(colours[record].rgb, high.z);
        if (INSTANCE || CONTRIBUTIONS) {
            batch_instances[thread] = floatBitsToUint(high.w);
        }
    }
    batch_tiles[thread] = tiles;
}

// Thread (word, tile) gathers one bit from each of the word's 32 records.
void turn_masks(uint thread) {
    uint tile = thread % 32u;
    uint word = thread / 32u;
    uint bits = 0u;
    for (uint bit = 0u; bit < 32u; ++bit) {
        bits |= (batch_tiles[word * 32u + bit] >> tile & 1u) << bit;
    }
    tile_records[tile][word] = bits;
}

// log2(alpha) of a record at two pixels, the second four columns to the right of the first, whose centre is `at`.
vec2 log2_alphas(uint entry, vec2 at) {
    vec4 slants = batch_slants[entry];
    vec2 fades = batch_fades[entry];
    float u = at.x * slants.x + (at.y * slants.y + slants.z);
    float u_right = u + 4.0 * slants.x;
    float v = at.y * fades.x + slants.w;
    float exponent = fades.y - v * v;
    return vec2(exponent - u * u, exponent - u_right * u_right);
}
