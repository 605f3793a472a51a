// A Gaussian as a LiDAR meets it, and the beams that may meet it.
//
// A sector is a run of columns of the grid of beams. Its `Camera` has the axes of the sector (x
// toward its middle, y left, z up) and its grid in place of an image. A beam meets a Gaussian
// where the Gaussian is largest along the beam (Yu et al., Gaussian Opacity Fields, 2024).
//
// Included after visibility.glsl, with column_bounds and row_bounds bound.

layout(constant_id = 20) const float DILATION_RAD = 5e-4; // standard deviation added across the direction to the mean
layout(constant_id = 21) const bool MOVING = false;       // sensor or splats move during the sweep

struct Sector {
    vec3 velocity_mps;   // mean velocity of the sensor, sector axes
    float half_time_s;   // no beam fires farther from the middle of the sector
    float residual_m;    // the sensor is no farther from where its mean velocity has it
    uint first_column;   // first of its columns among the bounds of all sectors
    uint first_row;      // first of its rows among the bounds of all sectors
};

// A splat in the axes of a sector.
struct LidarSplat {
    vec3 toward;  // unit direction of the mean
    float range_m; // distance of the mean
    vec3 inverse_x_yx_zx; // first column of the inverse of the triangular factor of its covariance
    vec3 inverse_y_zy_z;  // its other entries: yy, zy, zz
    vec3 drift_mps;       // velocity of the splat
    float log2_opacity;
};

// Standard deviation along the direction to the mean, at least, as a share of its distance.
const float THICKNESS_MIN = 1e-6;

// What rounding may add to slopes of directions, at most, with room to spare.
const float SLOPE_SLACK = 1e-5;

// A number that rises with the azimuth of (x, y), from -2 to 2, without an angle.
float around(float x, float y) {
    float size = abs(x) + abs(y);
    float part = size > 0.0 ? y / size : 0.0;
    return x >= 0.0 ? part : (y >= 0.0 ? 2.0 - part : -2.0 - part);
}

// Rotates two columns of three rows so that row `row` of the second is zero.
void rotate_columns(inout vec3 first, inout vec3 second, uint row) {
    float size = length(vec2(first[row], second[row]));
    float cosine = size > 0.0 ? first[row] / size : 1.0;
    float sine = size > 0.0 ? second[row] / size : 0.0;
    vec3 turned = cosine * first + sine * second;
    second = cosine * second - sine * first;
    first = turned;
}

const ivec4 NO_CELLS = ivec4(0, -1, 0, -1);

bool any_cell(ivec4 cells) {
    return cells.x <= cells.y;
}

// Cells (first column, last column, first row, last row) with beams between the azimuths of
// (x_low, y_low) and (x_high, y_high), counterclockwise, and slopes z / |xy| from slope_low to
// slope_high. Empty where first > last.
ivec4 cells_between(Camera camera, Sector sector, vec2 from, vec2 to, float slope_low, float slope_high) {
    float low = around(from.x, from.y);
    float high = around(to.x, to.y);
    int columns = int(camera.size_px.x);
    // First column whose highest azimuth is at least `low`.
    int first = 0;
    int end = columns;
    while (first < end) {
        int middle = (first + end) / 2;
        if (column_bounds[sector.first_column + uint(middle)].y < low) {
            first = middle + 1;
        } else {
            end = middle;
        }
    }
    // Last column whose lowest azimuth is at most `high`.
    int last = -1;
    end = columns - 1;
    while (last < end) {
        int middle = (last + end + 1) / 2;
        if (column_bounds[sector.first_column + uint(middle)].x > high) {
            end = middle - 1;
        } else {
            last = middle;
        }
    }
    if (low > high) { // across the direction behind the sector
        bool left = first < columns;
        bool right = last >= 0;
        first = right ? 0 : first;
        last = left ? columns - 1 : last;
    }
    int rows = int(camera.size_px.y);
    // First row whose lowest slope is at most `slope_high`: slopes fall from row to row.
    int top = 0;
    end = rows;
    while (top < end) {
        int middle = (top + end) / 2;
        if (row_bounds[sector.first_row + uint(middle)].x > slope_high) {
            top = middle + 1;
        } else {
            end = middle;
        }
    }
    int bottom = -1;
    end = rows - 1;
    while (bottom < end) {
        int middle = (bottom + end + 1) / 2;
        if (row_bounds[sector.first_row + uint(middle)].y < slope_low) {
            end = middle - 1;
        } else {
            bottom = middle;
        }
    }
    return first <= last && top <= bottom ? ivec4(first, last, top, bottom) : NO_CELLS;
}

ivec4 all_cells(Camera camera) {
    return ivec4(0, int(camera.size_px.x) - 1, 0, int(camera.size_px.y) - 1);
}

