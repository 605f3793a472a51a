// Sums and products of two f32 with their rounding errors kept, as an unevaluated pair (high, low):
// Dekker, A Floating-Point Technique for Extending the Available Precision, 1971. Only additions
// and multiplications, which Vulkan requires to be correctly rounded, and `precise`, which forbids
// fusing them: the bits are the same on every device.

vec2 two_sum(float a, float b) {
    precise float sum = a + b;
    precise float b_part = sum - a;
    precise float error = (a - (sum - b_part)) + (b - b_part);
    return vec2(sum, error);
}

// The upper and lower half of a's digits.
vec2 split_digits(float a) {
    precise float scaled = 4097.0 * a; // 2^12 + 1
    precise float high = scaled - (scaled - a);
    precise float low = a - high;
    return vec2(high, low);
}

vec2 two_product(float a, float b) {
    precise float product = a * b;
    vec2 a_half = split_digits(a);
    vec2 b_half = split_digits(b);
    precise float error = ((a_half.x * b_half.x - product) + a_half.x * b_half.y + a_half.y * b_half.x) + a_half.y * b_half.y;
    return vec2(product, error);
}

vec2 add_pairs(vec2 a, vec2 b) {
    vec2 sum = two_sum(a.x, b.x);
    precise float low = (a.y + b.y) + sum.y;
    return two_sum(sum.x, low);
}

vec2 multiply_pairs(vec2 a, vec2 b) {
    vec2 product = two_product(a.x, b.x);
    precise float low = (a.x * b.y + a.y * b.x) + product.y;
    return two_sum(product.x, low);
}
