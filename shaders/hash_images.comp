#version 460
// Sums over the blocks of an image that the hash XXH3 adds up (xxHash, doc/xxhash_spec.md, version
// 0.2): all that a hash reads of the image. The sums of a block follow from the block alone; the
// host chains them, which is 64 bytes for 1,024.
//
// An image is hashed in pieces of 1 MiB. A piece has units: its whole blocks of 16 stripes of 64
// bytes, what is left of stripes before its last byte, and its last 64 bytes. A thread adds up one
// of the 8 lanes of a unit. Sums are of 64 bits, as pairs of words, low first: not every device
// has such integers.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#include "frame.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, scalar) readonly buffer pixels_block { uint pixels[]; };
// The secret of the hash: 24 keys, and the 8 of last stripes behind them.
layout(set = 0, binding = 1, scalar) readonly buffer keys_block { uvec2 keys[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer sums_block { uvec2 sums[]; };

layout(push_constant, scalar) uniform push_block {
    uint first_pixel; // of the image
    uint pixel_count;
    uint first_unit; // of the image's sums
    uint unit_count;
};

const uint HASH_LANES = 8u;
const uint HASH_STRIPE_BYTES = 64u;
const uint HASH_BLOCK_BYTES = 1024u;
const uint HASH_PIECE_BYTES = 1048576u;
const uint HASH_PIECE_UNITS = HASH_PIECE_BYTES / HASH_BLOCK_BYTES + 1u; // of a whole piece: its last block is no whole one
const uint HASH_LAST_KEYS = 24u;

uvec2 sum_of(uvec2 a, uvec2 b) {
    uint carry;
    uint low = uaddCarry(a.x, b.x, carry);
    return uvec2(low, a.y + b.y + carry);
}

void main() {
    uint index = group_index() * 256u + gl_LocalInvocationIndex;
    uint unit = index / HASH_LANES;
    uint lane = index % HASH_LANES;
    if (unit >= unit_count) {
        return;
    }
    uint piece = unit / HASH_PIECE_UNITS;
    uint place = unit - piece * HASH_PIECE_UNITS;
    uint begin = piece * HASH_PIECE_BYTES;
    uint length = min(HASH_PIECE_BYTES, 4u * pixel_count - begin);
    uint blocks = (length - 1u) / HASH_BLOCK_BYTES;
    uint stripes = HASH_BLOCK_BYTES / HASH_STRIPE_BYTES;
    uint at = begin + place * HASH_BLOCK_BYTES;
    uint first_key = 0u;
    if (place == blocks) {
        stripes = (length - 1u - blocks * HASH_BLOCK_BYTES) / HASH_STRIPE_BYTES;
    } else if (place > blocks) {
        stripes = 1u;
        at = begin + length - HASH_STRIPE_BYTES;
        first_key = HASH_LAST_KEYS;
    }
    uvec2 sum = uvec2(0u);
    for (uint stripe = 0u; stripe < stripes; ++stripe) {
        uint first = first_pixel + at / 4u + stripe * (HASH_STRIPE_BYTES / 4u);
        uint own = first + 2u * lane;
        uint other = first + 2u * (lane ^ 1u);
        uvec2 keyed = uvec2(pixels[own], pixels[own + 1u]) ^ keys[first_key + stripe + lane];
        uint high;
        uint low;
        umulExtended(keyed.x, keyed.y, high, low);
        sum = sum_of(sum, uvec2(low, high));
        sum = sum_of(sum, uvec2(pixels[other], pixels[other + 1u]));
    }
    sums[first_unit * HASH_LANES + index] = sum;
}
