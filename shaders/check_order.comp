#version 460
// Proves the order of repaired lists, and counts the inversions of stale ones.
//
// A repaired list is taken over with the keys that its records really have. It is sorted and complete when every entry is a
// record of the list and stands behind the one before it: entries that all differ, as many as there are records, are all of
// them. Counted are the entries of which that is not so.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#include "frame.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, scalar) readonly buffer view_orders_block { ViewOrder view_orders[]; };
layout(set = 0, binding = 1, scalar) readonly buffer firsts_block { uint firsts[]; };
layout(set = 0, binding = 2, scalar) buffer keys_block { uint keys[]; };
layout(set = 0, binding = 3, scalar) buffer values_block { uint values[]; };
layout(set = 0, binding = 4, scalar) readonly buffer repaired_block { uint repaired[]; };
layout(set = 0, binding = 5, scalar) readonly buffer unranked_keys_block { uint unranked_keys[]; }; // by record
layout(set = 0, binding = 6, scalar) buffer inversions_block { uint inversions[]; }; // a camera

layout(push_constant, scalar) uniform push_block { uint camera_count; uint chunk_count; uint records_max; };

#include "static_lists.glsl"

const uint BLOCK = 1024u;
shared uint found;

// Key and record at a place of a list; of a repaired one the key that the record has, or one that nothing comes before when
// it is none of the list's.
uvec2 entry_at(uint place, uvec2 list, bool is_repaired) {
    if (!is_repaired) {
        return uvec2(keys[place], values[place]);
    }
    uint record = repaired[place];
    return record - list.x < list.y ? uvec2(unranked_keys[record], record) : uvec2(0u, 0u);
}

bool comes_behind(uvec2 entry, uvec2 other) {
    return entry.x > other.x || (entry.x == other.x && entry.y > other.y);
}

void main() {
    uint first = group_index() * BLOCK;
    for (uint camera = 0u; camera < camera_count; ++camera) {
        uvec2 list = static_list(camera);
        uint path = view_orders[camera].path;
        if (path == ORDER_SORTED || first >= list.x + list.y || first + BLOCK <= list.x) {
            continue;
        }
        bool is_repaired = path == ORDER_REPAIRED;
        if (gl_LocalInvocationIndex == 0u) {
            found = 0u;
        }
        barrier();
        for (uint item = gl_LocalInvocationIndex; item < BLOCK; item += 256u) {
            uint place = first + item;
            if (place < list.x || place >= list.x + list.y) {
                continue;
            }
            uvec2 entry = entry_at(place, list, is_repaired);
            bool foreign = is_repaired && repaired[place] - list.x >= list.y;
            if (foreign || (place > list.x && !comes_behind(entry, entry_at(place - 1u, list, is_repaired)))) {
                atomicAdd(found, 1u);
            }
            if (is_repaired) {
                keys[place] = entry.x;
                values[place] = entry.y;
            }
        }
        barrier();
        if (gl_LocalInvocationIndex == 0u && found > 0u) {
            atomicAdd(inversions[camera], found);
        }
    }
}
