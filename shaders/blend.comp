#version 460
// Alpha compositing: blends one segment of one coarse tile's list, front to back, into its 64 x 32
// pixels. Early termination: a saturated fine tile takes no more splats.
//
// The list is taken in batches. Each thread finds which of the 32 fine tiles (8 x 8 pixels) some
// records can reach; the masks are turned into one bit list per fine tile. Then every subgroup
// works by itself: its lanes read a round of the records of its fine tile, a record each, place
// them in shared memory, and all lanes blend one after the other, two pixels per lane. Threads wait
// for each other only while a batch is listed. Sums are f32; the pixel decides alpha >= 1/255 by
// itself, lists only leave out what that test would refuse.
//
// Where a segment is one batch, subgroups take their shares of the coarse tile from a counter, and
// one that meets few records takes more of them. Where it is several, each keeps four shares in
// registers from batch to batch.
//
// A segment leaves out fine tiles that the segments before it have covered, as far as these are
// done when it starts: composite stops at the same transmittance, so that the image does not depend
// on who was done first.
//
// By an early stop, where a pixel ends depends on all that lies before it. The first segment of
// a list knows that and stops. The others are blended to their end; composite finds the one segment
// in which a pixel ends, and leaves there what the pixel was before it. A second run, with FINISH,
// blends that segment again from there. The weights of splats (CONTRIBUTIONS) depend on what lies
// before them as well, and are counted in the same way. So are medians found (FINISH_MEDIANS) where
// something lies before the segment in which half of the light goes.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_memory_scope_semantics : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require
#extension GL_KHR_shader_subgroup_vote : require
#include "frame.glsl"
#include "footprint.glsl"
#include "color_code.glsl"
#include "mean_px.glsl"
#include "record.glsl"
#include "output.glsl"

const uint THREADS = 256u;
layout(local_size_x = 256) in;

layout(constant_id = 3) const float ALPHA_MAX = 0.99;
layout(constant_id = 12) const float LOG2_ALPHA_MAX = -0.014499569;
layout(constant_id = 4) const bool EARLY_STOP = false; // stop before the splat that would make a pixel full
layout(constant_id = 11) const bool INCLUSIVE_STOP = false; // with EARLY_STOP: stop behind that splat
layout(constant_id = 5) const uint LANES = 32u; // of a subgroup: 4 to 64
layout(constant_id = 6) const bool CONTRIBUTIONS = false; // add up the weights of each splat; records hold its index
layout(constant_id = 7) const bool FINISH = false; // blend again what composite has left to be finished
layout(constant_id = 8) const bool ONE_BATCH = false; // no segment is longer than a batch
layout(constant_id = 9) const bool FINISH_MEDIANS = false; // with FINISH: find the medians that composite has left

layout(set = 0, binding = 5, scalar) buffer required_block { RequiredCounts required; };
layout(set = 0, binding = 6, scalar) readonly buffer items_block { BlendItem items[]; };
layout(set = 0, binding = 7, scalar) readonly buffer records_block { uint records[]; };
layout(set = 0, binding = 8, std430) readonly buffer footprints_block { uvec4 footprints[]; };
layout(set = 0, binding = 9, std430) readonly buffer attributes_block { vec4 attributes[]; }; // ATTRIBUTE_VECTORS a record
layout(set = 0, binding = 10, scalar) buffer partial_colors_block { uint partial_colors[]; };
layout(set = 0, binding = 11, std430) buffer partial_planes_block { uint partial_planes[]; };

// Of each record, where planes or contributions need them: bits of the depth, and the instance.
layout(set = 0, binding = 12, std430) readonly buffer labels_block { uvec2 labels[]; };

// Per partial result and fine tile: bits of the largest transmittance that it left, or 0 while
// that is not known.
layout(set = 0, binding = 13, scalar) buffer partial_transmittances_block { uint partial_transmittances[]; };

// Per splat: the sum of its weights in all pixels, in steps of 1 / contribution_scale.
layout(set = 0, binding = 14, scalar) buffer contributions_block { uint contributions[]; };

// Per partial result: the fine tiles with pixels that are to be finished, as bits. With FINISH.
layout(set = 0, binding = 15, scalar) readonly buffer partial_unfinished_block { uint partial_unfinished[]; };

