// A shadow of an agent on the ground that it stands on: a soft super-ellipse about its footprint,
// or where its box keeps a light away.

struct Shadow {
    vec3 center_high_m; // the ground in the middle of the shadow, relative to the world's origin: high and low part
    vec3 center_low_m;
    vec3 along;  // in the ground; a half length of the shadow is 1
    vec3 across; // likewise, a half width
    vec3 normal; // of the ground, unit
    float strength;   // share of the light that is gone in the middle
    float log2_decay; // binary logarithm of what a half size farther out leaves of the mask, negated
    uint sharpness;   // squarings of the radius before it decays: 0 fades from the middle on, more are evener within
    float cutoff;     // half sizes beyond which the mask counts as zero
    float slab_m;     // splats whose mean is farther from the plane are not ground
    uint cameras;     // those that see it, a bit each
};

vec3 from_shadow_m(vec3 position_m, Shadow shadow) {
    return (position_m - shadow.center_high_m) - shadow.center_low_m;
}

// Share of the light that remains for a splat with its mean at `mean_m`.
float shadow_factor(Shadow shadow, vec3 mean_m) {
    vec3 offset = from_shadow_m(mean_m, shadow);
    if (abs(dot(shadow.normal, offset)) > shadow.slab_m) {
        return 1.0;
    }
    vec2 u = vec2(dot(shadow.along, offset), dot(shadow.across, offset));
    u *= u;
    float radius = sqrt(sqrt(dot(u, u))); // (|x|^4 + |y|^4)^(1/4)
    if (radius > shadow.cutoff) {
        return 1.0;
    }
    for (uint squaring = 0u; squaring < shadow.sharpness; ++squaring) {
        radius *= radius;
    }
    return clamp(1.0 - shadow.strength * exp2(-shadow.log2_decay * radius), 0.0, 1.0);
}
