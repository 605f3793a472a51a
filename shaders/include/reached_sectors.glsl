// Sectors whose beams may meet splats of one cluster.
//
// Included behind the buffer `visible_counts` and the push constants `camera_count` and
// `cluster_count`.

// As bits.
shared uint reached_sectors;

// The sectors in which the first run has found splats of the cluster. All threads of a workgroup
// call it.
void find_marked_sectors(uint cluster_index, uint thread) {
    if (thread == 0u) {
        reached_sectors = 0u;
    }
    barrier();
    if (thread < camera_count && visible_counts[thread * cluster_count + cluster_index] > 0u) {
        atomicOr(reached_sectors, 1u << thread);
    }
    barrier();
}