// Per partial result: the fine tiles that have one. Written by the first run, read by FINISH.
layout(set = 0, binding = 16, scalar) buffer partial_tiles_block { PartialTiles partial_tiles[]; };

// Of each record, with MEDIANS: depth and range, meters.
layout(set = 0, binding = 17, std430) readonly buffer depths_block { vec2 depths[]; };

// Per pixel of a partial result, with MEDIANS: the record in which half of the light is gone, or
// bits of a negative transmittance: what is left before the segment that has the median.
layout(set = 0, binding = 18, scalar) buffer partial_medians_block { uint partial_medians[]; };

layout(push_constant, scalar) uniform push_block { vec3 sky; uint camera_count; uint items_max; uint tiles_max; float contribution_scale; uint image_pixels; };

#include "bit_list.glsl"
#include "batch.glsl"
#include "partial.glsl"
#include "lane_pixels.glsl"

shared uint open_tiles; // fine tiles that the segments before have not covered
shared uint open_subgroups; // whether one of them has a pixel that is not full
shared uint next_share;
shared PartialTiles held_tiles;

// Largest transmittance by fine tile, bits. A subgroup of 32 lanes has a fine tile for itself, and
// needs none.
const bool WHOLE_TILES = LANES == 32u;
shared uint tile_largest[WHOLE_TILES ? 1u : 32u];

// Fine tiles that the segments before this one are not known to have covered. Every thread of the
// workgroup calls it.
uint uncovered_tiles(BlendItem item, uint thread) {
    uint tile = thread % 32u;
    uint row = thread / 32u;
    uint rows = THREADS / 32u;
    float transmittance = 1.0;
    for (uint back = 1u + row; back <= item.segment; back += rows) {
        uint slot = item.partial - back;
        uint bits = atomicLoad(partial_transmittances[32u * slot + tile], gl_ScopeDevice, gl_StorageSemanticsBuffer, gl_SemanticsRelaxed);
        transmittance *= bits == 0u ? 1.0 : uintBitsToFloat(bits);
    }
    place_slants[thread].x = transmittance;
    if (thread == 0u) {
        open_tiles = 0u;
    }
    barrier();
    if (thread < 32u) {
        for (uint other = 1u; other < rows; ++other) {
            transmittance *= place_slants[32u * other + tile].x;
        }
        atomicOr(open_tiles, transmittance > covered() ? 1u << tile : 0u);
    }
    barrier();
    return open_tiles;
}

// Blends the placed records of the lanes in `lanes`, one bit each and all below ROUND. Every lane
// calls it; `own` is the record that it has read.
void blend_placed(inout LanePixels pixels, vec2 at, uint first_place, uint lanes, Staged own) {
    for (; lanes != 0u; lanes &= lanes - 1u) {
        blend_record(pixels, at, placed_record(first_place, uint(findLSB(lanes)), own));
    }
}

// Records that are blended per turn of the loop.
const uint UNROLLED = 4u;

// Blends the placed records of the first `count` lanes, likewise. The lanes behind them up to a
// multiple of UNROLLED have placed records that add nothing.
void blend_first_placed(inout LanePixels pixels, vec2 at, uint first_place, uint count, Staged own) {
    for (uint first = 0u; first < count; first += UNROLLED) {
        [[unroll]] for (uint next = 0u; next < UNROLLED; ++next) {
            blend_record(pixels, at, placed_record(first_place, first + next, own));
        }
    }
}

