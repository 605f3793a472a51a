// Results of segments, a pixel each: blend leaves them for composite, and composite for the pass of
// blend that finishes pixels.
//
// Included where partial_colors and partial_planes are bound. A negative transmittance is a mark,
// which the two kernels explain.

// Transmittance at which a pixel ends by an exclusive stop.
float stop_limit() {
    return MEDIAN ? TRANSMITTANCE_MEDIAN : TRANSMITTANCE_MIN;
}

Pixel load_partial(uint place) {
    vec4 color = partial_colors[place];
    uint words[3];
    [[unroll]] for (uint word = 0u; word < PLANE_PARTIAL_WORDS; ++word) {
        words[word] = partial_planes[place * PLANE_PARTIAL_WORDS + word];
    }
    return Pixel(color.rgb, color.a, plane_sums(words));
}

void store_partial(uint place, Pixel pixel) {
    partial_colors[place] = vec4(pixel.color, pixel.transmittance);
    uint words[3] = plane_words(pixel.planes);
    [[unroll]] for (uint word = 0u; word < PLANE_PARTIAL_WORDS; ++word) {
        partial_planes[place * PLANE_PARTIAL_WORDS + word] = words[word];
    }
}