// Cells of beams that may meet a splat in the box of `cluster`. Splats move with at most
// `speed_mps` in the axes of the cluster, and with the frame of the camera record.
ivec4 cluster_cells(Cluster cluster, Camera camera, Sector sector, float speed_mps) {
    if (cluster.splat_radius_m < 0.0) {
        return NO_CELLS;
    }
    vec3 offset = to_camera_axes(camera, from_camera_m(cluster.center_m, camera));
    float around_m = length(cluster.half_extent_m);
    // Dilation is in proportion to the distance; 3.34 standard deviations reach 1/255.
    float radius_m = around_m + cluster.splat_radius_m + 3.34 * DILATION_RAD * (length(offset) + around_m);
    if (MOVING) {
        radius_m += (length(sector.velocity_mps) + speed_mps) * sector.half_time_s + sector.residual_m;
    }
    radius_m *= 1.0001;
    float level_m = length(offset.xy);
    if (level_m <= 1.001 * radius_m) {
        return all_cells(camera);
    }
    vec2 ahead = offset.xy / level_m;
    float slope = radius_m * inversesqrt((level_m - radius_m) * (level_m + radius_m)) + SLOPE_SLACK;
    float low_m = offset.z - radius_m;
    float high_m = offset.z + radius_m;
    float slope_low = low_m / (low_m < 0.0 ? level_m - radius_m : level_m + radius_m);
    float slope_high = high_m / (high_m > 0.0 ? level_m - radius_m : level_m + radius_m);
    vec2 side = vec2(-ahead.y, ahead.x);
    return cells_between(camera, sector, ahead - slope * side, ahead + slope * side,
                         slope_low - SLOPE_SLACK * (1.0 + abs(slope_low)), slope_high + SLOPE_SLACK * (1.0 + abs(slope_high)));
}

// Cells of the beams that the ellipsoid around `mean` may meet, whose points are `factor` * v +
// `drift` * t + r with |v| <= 1, |t| <= 1, |r| <= `residual`. A factor of 0 means no such part.
ivec4 ellipsoid_cells(Camera camera, Sector sector, vec3 mean, mat3 factor, vec3 drift, float residual) {
    float level_m = length(mean.xy);
    if (!(level_m > 0.0)) {
        return all_cells(camera);
    }
    vec2 ahead = mean.xy / level_m;
    // Outer ellipsoid of the sum: each part grows by the total over its own root of the trace.
    float size = sqrt(dot(factor[0], factor[0]) + dot(factor[1], factor[1]) + dot(factor[2], factor[2]));
    float drift_size = length(drift);
    float residual_size = 1.7320509 * residual;
    float total = size + drift_size + residual_size;
    float grown = sqrt(total / size);
    vec3 moved = drift_size > 0.0 ? drift * sqrt(total / drift_size) : vec3(0.0);
    float rest = residual_size > 0.0 ? residual * sqrt(total / residual_size) : 0.0;
    // Rows of the factor, turned so that the mean has azimuth 0.
    vec3 row_x = grown * vec3(factor[0].x, factor[1].x, factor[2].x);
    vec3 row_y = grown * vec3(factor[0].y, factor[1].y, factor[2].y);
    vec3 x = ahead.x * row_x + ahead.y * row_y;
    vec3 y = ahead.x * row_y - ahead.y * row_x;
    vec3 z = grown * vec3(factor[0].z, factor[1].z, factor[2].z);
    vec3 w = vec3(ahead.x * moved.x + ahead.y * moved.y, ahead.x * moved.y - ahead.y * moved.x, moved.z);
    float xx = dot(x, x) + w.x * w.x + rest * rest;
    float yy = dot(y, y) + w.y * w.y + rest * rest;
    float zz = dot(z, z) + w.z * w.z + rest * rest;
    float xy = dot(x, y) + w.x * w.y;
    float xz = dot(x, z) + w.x * w.z;
    // The plane through the mean across its azimuth has to be outside the ellipsoid's shadow.
    float depth2 = level_m * level_m - xx;
    if (!(depth2 > 1e-3 * level_m * level_m)) {
        return all_cells(camera);
    }
    // Tangents of the shadow: y / x, then z / x. Differences are formed before squares.
    float minor_y = max(xx * yy - xy * xy - 1e-6 * xx * yy, 0.0);
    float half_y = sqrt(max(level_m * level_m * yy - minor_y, 0.0)) / depth2;
    float middle_y = -xy / depth2;
    vec3 across = mean.z * x - level_m * z;
    float across_w = mean.z * w.x - level_m * w.z;
    float across2 = dot(across, across) + across_w * across_w + rest * rest * (mean.z * mean.z + level_m * level_m);
    float minor_z = max(xx * zz - xz * xz - 1e-6 * xx * zz, 0.0);
    float half_z = sqrt(max(across2 - minor_z, 0.0)) / depth2;
    float middle_z = (level_m * mean.z - xz) / depth2;
    float right = middle_y - half_y - SLOPE_SLACK * (1.0 + abs(middle_y) + half_y);
    float left = middle_y + half_y + SLOPE_SLACK * (1.0 + abs(middle_y) + half_y);
    float slack = SLOPE_SLACK * (1.0 + abs(middle_z) + half_z);
    float low = middle_z - half_z - slack;
    float high = middle_z + half_z + slack;
    // z / |xy| at another azimuth is z / x there, times the cosine.
    float cosine = inversesqrt(1.0 + max(right * right, left * left));
    vec2 side = vec2(-ahead.y, ahead.x);
    return cells_between(camera, sector, ahead + right * side, ahead + left * side, min(low, low * cosine), max(high, high * cosine));
}