// Blends the batch of `batch_records` from entry `first` of the lists on into the subgroup's share
// that begins at `first_index` of the coarse tile at `coarse_origin`; false once all its pixels are
// full. Every lane calls it.
bool blend_share(inout LanePixels pixels, uint first_index, uint first, uint batch_records, uvec2 coarse_origin, uint mean_shift) {
    uint lane = gl_SubgroupInvocationID;
    uint first_place = gl_LocalInvocationIndex / LANES * LANES;
    uint tile = fine_tile(first_index);
    uvec2 tile_offset = uvec2(tile % COARSE_COLUMNS, tile / COARSE_COLUMNS) * FINE_TILE_PX;
    vec2 corner = vec2(pixel_offset(first_index) - tile_offset);
    vec2 at = vec2(pixel_offset(first_index + lane) - tile_offset) + 0.5;
    uint words = (batch_records + 31u) / 32u;
    bool open = true;
    for (uint first_word = 0u; first_word < words && open; first_word += LANES) {
        uint bits = tile_word(tile, first_word + lane, words);
        uint count = uint(bitCount(bits));
        uint before = subgroupInclusiveAdd(count);
        uint candidates = subgroupBroadcast(before, LANES - 1u);
        before -= count;
        for (uint done = 0u; done < candidates && open; done += ROUND) {
            uint entry = 32u * first_word + entry_of_rank(done + lane, bits, before);
            bool some = lane < ROUND && done + lane < candidates;
            Staged own = read_record(records[first + (some ? entry : 0u)], coarse_origin + tile_offset, mean_shift);
            own.tones.y = some ? own.tones.y : -1e3; // of an alpha far below 1/255
            if (lane < ROUND) {
                place_record(first_place + lane, own);
            }
            subgroupBarrier(); // the records are placed
            if (LANES < 32u) {
                // Shares are smaller than the tile that records are listed for.
                uint reaching = subgroupBallot(some && reaches_share(own, corner)).x;
                blend_placed(pixels, at, first_place, reaching, own);
            } else {
                blend_first_placed(pixels, at, first_place, min(candidates - done, ROUND), own);
            }
            subgroupBarrier(); // they are read, and places may be written again
            float through = max(left_through(pixels.left, pixels.left_full), left_through(pixels.right, pixels.right_full));
            open = subgroupAny(through > nothing_left());
        }
    }
    return open;
}

// True if the segment's result goes through a partial result that this run writes.
bool writes_partial(BlendItem item) {
    return !FINISH && item.partial != NO_PARTIAL;
}

// Finds room for the results of `tiles`, and writes where it is. One thread calls it. Without room
// there are no results: the host grows the buffers and draws again.
PartialTiles hold_tiles(BlendItem item, uint tiles) {
    uint count = uint(bitCount(tiles));
    PartialTiles held = PartialTiles(0u, 0u);
    if (count > 0u) {
        held.first = atomicAdd(required.next_tile, count);
        held.tiles = held.first + count <= tiles_max ? tiles : 0u;
        atomicMax(required.tiles, held.first + count);
    }
    partial_tiles[item.partial] = held;
    return held;
}

// Finds room for the results of those of `tiles` that have records. Every thread of the workgroup
// calls it, behind a barrier.
void hold_drawn_tiles(BlendItem item, uint tiles) {
    if (gl_LocalInvocationIndex == 0u) {
        held_tiles = hold_tiles(item, tiles & drawn_tiles);
    }
    barrier();
}

void write_partial(uint index, Pixel pixel, bool full) {
    if (has_partial(held_tiles, index)) {
        // Negative: the pixel ends here.
        pixel.transmittance = EARLY_STOP && full ? -pixel.transmittance : pixel.transmittance;
        store_partial(held_tiles, index, pixel);
        if (MEDIANS) {
            partial_medians[partial_index(held_tiles, index)] = pixel.median;
        }
    }
}

// Pixel before its segment, or a full pixel if there is nothing to finish in it.
Pixel unfinished_pixel(PartialTiles held, uint index, out bool full) {
    Pixel pixel = PIXEL_EMPTY;
    if (!FINISH_MEDIANS) {
        pixel = load_partial(held, index);
    } else if (has_partial(held, index)) {
        pixel.transmittance = uintBitsToFloat(partial_medians[partial_index(held, index)]);
    }
    full = !(pixel.transmittance < 0.0);
    pixel.transmittance = full ? 0.0 : -pixel.transmittance;
    return pixel;
}

// The pixels of a lane before the segment is blended, the left one at `index` of the coarse tile at
// `origin`.
LanePixels first_pixels(BlendItem item, Camera camera, uvec2 origin, uint index) {
    LanePixels pixels = empty_pixels(origin + pixel_offset(index), camera.size_px);
    if (FINISH) {
        PartialTiles held = partial_tiles[item.partial];
        pixels.left = unfinished_pixel(held, index, pixels.left_full);
        pixels.right = unfinished_pixel(held, index + LEFT_PIXELS, pixels.right_full);
    }
    return pixels;
}

