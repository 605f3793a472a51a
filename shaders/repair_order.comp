#version 460
// Puts almost sorted lists right: counts, for every entry, the entries around it that stand on the wrong side of it.
//
// In any list the sorted place of an entry is its own place, less the entries before it that belong behind it, plus those
// behind it that belong before it. Where no such pair is more than `reach` places apart, a look at the neighbourhood finds
// them all. Where some are, two entries claim one place: check_order sees that.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
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
const uint REACH_MAX = 256u; // a reach is a multiple of STEPS_AT_ONCE
const uint STEPS_AT_ONCE = 8u;
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

// 1 when the entry of the window comes behind (key, value) in the order. No branch: entries disagree.
uint comes_behind(uint entry, uint key, uint value) {
    uint other = window_keys[entry];
    return uint(other > key) | (uint(other == key) & uint(window_values[entry] > value));
}

void main() {
    uint thread = gl_LocalInvocationIndex;
    uvec2 list;
    uint first;
    if (!find_block(group_index(), list, first)) {
        return;
    }
    // What lies outside of the list belongs there: nothing has to ask where it ends.
    for (uint entry = thread; entry < BLOCK + 2u * reach; entry += 256u) {
        uint place = first + entry - reach; // below 0 it wraps, and is beyond the end
        bool before = first + entry < reach;
        bool real = !before && place < list.y;
        window_keys[entry] = real ? keys[list.x + place] : before ? 0u : 0xffffffffu;
        window_values[entry] = real ? values[list.x + place] : before ? 0u : 0xffffffffu;
    }
    barrier();
    for (uint place = first + thread; place < min(first + BLOCK, list.y); place += 256u) {
        uint own = place - first + reach;
        uint key = window_keys[own];
        uint value = window_values[own];
        uint target = place;
        for (uint step = 0u; step < reach; step += STEPS_AT_ONCE) {
            [[unroll]] for (uint part = 1u; part <= STEPS_AT_ONCE; ++part) {
                target -= comes_behind(own - step - part, key, value);
                target += 1u - comes_behind(own + step + part, key, value);
            }
        }
        repaired[list.x + target] = value;
    }
}
