// Results of segments, a pixel each: blend leaves them for composite, and composite for the pass of
// blend that finishes pixels.
//
// Included where partial_colors, partial_depths and partial_instances are bound. A negative
// transmittance is a mark, which the two kernels explain.

Pixel load_partial(uint place) {
    vec4 color = partial_colors[place];
    Pixel pixel = Pixel(color.rgb, color.a, 0.0, 0.0, 0u);
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

void store_partial(uint place, Pixel pixel) {
    partial_colors[place] = vec4(pixel.color, pixel.transmittance);
    if (DEPTH) {
        partial_depths[place] = pixel.weighted_depth;
    }
    if (INSTANCE) {
        partial_instances[place] = uvec2(floatBitsToUint(pixel.best_weight), pixel.best_instance);
    }
}
