#version 460
// Joins each camera's two sorted lists, background and agents, to its front-to-back order.
//
// Merge path (Green, McColl and Bader, GPU Merge Path, 2012): a workgroup takes 1024 places of the result, finds by search
// how many of them come from either list, and each entry then counts the entries of the other list before it. Of equal
// keys the background's comes first, as its splats have the lower indices.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#include "frame.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, scalar) readonly buffer lists_block { ViewLists lists[]; };
layout(set = 0, binding = 1, scalar) readonly buffer keys_block { uint keys[]; };
layout(set = 0, binding = 2, scalar) readonly buffer values_block { uint values[]; };
layout(set = 0, binding = 3, scalar) writeonly buffer order_block { uint order[]; };

layout(push_constant, scalar) uniform push_block { uint camera_count; };

shared uint window_keys[PAIR_BLOCK];
shared uint shared_range[2];

uint static_key(ViewLists list, uint index) {
    return keys[list.first_static + index];
}

uint moving_key(ViewLists list, uint index) {
    return keys[list.first_moving + index];
}

// How many of the first `place` entries of the result come from the background: the least count such that the next of the
// background does not come before the last taken of the agents. All threads search together, 256 candidates at a time.
uint split_at(ViewLists list, uint place) {
    uint thread = gl_LocalInvocationIndex;
    if (thread == 0u) {
        shared_range[0] = place > list.moving_count ? place - list.moving_count : 0u;
        shared_range[1] = min(place, list.static_count);
    }
    barrier();
    for (;;) {
        uint low = shared_range[0];
        uint high = shared_range[1];
        barrier();
        if (low >= high) {
            return low;
        }
        uint step = (high - low + 255u) / 256u;
        uint candidate = low + thread * step;
        // Whether more than `candidate` must come from the background.
        bool more = candidate < high && static_key(list, candidate) <= moving_key(list, place - 1u - candidate);
        if (more) {
            atomicMax(shared_range[0], candidate + 1u);
        } else if (candidate < high) {
            atomicMin(shared_range[1], candidate);
        }
        barrier();
    }
}

// Entries of the window's run [first, end) whose key is below `key`, or not above it.
uint count_before(uint first, uint end, uint key, bool equal_too) {
    uint low = first;
    while (low < end) {
        uint middle = (low + end) / 2u;
        if (window_keys[middle] < key || (equal_too && window_keys[middle] == key)) {
            low = middle + 1u;
        } else {
            end = middle;
        }
    }
    return low - first;
}

void main() {
    uint group = group_index();
    uint camera = 0u;
    for (uint next = 1u; next < camera_count; ++next) {
        camera = lists[next].first_block <= group ? next : camera;
    }
    ViewLists list = lists[camera];
    uint total = list.static_count + list.moving_count;
    uint first = (group - list.first_block) * PAIR_BLOCK;
    if (first >= total) {
        return;
    }
    uint end = min(first + PAIR_BLOCK, total);
    uint static_first = split_at(list, first);
    uint static_taken = split_at(list, end) - static_first;
    uint moving_first = first - static_first;
    for (uint entry = gl_LocalInvocationIndex; entry < end - first; entry += 256u) {
        window_keys[entry] = entry < static_taken ? static_key(list, static_first + entry)
                                                  : moving_key(list, moving_first + entry - static_taken);
    }
    barrier();
    for (uint entry = gl_LocalInvocationIndex; entry < end - first; entry += 256u) {
        uint key = window_keys[entry];
        uint value;
        uint place;
        if (entry < static_taken) {
            value = values[list.first_static + static_first + entry];
            place = entry + count_before(static_taken, end - first, key, false);
        } else {
            value = values[list.first_moving + moving_first + entry - static_taken];
            place = entry - static_taken + count_before(0u, static_taken, key, true);
        }
        order[list.first_ordered + first + place] = value;
    }
}
