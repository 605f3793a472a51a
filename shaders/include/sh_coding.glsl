// Coding of a band of spherical harmonics, a stream of bits from the lowest bit of its first word
// on: a scale, its largest coefficient rounded up, then signed fractions of it, [coefficient][rgb]
// (engine/render/src/sh_codec.rs).

// The signed number of `bits` bits whose lowest bit is bit `place` of `low`; `high` is the word
// with its highest bit.
float sh_fraction(uint low, uint high, int place, int bits) {
    if (place + bits <= 32) {
        return float(bitfieldExtract(int(low), place, bits));
    }
    return float(bitfieldExtract(int(low >> place | high << (32 - place)), 0, bits));
}

// The scale in the lowest `scale_bits` bits of `word`, the upper bits of a positive f16, per step
// of a fraction of `bits` bits.
float sh_step(uint word, int scale_bits, int bits) {
    uint pattern = scale_bits == 16 ? word : bitfieldExtract(word, 0, scale_bits) << (15 - scale_bits);
    return unpackHalf2x16(pattern).x / float((1 << (bits - 1)) - 1);
}

#define SH_FRACTION(words, place, bits)                                                              \
    sh_fraction(words[(place) / 32], words[((place) + (bits) - 1) / 32], (place) % 32, bits)

// Coefficient k, in steps.
#define SH_COEFFICIENT(words, k, scale_bits, bits)                                                   \
    vec3(SH_FRACTION(words, (scale_bits) + 3 * (k) * (bits), bits),                                  \
         SH_FRACTION(words, (scale_bits) + (3 * (k) + 1) * (bits), bits),                            \
         SH_FRACTION(words, (scale_bits) + (3 * (k) + 2) * (bits), bits))
