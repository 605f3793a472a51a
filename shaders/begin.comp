#version 460
// Start of a frame: copies what the host wrote, and sets to zero what the frame counts.
//
// One dispatch in place of a transfer command per buffer: a transfer of a few bytes takes the
// device as long as one of a megabyte.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, scalar) readonly buffer staged_cameras_block { uint staged_cameras[]; };
layout(set = 0, binding = 1, scalar) readonly buffer staged_lenses_block { uint staged_lenses[]; };
layout(set = 0, binding = 2, scalar) readonly buffer staged_key_sets_block { uint staged_key_sets[]; };
layout(set = 0, binding = 3, scalar) writeonly buffer cameras_block { uint cameras[]; };
layout(set = 0, binding = 4, scalar) writeonly buffer lenses_block { uint lenses[]; };
layout(set = 0, binding = 5, scalar) writeonly buffer key_sets_block { uint key_sets[]; };
layout(set = 0, binding = 6, scalar) writeonly buffer required_block { uint required[]; };
layout(set = 0, binding = 7, scalar) writeonly buffer arguments_block { uint arguments[]; };
layout(set = 0, binding = 8, std430) writeonly buffer slab_counts_block { uvec4 slab_counts[]; };
layout(set = 0, binding = 9, scalar) writeonly buffer contributions_block { uint contributions[]; };
layout(set = 0, binding = 10, scalar) writeonly buffer agent_offsets_block { uint agent_offsets[]; };
layout(set = 0, binding = 11, scalar) writeonly buffer transmittances_block { uint transmittances[]; };
layout(set = 0, binding = 12, scalar) writeonly buffer unfinished_block { uint unfinished[]; };
layout(set = 0, binding = 13, scalar) writeonly buffer medians_unfinished_block { uint medians_unfinished[]; };

// Words of each buffer that are written.
layout(push_constant, scalar) uniform push_block {
    uint camera_words;
    uint lens_words;
    uint key_set_words;
    uint required_words;
    uint argument_words;
    uint slab_words;
    uint contribution_words;
    uint agent_offset_words;
    uint transmittance_words;
    uint unfinished_words;
    uint medians_unfinished_words;
};

#define EACH(index, words) for (uint index = gl_GlobalInvocationID.x; index < words; index += threads)

void main() {
    uint threads = gl_NumWorkGroups.x * gl_WorkGroupSize.x;
    EACH(index, camera_words) cameras[index] = staged_cameras[index];
    EACH(index, lens_words) lenses[index] = staged_lenses[index];
    EACH(index, key_set_words) key_sets[index] = staged_key_sets[index];
    EACH(index, required_words) required[index] = 0u;
    EACH(index, argument_words) arguments[index] = 0u;
    EACH(index, slab_words / 4u) slab_counts[index] = uvec4(0u); // by far the most of all
    EACH(index, contribution_words) contributions[index] = 0u;
    EACH(index, agent_offset_words) agent_offsets[index] = 0u;
    EACH(index, transmittance_words) transmittances[index] = 0u;
    EACH(index, unfinished_words) unfinished[index] = 0u;
    EACH(index, medians_unfinished_words) medians_unfinished[index] = 0u;
}
