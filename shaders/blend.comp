#version 460
// Blends one segment of one macro tile's list, front to back, into its 64 x 32 pixels.
//
// The list is taken in batches of 256: each thread loads one record, finds which of the 32 render tiles (8 x 8 pixels) it
// can reach, and the masks are turned into one bit list a render tile. A team of 32 threads then walks the bits of its
// four render tiles, two pixels a thread, so that a splat costs only where it is. Sums are f32; the pixel decides
// alpha >= 1/255 by itself, masks only leave out what that test would refuse.
//
// A segment leaves out render tiles that the segments before it have covered, as far as these are done when it starts:
// composite stops at the same transmittance, so that the picture does not depend on who was done first.
//
// By an exclusive stop, where a pixel ends depends on all that lies before it. The first segment of a list knows that and
// stops. The others are blended to their end; composite finds the one segment in which a pixel ends, and leaves there what the
// pixel was before it. A second run, with FINISH, blends that segment again from there. The weights of splats (CONTRIBUTIONS)
// depend on what lies before them as well, and are counted in the same way.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_memory_scope_semantics : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#include "frame.glsl"
#include "footprint.glsl"
#include "record.glsl"
#include "output.glsl"

layout(local_size_x = 256) in;

layout(constant_id = 3) const float ALPHA_MAX = 0.99;
layout(constant_id = 5) const bool TEAM_HOLDS_SUBGROUPS = false; // subgroups have at most 32 lanes
layout(constant_id = 4) const bool EXCLUSIVE_STOP = false; // stop before the splat that would make a pixel full
layout(constant_id = 6) const bool CONTRIBUTIONS = false; // add up the weights of each splat; records hold its index
layout(constant_id = 7) const bool ORDER_ERROR = false; // measure by how much lists are out of order, and draw nothing
layout(constant_id = 8) const bool FINISH = false; // blend again what composite has left to be finished

layout(set = 0, binding = 5, scalar) readonly buffer needs_block { Needs needs; };
layout(set = 0, binding = 6, scalar) readonly buffer items_block { Item items[]; };
layout(set = 0, binding = 7, scalar) readonly buffer records_block { uint records[]; };
layout(set = 0, binding = 8, std430) readonly buffer footprints_block { vec4 footprints[]; };
layout(set = 0, binding = 9, std430) readonly buffer colours_block { vec4 colours[]; };
layout(set = 0, binding = 10, std430) buffer partial_colours_block { vec4 partial_colours[]; };
layout(set = 0, binding = 11, std430) buffer partial_depths_block { float partial_depths[]; };
layout(set = 0, binding = 12, std430) buffer partial_instances_block { uvec2 partial_instances[]; };

// Of each partial result, by render tile: bits of the largest transmittance it left, or 0 while that is not known.
layout(set = 0, binding = 13, scalar) buffer partial_transmittances_block { uint partial_transmittances[]; };

// Of each splat, the sum of its weights in all pixels, in steps of 1 / contribution_scale.
layout(set = 0, binding = 14, scalar) buffer contributions_block { uint contributions[]; };

// Bits of the largest order error of a pixel, and how many pixels have one above 1/255, over one item of measured_stride.
layout(set = 0, binding = 15, scalar) buffer order_error_block { uint order_error[2]; };

// Of each partial result, the render tiles with pixels that are to be finished, as bits. Only with EXCLUSIVE_STOP or CONTRIBUTIONS.
layout(set = 0, binding = 16, scalar) readonly buffer partial_unfinished_block { uint partial_unfinished[]; };

layout(push_constant, scalar) uniform push_block { vec3 sky; uint camera_count; uint items_max; float contribution_scale; uint measured_stride; uint measured_first; };

#include "batch.glsl"
#include "partial.glsl"

// A product of largest transmittances up to here means that composite stops before, its own rounding included.
float covered() {
    return EXCLUSIVE_STOP ? 0.999 * TRANSMITTANCE_MIN : 0.999 * TRANSMITTANCE_FULL;
}

// A segment that lets no more than this through holds the end of its pixel, or lies behind it.
float nothing_left() {
    return EXCLUSIVE_STOP ? covered() : TRANSMITTANCE_FULL;
}

