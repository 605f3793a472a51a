#version 460
// Where every camera's two lists lie, which of them the radix sort has to order, and how the stages behind it are sized.
//
// One workgroup. A frame without room for its records draws none: the need is known, and the host draws it again.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#include "frame.glsl"

layout(local_size_x = 64) in;

layout(constant_id = 0) const uint SORT_BLOCK = 4096u; // keys a workgroup of the sort takes

layout(set = 0, binding = 0, scalar) readonly buffer view_orders_block { ViewOrder view_orders[]; };
layout(set = 0, binding = 1, scalar) readonly buffer static_firsts_block { uint static_firsts[]; };
layout(set = 0, binding = 2, scalar) readonly buffer moving_firsts_block { uint moving_firsts[]; };
layout(set = 0, binding = 3, scalar) readonly buffer inversions_block { uint inversions[]; };
layout(set = 0, binding = 4, scalar) writeonly buffer lists_block { ViewLists lists[]; };
layout(set = 0, binding = 5, scalar) writeonly buffer segments_block { SortSegment segments[]; }; // two a camera
layout(set = 0, binding = 6, scalar) buffer needs_block { Needs needs; };
layout(set = 0, binding = 7, scalar) writeonly buffer arguments_block { uvec3 arguments[]; };

layout(push_constant, scalar) uniform push_block {
    uint camera_count;
    uint static_chunks;
    uint moving_chunks;
    uint records_max;
};

const uint CAMERAS_MAX = 32u;
shared ViewLists planned[CAMERAS_MAX];
shared bool sorted[CAMERAS_MAX];
shared bool restored[CAMERAS_MAX];

uint blocks_of(uint count, uint block) {
    return (count + block - 1u) / block;
}

void main() {
    uint camera = gl_LocalInvocationIndex;
    uint static_records = static_firsts[camera_count * static_chunks];
    uint records = static_records + moving_firsts[camera_count * moving_chunks];
    bool fits = records <= records_max;
    if (camera < camera_count) {
        uint first_static = static_firsts[camera * static_chunks];
        uint first_moving = moving_firsts[camera * moving_chunks];
        ViewLists list;
        list.first_static = first_static;
        list.static_count = fits ? static_firsts[(camera + 1u) * static_chunks] - first_static : 0u;
        list.first_moving = static_records + first_moving;
        list.moving_count = fits ? moving_firsts[(camera + 1u) * moving_chunks] - first_moving : 0u;
        list.first_ordered = first_static + first_moving;
        list.first_block = 0u;
        planned[camera] = list;
        uint path = view_orders[camera].path;
        restored[camera] = path == ORDER_REPAIRED && inversions[camera] > 0u;
        sorted[camera] = path == ORDER_SORTED || restored[camera];
    }
    barrier();
    if (camera != 0u) {
        return;
    }
    uint sort_blocks = 0u;
    uint merge_blocks = 0u;
    bool any_restored = false;
    for (uint view = 0u; view < camera_count; ++view) {
        ViewLists list = planned[view];
        list.first_block = merge_blocks;
        lists[view] = list;
        merge_blocks += blocks_of(list.static_count + list.moving_count, PAIR_BLOCK);
        any_restored = any_restored || restored[view];
        uint sorted_static = sorted[view] ? list.static_count : 0u;
        segments[2u * view] = SortSegment(list.first_static, sorted_static, sort_blocks);
        sort_blocks += blocks_of(sorted_static, SORT_BLOCK);
        segments[2u * view + 1u] = SortSegment(list.first_moving, list.moving_count, sort_blocks);
        sort_blocks += blocks_of(list.moving_count, SORT_BLOCK);
    }
    uint drawn = held(records, records_max);
    needs.records = records;
    arguments[ARGUMENTS_SORT_RECORDS] = groups_for(sort_blocks);
    arguments[ARGUMENTS_PAIR_BLOCKS] = groups_for(blocks_of(drawn, PAIR_BLOCK));
    arguments[ARGUMENTS_MERGE] = groups_for(merge_blocks);
    arguments[ARGUMENTS_RESTORE] = groups_for(any_restored ? blocks_of(drawn, PAIR_BLOCK) : 0u);
}
