// Rotation by a rotation vector.

// The change of `v` under the rotation vector `turn`, at most 1 rad long: Rodrigues' formula with
// series for sine and cosine, whose accuracy Vulkan does not promise.
vec3 turn_change(vec3 turn, vec3 v) {
    float angle2 = dot(turn, turn);
    float sine = 1.0 - angle2 / 6.0 * (1.0 - angle2 / 20.0 * (1.0 - angle2 / 42.0 * (1.0 - angle2 / 72.0)));
    float cosine = 0.5 - angle2 / 24.0 * (1.0 - angle2 / 30.0 * (1.0 - angle2 / 56.0 * (1.0 - angle2 / 90.0)));
    vec3 across = cross(turn, v);
    return sine * across + cosine * cross(turn, across);
}
