#version 460
// Alpha compositing of segments: joins the partial results of cut lists, front to back, and writes
// their pixels.
//
// Over is associative. The segments of a long list are divided into runs; a thread joins a run at a
// pixel, and the runs of a pixel are joined through shared memory.
//
// By an early stop, the pixel is left to be finished in the segment in which it ends: see
// blend.comp.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#include "frame.glsl"
#include "output.glsl"
#include "color_code.glsl"

const uint WORKGROUP_THREADS = 256u;
const uint COMPOSITE_GROUPS = COARSE_PIXELS / WORKGROUP_THREADS; // workgroups that share a coarse tile
layout(local_size_x = 256) in;

layout(constant_id = 3) const bool EARLY_STOP = false; // see blend.comp
layout(constant_id = 7) const bool INCLUSIVE_STOP = false; // likewise
layout(constant_id = 4) const bool CONTRIBUTIONS = false;  // every segment is left to be finished, so that its weights can be counted

layout(set = 0, binding = 5, scalar) readonly buffer required_block { RequiredCounts required; };
layout(set = 0, binding = 6, scalar) readonly buffer composites_block { Composite composites[]; };
layout(set = 0, binding = 7, scalar) buffer partial_colors_block { uint partial_colors[]; };
layout(set = 0, binding = 8, std430) buffer partial_planes_block { uint partial_planes[]; };

layout(set = 0, binding = 9, scalar) buffer partial_unfinished_block { uint partial_unfinished[]; };
layout(set = 0, binding = 10, scalar) readonly buffer partial_tiles_block { PartialTiles partial_tiles[]; };

// Per partial result and fine tile: bits of the largest transmittance that it left, or 0 where that
// is not known.
layout(set = 0, binding = 11, scalar) readonly buffer partial_transmittances_block { uint partial_transmittances[]; };

// See blend.comp; the second is its partial_unfinished for medians.
layout(set = 0, binding = 12, scalar) buffer partial_medians_block { uint partial_medians[]; };
layout(set = 0, binding = 13, scalar) buffer medians_unfinished_block { uint medians_unfinished[]; };
layout(set = 0, binding = 14, std430) readonly buffer depths_block { vec2 depths[]; };

layout(push_constant, scalar) uniform push_block { vec3 sky; uint camera_count; uint image_pixels; };

// Segments that are read before the first is used, so that the reads overlap.
const uint AHEAD = 4u;

#include "partial.glsl"

// Leaves `before`, what lies before segment `slot`, in place of what the segment adds, to be
// blended again from there; nothing where the segment draws nothing.
void leave_unfinished(uint slot, PartialTiles held, uint index, Pixel before) {
    if (has_partial(held, index)) {
        before.transmittance = -before.transmittance;
        store_partial(held, index, before);
        atomicOr(partial_unfinished[slot], 1u << fine_tile(index));
    }
}

// Writes the medians of the pixel at `at`, or leaves them to be finished in the segment in which
// half of the light goes. It is looked for from `first` to before `end`; `transmittance` is what is
// left before these. `goes_here` is true if products in another order, whose rounding is another,
// say that it is one of them: then it is the last that draws, if none before it is.
void settle_medians(Camera camera, uvec2 at, Composite composite, uint first, uint end, uint index, float transmittance, bool goes_here) {
    PartialTiles last = PartialTiles(0u, 0u);
    uint last_slot = 0u;
    float before = transmittance;
    for (uint segment = first; segment < end && transmittance > TRANSMITTANCE_MEDIAN; ++segment) {
        uint slot = composite.first_partial + segment;
        PartialTiles held = partial_tiles[slot];
        float own = has_partial(held, index) ? partial_transmittance(held, index) : 1.0;
        if (own < 1.0) {
            last = held;
            last_slot = slot;
            before = transmittance;
            transmittance *= own;
        }
    }
    if (!goes_here && transmittance > TRANSMITTANCE_MEDIAN) {
        write_medians(camera, at, vec2(0.0), image_pixels);
        return;
    }
    uint place = partial_index(last, index);
    if (before == 1.0) {
        // Nothing lies before it: it has found the median by itself.
        write_medians(camera, at, depths[partial_medians[place]], image_pixels);
    } else {
        partial_medians[place] = floatBitsToUint(-before);
        atomicOr(medians_unfinished[last_slot], 1u << fine_tile(index));
    }
}