bool stops;  // EXCLUSIVE_STOP, where all that lies before is known
bool counts; // CONTRIBUTIONS, likewise

shared uint open_tiles; // render tiles with a pixel that is not full
shared float team_transmittances[TEAMS][32];
shared uint tile_largest[32];

// What a pixel's last splat was, to be compared with the next, and what their wrong order has cost so far. Neighbours that
// stand the wrong way round change a pixel by their weights: T a_i a_j |c_i - c_j| for transmittance T before both.
struct OrderState {
    float weight;
    float depth_m;
    vec3 colour;
    float error;
};

const OrderState ORDER_STATE_EMPTY = OrderState(0.0, 0.0, vec3(0.0), 0.0);

// A thread's share of a render tile. Named, not an array: what is indexed may end up outside of registers.
struct TilePixels {
    Pixel left;
    Pixel right; // four columns to the right of the first
    bool left_full;
    bool right_full;
    OrderState left_order;
    OrderState right_order;
};

// Place in the macro tile of the thread's left pixel in its team's render tile `step`.
uvec2 left_offset(uint thread, uint step) {
    return pixel_offset(thread, 2u * step);
}

TilePixels empty_pixels(uvec2 at, uvec2 size_px) {
    // Pixels beyond the image are full from the start, or they would keep their tile open.
    bool left_full = at.x >= size_px.x || at.y >= size_px.y;
    bool right_full = at.x + 4u >= size_px.x || at.y >= size_px.y;
    TilePixels pixels =
        TilePixels(PIXEL_EMPTY, PIXEL_EMPTY, left_full, right_full, ORDER_STATE_EMPTY, ORDER_STATE_EMPTY);
    pixels.left.transmittance = left_full ? 0.0 : 1.0;
    pixels.right.transmittance = right_full ? 0.0 : 1.0;
    return pixels;
}

void note_order(inout OrderState order, float weight, float alpha, vec4 colour) {
    if (alpha > 0.0) {
        vec3 apart = abs(colour.rgb - order.colour);
        float change = order.weight * alpha * max(apart.r, max(apart.g, apart.b));
        order.error += colour.a < order.depth_m ? change : 0.0;
        order.weight = weight;
        order.depth_m = colour.a;
        order.colour = colour.rgb;
    }
}

void blend_pixel(inout Pixel pixel, inout bool full, inout OrderState order, float log2_alpha, vec4 colour, uint entry) {
    float alpha = log2_alpha >= -LOG2_255 ? min(exp2(log2_alpha), ALPHA_MAX) : 0.0;
    if (EXCLUSIVE_STOP) {
        full = full || (stops && pixel.transmittance * (1.0 - alpha) <= TRANSMITTANCE_MIN);
        alpha = full ? 0.0 : alpha;
    }
    float weight = pixel.transmittance * alpha;
    pixel.colour += weight * colour.rgb;
    pixel.transmittance -= weight;
    if (CONTRIBUTIONS && counts && weight > 0.0) {
        atomicAdd(contributions[batch_instances[entry]], uint(weight * contribution_scale + 0.5));
    }
    if (ORDER_ERROR) {
        note_order(order, weight, alpha, colour);
    }
    if (DEPTH) {
        pixel.weighted_depth += weight * colour.a;
    }
    if (INSTANCE && weight > pixel.best_weight) {
        pixel.best_weight = weight;
        pixel.best_instance = batch_instances[entry];
    }
}

// Render tiles that the segments before this one are not known to have covered.
uint uncovered_tiles(Item item, uint thread) {
    uint tile = thread % 32u;
    uint team = thread / 32u;
    float transmittance = 1.0;
    for (uint back = 1u + team; back <= item.segment; back += TEAMS) {
        uint slot = item.partial - back;
        uint bits = atomicLoad(partial_transmittances[32u * slot + tile], gl_ScopeDevice, gl_StorageSemanticsBuffer, gl_SemanticsRelaxed);
        transmittance *= bits == 0u ? 1.0 : uintBitsToFloat(bits);
    }
    team_transmittances[team][tile] = transmittance;
    if (thread == 0u) {
        open_tiles = 0u;
    }
    barrier();
    if (thread < 32u) {
        for (uint other = 1u; other < TEAMS; ++other) {
            transmittance *= team_transmittances[other][tile];
        }
        atomicOr(open_tiles, transmittance > covered() ? 1u << tile : 0u);
    }
    barrier();
    return open_tiles;
}

