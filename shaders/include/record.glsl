// A visible splat as one camera sees it, in 48 bytes: two vec4 of footprint and one of color.

struct Record {
    Footprint splat;
    float depth_m; // camera-space z, or distance where the order is radial
    uint instance;
};

vec4 pack_record_low(Record record) {
    return vec4(record.splat.mean_px, record.splat.slope, record.splat.rate_x);
}

vec4 pack_record_high(Record record) {
    return vec4(record.splat.rate_y, record.splat.log2_opacity, record.depth_m, uintBitsToFloat(record.instance));
}

Footprint unpack_footprint(vec4 low, vec4 high) {
    return Footprint(low.xy, low.z, low.w, high.x, high.y);
}
