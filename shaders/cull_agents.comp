#version 460
// Frustum culling of the agents' splats: a bit per splat and camera of the rig.
//
// One workgroup per cluster of an agent, one thread per splat. Which cameras may see the agent at
// all is known from its box.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#include "frame.glsl"
#include "footprint.glsl"
#include "projection.glsl"
#include "visibility.glsl"
#include "lens.glsl"
#include "rolling.glsl"
#include "agent.glsl"

layout(local_size_x = 256) in;
#include "agent_buffers.glsl"

layout(set = 0, binding = 4, scalar) readonly buffer asset_clusters_block { Cluster asset_clusters[]; };
layout(set = 0, binding = 5, scalar) writeonly buffer visible_words_block { uint visible_words[]; };
layout(set = 0, binding = 6, scalar) writeonly buffer visible_counts_block { uint visible_counts[]; };

layout(push_constant, scalar) uniform push_block { uint agent_count; uint camera_count; uint cluster_count; };

#include "visible_words.glsl"

void main() {
    uint cluster_index = group_index();
    if (cluster_index >= cluster_count) {
        return;
    }
    uint thread = gl_LocalInvocationIndex;
    clear_words(thread);

    uint agent_index = agent_of_cluster(cluster_index, agent_count);
    Agent agent = agents[agent_index];
    uint own_cluster = cluster_index - agent.first_cluster;
    uint own_splat = own_cluster * CLUSTER_SPLATS + thread;
    // Clusters behind the last agent's end only fill up their number: no box, no splats.
    if (own_cluster * CLUSTER_SPLATS >= agent.splat_count) {
        store_words(cluster_index, thread);
        return;
    }
    Cluster cluster = asset_clusters[agent.first_bounds + own_cluster];
    bool loaded = false;
    CodedSplat coded;
    mat3 axes;
    for (uint camera_index = 0u; camera_index < camera_count; ++camera_index) {
        if (own_splat >= agent.splat_count || (agent.cameras >> camera_index & 1u) == 0u) {
            continue;
        }
        Camera camera = agent_cameras[agent_index * camera_count + camera_index];
        if (!cluster_overlaps_any_lens(swept(cluster, camera), camera, camera_index)) {
            continue;
        }
        if (!loaded) {
            coded = unpack_splat(coded_splats[agent.first_splat + own_splat], agent);
            axes = axes_of(agent, coded);
            loaded = true;
        }
        SeenSplat seen;
        if (see_splat(camera, camera_index, coded.mean_m, axes, coded.opacity, seen) && splat_overlaps(seen.splat, camera)) {
            set_visible(camera_index, thread);
        }
    }
    store_words(cluster_index, thread);
}