// Tells later segments of the coarse tile how much this one lets through in a fine tile, as bits.
void tell_largest(BlendItem item, uint tile, uint largest) {
    // 0 would mean that it is not known.
    atomicStore(partial_transmittances[32u * item.partial + tile], max(largest, 1u), gl_ScopeDevice, gl_StorageSemanticsBuffer, gl_SemanticsRelaxed);
}

// Writes the medians of a pixel before whose first splat all light was there.
void write_own_medians(Camera camera, uvec2 at, Pixel pixel) {
    if (MEDIANS) {
        bool found = pixel.transmittance <= TRANSMITTANCE_MEDIAN;
        write_medians(camera, at, found ? depths[pixel.median] : vec2(0.0), image_pixels);
    }
}

void write_result(BlendItem item, Camera camera, uvec2 origin, uint index, LanePixels pixels) {
    uvec2 at = origin + pixel_offset(index);
    if (FINISH_MEDIANS) {
        if (!pixels.left_full) {
            write_medians(camera, at, depths[pixels.left.median], image_pixels);
        }
        if (!pixels.right_full) {
            write_medians(camera, at + uvec2(2u, 0u), depths[pixels.right.median], image_pixels);
        }
    } else if (FINISH) {
        // Composite has written the pixel as it is without an end in this segment, and pixels that
        // were full before keep that.
        if (pixels.left_full && pixels.left.transmittance > 0.0) {
            write_pixel(camera, at, pixels.left, sky, image_pixels);
        }
        if (pixels.right_full && pixels.right.transmittance > 0.0) {
            write_pixel(camera, at + uvec2(2u, 0u), pixels.right, sky, image_pixels);
        }
    } else if (item.partial == NO_PARTIAL) {
        write_pixel(camera, at, pixels.left, sky, image_pixels);
        write_pixel(camera, at + uvec2(2u, 0u), pixels.right, sky, image_pixels);
        write_own_medians(camera, at, pixels.left);
        write_own_medians(camera, at + uvec2(2u, 0u), pixels.right);
    } else {
        write_partial(index, pixels.left, pixels.left_full);
        write_partial(index + LEFT_PIXELS, pixels.right, pixels.right_full);
        float through = max(left_through(pixels.left, pixels.left_full), left_through(pixels.right, pixels.right_full));
        if (WHOLE_TILES) {
            through = subgroupMax(through);
            if (gl_SubgroupInvocationID == 0u) {
                tell_largest(item, fine_tile(index), floatBitsToUint(through));
            }
        } else {
            atomicMax(tile_largest[fine_tile(index)], floatBitsToUint(through)); // positive floats order as their bits
        }
    }
}

// True if the share that begins at `first_index` has one of the segment's fine tiles that are to
// be rendered.
bool is_drawn(uint tiles, uint first_index) {
    return (tiles >> fine_tile(first_index) & (LANES > 32u ? 3u : 1u)) != 0u;
}

// Blends a segment of one batch: subgroups take shares from a counter. Small subgroups are those of
// software drivers, which run one after the other: the first would take all shares, and come to the
// end of the rounds that such a driver allows.
void blend_one_batch(BlendItem item, Camera camera, uvec2 origin, uint tiles) {
    list_records(item.first_pair, item.pairs, origin, camera.size_px, camera.mean_shift);
    barrier();
    if (writes_partial(item)) {
        hold_drawn_tiles(item, tiles);
    }
    // As many rounds as shares, so that the loop ends even if a counter is wrong.
    for (uint taken = 0u; taken < SHARES; ++taken) {
        uint share = taken * SUBGROUPS + gl_LocalInvocationIndex / LANES;
        if (LANES >= 32u) {
            if (gl_SubgroupInvocationID == 0u) {
                share = atomicAdd(next_share, 1u);
            }
            share = subgroupBroadcastFirst(share);
        }
        if (share >= SHARES) {
            break;
        }
        uint first_index = share * LANES;
        if (is_drawn(tiles, first_index)) {
            uint index = first_index + gl_SubgroupInvocationID;
            LanePixels pixels = first_pixels(item, camera, origin, index);
            blend_share(pixels, first_index, item.first_pair, item.pairs, origin, camera.mean_shift);
            write_result(item, camera, origin, index, pixels);
        }
    }
}