// What a pixel lets through to what lies behind the segment.
float left_through(Pixel pixel, bool full) {
    return EXCLUSIVE_STOP && full ? 0.0 : pixel.transmittance;
}

// Blends what the batch holds for the team's render tile `step`; says whether a pixel of the thread is still open.
bool blend_tile(inout TilePixels pixels, uint thread, uint step) {
    uint tile = thread / TEAM + TEAMS * step;
    vec2 at = vec2(left_offset(thread, step)) + 0.5;
    for (uint word = 0u; word < BATCH_WORDS; ++word) {
        uint bits = tile_records[tile][word];
        if (TEAM_HOLDS_SUBGROUPS) {
            bits = subgroupBroadcastFirst(bits); // the same for all: tells the compiler so
        }
        while (bits != 0u) {
            uint entry = word * 32u + findLSB(bits);
            bits &= bits - 1u;
            // No branch where a record adds nothing: that would cost more than the arithmetic it saves.
            vec2 log2_alpha = log2_alphas(entry, at);
            vec4 colour = batch_colours[entry];
            blend_pixel(pixels.left, pixels.left_full, pixels.left_order, log2_alpha.x, colour, entry);
            blend_pixel(pixels.right, pixels.right_full, pixels.right_order, log2_alpha.y, colour, entry);
        }
    }
    return max(left_through(pixels.left, pixels.left_full), left_through(pixels.right, pixels.right_full)) > nothing_left();
}

void write_partial(uint place, Pixel pixel, bool full) {
    // Negative: the pixel ends here.
    pixel.transmittance = EXCLUSIVE_STOP && full ? -pixel.transmittance : pixel.transmittance;
    store_partial(place, pixel);
}

void write_order_error(float error) {
    if (error > 0.0) {
        atomicMax(order_error[0], floatBitsToUint(error)); // positive floats order as their bits
        if (error > 1.0 / 255.0) {
            atomicAdd(order_error[1], 1u);
        }
    }
}

// What lies before the pixel's segment, or a full pixel if there is nothing to finish in it.
Pixel unfinished_pixel(uint place, out bool full) {
    Pixel pixel = load_partial(place);
    full = !(pixel.transmittance < 0.0);
    pixel.transmittance = full ? 0.0 : -pixel.transmittance;
    return pixel;
}

uint partial_place(Item item, uint thread, uint step) {
    return item.partial * MACRO_PIXELS + 2u * step * BATCH + thread;
}

// The thread's pixels of render tile `step` before the segment is blended.
TilePixels first_pixels(Item item, uvec2 at, uvec2 size_px, uint thread, uint step) {
    TilePixels pixels = empty_pixels(at, size_px);
    if (FINISH) {
        uint place = partial_place(item, thread, step);
        pixels.left = unfinished_pixel(place, pixels.left_full);
        pixels.right = unfinished_pixel(place + BATCH, pixels.right_full);
    }
    return pixels;
}

void write_result(Item item, Camera camera, uvec2 origin, uint thread, uint step, TilePixels pixels) {
    if (ORDER_ERROR) {
        write_order_error(pixels.left_order.error);
        write_order_error(pixels.right_order.error);
        return;
    }
    uvec2 at = origin + left_offset(thread, step);
    if (FINISH) {
        // Composite has written the pixel as it is without an end in this segment, and pixels that were full before keep that.
        if (pixels.left_full && pixels.left.transmittance > 0.0) {
            write_pixel(camera, at, pixels.left, sky);
        }
        if (pixels.right_full && pixels.right.transmittance > 0.0) {
            write_pixel(camera, at + uvec2(4u, 0u), pixels.right, sky);
        }
    } else if (item.partial == NO_PARTIAL) {
        write_pixel(camera, at, pixels.left, sky);
        write_pixel(camera, at + uvec2(4u, 0u), pixels.right, sky);
    } else {
        uint place = partial_place(item, thread, step);
        write_partial(place, pixels.left, pixels.left_full);
        write_partial(place + BATCH, pixels.right, pixels.right_full);
        // Positive floats order as their bits.
        float through = max(left_through(pixels.left, pixels.left_full), left_through(pixels.right, pixels.right_full));
        uint largest = floatBitsToUint(through);
        atomicMax(tile_largest[thread / TEAM + TEAMS * step], largest);
    }
}

