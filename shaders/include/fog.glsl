// Fog between splats and the camera: see `Fog` in the engine.

layout(constant_id = 19) const bool FOG = false; // there is fog

// Color of a splat of `color` at `range_m`; `fog` is the color of the air, and extinction per
// meter.
vec3 in_fog(vec3 color, float range_m, vec4 fog) {
    return FOG ? mix(fog.rgb, color, exp(-fog.a * range_m)) : color;
}
