// Bits of the visible splats of one cluster, for all cameras. Included behind the buffers
// `visible_words` and `visible_counts` and the push constants `camera_count` and `cluster_count`.
// All threads of a workgroup call each function.

shared uint words[CAMERAS_MAX * CLUSTER_WORDS];

// Before the first bit is set.
void clear_words(uint thread) {
    for (uint word = thread; word < camera_count * CLUSTER_WORDS; word += CLUSTER_SPLATS) {
        words[word] = 0u;
    }
    barrier();
}

void set_visible(uint camera_index, uint thread) {
    atomicOr(words[camera_index * CLUSTER_WORDS + thread / 32u], 1u << (thread % 32u));
}

// After the last bit is set.
void store_words(uint cluster_index, uint thread) {
    barrier();
    for (uint word = thread; word < camera_count * CLUSTER_WORDS; word += CLUSTER_SPLATS) {
        uint camera_index = word / CLUSTER_WORDS;
        visible_words[(camera_index * cluster_count + cluster_index) * CLUSTER_WORDS + word % CLUSTER_WORDS] = words[word];
    }
    if (thread < camera_count) {
        uint count = 0u;
        for (uint word = 0u; word < CLUSTER_WORDS; ++word) {
            count += bitCount(words[thread * CLUSTER_WORDS + word]);
        }
        visible_counts[thread * cluster_count + cluster_index] = count;
    }
}