// A splat with covariance `axes` * transpose(`axes`) in the frame of the camera record, and the
// cells of the beams that it may add to. `velocity_mps` is that of its mean relative to that frame,
// in the frame's axes.
ivec4 see_from_lidar(Camera camera, Sector sector, vec3 mean_m, mat3 axes, float opacity, vec3 velocity_mps, out LidarSplat seen) {
    vec3 mean = to_camera_axes(camera, from_camera_m(mean_m, camera));
    float range_m = length(mean);
    seen = LidarSplat(vec3(1.0, 0.0, 0.0), range_m, vec3(1.0, 0.0, 0.0), vec3(1.0, 0.0, 1.0), vec3(0.0), -LOG2_255);
    if (!(range_m > 1e-6) || !(range_m < 1e6)) {
        return NO_CELLS;
    }
    seen.toward = mean / range_m;
    vec3 up = abs(seen.toward.z) < 0.7 ? vec3(0.0, 0.0, 1.0) : vec3(1.0, 0.0, 0.0);
    vec3 u = normalize(cross(up, seen.toward));
    vec3 v = cross(seen.toward, u);
    float width_m = DILATION_RAD * range_m;
    // Columns whose products with themselves sum to the covariance. Nothing is squared: needles
    // keep their width.
    vec3 a = to_camera_axes(camera, axes[0]);
    vec3 b = to_camera_axes(camera, axes[1]);
    vec3 c = to_camera_axes(camera, axes[2]);
    if (ANTIALIAS) {
        vec3 m0 = vec3(dot(u, a), dot(u, b), dot(u, c));
        vec3 m1 = vec3(dot(v, a), dot(v, b), dot(v, c));
        vec3 longest = max(abs(m0), abs(m1));
        float unit = max(width_m, max(longest.x, max(longest.y, longest.z)));
        m0 /= unit;
        m1 /= unit;
        float dilation = (width_m / unit) * (width_m / unit);
        vec3 area = cross(m0, m1);
        float undilated = dot(area, area);
        opacity *= sqrt(undilated / (undilated + dilation * (dot(m0, m0) + dot(m1, m1)) + dilation * dilation));
    }
    if (!(opacity >= ALPHA_MIN)) {
        return NO_CELLS;
    }
    vec3 d = width_m * u;
    vec3 e = width_m * v;
    vec3 f = (THICKNESS_MIN * range_m) * seen.toward;
    rotate_columns(a, b, 0u);
    rotate_columns(a, c, 0u);
    rotate_columns(a, d, 0u);
    rotate_columns(a, e, 0u);
    rotate_columns(a, f, 0u);
    rotate_columns(b, c, 1u);
    rotate_columns(b, d, 1u);
    rotate_columns(b, e, 1u);
    rotate_columns(b, f, 1u);
    rotate_columns(c, d, 2u);
    rotate_columns(c, e, 2u);
    rotate_columns(c, f, 2u);
    float xx = 1.0 / a.x;
    float yy = 1.0 / b.y;
    float zz = 1.0 / c.z;
    float yx = -a.y * xx * yy;
    float zy = -b.z * yy * zz;
    seen.inverse_x_yx_zx = vec3(xx, yx, -(a.z * xx + b.z * yx) * zz);
    seen.inverse_y_zy_z = vec3(yy, zy, zz);
    seen.log2_opacity = max(log2(opacity), -LOG2_255);
    // The squared radius is that of alpha 1/255, in standard deviations, with room for rounding.
    float radius = sqrt((seen.log2_opacity + LOG2_255 + SQUARED_RADIUS_SLACK) / HALF_LOG2_E);
    vec3 drift = vec3(0.0);
    float residual_m = 0.0;
    if (MOVING) {
        seen.drift_mps = to_camera_axes(camera, velocity_mps) + camera.frame_velocity_mps;
        drift = (seen.drift_mps - sector.velocity_mps) * sector.half_time_s;
        residual_m = sector.residual_m;
    }
    if (!(abs(seen.inverse_x_yx_zx.x) < 1e30 && abs(yy) < 1e30 && abs(zz) < 1e30)) {
        return NO_CELLS;
    }
    return ellipsoid_cells(camera, sector, mean, mat3(radius * a, radius * vec3(0.0, b.yz), radius * vec3(0.0, 0.0, c.z)), drift, residual_m);
}
