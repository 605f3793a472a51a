// Attributes of a splat that planes show: range, normal and motion, and depths for medians.

#include "attributes.glsl"

layout(constant_id = 18) const bool DEPTHS = false; // depths and ranges of records are asked for

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

// The attributes of a splat that a camera sees; its normal and velocity in world axes.
Attributes seen_attributes(Camera camera, uint lens, vec3 mean_m, SeenSplat seen, vec3 normal, vec3 velocity_mps, float flow_interval_s) {
    Attributes own = NO_ATTRIBUTES;
    if (RANGE) {
        own.first.x = length(seen.t);
    }
    if (NORMAL) {
        set_attribute_words(own, NORMAL_WORD, normal, 3u);
    }
    if (FLOW_FORWARD) {
        set_attribute_words(own, FLOW_FORWARD_WORD, vec3(flow_px(camera, lens, mean_m, seen, flow_interval_s), 0.0), 2u);
    }
    if (FLOW_BACKWARD) {
        set_attribute_words(own, FLOW_BACKWARD_WORD, vec3(flow_px(camera, lens, mean_m, seen, -flow_interval_s), 0.0), 2u);
    }
    if (SCENE_FLOW) {
        set_attribute_words(own, SCENE_FLOW_WORD, velocity_mps, 3u);
    }
    return own;
}
