#version 460
// Alpha compositing of segments: joins the partial results of cut lists, front to back, and writes
// their pixels.
//
// By an exclusive stop, the pixel is left to be finished in the segment in which it ends: see
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

layout(constant_id = 3) const bool EXCLUSIVE_STOP = false; // stop before the splat that would make a pixel full
layout(constant_id = 4) const bool CONTRIBUTIONS = false;  // every segment is left to be finished, so that its weights can be counted
layout(constant_id = 5) const bool MEDIAN = false; // see blend.comp
layout(constant_id = 6) const bool ATTRIBUTES = false; // likewise

layout(set = 0, binding = 5, scalar) readonly buffer required_block { RequiredCounts required; };
layout(set = 0, binding = 6, scalar) readonly buffer composites_block { Composite composites[]; };
layout(set = 0, binding = 7, scalar) buffer partial_colors_block { uint partial_colors[]; };
layout(set = 0, binding = 8, std430) buffer partial_planes_block { uint partial_planes[]; };

layout(set = 0, binding = 9, scalar) buffer partial_unfinished_block { uint partial_unfinished[]; };
layout(set = 0, binding = 10, scalar) readonly buffer partial_tiles_block { PartialTiles partial_tiles[]; };

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

void main() {
    uint composite_index = group_index() / COMPOSITE_GROUPS;
    if (composite_index >= required.composites) {
        return;
    }
    uint index = group_index() % COMPOSITE_GROUPS * WORKGROUP_THREADS + gl_LocalInvocationIndex; // in a partial result
    Composite composite = composites[composite_index];
    Camera camera = cameras[camera_of_bin(composite.bin, camera_count)];
    uvec2 at = coarse_tile_origin(composite.bin, camera) + pixel_offset(index);
    if (any(greaterThanEqual(at, camera.size_px))) {
        return;
    }
    Pixel pixel = PIXEL_EMPTY;
    bool open = true;
    // Segments behind a full pixel may never have been blended. They may be read, not used.
    for (uint base = 0u; base < composite.partials && open; base += AHEAD) {
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
            if (segment < composite.partials && open) {
                Pixel before = pixel;
                // The first segment stops by itself, and says so by the sign.
                open = !(EXCLUSIVE_STOP && ahead[next].transmittance < 0.0);
                ahead[next].transmittance = EXCLUSIVE_STOP ? abs(ahead[next].transmittance) : ahead[next].transmittance;
                pixel = over(before, ahead[next]);
                bool ends = EXCLUSIVE_STOP && segment > 0u && pixel.transmittance <= stop_limit();
                if (ends || (CONTRIBUTIONS && segment > 0u)) {
                    leave_unfinished(composite.first_partial + segment, held[next], index, before);
                }
                open = EXCLUSIVE_STOP ? open && !ends : pixel.transmittance > TRANSMITTANCE_FULL;
            }
        }
    }
    write_pixel(camera, at, pixel, sky, image_pixels);
}
