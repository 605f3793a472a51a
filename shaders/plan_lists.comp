#version 460
// First records of each camera, and the number of workgroups that bin them.
//
// One workgroup. With `moving_only`, records of agents alone are binned: the lists of the background
// are kept. A frame without room for its records bins none: the need is known, and the host
// draws it again.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#include "frame.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, scalar) readonly buffer static_offsets_block { uint static_offsets[]; };
layout(set = 0, binding = 1, scalar) readonly buffer moving_offsets_block { uint moving_offsets[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer lists_block { ViewLists lists[]; };
layout(set = 0, binding = 3, scalar) buffer required_block { RequiredCounts required; };
layout(set = 0, binding = 4, scalar) writeonly buffer arguments_block { uvec3 arguments[]; };

layout(push_constant, scalar) uniform push_block {
    uint camera_count;
    uint static_clusters;
    uint moving_clusters;
    uint records_max;
    uint moving_only; // 1 where records of the background are not binned
};

void main() {
    uint camera = gl_LocalInvocationIndex;
    uint static_records = static_offsets[camera_count * static_clusters];
    if (camera < camera_count) {
        lists[camera] = ViewLists(static_offsets[camera * static_clusters], static_records + moving_offsets[camera * moving_clusters]);
    }
    if (camera == 0u) {
        uint records = static_records + moving_offsets[camera_count * moving_clusters];
        uint first = moving_only != 0u ? static_records : 0u;
        required.records = records;
        required.first_binned = first;
        arguments[ARGUMENTS_PAIR_BLOCKS] = groups_for((binned_records(records, first, records_max) + PAIR_BLOCK - 1u) / PAIR_BLOCK);
    }
}
