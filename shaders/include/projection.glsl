// From a Gaussian in the world to its footprint in an image: elliptical weighted average splatting
// (Zwicker et al., EWA Splatting, 2002; Kerbl et al., 3D Gaussian Splatting, 2023), in f32.

// Variants of an image's rules, fixed when the kernel is built.
layout(constant_id = 0) const float NEAR_M = 0.01;
layout(constant_id = 1) const bool ANTIALIAS = false;

// 0.5 log2(e): exp(-q/2) = exp2(-HALF_LOG2_E q).
const float HALF_LOG2_E = 0.7213475204444817;
const float DILATION_PX2 = 0.3;

// The mean relative to the camera, world axes. The two-part center keeps millimeters at UTM
// distances from the origin.
vec3 from_camera_m(vec3 mean_m, Camera camera) {
    return (mean_m - camera.center_high_m) - camera.center_low_m;
}

mat3 matrix_from_quaternion(vec4 q) { // w, x, y, z, of unit length
    float w = q.x, x = q.y, y = q.z, z = q.w;
    return mat3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
                2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
                2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

// The footprint of a splat whose mean is `t` in camera space and whose covariance is `axes` *
// transpose(`axes`) in world space. False when the splat is behind the near plane or adds nothing
// to any pixel.
bool project_splat(Camera camera, vec3 t, mat3 axes, float opacity, out Footprint splat) {
    splat = Footprint(vec2(0.0), 0.0, 1.0, 1.0, -1.0);
    if (!(t.z >= NEAR_M)) {
        return false;
    }
    vec2 slope = clamp(t.xy / t.z, camera.slope_min, camera.slope_max);
    vec3 depth_row = camera.row_z * axes;
    vec3 m0 = (camera.row_x * axes - slope.x * depth_row) * (camera.focal_px.x / t.z);
    vec3 m1 = (camera.row_y * axes - slope.y * depth_row) * (camera.focal_px.y / t.z);
    // The covariance is [m0.m0, m0.m1; m0.m1, m1.m1]. In units of the larger axis nothing
    // overflows, and its determinant as
    // |m0 x m1|^2 has no cancellation: needles keep their width.
    vec3 longest = max(abs(m0), abs(m1));
    float unit_px = max(1.0, max(longest.x, max(longest.y, longest.z)));
    m0 /= unit_px;
    m1 /= unit_px;
    float dilation = DILATION_PX2 / (unit_px * unit_px);
    vec3 area = cross(m0, m1);
    float undilated = dot(area, area);
    float xx = dot(m0, m0);
    float yy = dot(m1, m1);
    float determinant = undilated + dilation * (xx + yy) + dilation * dilation;
    float variance_y = yy + dilation;
    if (ANTIALIAS) {
        opacity *= sqrt(undilated / determinant);
    }
    splat.mean_px = camera.focal_px * (t.xy / t.z) + camera.principal_px;
    splat.slope = dot(m0, m1) / variance_y;
    splat.rate_x = sqrt(HALF_LOG2_E * variance_y / determinant) / unit_px;
    splat.rate_y = sqrt(HALF_LOG2_E / variance_y) / unit_px;
    // At least that of 1/255: whether the opacity reaches it is asked of the opacity itself, below,
    // because the last digits of log2 differ from device to device.
    splat.log2_opacity = max(log2(opacity), -LOG2_255);
    // Written so that a NaN anywhere fails.
    return opacity >= ALPHA_MIN && splat.rate_x > 0.0 && splat.rate_y > 0.0 && abs(splat.slope) < 1e30
        && all(lessThan(abs(splat.mean_px), vec2(1e30)));
}
