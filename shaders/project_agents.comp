#version 460
// Footprint, depth key and color of every visible (camera, splat) of the agents: what project is
// for the background.
//
// Their records come behind those of the background, by camera, agent and splat. Shapes and colors
// are entries of the asset's codebooks, decoded here and nowhere else.
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
#include "agent.glsl"
#include "geometry.glsl"
#include "shading.glsl"
#include "fog.glsl"

layout(local_size_x = 256) in;
#include "agent_buffers.glsl"

layout(constant_id = 3) const bool RADIAL = false;
layout(constant_id = 4) const bool RELIT = false; // some agents have colors of their own
layout(constant_id = 5) const bool SHADED = false; // some agents are shaded by normals

layout(set = 0, binding = 4, scalar) readonly buffer visible_words_block { uint visible_words[]; };
layout(set = 0, binding = 5, scalar) readonly buffer offsets_block { uint offsets[]; }; // of agents, [camera][cluster]
layout(set = 0, binding = 6, scalar) readonly buffer coded_dc_block { vec3 coded_dc[]; };
layout(set = 0, binding = 7, std430) readonly buffer coded_bands_block { uvec4 coded_bands[]; }; // 6 per color
layout(set = 0, binding = 8, scalar) readonly buffer static_offsets_block { uint static_offsets[]; }; // of the background
layout(set = 0, binding = 9, scalar) readonly buffer relit_dc_block { vec3 relit_dc[]; };
layout(set = 0, binding = 10, std430) readonly buffer relit_bands_block { uvec4 relit_bands[]; };
layout(set = 0, binding = 20, scalar) readonly buffer shadings_block { Shading shadings[]; };

layout(push_constant, scalar) uniform push_block {
    uint agent_count;
    uint camera_count;
    uint cluster_count;
    uint records_max;
    uint static_lists; // of the background: how many records it has stands behind them
    float flow_interval_s;
    vec4 fog;
};

// All bands of a color in one piece: a codebook stays in cache, and its entries are read in any
// order, 16 bytes at a time.
const uint COLOR_WORDS = 24u;
const uint FIRST_WORD_1 = 0u;
const uint FIRST_WORD_2 = 5u;
const uint FIRST_WORD_3 = 13u;
uint color_words[COLOR_WORDS];
#define SH_WORD(band, word, index, stride) color_words[FIRST_WORD_##band + (word)]
#define SH_COMPACT false
#include "sh_coding.glsl"
#include "sh.glsl"
#include "write_record.glsl"

int visible_rank(uint first_word, uint bit) {
    VISIBLE_RANK(visible_words, first_word, bit);
}

// Reads the words that colors of SH_DEGREE have into color_words.
void load_color(uint color, bool from_relit) {
    uint words = SH_DEGREE >= 3u ? COLOR_WORDS : SH_DEGREE == 2u ? FIRST_WORD_3 : SH_DEGREE == 1u ? FIRST_WORD_2 : 0u;
    [[unroll]] for (uint first = 0u; first < COLOR_WORDS; first += 4u) {
        if (first < words) {
            uint at = (color * COLOR_WORDS + first) / 4u;
            uvec4 four = RELIT && from_relit ? relit_bands[at] : coded_bands[at];
            color_words[first] = four.x;
            color_words[first + 1u] = four.y;
            color_words[first + 2u] = four.z;
            color_words[first + 3u] = four.w;
        }
    }
}

vec3 turned(Agent agent, vec3 d) {
    return vec3(dot(agent.row_x, d), dot(agent.row_y, d), dot(agent.row_z, d));
}

void main() {
    uint cluster_index = group_index();
    if (cluster_index >= cluster_count) {
        return;
    }
    uint thread = gl_LocalInvocationIndex;
    uint agent_index = agent_of_cluster(cluster_index, agent_count);
    Agent agent = agents[agent_index];
    uint own_splat = (cluster_index - agent.first_cluster) * CLUSTER_SPLATS + thread;
    if (own_splat >= agent.splat_count) {
        return;
    }
    bool from_relit = agent.colors_relit != 0u;
    bool loaded = false;
    CodedSplat coded;
    mat3 axes;
    vec3 gain = vec3(1.0);
    for (uint camera_index = 0u; camera_index < camera_count; ++camera_index) {
        uint list = camera_index * cluster_count + cluster_index;
        int rank = visible_rank(list * CLUSTER_WORDS, thread);
        if (rank < 0) {
            continue;
        }
        uint slot = static_offsets[static_lists] + offsets[list] + uint(rank);
        if (slot >= records_max) {
            continue; // the need is known: the host grows the buffer and draws again
        }
        if (!loaded) {
            coded = unpack_splat(coded_splats[agent.first_splat + own_splat], agent);
            axes = axes_of(agent, coded);
            if (SHADED && agent.shading != 0u) {
                Shading shading = shadings[agent.shading - 1u];
                gain = shading_gain(shading, shading_normal(shading, axes, coded.mean_m), coded.mean_m);
            }
            loaded = true;
        }
        Camera camera = agent_cameras[agent_index * camera_count + camera_index];
        SeenSplat seen;
        see_splat(camera, camera_index, coded.mean_m, axes, coded.opacity, seen);
        Record record;
        record.splat = seen.splat;
        record.mean = code_of_mean(camera, camera_index, coded.mean_m, seen.splat);
        record.depth_m = RADIAL ? length(seen.offset_m) : seen.t.z;
        record.instance = agent.instance;
        vec3 d = normalize(seen.offset_m);
        uint color = agent.first_color + coded.color;
        vec3 dc = (RELIT && from_relit ? relit_dc[color] : coded_dc[color]) + agent.dc_residual_gain * coded.dc_residual;
        load_color(color, from_relit);
        vec3 rgb = sh_color(dc, color, COLOR_WORDS, agent.colors_in_world != 0u ? turned(agent, d) : d);
        if (SHADED) {
            rgb *= gain;
        }
        record.color = in_fog(rgb, length(seen.offset_m), fog);
        write_record(slot, record);
        if (ATTRIBUTE_WORDS > 0u) {
            vec3 normal = NORMAL ? turned(agent, normal_of(axes, seen)) : vec3(0.0);
            vec3 velocity_mps = agent.velocity_mps + turned(agent, cross(agent.turn_rad_per_s, coded.mean_m));
            write_attributes(slot, seen_attributes(camera, camera_index, coded.mean_m, seen, normal, velocity_mps, flow_interval_s));
        }
        if (DEPTHS) {
            depths[slot] = vec2(record.depth_m, length(seen.t));
        }
        keys[slot] = depth_key(RADIAL ? scaled_distance(coded.mean_m, camera) : scaled_depth(coded.mean_m, camera));
    }
}
