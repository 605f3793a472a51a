// Where the mean of a splat lies in the image, exact to about 2^-20 px. An f32 is off by up to
// 2^-14 px at column 1,600.
//
// alpha >= 1/255 is asked of every pixel at a splat's rim. There alpha of the thinnest splats
// changes by up to 6 times itself per pixel, so the rounding of f32 means decides that test for a
// hundred pixels of a captured street. Nothing else of a footprint comes near that.
//
// A mean is found as a coarse and a fine part. Products and sums of coarse parts have at most 24
// binary digits: an f32 holds them without rounding, fused or not, on every device. Fine parts are
// 2^11 times smaller, and so is their rounding.

// 1.5 * 2^12: an f32 of that size has steps of 2^-11.
const float GRID_ANCHOR = 6144.0;

// The multiples of unit * 2^-11 next to `v`; `unit` is a power of two.
vec3 on_grid(vec3 v, float unit) {
    float anchor = GRID_ANCHOR * unit;
    precise vec3 raised = v + anchor;
    precise vec3 rounded = raised - anchor;
    return rounded;
}

// A position in the image in two parts whose sum it is; the coarse one is a multiple of
// 2^(7 - mean_shift) px.
struct PixelPair {
    vec2 coarse;
    vec2 fine;
};

// Projection of a mean by a pinhole.
PixelPair exact_mean_px(Camera camera, vec3 mean_m) {
    // The offset from the camera, and what rounding leaves of it.
    precise vec3 offset = mean_m - camera.center_high_m;
    precise vec3 center_part = offset - mean_m;
    precise vec3 rest = (mean_m - (offset - center_part)) + (-camera.center_high_m - center_part) - camera.center_low_m;
    float longest = max(abs(offset.x), max(abs(offset.y), abs(offset.z)));
    float unit = 2.0 * uintBitsToFloat(floatBitsToUint(longest) & 0x7f800000u);
    vec3 coarse = on_grid(offset, unit);
    vec3 fine = (offset - coarse) + rest;
    vec3 both = coarse + fine;
    // In camera axes.
    vec3 t = vec3(dot(camera.row_x_coarse, coarse), dot(camera.row_y_coarse, coarse), dot(camera.row_z_coarse, coarse));
    vec3 t_fine = vec3(dot(camera.row_x_coarse, fine) + dot(camera.row_x_fine, both),
                       dot(camera.row_y_coarse, fine) + dot(camera.row_y_fine, both),
                       dot(camera.row_z_coarse, fine) + dot(camera.row_z_fine, both));
    float z = t.z + t_fine.z;
    // x / z is a multiple of 2^-11 and the rest of that division over z.
    vec2 ratio = on_grid(vec3((t.xy + t_fine.xy) / z, 0.0), 1.0).xy;
    float z_coarse = on_grid(vec3(t.z, 0.0, 0.0), unit).x;
    float z_fine = (t.z - z_coarse) + t_fine.z;
    vec2 remainder = ((t.xy - ratio * z_coarse) - ratio * z_fine) + t_fine.xy;
    return PixelPair(camera.focal_coarse_px * ratio + camera.principal_coarse_px,
                     camera.focal_fine_px * ratio + camera.principal_fine_px + camera.focal_px * (remainder / z));
}

// A position in the image in 32 bits a coordinate: steps of 2^-shift px from 0 to 2^(31 - shift)
// px, which is beyond the image. Others are f32 without the last digit, behind a set bit: a splat
// that reaches into the image from there is so wide that it needs no more.
uint pack_coordinate(float coarse, float fine, float plain, uint shift) {
    float steps_per_px = uintBitsToFloat((127u + shift) << 23u);
    float place = (coarse + fine) * steps_per_px;
    if (place >= 0.0 && place < 2147483648.0) {
        return uint(int(roundEven(coarse * steps_per_px)) + int(roundEven(fine * steps_per_px)));
    }
    return 0x80000000u | (floatBitsToUint(plain) + 1u) >> 1u;
}

// The code of a position whose f32 is `plain`.
uvec2 pack_mean(PixelPair pair, vec2 plain, uint shift) {
    return uvec2(pack_coordinate(pair.coarse.x, pair.fine.x, plain.x, shift),
                 pack_coordinate(pair.coarse.y, pair.fine.y, plain.y, shift));
}

// A coordinate relative to pixel coordinate `origin` of the image. The difference is taken before
// it is rounded to f32.
float unpack_coordinate(uint code, uint origin, uint shift) {
    float px_per_step = uintBitsToFloat((127u - shift) << 23u);
    return code >= 0x80000000u ? uintBitsToFloat(code << 1u) - float(origin)
                               : float(int(code - (origin << shift))) * px_per_step;
}

vec2 unpack_mean(uvec2 code, uvec2 origin, uint shift) {
    return vec2(unpack_coordinate(code.x, origin.x, shift), unpack_coordinate(code.y, origin.y, shift));
}
