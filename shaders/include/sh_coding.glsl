// Coding of a band of spherical harmonics, a stream of bits from the lowest bit of its first word
// on: a scale, its largest coefficient rounded up, then signed fractions of it, [coefficient][rgb]
// (engine/render/src/sh_codec.rs).

// The signed number of `bits` bits whose lowest bit is bit `index` of `low`; `high` is the word
// with its highest bit.
float sh_fraction(uint low, uint high, int index, int bits) {
    if (index + bits <= 32) {
        return float(bitfieldExtract(int(low), index, bits));
    }
    return float(bitfieldExtract(int(low >> index | high << (32 - index)), 0, bits));
}

// The scale in the lowest `scale_bits` bits of `word`, the upper bits of a positive f16, per step
// of a fraction of `bits` bits.
float sh_step(uint word, int scale_bits, int bits) {
    uint pattern = scale_bits == 16 ? word : bitfieldExtract(word, 0, scale_bits) << (15 - scale_bits);
    return unpackHalf2x16(pattern).x / float((1 << (bits - 1)) - 1);
}

#define SH_FRACTION(words, index, bits)                                                              \
    sh_fraction(words[(index) / 32], words[((index) + (bits) - 1) / 32], (index) % 32, bits)

// Coefficient k, in steps.
#define SH_COEFFICIENT(words, k, scale_bits, bits)                                                   \
    vec3(SH_FRACTION(words, (scale_bits) + 3 * (k) * (bits), bits),                                  \
         SH_FRACTION(words, (scale_bits) + (3 * (k) + 1) * (bits), bits),                            \
         SH_FRACTION(words, (scale_bits) + (3 * (k) + 2) * (bits), bits))
