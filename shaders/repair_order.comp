#version 460
// Puts almost sorted lists right: counts, for every entry, the entries around it that stand on the wrong side of it.
//
// In any list the sorted place of an entry is its own place, less the entries before it that belong behind it, plus those
// behind it that belong before it. Where no such pair is more than `reach` places apart, a look at the neighbourhood finds
// them all. Where some are, two entries claim one place: check_order sees that.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#include "frame.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, scalar) readonly buffer view_orders_block { ViewOrder view_orders[]; };
layout(set = 0, binding = 1, scalar) readonly buffer firsts_block { uint firsts[]; };
layout(set = 0, binding = 2, scalar) readonly buffer keys_block { uint keys[]; };
layout(set = 0, binding = 3, scalar) readonly buffer values_block { uint values[]; };
layout(set = 0, binding = 4, scalar) writeonly buffer repaired_block { uint repaired[]; };

layout(push_constant, scalar) uniform push_block { uint camera_count; uint chunk_count; uint records_max; uint reach; };

#include "static_lists.glsl"

const uint BLOCK = 1024u;
const uint REACH_MAX = 256u;
shared uint window_keys[BLOCK + 2u * REACH_MAX];
shared uint window_values[BLOCK + 2u * REACH_MAX];

// The list and the first place in it of a block; false when there are fewer.
bool find_block(uint block, out uvec2 list, out uint first) {
    for (uint camera = 0u; camera < camera_count; ++camera) {
        if (view_orders[camera].path != ORDER_REPAIRED) {
            continue;
        }
        list = static_list(camera);
        uint blocks = (list.y + BLOCK - 1u) / BLOCK;
        if (block < blocks) {
            first = block * BLOCK;
            return true;
        }
        block -= blocks;
    }
    return false;
}

void main() {
    uint thread = gl_LocalInvocationIndex;
    uvec2 list;
    uint first;
    if (!find_block(group_index(), list, first)) {
        return;
    }
    uint window_first = first < reach ? 0u : first - reach;
    uint window_end = min(first + BLOCK + reach, list.y);
    for (uint place = window_first + thread; place < window_end; place += 256u) {
        window_keys[place - window_first] = keys[list.x + place];
        window_values[place - window_first] = values[list.x + place];
    }
    barrier();
    for (uint place = first + thread; place < min(first + BLOCK, list.y); place += 256u) {
        uint own = place - window_first;
        uint key = window_keys[own];
        uint value = window_values[own];
        uint target = place;
        for (uint other = own < reach ? 0u : own - reach; other < own; ++other) {
            uint other_key = window_keys[other];
            target -= other_key > key || (other_key == key && window_values[other] > value) ? 1u : 0u;
        }
        uint end = min(own + reach + 1u, window_end - window_first);
        for (uint other = own + 1u; other < end; ++other) {
            uint other_key = window_keys[other];
            target += other_key < key || (other_key == key && window_values[other] < value) ? 1u : 0u;
        }
        repaired[list.x + target] = value;
    }
}
