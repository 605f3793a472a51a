#version 460
// Joins the segments of macro tiles that were cut, front to back, and writes their pixels.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#include "frame.glsl"
#include "output.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 5, scalar) readonly buffer needs_block { Needs needs; };
layout(set = 0, binding = 6, scalar) readonly buffer composites_block { Composite composites[]; };
layout(set = 0, binding = 7, std430) readonly buffer partial_colours_block { vec4 partial_colours[]; };
layout(set = 0, binding = 8, std430) readonly buffer partial_depths_block { float partial_depths[]; };
layout(set = 0, binding = 9, std430) readonly buffer partial_instances_block { uvec2 partial_instances[]; };

layout(push_constant, scalar) uniform push_block { vec3 sky; uint camera_count; };

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
    // One workgroup for the pixels that blend's threads hold at one index.
    uint composite_index = group_index() / PIXELS;
    if (composite_index >= needs.composites) {
        return;
    }
    uint index = group_index() % PIXELS;
    uint thread = gl_LocalInvocationIndex;
    Composite composite = composites[composite_index];
    Camera camera = cameras[camera_of_bin(composite.bin, camera_count)];
    Pixel pixel = PIXEL_EMPTY;
    for (uint partial = 0u; partial < composite.partials; ++partial) {
        pixel = over(pixel, load_partial((composite.first_partial + partial) * MACRO_PIXELS + index * BLEND_THREADS + thread));
    }
    write_pixel(camera, macro_tile_origin(composite.bin, camera) + pixel_offset(thread, index), pixel, sky);
}
