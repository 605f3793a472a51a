#version 460
// Culling of shadows on the ground: a bit per shadow and cluster of the background. Where no agent
// stands near, projection reads a zero.
//
// One thread per word: 32 shadows on one cluster.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#include "frame.glsl"
#include "shadow.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, scalar) readonly buffer clusters_block { Cluster clusters[]; };
layout(set = 0, binding = 1, scalar) readonly buffer shadows_block { Shadow shadows[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer shadow_words_block { uint shadow_words[]; }; // [cluster][word]

layout(push_constant, scalar) uniform push_block { uint cluster_count; uint shadow_count; };

// True if the box of the cluster's means reaches into the slab of ground that the shadow lies on.
bool shadow_overlaps(Shadow shadow, Cluster cluster) {
    vec3 center = from_shadow_m(cluster.center_m, shadow);
    vec3 half_extent = cluster.half_extent_m;
    // Rounding of the box, relative to its distance.
    float slack = 1e-5 * (dot(abs(center), vec3(1.0)) + dot(half_extent, vec3(1.0)));
    vec3 wide = half_extent + slack;
    return abs(dot(shadow.normal, center)) <= dot(abs(shadow.normal), wide) + shadow.slab_m
        && abs(dot(shadow.along, center)) <= dot(abs(shadow.along), wide) + shadow.cutoff
        && abs(dot(shadow.across, center)) <= dot(abs(shadow.across), wide) + shadow.cutoff;
}

void main() {
    uint words = (shadow_count + 31u) / 32u;
    uint index = group_index() * gl_WorkGroupSize.x + gl_LocalInvocationIndex;
    if (words == 0u || index >= cluster_count * words) {
        return;
    }
    Cluster cluster = clusters[index / words];
    uint first = index % words * 32u;
    uint bits = 0u;
    // A negative radius: nothing of the cluster is drawn.
    if (cluster.splat_radius_m >= 0.0) {
        for (uint bit = 0u; bit < min(32u, shadow_count - first); ++bit) {
            bits |= uint(shadow_overlaps(shadows[first + bit], cluster)) << bit;
        }
    }
    shadow_words[index] = bits;
}
