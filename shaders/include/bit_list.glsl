// Entries of a list of which a bit says that they count, taken by rank.
//
// Included after LANES, the lanes of a subgroup, with GL_KHR_shader_subgroup_shuffle.

// Index of the set bit of `bits` that has `rank` others below it.
uint place_of_bit(uint bits, uint rank) {
    uint index = 0u;
    [[unroll]] for (uint step = 16u; step > 0u; step /= 2u) {
        uint below = uint(bitCount(bits >> index & ((1u << step) - 1u)));
        bool above = rank >= below;
        rank -= above ? below : 0u;
        index += above ? step : 0u;
    }
    return index;
}

// Entry `rank` of those whose bits the lanes hold: `bits` of each, and how many bits lie in the
// lanes before. Every lane calls it.
uint entry_of_rank(uint rank, uint bits, uint before) {
    uint holder = 0u;
    [[unroll]] for (uint step = LANES / 2u; step > 0u; step /= 2u) {
        holder += subgroupShuffle(before, holder + step) <= rank ? step : 0u;
    }
    uint held = subgroupShuffle(bits, holder);
    return 32u * holder + place_of_bit(held, rank - subgroupShuffle(before, holder));
}
