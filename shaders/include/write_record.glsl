// Record of a visible (camera, splat), written by both projections.

layout(set = 0, binding = 11, std430) writeonly buffer footprints_block { vec4 footprints[]; }; // two a record
layout(set = 0, binding = 12, std430) writeonly buffer colors_block { vec4 colors[]; };
layout(set = 0, binding = 13, scalar) writeonly buffer keys_block { uint keys[]; }; // depth keys

void write_record(uint slot, Record record, vec3 color) {
    footprints[2u * slot] = pack_record_low(record);
    footprints[2u * slot + 1u] = pack_record_high(record);
    colors[slot] = vec4(color, 0.0);
}

// An attribute in the place of the color of a record that was written before.
void write_attribute(uint slot, vec3 value) {
    colors[slot] = vec4(value, 0.0);
}
