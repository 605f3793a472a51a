// Rolling shutters: a splat is projected with the poses of the time at which its mean is exposed,
// and its footprint is sheared by its motion in the image during the readout.
//
// Row r of the image is row r of an image with all poses at the time of the row. A splat that is at
// m when m is exposed, and moves by w pixels per second, is at m + w (time(p) - time(m)) when pixel
// p is exposed. The time is affine in p, so the exponent stays a quadratic form in p - m: the shear
// is folded into its factors.

#include "turn.glsl"

layout(constant_id = 17) const bool ROLLING = false; // some splats move while an image is exposed

const uint TIME_STEPS = 4u;

// Largest share of the readout's own speed at which a splat that follows it is sheared.
const float FOLLOW_MAX = 0.9;

// Reach of a lens's derivative, radians.
const float LENS_STEP_RAD = 0.01;

bool rolls(Camera camera) {
    return camera.shutter_s_per_px != vec2(0.0);
}

// Time at which an image position is exposed, seconds after that of the poses.
float exposed_s(Camera camera, vec2 place_px) {
    return camera.shutter_first_s + dot(camera.shutter_s_per_px, place_px);
}

// A splat's mean in camera axes at `time_s`, and its velocity there.
struct MovingPoint {
    vec3 at;
    vec3 velocity;
};

MovingPoint moving_point(Camera camera, vec3 mean_m, float time_s) {
    vec3 change = turn_change(time_s * camera.frame_turn_rad_per_s, mean_m);
    vec3 point = to_camera_axes(camera, from_camera_m(mean_m, camera) + change) + time_s * camera.frame_velocity_mps;
    vec3 velocity = to_camera_axes(camera, cross(camera.frame_turn_rad_per_s, mean_m + change)) + camera.frame_velocity_mps;
    vec3 back = -time_s * camera.turn_rad_per_s;
    point += turn_change(back, point);
    velocity += turn_change(back, velocity);
    return MovingPoint(point, velocity - cross(camera.turn_rad_per_s, point));
}

// The axes of a camera turned on by `time_s`, rows of camera from splats' frame.
Camera turned_camera(Camera camera, float time_s) {
    vec3 on = time_s * camera.turn_rad_per_s;
    vec3 back = -time_s * camera.frame_turn_rad_per_s;
    // Columns of the inverse: the camera's axes in the splats' frame.
    mat3 axes = mat3(1.0);
    axes[0] += turn_change(on, axes[0]);
    axes[1] += turn_change(on, axes[1]);
    axes[2] += turn_change(on, axes[2]);
    mat3 rows = mat3(camera.row_x, camera.row_y, camera.row_z) * axes;
    camera.row_x = rows[0] + turn_change(back, rows[0]);
    camera.row_y = rows[1] + turn_change(back, rows[1]);
    camera.row_z = rows[2] + turn_change(back, rows[2]);
    return camera;
}

// Position of a point in the image, and its velocity there, pixels and pixels per second.
struct MovingPixel {
    vec2 at_px;
    vec2 px_per_s;
};

MovingPixel moving_pixel(Camera camera, uint lens, MovingPoint point) {
    if (LENSES && lenses[lens].kind != LENS_PINHOLE) {
        float step_s = LENS_STEP_RAD * length(point.at) / max(length(point.velocity), 1e-6);
        vec2 after = through_lens(lens, point.at + step_s * point.velocity);
        vec2 before = through_lens(lens, point.at - step_s * point.velocity);
        return MovingPixel(camera.principal_px + through_lens(lens, point.at), (after - before) / (2.0 * step_s));
    }
    // A point behind the near plane lies far beside the image, on the side where it comes in.
    float z = max(point.at.z, NEAR_M);
    vec2 slope = point.at.xy / z;
    vec2 velocity = point.at.z < NEAR_M ? vec2(0.0) : (point.velocity.xy - slope * point.velocity.z) / z;
    return MovingPixel(camera.focal_px * slope + camera.principal_px, camera.focal_px * velocity);
}

// True if a shear shows the motion of a splat at `t`: it lies where the projection is linear, and
// does not follow the readout through the image.
bool is_sheared(Camera camera, uint lens, vec3 t, vec2 px_per_s) {
    bool near = LENSES && lenses[lens].kind != LENS_PINHOLE
        ? lens_shows(lens, t)
        : all(greaterThanEqual(t.xy, camera.slope_min * t.z)) && all(lessThanEqual(t.xy, camera.slope_max * t.z));
    return near && px_per_s != vec2(0.0) && dot(camera.shutter_s_per_px, px_per_s) <= FOLLOW_MAX;
}

