// Sums over a workgroup, right for every subgroup size. Requires WORKGROUP_THREADS and
// GL_KHR_shader_subgroup_arithmetic.

// At most this many subgroups in a workgroup: 256 threads in subgroups of 4.
shared uint block_subgroup_sums[WORKGROUP_THREADS / 4];

// The thread's index in the workgroup such that neighbors in it are neighbors in a subgroup.
uint block_thread() {
    return gl_SubgroupID * gl_SubgroupSize + gl_SubgroupInvocationID;
}

// Sum of `value` over the threads before this one in block_thread() order; `total` is the sum over
// all of them. Every thread of the workgroup calls it.
uint block_exclusive_sum(uint value, out uint total) {
    uint inclusive = subgroupInclusiveAdd(value);
    barrier(); // an earlier call may still be read
    if (gl_SubgroupInvocationID == gl_SubgroupSize - 1u) {
        block_subgroup_sums[gl_SubgroupID] = inclusive;
    }
    barrier();
    uint before = 0u;
    total = 0u;
    for (uint subgroup = 0u; subgroup < gl_NumSubgroups; ++subgroup) {
        uint sum = block_subgroup_sums[subgroup];
        before += subgroup < gl_SubgroupID ? sum : 0u;
        total += sum;
    }
    return before + inclusive - value;
}

// Sum of `value` over the workgroup.
uint block_sum(uint value) {
    uint total;
    block_exclusive_sum(value, total);
    return total;
}
