#version 460
// Frustum culling of the agents' splats: a bit per splat and camera of the rig.
//
// One workgroup a chunk of an agent, one thread a splat. Which cameras may see the agent at all is known from its box.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#include "frame.glsl"
#include "footprint.glsl"
#include "projection.glsl"
#include "visibility.glsl"
#include "lens.glsl"
#include "agent.glsl"

layout(local_size_x = 256) in;
#include "agent_buffers.glsl"

layout(set = 0, binding = 4, scalar) readonly buffer asset_chunks_block { Chunk asset_chunks[]; };
layout(set = 0, binding = 5, scalar) writeonly buffer visible_words_block { uint visible_words[]; };
layout(set = 0, binding = 6, scalar) writeonly buffer visible_counts_block { uint visible_counts[]; };

layout(push_constant, scalar) uniform push_block { uint agent_count; uint camera_count; uint chunk_count; };

const uint CAMERAS_MAX = 32u;
shared uint words[CAMERAS_MAX * CHUNK_WORDS];

void main() {
    uint chunk_index = group_index();
    if (chunk_index >= chunk_count) {
        return;
    }
    uint thread = gl_LocalInvocationIndex;
    for (uint word = thread; word < camera_count * CHUNK_WORDS; word += CHUNK_SPLATS) {
        words[word] = 0u;
    }
    barrier();

    uint agent_index = agent_of_chunk(chunk_index, agent_count);
    Agent agent = agents[agent_index];
    uint own_chunk = chunk_index - agent.first_chunk;
    Chunk chunk = asset_chunks[agent.first_bounds + own_chunk];
    uint own_splat = own_chunk * CHUNK_SPLATS + thread;
    bool loaded = false;
    CodedSplat coded;
    mat3 axes;
    for (uint camera_index = 0u; camera_index < camera_count; ++camera_index) {
        if (own_splat >= agent.splat_count || (agent.cameras >> camera_index & 1u) == 0u) {
            continue;
        }
        Camera camera = agent_cameras[agent_index * camera_count + camera_index];
        if (!chunk_reaches_seen(chunk, camera, camera_index)) {
            continue;
        }
        if (!loaded) {
            coded = unpack_splat(coded_splats[agent.first_splat + own_splat], agent);
            axes = axes_of(agent, coded);
            loaded = true;
        }
        vec3 t = to_camera_axes(camera, from_camera_m(coded.mean_m, camera));
        Footprint splat;
        if (project_splat_seen(camera, camera_index, t, axes, coded.opacity, splat) && splat_reaches(splat, camera)) {
            atomicOr(words[camera_index * CHUNK_WORDS + thread / 32u], 1u << (thread % 32u));
        }
    }
    barrier();

    for (uint word = thread; word < camera_count * CHUNK_WORDS; word += CHUNK_SPLATS) {
        uint camera_index = word / CHUNK_WORDS;
        visible_words[(camera_index * chunk_count + chunk_index) * CHUNK_WORDS + word % CHUNK_WORDS] = words[word];
    }
    if (thread < camera_count) {
        uint count = 0u;
        for (uint word = 0u; word < CHUNK_WORDS; ++word) {
            count += bitCount(words[thread * CHUNK_WORDS + word]);
        }
        visible_counts[thread * chunk_count + chunk_index] = count;
    }
}
