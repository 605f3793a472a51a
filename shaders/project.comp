#version 460
// Projection: footprint, depth key and color (spherical harmonics) of every visible (camera, splat)
// of the background, at the index from the prefix sum.
//
// One workgroup per cluster, one thread per splat, all cameras: attributes are read once. Records
// of a camera are in splat order: equal depth keys are drawn in the order of records. Where the
// keys of a camera's direction are kept, they are read instead of computed.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#include "frame.glsl"
#include "footprint.glsl"
#include "projection.glsl"
#include "visibility.glsl"
#include "lens.glsl"
#include "rolling.glsl"
#include "double_float.glsl"
#include "depth_key.glsl"
#include "color_code.glsl"
#include "mean_px.glsl"
#include "record.glsl"
#include "shadow.glsl"
#include "geometry.glsl"
#include "fog.glsl"

layout(local_size_x = 256) in;

layout(constant_id = 3) const bool RADIAL = false;    // order by distance instead of z
layout(constant_id = 4) const bool INSTANCES = false; // splats belong to instances, and these are asked for
layout(constant_id = 6) const bool SPLAT_IDS = false; // records hold the splat's index instead of an instance
layout(constant_id = 7) const bool SHADOWS = false;   // agents throw shadows on the ground
layout(constant_id = 8) const bool SHADOWS_BY_CAMERA = false; // not all cameras see all of them

layout(set = 0, binding = 0, scalar) uniform cameras_block { Camera cameras[CAMERAS_MAX]; };
layout(set = 0, binding = 1, scalar) readonly buffer means_block { vec3 means_m[]; };
layout(set = 0, binding = 2, scalar) readonly buffer shapes_block { uvec4 shapes[]; };
layout(set = 0, binding = 3, scalar) readonly buffer rotations_block { uvec4 rotations[]; };
layout(set = 0, binding = 4, scalar) readonly buffer visible_words_block { uint visible_words[]; };
layout(set = 0, binding = 5, scalar) readonly buffer offsets_block { uint offsets[]; };
layout(set = 0, binding = 6, scalar) readonly buffer sh_dc_block { uint sh_dc[]; };
layout(set = 0, binding = 7, scalar) readonly buffer sh_band1_block { uint sh_band1[]; };
layout(set = 0, binding = 8, scalar) readonly buffer sh_band2_block { uint sh_band2[]; };
layout(set = 0, binding = 9, scalar) readonly buffer sh_band3_block { uint sh_band3[]; };
layout(set = 0, binding = 10, scalar) readonly buffer instances_block { uint instances[]; }; // two 16-bit ids a word
layout(set = 0, binding = 14, scalar) readonly buffer key_sets_block { uint key_sets[]; };    // of each camera, or NO_KEY_SET
layout(set = 0, binding = 15, scalar) readonly buffer kept_keys_block { uint kept_keys[]; }; // [set][splat]
layout(set = 0, binding = 16, scalar) readonly buffer shadows_block { Shadow shadows[]; };
layout(set = 0, binding = 17, scalar) readonly buffer shadow_words_block { uint shadow_words[]; }; // [cluster][word]

layout(push_constant, scalar) uniform push_block {
    uint splat_count;
    uint camera_count;
    uint cluster_count;
    uint records_max;
    uint shadow_word_count; // a cluster
    float flow_interval_s;
    vec4 fog;
};

// By plane: word w of splat i stands at w * splat_count + i, so that neighboring threads read
// neighboring words.
#define SH_WORD(band, word, index, stride) sh_band##band[(word) * (stride) + (index)]
#include "stored_splat.glsl"
#include "sh_coding.glsl"
#include "stored_dc.glsl"
#define SH_COMPACT COMPACT
#include "sh.glsl"
#include "write_record.glsl"

int visible_rank(uint first_word, uint bit) {
    VISIBLE_RANK(visible_words, first_word, bit);
}

uint key_of(uint camera_index, uint splat_index, vec3 mean_m, Camera camera) {
    uint key_set = key_sets[camera_index];
    if (key_set != NO_KEY_SET) {
        return kept_keys[key_set * splat_count + splat_index];
    }
    return depth_key(RADIAL ? scaled_distance(mean_m, camera) : scaled_depth(mean_m, camera));
}

// Share of a splat's light after all shadows that may lie on the cluster; if cameras see different
// shadows, after those that this camera sees.
float light_left(uint cluster_index, vec3 mean_m, uint camera_index) {
    float light = 1.0;
    for (uint word = 0u; word < shadow_word_count; ++word) {
        uint bits = shadow_words[cluster_index * shadow_word_count + word];
        while (bits != 0u) {
            uint index = 32u * word + uint(findLSB(bits));
            bits &= bits - 1u;
            if (!SHADOWS_BY_CAMERA || (shadows[index].cameras >> camera_index & 1u) != 0u) {
                light *= shadow_factor(shadows[index], mean_m);
            }
        }
    }
    return light;
}

void main() {
    uint cluster_index = group_index();
    uint thread = gl_LocalInvocationIndex;
    uint splat_index = cluster_index * CLUSTER_SPLATS + thread;
    if (splat_index >= splat_count) {
        return;
    }
    bool loaded = false;
    vec3 mean_m;
    float opacity;
    mat3 axes;
    float light = 1.0;
    for (uint camera_index = 0u; camera_index < camera_count; ++camera_index) {
        uint list = camera_index * cluster_count + cluster_index;
        int rank = visible_rank(list * CLUSTER_WORDS, thread);
        if (rank < 0) {
            continue;
        }
        uint slot = offsets[list] + uint(rank);
        if (slot >= records_max) {
            continue; // the need is known: the host grows the buffer and draws again
        }
        if (!loaded) {
            mean_m = means_m[splat_index];
            axes = load_axes(splat_index, opacity);
            if (SHADOWS && !SHADOWS_BY_CAMERA) {
                light = light_left(cluster_index, mean_m, camera_index);
            }
            loaded = true;
        }
        if (SHADOWS_BY_CAMERA) {
            light = light_left(cluster_index, mean_m, camera_index);
        }
        Camera camera = cameras[camera_index];
        SeenSplat seen;
        see_splat(camera, camera_index, mean_m, axes, opacity, seen);
        Record record;
        record.splat = seen.splat;
        record.mean = code_of_mean(camera, camera_index, mean_m, seen.splat);
        record.depth_m = RADIAL ? length(seen.offset_m) : seen.t.z;
        record.instance = SPLAT_IDS ? splat_index : INSTANCES ? instances[splat_index / 2u] >> (16u * (splat_index % 2u)) & 0xffffu : 0u;
        vec3 color = sh_color(load_dc(splat_index), splat_index, splat_count, normalize(seen.offset_m));
        record.color = in_fog(SHADOWS ? light * color : color, length(seen.offset_m), fog);
        write_record(slot, record);
        if (ATTRIBUTE_WORDS > 0u) {
            // The background does not move.
            vec3 normal = NORMAL ? normal_of(axes, seen) : vec3(0.0);
            write_attributes(slot, seen_attributes(camera, camera_index, mean_m, seen, normal, vec3(0.0), flow_interval_s));
        }
        if (DEPTHS) {
            depths[slot] = vec2(record.depth_m, length(seen.t));
        }
        keys[slot] = key_of(camera_index, splat_index, mean_m, camera);
    }
}
