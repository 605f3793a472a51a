#version 460
// First records of each camera, and the number of workgroups that bin them.
//
// One workgroup. A frame without room for its records bins none: the need is known, and the host draws it again.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#include "frame.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, scalar) readonly buffer static_firsts_block { uint static_firsts[]; };
layout(set = 0, binding = 1, scalar) readonly buffer moving_firsts_block { uint moving_firsts[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer lists_block { ViewLists lists[]; };
layout(set = 0, binding = 3, scalar) buffer needs_block { Needs needs; };
layout(set = 0, binding = 4, scalar) writeonly buffer arguments_block { uvec3 arguments[]; };

layout(push_constant, scalar) uniform push_block {
    uint camera_count;
    uint static_chunks;
    uint moving_chunks;
    uint records_max;
};

void main() {
    uint camera = gl_LocalInvocationIndex;
    uint static_records = static_firsts[camera_count * static_chunks];
    if (camera < camera_count) {
        lists[camera] = ViewLists(static_firsts[camera * static_chunks], static_records + moving_firsts[camera * moving_chunks]);
    }
    if (camera == 0u) {
        uint records = static_records + moving_firsts[camera_count * moving_chunks];
        needs.records = records;
        arguments[ARGUMENTS_PAIR_BLOCKS] = groups_for((held(records, records_max) + PAIR_BLOCK - 1u) / PAIR_BLOCK);
    }
}
