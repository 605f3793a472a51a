// Results of segments, a pixel each: blend leaves them for composite, and composite for the pass of
// blend that finishes pixels.
//
// Included where partial_colors and partial_planes are bound. Only fine tiles that a segment draws
// have results. A negative transmittance is a mark, which the two kernels explain.

// Transmittance at which a pixel ends by an exclusive stop.
float stop_limit() {
    return MEDIAN ? TRANSMITTANCE_MEDIAN : TRANSMITTANCE_MIN;
}

const uint TILE_PIXELS = FINE_TILE_PX * FINE_TILE_PX;

bool has_partial(PartialTiles held, uint at) {
    return (held.tiles >> fine_tile(at) & 1u) != 0u;
}

// Index of the result of the pixel at `at` of the coarse tile, which has one.
uint partial_index(PartialTiles held, uint at) {
    uint before = held.tiles & ((1u << fine_tile(at)) - 1u);
    uint right = at / LEFT_PIXELS;
    return (held.first + uint(bitCount(before))) * TILE_PIXELS + right * TILE_LEFT_PIXELS + at % TILE_LEFT_PIXELS;
}

Pixel load_partial(PartialTiles held, uint at) {
    if (!has_partial(held, at)) {
        return PIXEL_EMPTY;
    }
    uint place = partial_index(held, at);
    vec4 color = partial_colors[place];
    uint words[3];
    [[unroll]] for (uint word = 0u; word < PLANE_PARTIAL_WORDS; ++word) {
        words[word] = partial_planes[place * PLANE_PARTIAL_WORDS + word];
    }
    return Pixel(color.rgb, color.a, plane_sums(words));
}

// The pixel must have a result.
void store_partial(PartialTiles held, uint at, Pixel pixel) {
    uint place = partial_index(held, at);
    partial_colors[place] = vec4(pixel.color, pixel.transmittance);
    uint words[3] = plane_words(pixel.planes);
    [[unroll]] for (uint word = 0u; word < PLANE_PARTIAL_WORDS; ++word) {
        partial_planes[place * PLANE_PARTIAL_WORDS + word] = words[word];
    }
}