// What the threads of a workgroup have joined, each for its run of segments.
shared vec4 joined_pixels[WORKGROUP_THREADS]; // color and transmittance
shared uint joined_planes[PLANE_PARTIAL_WORDS > 0u ? PLANE_PARTIAL_WORDS * WORKGROUP_THREADS : 1u];

void show_joined(uint thread, Pixel pixel) {
    joined_pixels[thread] = vec4(pixel.color, pixel.transmittance);
    uint words[PLANE_PARTIAL_WORDS_MAX] = plane_words(pixel.planes);
    [[unroll]] for (uint word = 0u; word < PLANE_PARTIAL_WORDS; ++word) {
        joined_planes[word * WORKGROUP_THREADS + thread] = words[word];
    }
}

Pixel joined_by(uint thread) {
    vec4 joined = joined_pixels[thread];
    uint words[PLANE_PARTIAL_WORDS_MAX];
    [[unroll]] for (uint word = 0u; word < PLANE_PARTIAL_WORDS; ++word) {
        words[word] = joined_planes[word * WORKGROUP_THREADS + thread];
    }
    return Pixel(joined.rgb, joined.a, plane_sums(words), 0u);
}

// True if nothing behind `pixel`, which holds more than the first segment, counts.
bool has_ended(Pixel pixel) {
    return pixel.transmittance <= (EARLY_STOP ? stop_limit() : TRANSMITTANCE_FULL);
}

// Joins the segments from `first` to before `end` behind `pixel`. Returns false where the first
// segment says that the pixel ends in it.
//
// Where `all_before` lies in `pixel`, the segment in which it ends is known, and what is to be
// finished is left; that it ends in one of them, where `ends_here`, was found from their product,
// whose rounding is another: then the last segment is the end if none before it is.
bool join(inout Pixel pixel, Composite composite, uint first, uint end, uint index, bool all_before, bool ends_here) {
    bool open = true;
    bool stopped = false;
    // Segments behind a full pixel may never have been blended. They may be read, not used.
    for (uint base = first; base < end && open; base += AHEAD) {
        PartialTiles held[AHEAD];
        Pixel ahead[AHEAD];
        [[unroll]] for (uint next = 0u; next < AHEAD; ++next) {
            held[next] = partial_tiles[composite.first_partial + min(base + next, composite.partials - 1u)];
        }
        [[unroll]] for (uint next = 0u; next < AHEAD; ++next) {
            ahead[next] = load_partial(held[next], index);
        }
        [[unroll]] for (uint next = 0u; next < AHEAD; ++next) {
            uint segment = base + next;
            if (segment < end && open) {
                Pixel before = pixel;
                // The first segment stops by itself, and says so by the sign.
                stopped = EARLY_STOP && ahead[next].transmittance < 0.0;
                ahead[next].transmittance = EARLY_STOP ? abs(ahead[next].transmittance) : ahead[next].transmittance;
                pixel = over(before, ahead[next]);
                bool ends = EARLY_STOP && all_before && segment > 0u && (pixel.transmittance <= stop_limit() || (ends_here && segment + 1u == end));
                if (ends || (CONTRIBUTIONS && all_before && segment > 0u)) {
                    leave_unfinished(composite.first_partial + segment, held[next], index, before);
                }
                open = EARLY_STOP ? !stopped && !ends : pixel.transmittance > TRANSMITTANCE_FULL;
            }
        }
    }
    return !stopped;
}

// A product of largest transmittances up to here means that all pixels have ended, its own rounding
// included.
float covered() {
    return 0.5 * (EARLY_STOP ? stop_limit() : TRANSMITTANCE_FULL);
}

shared float run_transmittances[WORKGROUP_THREADS];

