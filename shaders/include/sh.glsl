// Spherical harmonics of a splat, to degree 3, with the basis signs of the original 3DGS.
//
// Bands are coded as sh_coding.glsl says. In codebooks and exact storage fractions have 16 bits:
// against f32 the error is at most 1.6e-5 of the band's largest coefficient, a thirtieth of what
// f16 would make of it, for the same bytes. In compact storage they have 13 or 14. Where the words
// stand is the including kernel's: it says SH_WORD(band, word, index, stride), and SH_COMPACT,
// before it includes this.

layout(constant_id = 2) const uint SH_DEGREE = 3u;

// Functions of each band, for one form of storage: words, bits of the scale, bits of a fraction.
#define SH_BAND1(name, word_count, scale_bits, bits)                                                 \
    vec3 name(uint index, uint stride, vec3 d) {                                                     \
        uint words[word_count];                                                                      \
        [[unroll]] for (int w = 0; w < word_count; ++w) {                                            \
            words[w] = SH_WORD(1, w, index, stride);                                                 \
        }                                                                                            \
        vec3 color = vec3(0.0);                                                                      \
        color += -0.4886025119029199 * d.y * SH_COEFFICIENT(words, 0, scale_bits, bits);             \
        color += 0.4886025119029199 * d.z * SH_COEFFICIENT(words, 1, scale_bits, bits);              \
        color += -0.4886025119029199 * d.x * SH_COEFFICIENT(words, 2, scale_bits, bits);             \
        return color * sh_step(words[0], scale_bits, bits);                                          \
    }

#define SH_BAND2(name, word_count, scale_bits, bits)                                                 \
    vec3 name(uint index, uint stride, vec3 d) {                                                     \
        uint words[word_count];                                                                      \
        [[unroll]] for (int w = 0; w < word_count; ++w) {                                            \
            words[w] = SH_WORD(2, w, index, stride);                                                 \
        }                                                                                            \
        float xx = d.x * d.x, yy = d.y * d.y;                                                        \
        vec3 color = vec3(0.0);                                                                      \
        color += 1.0925484305920792 * d.x * d.y * SH_COEFFICIENT(words, 0, scale_bits, bits);        \
        color += -1.0925484305920792 * d.y * d.z * SH_COEFFICIENT(words, 1, scale_bits, bits);       \
        color += 0.31539156525252005 * (2.0 * d.z * d.z - xx - yy)                                   \
                 * SH_COEFFICIENT(words, 2, scale_bits, bits);                                       \
        color += -1.0925484305920792 * d.x * d.z * SH_COEFFICIENT(words, 3, scale_bits, bits);       \
        color += 0.5462742152960396 * (xx - yy) * SH_COEFFICIENT(words, 4, scale_bits, bits);        \
        return color * sh_step(words[0], scale_bits, bits);                                          \
    }

#define SH_BAND3(name, word_count, scale_bits, bits)                                                 \
    vec3 name(uint index, uint stride, vec3 d) {                                                     \
        uint words[word_count];                                                                      \
        [[unroll]] for (int w = 0; w < word_count; ++w) {                                            \
            words[w] = SH_WORD(3, w, index, stride);                                                 \
        }                                                                                            \
        float xx = d.x * d.x, yy = d.y * d.y, zz = d.z * d.z;                                        \
        vec3 color = vec3(0.0);                                                                      \
        color += -0.5900435899266435 * d.y * (3.0 * xx - yy)                                         \
                 * SH_COEFFICIENT(words, 0, scale_bits, bits);                                       \
        color += 2.890611442640554 * d.x * d.y * d.z * SH_COEFFICIENT(words, 1, scale_bits, bits);   \
        color += -0.4570457994644658 * d.y * (4.0 * zz - xx - yy)                                    \
                 * SH_COEFFICIENT(words, 2, scale_bits, bits);                                       \
        color += 0.3731763325901154 * d.z * (2.0 * zz - 3.0 * xx - 3.0 * yy)                         \
                 * SH_COEFFICIENT(words, 3, scale_bits, bits);                                       \
        color += -0.4570457994644658 * d.x * (4.0 * zz - xx - yy)                                    \
                 * SH_COEFFICIENT(words, 4, scale_bits, bits);                                       \
        color += 1.445305721320277 * d.z * (xx - yy) * SH_COEFFICIENT(words, 5, scale_bits, bits);   \
        color += -0.5900435899266435 * d.x * (xx - 3.0 * yy)                                         \
                 * SH_COEFFICIENT(words, 6, scale_bits, bits);                                       \
        return color * sh_step(words[0], scale_bits, bits);                                          \
    }

SH_BAND1(sh_band1_exact, 5, 16, 16)
SH_BAND2(sh_band2_exact, 8, 16, 16)
SH_BAND3(sh_band3_exact, 11, 16, 16)
SH_BAND1(sh_band1_compact, 4, 11, 13)
SH_BAND2(sh_band2_compact, 7, 14, 14)
SH_BAND3(sh_band3_compact, 9, 15, 13)

// The color of entry `index` with the DC coefficients `dc`, seen along the unit vector d, from the
// camera to the splat.
vec3 sh_color(vec3 dc, uint index, uint stride, vec3 d) {
    vec3 color = 0.28209479177387814 * dc + 0.5;
    if (SH_DEGREE >= 1u) {
        color += SH_COMPACT ? sh_band1_compact(index, stride, d) : sh_band1_exact(index, stride, d);
    }
    if (SH_DEGREE >= 2u) {
        color += SH_COMPACT ? sh_band2_compact(index, stride, d) : sh_band2_exact(index, stride, d);
    }
    if (SH_DEGREE >= 3u) {
        color += SH_COMPACT ? sh_band3_compact(index, stride, d) : sh_band3_exact(index, stride, d);
    }
    return max(color, vec3(0.0));
}
