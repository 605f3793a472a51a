// Record of a visible (camera, splat), written by both projections.

layout(constant_id = 9) const bool LABELS = false; // records have labels

layout(set = 0, binding = 11, std430) writeonly buffer footprints_block { uvec4 footprints[]; }; // two a record
layout(set = 0, binding = 12, std430) writeonly buffer attributes_block { vec4 attributes[]; }; // ATTRIBUTE_VECTORS a record
layout(set = 0, binding = 13, scalar) writeonly buffer keys_block { uint keys[]; }; // depth keys
layout(set = 0, binding = 19, std430) writeonly buffer labels_block { uvec2 labels[]; }; // bits of the depth, instance
layout(set = 0, binding = 21, std430) writeonly buffer depths_block { vec2 depths[]; }; // depth and range, meters

// The code of the mean of a projected splat. Through a lens and under a rolling shutter, it is an
// f32's.
uvec2 code_of_mean(Camera camera, uint lens, vec3 mean_m, Footprint splat) {
    PixelPair pair = PixelPair(splat.mean_px, vec2(0.0));
    if (!(ROLLING && rolls(camera)) && !(LENSES && lenses[lens].kind != LENS_PINHOLE)) {
        pair = exact_mean_px(camera, mean_m);
    }
    return pack_mean(pair, splat.mean_px, camera.mean_shift);
}

void write_record(uint slot, Record record) {
    footprints[2u * slot] = pack_record_low(record);
    footprints[2u * slot + 1u] = pack_record_high(record);
    if (LABELS) {
        labels[slot] = uvec2(floatBitsToUint(record.depth_m), record.instance);
    }
}

void write_attributes(uint slot, Attributes own) {
    if (ATTRIBUTE_VECTORS > 0u) {
        attributes[ATTRIBUTE_VECTORS * slot] = own.first;
    }
    if (ATTRIBUTE_VECTORS > 1u) {
        attributes[ATTRIBUTE_VECTORS * slot + 1u] = own.second;
    }
    if (ATTRIBUTE_VECTORS > 2u) {
        attributes[ATTRIBUTE_VECTORS * slot + 2u] = own.third;
    }
}
