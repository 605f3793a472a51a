// The pixels that a projected splat can reach. Culling, binning, masks and blending all use the
// numbers here, so that nothing is dropped that blending would count. `precise`: count_pairs and
// fill_pairs must find the same tiles, and a compiler might fuse them differently.

// A projected Gaussian in the factored form that blending evaluates: with d = pixel center - mean,
// log2(alpha) = log2_opacity - ((d.x - slope * d.y) * rate_x)^2 - (d.y * rate_y)^2, a sum of
// squares: never positive by rounding, however thin the splat (Cholesky factors of the inverse
// covariance).
struct Footprint {
    vec2 mean_px;
    float slope;
    float rate_x;
    float rate_y;
    float log2_opacity;
};

// log2(255): alpha >= 1/255 where the sum of squares is at most log2_opacity + LOG2_255.
const float LOG2_255 = 7.994353436858858;

// The least alpha that is blended.
const float ALPHA_MIN = 1.0 / 255.0;

// Where rules have a least response, the share of its opacity that a splat must have at a pixel:
// the sum of squares there, which is -log2 of it.
layout(constant_id = 40) const bool LEAST_RESPONSE = false;
layout(constant_id = 41) const float LEAST_RESPONSE_SQUARES = 8.0;

// Added to the squared radius wherever pixels are only bounded, never where they are blended.
// Rounding moves the sum of squares of a pixel by less than 1e-3 for means within 10^5 pixels of
// the image; a wider bound costs work, not truth.
const float SQUARED_RADIUS_SLACK = 0.01;

// Squared radius, in units of the exponent, beyond which the splat adds nothing.
float squared_radius(float log2_opacity) {
    float squared = log2_opacity + LOG2_255;
    return LEAST_RESPONSE ? min(squared, LEAST_RESPONSE_SQUARES) : squared;
}

// log2 of the least alpha of a splat that is blended.
float log2_alpha_min(float log2_opacity) {
    return LEAST_RESPONSE ? max(-LOG2_255, log2_opacity - LEAST_RESPONSE_SQUARES) : -LOG2_255;
}

// Pixel coordinates [first, last] along one axis whose centers lie in [low, high], clipped to the
// image.
ivec2 pixels_between(float low, float high, uint size_px) {
    // Both ends from both sides: what an int cannot hold has no defined conversion.
    float size = float(size_px);
    return ivec2(clamp(ceil(low - 0.5), 0.0, size), clamp(floor(high - 0.5), -1.0, size - 1.0));
}

// Rows of pixels the splat can reach, [first, last].
ivec2 reached_rows(Footprint splat, uint height_px) {
    precise float half_height = sqrt(squared_radius(splat.log2_opacity) + SQUARED_RADIUS_SLACK) / splat.rate_y;
    return pixels_between(splat.mean_px.y - half_height, splat.mean_px.y + half_height, height_px);
}

// Left and right edge of the ellipse that a splat can reach. In v = d.y * rate_y they are
// x = A v -+ B sqrt(r2 - v^2), A = slope / rate_y, B = 1 / rate_x. The right edge is concave in v
// with its top at v = r A / sqrt(A^2 + B^2), the left edge is its mirror image: the extreme over a
// strip is at that v, moved into the strip.
struct Edges {
    float r2;
    float r;
    float a;
    float b;
    float top_v;
    float rounding; // of the edges themselves, which needles of 10^5 pixels make visible, pixels
};

Edges edges_of(Footprint splat) {
    precise float r2 = squared_radius(splat.log2_opacity) + SQUARED_RADIUS_SLACK;
    precise float r = sqrt(r2);
    precise float a = splat.slope / splat.rate_y;
    precise float b = 1.0 / splat.rate_x;
    precise float top_v = r * a * inversesqrt(a * a + b * b);
    precise float rounding = 1e-6 * (abs(a) * r + b * r);
    return Edges(r2, r, a, b, top_v, rounding);
}

// Columns of pixels [first, last] the splat can reach in the rows whose centers lie in [low_y,
// high_y]. `edges` are those of the splat.
ivec2 reached_columns(Footprint splat, Edges edges, float low_y, float high_y, uint width_px) {
    precise float low_v = max((low_y - splat.mean_px.y) * splat.rate_y, -edges.r);
    precise float high_v = min((high_y - splat.mean_px.y) * splat.rate_y, edges.r);
    if (!(low_v <= high_v)) {
        return ivec2(0, -1);
    }
    precise float right_v = clamp(edges.top_v, low_v, high_v);
    precise float left_v = clamp(-edges.top_v, low_v, high_v);
    precise float right = edges.a * right_v + edges.b * sqrt(max(edges.r2 - right_v * right_v, 0.0));
    precise float left = edges.a * left_v - edges.b * sqrt(max(edges.r2 - left_v * left_v, 0.0));
    return pixels_between(splat.mean_px.x + left - edges.rounding, splat.mean_px.x + right + edges.rounding, width_px);
}

// Coarse tiles [x, y] of row `row` of the camera's tiles that the splat can reach; empty when x >
// y.
ivec2 reached_coarse_tiles(Footprint splat, uint row, uvec2 size_px) {
    float top = float(row * COARSE_HEIGHT_PX);
    float bottom = min(top + float(COARSE_HEIGHT_PX), float(size_px.y));
    ivec2 columns = reached_columns(splat, edges_of(splat), top + 0.5, bottom - 0.5, size_px.x);
    return columns.x > columns.y ? ivec2(0, -1) : columns / int(COARSE_WIDTH_PX);
}

// Rows [x, y] of coarse tiles that the splat can reach; empty when x > y.
ivec2 reached_coarse_rows(Footprint splat, uint height_px) {
    ivec2 rows = reached_rows(splat, height_px);
    return rows.x > rows.y ? ivec2(0, -1) : rows / int(COARSE_HEIGHT_PX);
}
