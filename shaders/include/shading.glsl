// Light on an agent, for each normal of its surface: a sky above, a ground below, and lights from
// one side each (hemisphere lighting and Lambert's cosine law).

const uint SHADING_LIGHTS = 4u;
const float SHADING_LIGHT_MIN = 1e-4; // least light on a surface

// All in the agent's frame. Light is E / pi, linear.
struct Shading {
    vec3 up;                      // away from the ground
    vec3 upright;                 // light of sky and ground on upright surfaces
    vec3 upward;                  // what faces that look up have more than these
    vec3 outward;                 // 1 / half size^2 of the agent's box
    vec3 towards[SHADING_LIGHTS]; // unit vectors
    vec3 rgb[SHADING_LIGHTS];     // on surfaces that face them
    vec3 first_slope_per_m;       // of the share of the first light that reaches a position
    float first_middle;           // the share in the middle of the agent
};

// Normal by which a splat with the mean `mean_m` is shaded: the direction out of the agent, times
// the fourth power of the inverse covariance. That is the thinnest axis of a flat splat, on its
// outer side, and the direction itself for a ball.
vec3 shading_normal(Shading shading, mat3 axes, vec3 mean_m) {
    vec3 outward = mean_m * shading.outward;
    float size = length(outward);
    outward = size > 0.0 ? outward / size : vec3(0.0, 0.0, 1.0);
    vec3 normal = inverse_power(axes, 2u) * outward;
    size = length(normal);
    return size > 0.0 ? normal / size : outward;
}

// Factor on the displayed color of a surface of the given normal at `mean_m`.
vec3 shading_gain(Shading shading, vec3 normal, vec3 mean_m) {
    vec3 light = shading.upright + dot(normal, shading.up) * shading.upward;
    float share = clamp(shading.first_middle + dot(shading.first_slope_per_m, mean_m), 0.0, 1.0);
    light += share * max(dot(normal, shading.towards[0]), 0.0) * shading.rgb[0];
    for (uint i = 1u; i < SHADING_LIGHTS; ++i) {
        light += max(dot(normal, shading.towards[i]), 0.0) * shading.rgb[i];
    }
    return pow(max(light, SHADING_LIGHT_MIN), vec3(1.0 / 2.2));
}
