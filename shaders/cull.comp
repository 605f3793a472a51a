#version 460
// Which splats of a chunk can be seen by which camera of the rig.
//
// One workgroup a chunk, one thread a splat; attributes are read once for all cameras. A chunk whose box cannot reach a
// camera's image is skipped with one test that is conservative for the projection used: a splat's half-width in pixels is
// at most reach * (focal / z) * sqrt(1 + slope_limit^2) plus the dilation, so 'reaches the image' is a plane test.
// Writes one bit a splat and the count a (camera, chunk).
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#include "frame.glsl"
#include "footprint.glsl"
#include "projection.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, scalar) readonly buffer cameras_block { Camera cameras[]; };
layout(set = 0, binding = 1, scalar) readonly buffer chunks_block { Chunk chunks[]; };
layout(set = 0, binding = 2, scalar) readonly buffer means_block { vec3 means_m[]; };
layout(set = 0, binding = 3, scalar) readonly buffer shapes_block { vec4 shapes[]; };       // scales (m), opacity
layout(set = 0, binding = 4, scalar) readonly buffer rotations_block { vec4 rotations[]; }; // w, x, y, z
layout(set = 0, binding = 5, scalar) writeonly buffer visible_words_block { uint visible_words[]; };
layout(set = 0, binding = 6, scalar) writeonly buffer visible_counts_block { uint visible_counts[]; };

layout(push_constant, scalar) uniform push_block { uint splat_count; uint camera_count; uint chunk_count; };

const uint CAMERAS_MAX = 32u;
shared uint words[CAMERAS_MAX * CHUNK_WORDS];

// Pixels that dilation adds to a splat's half-width at most: sqrt(0.3 * 2 ln 255), rounded up.
const float DILATION_REACH_PX = 1.9;

// The largest value of dot(normal, p) over the chunk's box, p relative to the camera.
float farthest(Chunk chunk, vec3 centre, vec3 normal) {
    return dot(normal, centre) + dot(abs(normal), chunk.half_extent_m);
}

bool chunk_reaches(Chunk chunk, Camera camera) {
    vec3 centre = from_camera_m(chunk.centre_m, camera);
    vec2 spread = sqrt(1.0 + pow(max(abs(camera.slope_min), abs(camera.slope_max)), vec2(2.0)));
    // Rounding of the box, relative to its distance.
    float slack = 1e-5 * (dot(abs(centre), vec3(1.0)) + dot(chunk.half_extent_m, vec3(1.0)) + chunk.reach_m);
    vec2 reach = chunk.reach_m * spread + slack;
    vec2 low = (camera.principal_px + DILATION_REACH_PX) / camera.focal_px;
    vec2 high = (vec2(camera.size_px) - camera.principal_px + DILATION_REACH_PX) / camera.focal_px;
    return farthest(chunk, centre, camera.row_z) + slack >= NEAR_M
        && farthest(chunk, centre, camera.row_x + low.x * camera.row_z) + reach.x >= 0.0
        && farthest(chunk, centre, -camera.row_x + high.x * camera.row_z) + reach.x >= 0.0
        && farthest(chunk, centre, camera.row_y + low.y * camera.row_z) + reach.y >= 0.0
        && farthest(chunk, centre, -camera.row_y + high.y * camera.row_z) + reach.y >= 0.0;
}

bool splat_reaches(Footprint splat, Camera camera) {
    ivec2 rows = reached_macro_rows(splat, camera.size_px.y);
    for (int row = rows.x; row <= rows.y; ++row) {
        ivec2 tiles = reached_macro_tiles(splat, uint(row), camera.size_px);
        if (tiles.x <= tiles.y) {
            return true;
        }
    }
    return false;
}

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

    Chunk chunk = chunks[chunk_index];
    uint splat_index = chunk_index * CHUNK_SPLATS + thread;
    bool loaded = false;
    vec3 mean_m;
    float opacity;
    mat3 axes;
    for (uint camera_index = 0u; camera_index < camera_count; ++camera_index) {
        Camera camera = cameras[camera_index];
        if (splat_index >= splat_count || !chunk_reaches(chunk, camera)) {
            continue;
        }
        if (!loaded) {
            mean_m = means_m[splat_index];
            vec4 shape = shapes[splat_index];
            opacity = shape.w;
            axes = matrix_from_quaternion(rotations[splat_index]);
            axes[0] *= shape.x;
            axes[1] *= shape.y;
            axes[2] *= shape.z;
            loaded = true;
        }
        vec3 offset = from_camera_m(mean_m, camera);
        vec3 t = vec3(dot(camera.row_x, offset), dot(camera.row_y, offset), dot(camera.row_z, offset));
        Footprint splat;
        if (project_splat(camera, t, axes, opacity, splat) && splat_reaches(splat, camera)) {
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
