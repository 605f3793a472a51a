#version 460
// Joins the segments of macro tiles that were cut, front to back, and writes their pixels.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#include "frame.glsl"
#include "output.glsl"

const uint WORKGROUP_THREADS = 256u;
const uint COMPOSITE_GROUPS = MACRO_PIXELS / WORKGROUP_THREADS; // workgroups that share a macro tile
layout(local_size_x = 256) in;

layout(set = 0, binding = 5, scalar) readonly buffer needs_block { Needs needs; };
layout(set = 0, binding = 6, scalar) readonly buffer composites_block { Composite composites[]; };
layout(set = 0, binding = 7, std430) readonly buffer partial_colours_block { vec4 partial_colours[]; };
layout(set = 0, binding = 8, std430) readonly buffer partial_depths_block { float partial_depths[]; };
layout(set = 0, binding = 9, std430) readonly buffer partial_instances_block { uvec2 partial_instances[]; };

layout(push_constant, scalar) uniform push_block { vec3 sky; uint camera_count; };

// Segments that are read before the first is used, so that the reads overlap.
const uint AHEAD = 4u;

Pixel load_partial(uint place) {
    vec4 colour = partial_colours[place];
    Pixel pixel = Pixel(colour.rgb, colour.a, 0.0, 0.0, 0u);
    if (DEPTH) {
        pixel.weighted_depth = partial_depths[place];
    }
    if (INSTANCE) {
        uvec2 best = partial_instances[place];
        pixel.best_weight = uintBitsToFloat(best.x);
        pixel.best_instance = best.y;
    }
    return pixel;
}

void main() {
    uint composite_index = group_index() / COMPOSITE_GROUPS;
    if (composite_index >= needs.composites) {
        return;
    }
    // The pixel's place in a partial result: thread of blend and index among its pixels.
    uint place = group_index() % COMPOSITE_GROUPS * WORKGROUP_THREADS + gl_LocalInvocationIndex;
    uint thread = place % BLEND_THREADS;
    uint index = place / BLEND_THREADS;
    Composite composite = composites[composite_index];
    Camera camera = cameras[camera_of_bin(composite.bin, camera_count)];
    Pixel pixel = PIXEL_EMPTY;
    uint first_place = composite.first_partial * MACRO_PIXELS + place;
    // Segments behind a full pixel may never have been blended. They may be read, not used.
    for (uint base = 0u; base < composite.partials && pixel.transmittance > TRANSMITTANCE_FULL; base += AHEAD) {
        Pixel ahead[AHEAD];
        [[unroll]] for (uint next = 0u; next < AHEAD; ++next) {
            ahead[next] = load_partial(first_place + min(base + next, composite.partials - 1u) * MACRO_PIXELS);
        }
        [[unroll]] for (uint next = 0u; next < AHEAD; ++next) {
            if (base + next < composite.partials && pixel.transmittance > TRANSMITTANCE_FULL) {
                pixel = over(pixel, ahead[next]);
            }
        }
    }
    write_pixel(camera, macro_tile_origin(composite.bin, camera) + pixel_offset(thread, index), pixel, sky);
}
