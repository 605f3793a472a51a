// Spherical harmonics of a splat, to degree 3, with the basis signs of the original 3DGS.
//
// DC is f32. Each higher band is stored as 16-bit fractions of its own largest coefficient (rounded
// up to f16): half-word 0 is that scale, then [coefficient][rgb]. Against f32 the error is at most
// 1.6e-5 of the band's largest coefficient, a thirtieth of what f16 would make of it, for the same
// bytes. Where the words stand is the including kernel's: it says SH_WORD(band, word, index,
// stride) before it includes this.

layout(constant_id = 2) const uint SH_DEGREE = 3u;

// Adds weight * half-word `index` of a band; `words` are the band's words, `channel` the color it
// belongs to.
#define ADD_COEFFICIENT(color, words, k, basis)                                                      \
    color += (basis) * vec3(sh_fraction(words[(3 * (k) + 1) / 2], (3 * (k) + 1) % 2),                \
                             sh_fraction(words[(3 * (k) + 2) / 2], (3 * (k) + 2) % 2),                \
                             sh_fraction(words[(3 * (k) + 3) / 2], (3 * (k) + 3) % 2))

float sh_fraction(uint word, int half_word) {
    int value = half_word == 0 ? int(word << 16) >> 16 : int(word) >> 16;
    return float(value);
}

float sh_scale(uint word) {
    return unpackHalf2x16(word).x / 32767.0;
}

vec3 sh_band1_color(uint index, uint stride, vec3 d) {
    uint words[5];
    [[unroll]] for (int w = 0; w < 5; ++w) {
        words[w] = SH_WORD(1, w, index, stride);
    }
    vec3 color = vec3(0.0);
    ADD_COEFFICIENT(color, words, 0, -0.4886025119029199 * d.y);
    ADD_COEFFICIENT(color, words, 1, 0.4886025119029199 * d.z);
    ADD_COEFFICIENT(color, words, 2, -0.4886025119029199 * d.x);
    return color * sh_scale(words[0]);
}

vec3 sh_band2_color(uint index, uint stride, vec3 d) {
    uint words[8];
    [[unroll]] for (int w = 0; w < 8; ++w) {
        words[w] = SH_WORD(2, w, index, stride);
    }
    vec3 color = vec3(0.0);
    ADD_COEFFICIENT(color, words, 0, 1.0925484305920792 * d.x * d.y);
    ADD_COEFFICIENT(color, words, 1, -1.0925484305920792 * d.y * d.z);
    ADD_COEFFICIENT(color, words, 2, 0.31539156525252005 * (2.0 * d.z * d.z - d.x * d.x - d.y * d.y));
    ADD_COEFFICIENT(color, words, 3, -1.0925484305920792 * d.x * d.z);
    ADD_COEFFICIENT(color, words, 4, 0.5462742152960396 * (d.x * d.x - d.y * d.y));
    return color * sh_scale(words[0]);
}

vec3 sh_band3_color(uint index, uint stride, vec3 d) {
    uint words[11];
    [[unroll]] for (int w = 0; w < 11; ++w) {
        words[w] = SH_WORD(3, w, index, stride);
    }
    float xx = d.x * d.x, yy = d.y * d.y, zz = d.z * d.z;
    vec3 color = vec3(0.0);
    ADD_COEFFICIENT(color, words, 0, -0.5900435899266435 * d.y * (3.0 * xx - yy));
    ADD_COEFFICIENT(color, words, 1, 2.890611442640554 * d.x * d.y * d.z);
    ADD_COEFFICIENT(color, words, 2, -0.4570457994644658 * d.y * (4.0 * zz - xx - yy));
    ADD_COEFFICIENT(color, words, 3, 0.3731763325901154 * d.z * (2.0 * zz - 3.0 * xx - 3.0 * yy));
    ADD_COEFFICIENT(color, words, 4, -0.4570457994644658 * d.x * (4.0 * zz - xx - yy));
    ADD_COEFFICIENT(color, words, 5, 1.445305721320277 * d.z * (xx - yy));
    ADD_COEFFICIENT(color, words, 6, -0.5900435899266435 * d.x * (xx - 3.0 * yy));
    return color * sh_scale(words[0]);
}

// The color of entry `index` with the DC coefficients `dc`, seen along the unit vector d, from the
// camera to the splat.
vec3 sh_color(vec3 dc, uint index, uint stride, vec3 d) {
    vec3 color = 0.28209479177387814 * dc + 0.5;
    if (SH_DEGREE >= 1u) {
        color += sh_band1_color(index, stride, d);
    }
    if (SH_DEGREE >= 2u) {
        color += sh_band2_color(index, stride, d);
    }
    if (SH_DEGREE >= 3u) {
        color += sh_band3_color(index, stride, d);
    }
    return max(color, vec3(0.0));
}
