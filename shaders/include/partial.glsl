// Results of segments, a pixel each: blend leaves them for composite, and composite for the pass of
// blend that finishes pixels.
//
// Included where partial_colors, partial_planes and partial_medians are bound. Only fine tiles that
// a segment draws have results. A negative transmittance is a mark, which the two kernels explain.

// Transmittance at which a pixel ends by an early stop.
float stop_limit() {
    return INCLUSIVE_STOP ? TRANSMITTANCE_MIN_INCLUSIVE : TRANSMITTANCE_MIN;
}

// Words per pixel: color and transmittance. Stops are decided by transmittance, which stays whole.
const uint PARTIAL_COLOR_WORDS = 3u;

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

// No branch around the reads, so that those of several segments overlap.
Pixel load_partial(PartialTiles held, uint at) {
    bool there = has_partial(held, at);
    uint index = there ? partial_index(held, at) : 0u;
    uint first = index * PARTIAL_COLOR_WORDS;
    vec3 color = unpack_color(uvec2(partial_colors[first], partial_colors[first + 1u]));
    float transmittance = uintBitsToFloat(partial_colors[first + 2u]);
    uint words[PLANE_PARTIAL_WORDS_MAX];
    [[unroll]] for (uint word = 0u; word < PLANE_PARTIAL_WORDS; ++word) {
        words[word] = partial_planes[index * PLANE_PARTIAL_WORDS + word];
    }
    Pixel pixel = Pixel(color, transmittance, plane_sums(words), 0u);
    if (!there) {
        pixel = PIXEL_EMPTY;
    }
    return pixel;
}

// The pixel must have a result.
void store_partial(PartialTiles held, uint at, Pixel pixel) {
    uint index = partial_index(held, at);
    uint first = index * PARTIAL_COLOR_WORDS;
    uvec2 color = pack_color(pixel.color);
    partial_colors[first] = color.x;
    partial_colors[first + 1u] = color.y;
    partial_colors[first + 2u] = floatBitsToUint(pixel.transmittance);
    uint words[PLANE_PARTIAL_WORDS_MAX] = plane_words(pixel.planes);
    [[unroll]] for (uint word = 0u; word < PLANE_PARTIAL_WORDS; ++word) {
        partial_planes[index * PLANE_PARTIAL_WORDS + word] = words[word];
    }
}

// Transmittance that a segment leaves at a pixel, which has a result.
float partial_transmittance(PartialTiles held, uint at) {
    return abs(uintBitsToFloat(partial_colors[partial_index(held, at) * PARTIAL_COLOR_WORDS + 2u]));
}
