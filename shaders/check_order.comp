#version 460
// How many neighbours of each list that was not sorted by the radix sort stand the wrong way round: none proves its order.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#include "frame.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, scalar) readonly buffer view_orders_block { ViewOrder view_orders[]; };
layout(set = 0, binding = 1, scalar) readonly buffer firsts_block { uint firsts[]; };
layout(set = 0, binding = 2, scalar) readonly buffer keys_block { uint keys[]; };
layout(set = 0, binding = 3, scalar) readonly buffer values_block { uint values[]; };
layout(set = 0, binding = 4, scalar) buffer inversions_block { uint inversions[]; }; // a camera

layout(push_constant, scalar) uniform push_block { uint camera_count; uint chunk_count; uint records_max; };

#include "static_lists.glsl"

const uint BLOCK = 1024u;
shared uint found;

void main() {
    uint first = group_index() * BLOCK;
    for (uint camera = 0u; camera < camera_count; ++camera) {
        uvec2 list = static_list(camera);
        if (view_orders[camera].path == ORDER_SORTED || first >= list.x + list.y || first + BLOCK <= list.x) {
            continue;
        }
        if (gl_LocalInvocationIndex == 0u) {
            found = 0u;
        }
        barrier();
        for (uint entry = gl_LocalInvocationIndex; entry < BLOCK; entry += 256u) {
            uint place = first + entry;
            if (place > list.x && place < list.x + list.y) {
                uint before = keys[place - 1u];
                uint here = keys[place];
                if (before > here || (before == here && values[place - 1u] > values[place])) {
                    atomicAdd(found, 1u);
                }
            }
        }
        barrier();
        if (gl_LocalInvocationIndex == 0u && found > 0u) {
            atomicAdd(inversions[camera], found);
        }
    }
}
