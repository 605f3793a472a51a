// The background's lists of records, found without waiting for plan_order: `firsts` is [camera][chunk] and their total.

// First place and length of a camera's list.
uvec2 static_list(uint camera) {
    uint first = min(firsts[camera * chunk_count], records_max);
    uint end = min(firsts[(camera + 1u) * chunk_count], records_max);
    return uvec2(first, end - first);
}