// True if the runs before the thread's own are known to cover the fine tile `tile`: then nobody
// needs the thread's run. Every thread of the workgroup calls it.
bool is_covered(Composite composite, uint first, uint end, uint tile, uint thread, uint pixels) {
    float transmittance = 1.0;
    for (uint base = first; base < end; base += AHEAD) {
        uint ahead[AHEAD];
        [[unroll]] for (uint next = 0u; next < AHEAD; ++next) {
            ahead[next] = partial_transmittances[32u * (composite.first_partial + min(base + next, end - 1u)) + tile];
        }
        [[unroll]] for (uint next = 0u; next < AHEAD; ++next) {
            transmittance *= ahead[next] == 0u || base + next >= end ? 1.0 : uintBitsToFloat(ahead[next]);
        }
    }
    run_transmittances[thread] = transmittance;
    barrier();
    transmittance = 1.0;
    for (uint other = thread % pixels; other < thread; other += pixels) {
        transmittance *= run_transmittances[other];
    }
    return transmittance <= covered();
}

void main() {
    uint composite_index = group_index() / COMPOSITE_GROUPS;
    if (composite_index >= required.composites) {
        return;
    }
    Composite composite = composites[composite_index];
    uint runs = composite_runs(composite.partials);
    uint pixels = WORKGROUP_THREADS / runs; // of the workgroup
    uint thread = gl_LocalInvocationIndex;
    uint run = thread / pixels;
    uint index = (composite.part * COMPOSITE_GROUPS + group_index() % COMPOSITE_GROUPS) * pixels + thread % pixels; // in a partial result
    Camera camera = cameras[camera_of_bin(composite.bin, camera_count)];
    uvec2 at = coarse_tile_origin(composite.bin, camera) + pixel_offset(index);
    bool real = all(lessThan(at, camera.size_px));
    Pixel pixel = PIXEL_EMPTY;
    if (runs == 1u) {
        if (real) {
            if (MEDIANS) {
                settle_medians(camera, at, composite, 0u, composite.partials, index, 1.0, false);
            }
            join(pixel, composite, 0u, composite.partials, index, true, false);
            write_pixel(camera, at, pixel, sky, image_pixels);
        }
        return;
    }
    uint length = (composite.partials + runs - 1u) / runs;
    uint first = min(run * length, composite.partials);
    uint end = min(first + length, composite.partials);
    bool hidden = is_covered(composite, first, end, fine_tile(index), thread, pixels);
    if (real) {
        bool open = hidden || join(pixel, composite, first, end, index, false, false);
        Pixel shown = pixel;
        shown.transmittance = open ? pixel.transmittance : -pixel.transmittance;
        show_joined(thread, shown);
    }
    barrier();
    if (!real) {
        return;
    }
    // What lies before the thread's own run. The pixel's end is found by the thread in whose run it
    // lies, which writes the pixel.
    Pixel before = PIXEL_EMPTY;
    for (uint other = thread % pixels; other < thread; other += pixels) {
        Pixel nearer = joined_by(other);
        if (EARLY_STOP && nearer.transmittance < 0.0) {
            return;
        }
        before = over(before, nearer);
        if (has_ended(before)) {
            return;
        }
    }
    bool stopped = EARLY_STOP && joined_by(thread).transmittance < 0.0;
    Pixel all = over(before, pixel);
    bool ends_here = stopped || has_ended(all);
    if (MEDIANS && before.transmittance > TRANSMITTANCE_MEDIAN && (all.transmittance <= TRANSMITTANCE_MEDIAN || run + 1u == runs)) {
        bool goes_here = all.transmittance <= TRANSMITTANCE_MEDIAN;
        settle_medians(camera, at, composite, first, goes_here ? end : first, index, before.transmittance, goes_here);
    }
    // Segments behind the end may or may not have been blended, depending on which were done first:
    // the run is joined again, up to the end.
    if ((ends_here && !stopped) || CONTRIBUTIONS) {
        all = before;
        join(all, composite, first, end, index, true, EARLY_STOP && ends_here);
    }
    if (ends_here || run + 1u == runs) {
        write_pixel(camera, at, all, sky, image_pixels);
    }
}