void main() {
    uint item_index = group_index();
    if (item_index >= min(needs.items, items_max) || (ORDER_ERROR && item_index % measured_stride != measured_first)) {
        return;
    }
    Item item = items[item_index];
    Camera camera = cameras[camera_of_bin(item.bin, camera_count)];
    uvec2 origin = macro_tile_origin(item.bin, camera);
    uint thread = gl_LocalInvocationIndex;
    if (thread < 32u) {
        tile_largest[thread] = 1u; // 0 would mean that it is not known
    }
    if (EXCLUSIVE_STOP || CONTRIBUTIONS) {
        bool starts = FINISH || item.segment == 0u;
        stops = EXCLUSIVE_STOP && (starts || ORDER_ERROR);
        counts = CONTRIBUTIONS && starts;
    }
    if (FINISH) {
        uint unfinished = item.partial == NO_PARTIAL ? 0u : partial_unfinished[item.partial];
        if (unfinished == 0u) {
            return;
        }
        if (thread == 0u) {
            open_tiles = unfinished;
        }
    } else if (item.segment > 0u && !ORDER_ERROR) {
        if (uncovered_tiles(item, thread) == 0u) {
            return; // composite stops before it gets here
        }
    } else if (thread == 0u) {
        open_tiles = 0xffffffffu;
    }
    TilePixels pixels0 = first_pixels(item, origin + left_offset(thread, 0u), camera.size_px, thread, 0u);
    TilePixels pixels1 = first_pixels(item, origin + left_offset(thread, 1u), camera.size_px, thread, 1u);
    TilePixels pixels2 = first_pixels(item, origin + left_offset(thread, 2u), camera.size_px, thread, 2u);
    TilePixels pixels3 = first_pixels(item, origin + left_offset(thread, 3u), camera.size_px, thread, 3u);
    uint tile = thread / TEAM;
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
        if ((open >> tile & 1u) != 0u && blend_tile(pixels0, thread, 0u)) {
            still_open |= 1u;
        }
        if ((open >> (tile + TEAMS) & 1u) != 0u && blend_tile(pixels1, thread, 1u)) {
            still_open |= 1u << TEAMS;
        }
        if ((open >> (tile + 2u * TEAMS) & 1u) != 0u && blend_tile(pixels2, thread, 2u)) {
            still_open |= 1u << (2u * TEAMS);
        }
        if ((open >> (tile + 3u * TEAMS) & 1u) != 0u && blend_tile(pixels3, thread, 3u)) {
            still_open |= 1u << (3u * TEAMS);
        }
        // Not by way of subgroupOr and subgroupElect: lanes whose pixels are full take another path here, and NVIDIA's driver
        // (580.159) then lost the bits of those that are open.
        atomicOr(open_tiles, still_open << tile);
    }
    write_result(item, camera, origin, thread, 0u, pixels0);
    write_result(item, camera, origin, thread, 1u, pixels1);
    write_result(item, camera, origin, thread, 2u, pixels2);
    write_result(item, camera, origin, thread, 3u, pixels3);
    if (item.partial != NO_PARTIAL && !ORDER_ERROR && !FINISH) {
        // Tells later segments of the tile how much this one lets through.
        barrier();
        if (thread < 32u) {
            uint place = 32u * item.partial + thread;
            atomicStore(partial_transmittances[place], tile_largest[thread], gl_ScopeDevice, gl_StorageSemanticsBuffer, gl_SemanticsRelaxed);
        }
    }
}
