#version 460
// Frustum culling of clusters and splats: a bit per splat and camera of the rig.
//
// One workgroup per cluster, one thread per splat; attributes are read once for all cameras. A
// cluster whose box cannot reach a camera's image is skipped with one test, which one subgroup does
// for all. Writes one bit per splat and the count a (camera, cluster).
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_KHR_shader_subgroup_basic : require
#include "frame.glsl"
#include "footprint.glsl"
#include "projection.glsl"
#include "visibility.glsl"
#include "lens.glsl"
#include "rolling.glsl"
#include "detail.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, scalar) uniform cameras_block { Camera cameras[CAMERAS_MAX]; };
layout(set = 0, binding = 1, scalar) readonly buffer clusters_block { Cluster clusters[]; };
layout(set = 0, binding = 2, scalar) readonly buffer means_block { vec3 means_m[]; };
layout(set = 0, binding = 3, scalar) readonly buffer shapes_block { uvec4 shapes[]; };
layout(set = 0, binding = 4, scalar) readonly buffer rotations_block { uvec4 rotations[]; };
layout(set = 0, binding = 5, scalar) writeonly buffer visible_words_block { uint visible_words[]; };
layout(set = 0, binding = 6, scalar) writeonly buffer visible_counts_block { uint visible_counts[]; };

layout(set = 0, binding = 7, scalar) readonly buffer nodes_block { DetailNode nodes[]; };

layout(push_constant, scalar) uniform push_block {
    uint splat_count;
    uint camera_count;
    uint cluster_count;
    float pitch_px; // of levels of detail; negative where there are none
};

#include "visible_words.glsl"
#include "stored_splat.glsl"

// True if the camera draws the cluster, which is a node of the levels of detail if there are any.
bool is_shown(uint cluster_index, Camera camera) {
    if (pitch_px < 0.0) {
        return true;
    }
    DetailNode node = nodes[cluster_index];
    return fine_enough(node, camera, pitch_px)
        && (node.parent == NO_PARENT || !fine_enough(nodes[node.parent], camera, pitch_px));
}

// Cameras whose image the cluster may reach, as bits.
shared uint reached_cameras;

// Finds the cameras whose image the cluster may reach, a subgroup per camera. Every thread of the
// workgroup calls it.
uint cameras_reached(uint cluster_index, Cluster cluster, uint thread) {
    if (thread == 0u) {
        reached_cameras = 0u;
    }
    barrier();
    for (uint camera_index = gl_SubgroupID; camera_index < camera_count; camera_index += gl_NumSubgroups) {
        Camera camera = cameras[camera_index];
        bool reached = cluster_overlaps_any_lens(swept(cluster, camera), camera, camera_index) && is_shown(cluster_index, camera);
        if (reached && subgroupElect()) {
            atomicOr(reached_cameras, 1u << camera_index);
        }
    }
    barrier();
    return reached_cameras;
}

void main() {
    uint cluster_index = group_index();
    if (cluster_index >= cluster_count) {
        return;
    }
    uint thread = gl_LocalInvocationIndex;
    clear_words(thread);

    uint reached = cameras_reached(cluster_index, clusters[cluster_index], thread);
    uint splat_index = cluster_index * CLUSTER_SPLATS + thread;
    bool loaded = false;
    vec3 mean_m;
    float opacity;
    mat3 axes;
    for (; reached != 0u && splat_index < splat_count; reached &= reached - 1u) {
        uint camera_index = uint(findLSB(reached));
        Camera camera = cameras[camera_index];
        if (!loaded) {
            mean_m = means_m[splat_index];
            axes = load_axes(splat_index, opacity);
            loaded = true;
        }
        SeenSplat seen;
        if (see_splat(camera, camera_index, mean_m, axes, opacity, seen) && splat_overlaps(seen.splat, camera)) {
            set_visible(camera_index, thread);
        }
    }
    store_words(cluster_index, thread);
}
