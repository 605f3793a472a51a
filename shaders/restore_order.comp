#version 460
// Puts the lists whose repair did not hold back as the projection found them: in splat order, for the radix sort.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#include "frame.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, scalar) readonly buffer view_orders_block { ViewOrder view_orders[]; };
layout(set = 0, binding = 1, scalar) readonly buffer inversions_block { uint inversions[]; };
layout(set = 0, binding = 2, scalar) readonly buffer lists_block { ViewLists lists[]; };
layout(set = 0, binding = 3, scalar) readonly buffer unranked_keys_block { uint unranked_keys[]; };
layout(set = 0, binding = 4, scalar) writeonly buffer keys_block { uint keys[]; };
layout(set = 0, binding = 5, scalar) writeonly buffer values_block { uint values[]; };

layout(push_constant, scalar) uniform push_block { uint camera_count; };

void main() {
    uint first = group_index() * PAIR_BLOCK;
    for (uint camera = 0u; camera < camera_count; ++camera) {
        if (view_orders[camera].path != ORDER_REPAIRED || inversions[camera] == 0u) {
            continue;
        }
        ViewLists list = lists[camera];
        for (uint entry = gl_LocalInvocationIndex; entry < PAIR_BLOCK; entry += 256u) {
            uint place = first + entry;
            if (place >= list.first_static && place < list.first_static + list.static_count) {
                keys[place] = unranked_keys[place];
                values[place] = place;
            }
        }
    }
}
