// A visible splat as one camera sees it: 32 bytes, two uvec4. Beside them, where planes or
// contributions ask for it, a label of 8 bytes.

struct Record {
    Footprint splat;
    vec3 color;    // not negative
    float depth_m; // camera-space z, or distance where the order is radial
    uint instance;
};

uvec4 pack_record_low(Record record) {
    return floatBitsToUint(vec4(record.splat.mean_px, record.splat.slope, record.splat.rate_x));
}

uvec4 pack_record_high(Record record) {
    return uvec4(floatBitsToUint(vec2(record.splat.rate_y, record.splat.log2_opacity)), pack_color(record.color));
}

Footprint unpack_footprint(uvec4 low, uvec4 high) {
    vec4 first = uintBitsToFloat(low);
    vec2 rest = uintBitsToFloat(high.xy);
    return Footprint(first.xy, first.z, first.w, rest.x, rest.y);
}

vec3 unpack_record_color(uvec4 high) {
    return unpack_color(high.zw);
}
