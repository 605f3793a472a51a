// What the three kernels of a radix sort pass share. Keys are 32 bits, a pass orders them by 8 of these.
//
// Several lists are sorted side by side, each by itself and in its place: a block of keys belongs to one of them.

const uint RADIX_BITS = 8u;
const uint RADIX = 1u << RADIX_BITS;

layout(constant_id = 0) const uint WORKGROUP_THREADS = 256u; // at most 8 subgroups
layout(constant_id = 1) const uint ITEMS = 16u;              // keys a thread

layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer segments_block { SortSegment segments[]; };

// Workgroups that `count` keys keep busy.
uint sort_blocks(uint count) {
    uint block = WORKGROUP_THREADS * ITEMS;
    return (count + block - 1u) / block;
}

// The segment that a block belongs to: the last that begins at or before it. Empty ones end where they begin, and are passed.
uint segment_of(uint block, uint segment_count) {
    uint segment = 0u;
    for (uint next = 1u; next < segment_count; ++next) {
        segment = segments[next].first_block <= block ? next : segment;
    }
    return segment;
}

// Where the counters of a digit of a segment begin: one a block.
uint first_counter(SortSegment segment, uint digit) {
    return segment.first_block * RADIX + digit * sort_blocks(segment.count);
}