// A footprint that moves with `w` pixels per second, and whose mean is exposed `late_s` after the
// time that it was projected for.
Footprint sheared(Footprint splat, vec2 w, vec2 s_per_px, float late_s) {
    float stand = 1.0 - dot(s_per_px, w);
    splat.mean_px += w * (late_s / stand);
    if (s_per_px.x == 0.0) {
        // Rows: the factor stays triangular.
        splat.slope = w.x * s_per_px.y + splat.slope * stand;
        splat.rate_y *= stand;
        return splat;
    }
    // Columns: the two rows of the factor are turned into each other.
    float down = w.y * s_per_px.x;
    vec2 upper = splat.rate_x * vec2(stand + splat.slope * down, -splat.slope);
    vec2 lower = splat.rate_y * vec2(-down, 1.0);
    float side2 = upper.x * upper.x + lower.x * lower.x;
    float side = sqrt(side2);
    splat.slope = -(upper.x * upper.y + lower.x * lower.y) / side2;
    splat.rate_y *= splat.rate_x * stand / side;
    splat.rate_x = side;
    return splat;
}

// Projection of a splat: what project_splat_seen needs and finds.
struct SeenSplat {
    Camera camera;  // as it stands when the splat is exposed
    vec3 offset_m;  // of the mean from the camera, in the splats' axes
    vec3 t;         // the same in camera axes
    float time_s;   // of its exposure
    Footprint splat;
};

// Projects a splat for whatever lens and shutter. False when it is behind the near plane or adds
// nothing to any pixel.
bool see_splat(Camera camera, uint lens, vec3 mean_m, mat3 axes, float opacity, out SeenSplat seen) {
    if (!ROLLING || !rolls(camera)) {
        seen.camera = camera;
        seen.offset_m = from_camera_m(mean_m, camera);
        seen.t = to_camera_axes(camera, seen.offset_m);
        seen.time_s = 0.0;
        return project_splat_seen(camera, lens, seen.t, axes, opacity, seen.splat);
    }
    vec2 s_per_px = camera.shutter_s_per_px;
    float first_s = camera.shutter_first_s;
    float last_s = exposed_s(camera, vec2(camera.size_px));
    float low_s = min(first_s, last_s);
    float high_s = max(first_s, last_s);
    float time_s = clamp(0.0, low_s, high_s);
    MovingPoint point = moving_point(camera, mean_m, time_s);
    MovingPixel position = moving_pixel(camera, lens, point);
    // Newton's method for the time at which the position of the mean is exposed.
    for (uint i = 0u; i < TIME_STEPS; ++i) {
        float late_s = exposed_s(camera, position.at_px) - time_s;
        float stand = max(1.0 - dot(s_per_px, position.px_per_s), 1.0 - FOLLOW_MAX);
        time_s = clamp(time_s + late_s / stand, low_s, high_s);
        point = moving_point(camera, mean_m, time_s);
        position = moving_pixel(camera, lens, point);
    }
    seen.camera = turned_camera(camera, time_s);
    seen.t = point.at;
    seen.time_s = time_s;
    seen.offset_m = seen.camera.row_x * point.at.x + seen.camera.row_y * point.at.y + seen.camera.row_z * point.at.z;
    if (!project_splat_seen(seen.camera, lens, seen.t, axes, opacity, seen.splat)) {
        return false;
    }
    if (is_sheared(camera, lens, seen.t, position.px_per_s)) {
        float late_s = exposed_s(camera, seen.splat.mean_px) - time_s;
        seen.splat = sheared(seen.splat, position.px_per_s, s_per_px, late_s);
    }
    return seen.splat.rate_x > 0.0 && seen.splat.rate_y > 0.0 && abs(seen.splat.slope) < 1e30
        && all(lessThan(abs(seen.splat.mean_px), vec2(1e30)));
}

// The cluster with a box around all positions where its means are while the image is exposed.
Cluster swept(Cluster cluster, Camera camera) {
    if (!ROLLING || !rolls(camera)) {
        return cluster;
    }
    float last_s = exposed_s(camera, vec2(camera.size_px));
    float time_s = max(abs(camera.shutter_first_s), abs(last_s));
    float half_m = length(cluster.half_extent_m);
    float moved_m = time_s * (length(camera.frame_velocity_mps) + length(camera.frame_turn_rad_per_s) * (length(cluster.center_m) + half_m));
    float distance_m = length(from_camera_m(cluster.center_m, camera)) + half_m + moved_m;
    cluster.half_extent_m += moved_m + time_s * length(camera.turn_rad_per_s) * distance_m;
    return cluster;
}
