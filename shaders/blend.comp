#version 460
// Blends one segment of one macro tile's list, front to back, into its 64 x 32 pixels.
//
// The list is taken in batches of 256: each thread loads one record, finds which of the 32 render tiles (8 x 8 pixels) it
// can reach, and the masks are turned into one bit list a render tile. A team of 32 threads then walks the bits of its
// four render tiles, two pixels a thread, so that a splat costs only where it is. Sums are f32; the pixel decides
// alpha >= 1/255 by itself, masks only leave out what that test would refuse.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#include "frame.glsl"
#include "footprint.glsl"
#include "record.glsl"
#include "output.glsl"

layout(local_size_x = 256) in;

layout(constant_id = 3) const float ALPHA_MAX = 0.99;
layout(constant_id = 4) const bool EXCLUSIVE_STOP = false; // stop before the splat that would make a pixel full

layout(set = 0, binding = 5, scalar) readonly buffer needs_block { Needs needs; };
layout(set = 0, binding = 6, scalar) readonly buffer items_block { Item items[]; };
layout(set = 0, binding = 7, scalar) readonly buffer records_block { uint records[]; };
layout(set = 0, binding = 8, std430) readonly buffer footprints_block { vec4 footprints[]; };
layout(set = 0, binding = 9, std430) readonly buffer colours_block { vec4 colours[]; };
layout(set = 0, binding = 10, std430) writeonly buffer partial_colours_block { vec4 partial_colours[]; };
layout(set = 0, binding = 11, std430) writeonly buffer partial_depths_block { float partial_depths[]; };
layout(set = 0, binding = 12, std430) writeonly buffer partial_instances_block { uvec2 partial_instances[]; };

layout(push_constant, scalar) uniform push_block { vec3 sky; uint camera_count; uint items_max; };

const uint BATCH = BLEND_THREADS;
const uint BATCH_WORDS = BATCH / 32u;
const float TRANSMITTANCE_MIN = 1e-4;

shared vec4 batch_low[BATCH];
shared vec4 batch_high[BATCH];
shared vec4 batch_colour[BATCH];
shared uint batch_tiles[BATCH];            // render tiles each record of the batch can reach
shared uint tile_records[32][BATCH_WORDS]; // the same by render tile
shared uint open_tiles;                    // render tiles with a pixel that is not full

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
        tiles = reached_render_tiles(unpack_footprint(low, high), origin, size_px);
        batch_low[thread] = low;
        batch_high[thread] = high;
        batch_colour[thread] = colours[record];
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

// Adds one splat to a pixel at horizontal distance dx from its mean; `shear` is slope * dy, `exponent` what dy leaves.
void blend_pixel(inout Pixel pixel, inout bool full, float dx, float shear, float rate_x, float exponent, uint entry) {
    float u = (dx - shear) * rate_x;
    float log2_alpha = exponent - u * u;
    if (log2_alpha < -LOG2_255 || (EXCLUSIVE_STOP && full)) {
        return;
    }
    float alpha = min(exp2(log2_alpha), ALPHA_MAX);
    if (EXCLUSIVE_STOP && pixel.transmittance * (1.0 - alpha) <= TRANSMITTANCE_MIN) {
        full = true;
        return;
    }
    float weight = pixel.transmittance * alpha;
    pixel.colour += weight * batch_colour[entry].rgb;
    pixel.transmittance -= weight;
    if (DEPTH) {
        pixel.weighted_depth += weight * batch_high[entry].z;
    }
    if (INSTANCE && weight > pixel.best_weight) {
        pixel.best_weight = weight;
        pixel.best_instance = floatBitsToUint(batch_high[entry].w);
    }
}

void write_result(Item item, Camera camera, uvec2 origin, uint thread, Pixel pixels[PIXELS]) {
    [[unroll]] for (uint index = 0u; index < PIXELS; ++index) {
        if (item.partial == NO_PARTIAL) {
            write_pixel(camera, origin + pixel_offset(thread, index), pixels[index], sky);
        } else {
            uint place = item.partial * MACRO_PIXELS + index * BATCH + thread;
            partial_colours[place] = vec4(pixels[index].colour, pixels[index].transmittance);
            if (DEPTH) {
                partial_depths[place] = pixels[index].weighted_depth;
            }
            if (INSTANCE) {
                partial_instances[place] = uvec2(floatBitsToUint(pixels[index].best_weight), pixels[index].best_instance);
            }
        }
    }
}

void main() {
    uint item_index = group_index();
    if (item_index >= min(needs.items, items_max)) {
        return;
    }
    Item item = items[item_index];
    Camera camera = cameras[camera_of_bin(item.bin, camera_count)];
    uvec2 origin = macro_tile_origin(item.bin, camera);
    uint thread = gl_LocalInvocationIndex;

    Pixel pixels[PIXELS];
    bool full[PIXELS];
    [[unroll]] for (uint index = 0u; index < PIXELS; ++index) {
        pixels[index] = PIXEL_EMPTY;
        full[index] = false;
    }
    if (thread == 0u) {
        open_tiles = 0xffffffffu;
    }
    for (uint done = 0u; done < item.pairs; done += BATCH) {
        barrier(); // the batch before is read to its end, and open_tiles is written
        uint open = open_tiles;
        if (open == 0u) {
            break;
        }
        load_batch(item.first_pair + done, min(BATCH, item.pairs - done), thread, origin, camera.size_px);
        barrier();
        turn_masks(thread);
        if (thread == 0u) {
            open_tiles = 0u;
        }
        barrier();
        uint still_open = 0u;
        [[unroll]] for (uint step = 0u; step < TILES_A_TEAM; ++step) {
            uint tile = thread / TEAM + TEAMS * step;
            if ((open >> tile & 1u) == 0u) {
                continue;
            }
            vec2 centre = vec2(origin + pixel_offset(thread, 2u * step)) + 0.5;
            for (uint word = 0u; word < BATCH_WORDS; ++word) {
                uint bits = tile_records[tile][word];
                while (bits != 0u) {
                    uint entry = word * 32u + findLSB(bits);
                    bits &= bits - 1u;
                    vec4 low = batch_low[entry];
                    vec2 high = batch_high[entry].xy;
                    vec2 d = centre - low.xy;
                    float shear = low.z * d.y;
                    float v = d.y * high.x;
                    float exponent = high.y - v * v;
                    blend_pixel(pixels[2u * step], full[2u * step], d.x, shear, low.w, exponent, entry);
                    blend_pixel(pixels[2u * step + 1u], full[2u * step + 1u], d.x + 4.0, shear, low.w, exponent, entry);
                }
            }
            bool open_left = EXCLUSIVE_STOP ? !full[2u * step] : pixels[2u * step].transmittance > TRANSMITTANCE_MIN;
            bool open_right = EXCLUSIVE_STOP ? !full[2u * step + 1u] : pixels[2u * step + 1u].transmittance > TRANSMITTANCE_MIN;
            still_open |= open_left || open_right ? 1u << tile : 0u;
        }
        still_open = subgroupOr(still_open);
        if (subgroupElect()) {
            atomicOr(open_tiles, still_open);
        }
    }
    write_result(item, camera, origin, thread, pixels);
}
