// What the three kernels of a radix sort pass share. Keys are 32 bits, a pass orders them by 8 of these.

const uint RADIX_BITS = 8u;
const uint RADIX = 1u << RADIX_BITS;

layout(constant_id = 0) const uint WORKGROUP_THREADS = 256u; // at most 8 subgroups
layout(constant_id = 1) const uint ITEMS = 16u;              // keys a thread

layout(local_size_x_id = 0) in;

// Workgroups that `count` keys keep busy.
uint sort_blocks(uint count) {
    uint block = WORKGROUP_THREADS * ITEMS;
    return (count + block - 1u) / block;
}
