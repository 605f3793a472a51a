// A visible splat as one camera sees it: 32 bytes, two uvec4. Beside them, where planes or
// contributions ask for it, a label of 8 bytes.

struct Record {
    Footprint splat;
    uvec2 mean; // the code of its mean (mean_px.glsl)
    vec3 color;    // not negative
    float depth_m; // camera-space z, or distance where the order is radial
    uint instance;
};

uvec4 pack_record_low(Record record) {
    return uvec4(record.mean, floatBitsToUint(vec2(record.splat.slope, record.splat.rate_x)));
}

uvec4 pack_record_high(Record record) {
    return uvec4(floatBitsToUint(vec2(record.splat.rate_y, record.splat.log2_opacity)), pack_color(record.color));
}

// The footprint, its mean rounded to f32.
Footprint unpack_footprint(uvec4 low, uvec4 high, uint mean_shift) {
    vec4 rest = uintBitsToFloat(uvec4(low.zw, high.xy));
    return Footprint(unpack_mean(low.xy, uvec2(0u), mean_shift), rest.x, rest.y, rest.z, rest.w);
}

vec3 unpack_record_color(uvec4 high) {
    return unpack_color(high.zw);
}
