// A lane's two pixels and how a record is blended into them.
//
// Included by blend.comp, after batch.glsl and partial.glsl.

// A product of largest transmittances up to here means that composite stops before, its own
// rounding included.
float covered() {
    return EARLY_STOP ? 0.999 * stop_limit() : 0.999 * TRANSMITTANCE_FULL;
}

// A segment that lets no more than this through holds the end of its pixel, or lies behind it.
float nothing_left() {
    return FINISH_MEDIANS ? TRANSMITTANCE_MEDIAN : EARLY_STOP ? covered() : TRANSMITTANCE_FULL;
}

bool stops;  // EARLY_STOP, where all that lies before is known
bool counts; // CONTRIBUTIONS, likewise

// A lane's pixels in a share. Named, not an array: what is indexed may end up outside of registers.
struct LanePixels {
    Pixel left;
    Pixel right; // two columns to the right of the first
    bool left_full;
    bool right_full;
};

LanePixels empty_pixels(uvec2 at, uvec2 size_px) {
    // Pixels beyond the image are full from the start, or they would keep their share open.
    bool left_full = at.x >= size_px.x || at.y >= size_px.y;
    bool right_full = at.x + 2u >= size_px.x || at.y >= size_px.y;
    LanePixels pixels = LanePixels(PIXEL_EMPTY, PIXEL_EMPTY, left_full, right_full);
    pixels.left.transmittance = left_full ? 0.0 : 1.0;
    pixels.right.transmittance = right_full ? 0.0 : 1.0;
    return pixels;
}

// Blends a record whose alpha is 2^log2_share of ALPHA_MAX.
//
// All is written for few instructions: a clamp to 1 costs none on NVIDIA, where one to ALPHA_MAX
// would, and a comparison gives a factor of 0 or 1.
void blend_pixel(inout Pixel pixel, inout bool full, float log2_share, vec3 color, Staged record, Attributes own) {
    float blended = log2_share >= log2_alpha_min(record.tones.y + LOG2_ALPHA_MAX) - LOG2_ALPHA_MAX ? 1.0 : 0.0;
    float share = clamp(exp2(log2_share) * blended, 0.0, 1.0);
    if (FINISH_MEDIANS) {
        pixel.median = pixel.transmittance > TRANSMITTANCE_MEDIAN && share > 0.0 ? record.record : pixel.median;
        pixel.transmittance -= ALPHA_MAX * (pixel.transmittance * share);
        return;
    }
    if (EARLY_STOP && !INCLUSIVE_STOP) {
        bool ends = !full && stops && pixel.transmittance * (1.0 - ALPHA_MAX * share) <= stop_limit();
        full = full || ends;
    }
    if (EARLY_STOP) {
        share = full ? 0.0 : share;
    }
    if (MEDIANS) {
        // One that adds nothing does no harm: the one that takes the light is the last.
        pixel.median = pixel.transmittance > TRANSMITTANCE_MEDIAN ? record.record : pixel.median;
    }
    float weight_share = pixel.transmittance * share;
    float weight = ALPHA_MAX * weight_share;
    pixel.color += weight_share * color; // which has been multiplied by ALPHA_MAX
    pixel.transmittance -= weight;
    if (EARLY_STOP && INCLUSIVE_STOP) {
        full = full || (stops && pixel.transmittance <= stop_limit());
    }
    if (CONTRIBUTIONS && counts && weight > 0.0) {
        atomicAdd(contributions[record.instance], uint(weight * contribution_scale + 0.5));
    }
    add_to_planes(pixel.planes, weight, record.depth_m, record.instance, own);
}

// Transmittance of a pixel that remains behind the segment.
float left_through(Pixel pixel, bool full) {
    return EARLY_STOP && full ? 0.0 : pixel.transmittance;
}

// The attributes of a record. All lanes read the same ones: they stay in the first cache, and
// places in shared memory would cost workgroups.
Attributes attributes_of(uint record) {
    Attributes own = NO_ATTRIBUTES;
    if (ATTRIBUTE_VECTORS > 0u) {
        own.first = attributes[ATTRIBUTE_VECTORS * record];
    }
    if (ATTRIBUTE_VECTORS > 1u) {
        own.second = attributes[ATTRIBUTE_VECTORS * record + 1u];
    }
    if (ATTRIBUTE_VECTORS > 2u) {
        own.third = attributes[ATTRIBUTE_VECTORS * record + 2u];
    }
    return own;
}

void blend_record(inout LanePixels pixels, vec2 at, Staged record) {
    vec2 log2_share = log2_shares(record.slants, record.tones, at);
    vec3 color = vec3(record.tones.zw, record.blue);
    Attributes own = attributes_of(record.record);
    // No branch where a record adds nothing: that would cost more than the arithmetic it saves.
    blend_pixel(pixels.left, pixels.left_full, log2_share.x, color, record, own);
    blend_pixel(pixels.right, pixels.right_full, log2_share.y, color, record, own);
}