// Blends a segment of any length: each subgroup has its shares from the first batch to the last.
void blend_batches(BlendItem item, Camera camera, uvec2 origin, uint tiles) {
    uint lane = gl_SubgroupInvocationID;
    uint first0 = gl_LocalInvocationIndex / LANES * LANES;
    uint first1 = first0 + THREADS;
    uint first2 = first1 + THREADS;
    uint first3 = first2 + THREADS;
    LanePixels pixels0 = first_pixels(item, camera, origin, first0 + lane);
    LanePixels pixels1 = first_pixels(item, camera, origin, first1 + lane);
    LanePixels pixels2 = first_pixels(item, camera, origin, first2 + lane);
    LanePixels pixels3 = first_pixels(item, camera, origin, first3 + lane);
    bool open0 = is_drawn(tiles, first0);
    bool open1 = is_drawn(tiles, first1);
    bool open2 = is_drawn(tiles, first2);
    bool open3 = is_drawn(tiles, first3);
    for (uint done = 0u; done < item.pairs; done += BATCH) {
        uint count = min(BATCH, item.pairs - done);
        list_records(item.first_pair + done, count, origin, camera.size_px, camera.mean_shift);
        if (gl_LocalInvocationIndex == 0u) {
            open_subgroups = 0u;
        }
        barrier();
        open0 = open0 && blend_share(pixels0, first0, item.first_pair + done, count, origin, camera.mean_shift);
        open1 = open1 && blend_share(pixels1, first1, item.first_pair + done, count, origin, camera.mean_shift);
        open2 = open2 && blend_share(pixels2, first2, item.first_pair + done, count, origin, camera.mean_shift);
        open3 = open3 && blend_share(pixels3, first3, item.first_pair + done, count, origin, camera.mean_shift);
        if (lane == 0u && (open0 || open1 || open2 || open3)) {
            atomicOr(open_subgroups, 1u);
        }
        barrier(); // the batch is read to its end
        if (open_subgroups == 0u) {
            break;
        }
        barrier(); // and so is open_subgroups
    }
    if (writes_partial(item)) {
        hold_drawn_tiles(item, tiles);
    }
    if (is_drawn(tiles, first0)) {
        write_result(item, camera, origin, first0 + lane, pixels0);
    }
    if (is_drawn(tiles, first1)) {
        write_result(item, camera, origin, first1 + lane, pixels1);
    }
    if (is_drawn(tiles, first2)) {
        write_result(item, camera, origin, first2 + lane, pixels2);
    }
    if (is_drawn(tiles, first3)) {
        write_result(item, camera, origin, first3 + lane, pixels3);
    }
}

void main() {
    uint item_index = group_index();
    if (item_index >= min(required.items, items_max)) {
        return;
    }
    BlendItem item = items[item_index];
    Camera camera = cameras[camera_of_bin(item.bin, camera_count)];
    uvec2 origin = coarse_tile_origin(item.bin, camera);
    uint thread = gl_LocalInvocationIndex;
    if (!WHOLE_TILES && thread < 32u) {
        tile_largest[thread] = 0u;
    }
    if (thread == 0u) {
        next_share = 0u;
        drawn_tiles = 0u;
    }
    barrier(); // before others add to them
    if (EARLY_STOP || CONTRIBUTIONS) {
        bool starts = FINISH || item.segment == 0u;
        stops = EARLY_STOP && starts;
        counts = CONTRIBUTIONS && starts;
    }
    uint tiles = 0xffffffffu; // that are to be drawn
    if (FINISH) {
        tiles = item.partial == NO_PARTIAL ? 0u : partial_unfinished[item.partial];
    } else if (item.segment > 0u) {
        tiles = uncovered_tiles(item, thread);
    }
    if (tiles == 0u) {
        if (writes_partial(item) && thread == 0u) {
            hold_tiles(item, 0u);
        }
        return; // composite stops before it gets here, or leaves nothing to be finished
    }
    if (ONE_BATCH) {
        blend_one_batch(item, camera, origin, tiles);
    } else {
        blend_batches(item, camera, origin, tiles);
    }
    if (!WHOLE_TILES && writes_partial(item)) {
        barrier();
        if (thread < 32u) {
            tell_largest(item, thread, tile_largest[thread]);
        }
    }
}
