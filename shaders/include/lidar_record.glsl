// Record of a splat that beams of a sector may meet.
//
// footprints, in the buffer of footprints of images: bits of the cells (first and last column,
// first and last row); of the direction of the mean and its distance. looks: log2 opacity,
// intensity, instance. lidar_shapes: the inverse factor and the velocity.

layout(set = 0, binding = 11, std430) writeonly buffer footprints_block { uvec4 footprints[]; }; // two a record
layout(set = 0, binding = 12, scalar) writeonly buffer looks_block { vec3 looks[]; };
layout(set = 0, binding = 13, scalar) writeonly buffer keys_block { uint keys[]; }; // distance keys
layout(set = 0, binding = 14, std430) writeonly buffer lidar_shapes_block { vec4 lidar_shapes[]; }; // three a record

// Luma (Rec. 709).
const vec3 LUMA = vec3(0.2126, 0.7152, 0.0722);

float intensity_of(vec3 dc) {
    return min(dot(LUMA, max(0.5 + 0.28209479177387814 * dc, vec3(0.0))), 1.0);
}

void write_lidar_record(uint slot, LidarSplat splat, ivec4 cells, float intensity, uint instance) {
    footprints[2u * slot] = floatBitsToUint(vec4(cells));
    footprints[2u * slot + 1u] = floatBitsToUint(vec4(splat.toward, splat.range_m));
    looks[slot] = vec3(splat.log2_opacity, intensity, uintBitsToFloat(instance));
    lidar_shapes[3u * slot] = vec4(splat.inverse_x_yx_zx, splat.drift_mps.x);
    lidar_shapes[3u * slot + 1u] = vec4(splat.inverse_y_zy_z, splat.drift_mps.y);
    lidar_shapes[3u * slot + 2u] = vec4(splat.drift_mps.z, 0.0, 0.0, 0.0);
}
