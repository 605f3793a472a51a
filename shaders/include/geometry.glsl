// Attributes of a splat that planes show: normal, range and motion. Where one is asked for, the
// projections write it instead of color.

layout(constant_id = 18) const uint ATTRIBUTE = 0u;

const uint ATTRIBUTE_NONE = 0u;       // color
const uint ATTRIBUTE_RANGE = 1u;      // distance from the camera, meters
const uint ATTRIBUTE_NORMAL = 2u;     // unit vector, world axes
const uint ATTRIBUTE_FLOW = 3u;       // displacement in the image after a time, pixels
const uint ATTRIBUTE_SCENE_FLOW = 4u; // velocity, meters per second, world axes
const uint ATTRIBUTE_DEPTH = 5u;      // depth, meters, as in records

// The inverse of the covariance `axes` * transpose(`axes`), squared `squarings` times, but for a
// factor.
mat3 inverse_power(mat3 axes, uint squarings) {
    // The adjugate is the inverse but for a factor, and exists for flat splats too.
    float unit = max(length(axes[0]), max(length(axes[1]), length(axes[2])));
    mat3 scaled = axes / max(unit, 1e-30);
    mat3 adjugate = mat3(cross(scaled[1], scaled[2]), cross(scaled[2], scaled[0]), cross(scaled[0], scaled[1]));
    mat3 power = adjugate * transpose(adjugate);
    for (uint i = 0u; i < squarings; ++i) {
        float trace = power[0].x + power[1].y + power[2].z;
        power /= max(trace, 1e-30);
        power = power * power;
    }
    return power;
}

// The axis of a Gaussian along which it is thinnest, of unit length: the eigenvector of the
// smallest eigenvalue of the covariance `axes` * transpose(`axes`). Powers of the inverse turn
// towards it.
vec3 thinnest_axis(mat3 axes) {
    mat3 power = inverse_power(axes, 5u);
    vec3 squares = vec3(dot(power[0], power[0]), dot(power[1], power[1]), dot(power[2], power[2]));
    float most = max(squares.x, max(squares.y, squares.z));
    return normalize(squares.x == most ? power[0] : squares.y == most ? power[1] : power[2]);
}

// Displacement of a splat's mean in the image `interval_s` later, or earlier where negative,
// pixels; 0 for one that is behind the near plane then.
vec2 flow_px(Camera camera, uint lens, vec3 mean_m, SeenSplat seen, float interval_s) {
    MovingPoint other = moving_point(camera, mean_m, seen.time_s + interval_s);
    if (other.at.z < NEAR_M) {
        return vec2(0.0);
    }
    MovingPoint now = MovingPoint(seen.t, vec3(0.0));
    return moving_pixel(camera, lens, other).at_px - moving_pixel(camera, lens, now).at_px;
}

// Normal of a splat towards the camera, in the axes of the splats' frame.
vec3 normal_of(mat3 axes, SeenSplat seen) {
    vec3 normal = thinnest_axis(axes);
    return dot(normal, seen.offset_m) > 0.0 ? -normal : normal;
}
