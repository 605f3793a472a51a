// What list_lidar.comp makes of sorted lists: which fine tiles their records may reach, one word of
// 32 pairs per fine tile of their coarse tile, bit i for pair 32 word + i; and the cells of the
// coarse tile that each record reaches.
//
// Included where required counts are bound.

// False if lists are not complete: the host grows the buffers and traces again.
bool lists_have_room(uint records_max, uint pairs_max) {
    return required.records <= records_max && wanted_pairs(required) <= pairs_max;
}

// Place of the word of 32 pairs from pair 32 `word` on, of the first fine tile of coarse tile
// `bin`; those of the others follow. A word may hold pairs of several lists. The list with the
// last of its pairs has it there. Of the others it is the end, and each has that at a place of its
// own, behind the words of the `pairs_max` pairs.
uint place_of_word(uint word, uint bin, uvec2 list, uint pairs_max) {
    return 32u * (32u * word + 31u < list.x + list.y ? word : (pairs_max + 31u) / 32u + bin);
}

// First and last column, first and last row of a coarse tile, in a word.
uint pack_cells(uvec4 cells) {
    return cells.x | cells.y << 8u | cells.z << 16u | cells.w << 24u;
}

uvec4 unpack_cells(uint packed) {
    return uvec4(packed, packed >> 8u, packed >> 16u, packed >> 24u) & 255u;
}
