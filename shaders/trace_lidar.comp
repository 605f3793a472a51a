#version 460
// Beams of a LiDAR through their sorted splats: alpha compositing along exact rays.
//
// One workgroup per tile of 8 x 8 beams, one thread per beam. It walks the list of its coarse tile
// in batches: each thread looks at the cells of one record, those that reach the tile are listed in
// order, and each beam meets these. Long lists are walked in several dispatches: the state of each
// beam is kept in between.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#include "frame.glsl"
#include "footprint.glsl"
#include "projection.glsl"

const uint WORKGROUP_THREADS = 64u;
layout(local_size_x = 64) in;
#include "block.glsl"

layout(constant_id = 2) const float ALPHA_MAX = 0.99;
layout(constant_id = 21) const bool MOVING = false;
layout(constant_id = 22) const bool ECHOES = false; // found for dual returns

// A beam of the grid, at the place of its cell.
struct LidarBeam {
    vec3 direction; // sector axes at its time of firing; zero where the cell has no beam
    uint firing;    // index of its time of firing
};

// Sensor at a time of firing, relative to the middle of the sector.
struct Firing {
    vec3 offset_m; // sector axes
    float time_s;
};

// What a beam has met so far.
struct BeamState {
    float transmittance;
    float range_sum_m;     // sum of weight times range
    float intensity_sum;   // sum of weight times intensity
    float median_m;        // range at which transmittance fell to 1/2 or below; 0 before
    float strongest_weight;
    float strongest_m;
    uint instances;        // of the median in the low half, of the strongest in the high half
};

// Splats of a beam that follow one another.
struct Echo {
    float weight; // 0: none
    float range_sum_m;
    float intensity_sum;
    uint instance; // that of the splat with the largest weight
};

// Echoes of a beam so far.
struct BeamEchoes {
    Echo open; // the group that may go on
    float open_strongest; // largest weight of a splat in that group
    Echo strongest;
    Echo last;
};

layout(set = 0, binding = 0, scalar) readonly buffer cameras_block { Camera cameras[]; };
layout(set = 0, binding = 1, scalar) readonly buffer tile_lists_block { uvec2 tile_lists[]; }; // first pair and length
layout(set = 0, binding = 2, scalar) readonly buffer sorted_records_block { uint sorted_records[]; };
layout(set = 0, binding = 3, std430) readonly buffer footprints_block { uvec4 footprints[]; };
layout(set = 0, binding = 4, scalar) readonly buffer looks_block { vec3 looks[]; };
layout(set = 0, binding = 5, std430) readonly buffer lidar_shapes_block { vec4 lidar_shapes[]; };
layout(set = 0, binding = 6, scalar) readonly buffer beams_block { LidarBeam beams[]; };
layout(set = 0, binding = 7, scalar) readonly buffer firings_block { Firing firings[]; };
layout(set = 0, binding = 8, scalar) buffer states_block { BeamState states[]; };
layout(set = 0, binding = 9, scalar) buffer echoes_block { BeamEchoes echoes[]; };
#include "camera_of_bin.glsl"

layout(push_constant, scalar) uniform push_block {
    uint camera_count;
    uint bin_count;
    uint first_entry; // of each list that this dispatch walks
    uint entries_max;
    float range_min_m;
};

// A beam that has this little left ends.
const float TRANSMITTANCE_END = 1e-4;

const float ECHO_SEPARATION_M = 0.6;
const float ECHO_WEIGHT_MIN = 0.1;

shared uint shared_records[WORKGROUP_THREADS];

// Adds a splat to the echoes of its beam.
void add_to_echo(float weight, float range_m, float intensity, uint instance, inout BeamEchoes found) {
    Echo open = found.open;
    bool joins = abs(range_m * open.weight - open.range_sum_m) <= ECHO_SEPARATION_M * open.weight;
    if (open.weight > 0.0 && !joins) {
        if (open.weight >= ECHO_WEIGHT_MIN) {
            found.last = open;
            if (open.weight > found.strongest.weight) {
                found.strongest = open;
            }
        }
        found.open = Echo(0.0, 0.0, 0.0, 0u);
        found.open_strongest = 0.0;
    }
    found.open.weight += weight;
    found.open.range_sum_m += weight * range_m;
    found.open.intensity_sum += weight * intensity;
    if (weight > found.open_strongest) {
        found.open_strongest = weight;
        found.open.instance = instance;
    }
}

// Adds a splat to the beam with direction `direction`, fired at `firing`.
void meet(uint record, vec3 direction, Firing firing, inout BeamState state, inout BeamEchoes found) {
    vec4 toward = uintBitsToFloat(footprints[2u * record + 1u]);
    vec4 x = lidar_shapes[3u * record];
    vec4 y = lidar_shapes[3u * record + 1u];
    // Whitening: the inverse W of the triangular factor. W toward is W direction less the whitened
    // difference of the two, which is formed before it is whitened.
    mat3 whiten = mat3(x.x, x.y, x.z, 0.0, y.x, y.y, 0.0, 0.0, y.z);
    vec3 a = whiten * toward.xyz;
    vec3 b = whiten * (direction - toward.xyz);
    vec3 e = a + b;
    vec3 h = toward.w * a;
    vec3 across = toward.w * cross(a, b);
    if (MOVING) {
        vec3 drift_mps = vec3(x.w, y.w, lidar_shapes[3u * record + 2u].x);
        vec3 moved = whiten * (firing.time_s * drift_mps - firing.offset_m);
        h += moved;
        across += cross(moved, e);
    }
    float square = dot(e, e);
    float range_m = dot(e, h) / square;
    vec3 look = looks[record];
    float exponent = look.x - HALF_LOG2_E * dot(across, across) / square;
    if (!(exponent >= -LOG2_255) || !(range_m > range_min_m)) {
        return;
    }
    float alpha = min(exp2(exponent), ALPHA_MAX);
    float weight = state.transmittance * alpha;
    state.transmittance *= 1.0 - alpha;
    state.range_sum_m += weight * range_m;
    state.intensity_sum += weight * look.y;
    uint instance = floatBitsToUint(look.z);
    if (state.median_m == 0.0 && state.transmittance <= 0.5) {
        state.median_m = range_m;
        state.instances = state.instances & 0xffff0000u | instance;
    }
    if (weight > state.strongest_weight) {
        state.strongest_weight = weight;
        state.strongest_m = range_m;
        state.instances = state.instances & 0xffffu | instance << 16u;
    }
    if (ECHOES) {
        add_to_echo(weight, range_m, look.y, instance, found);
    }
}

void main() {
    const uint TILES = COARSE_COLUMNS * COARSE_ROWS;
    uint bin = group_index() / TILES;
    if (bin >= bin_count) {
        return;
    }
    uint tile = group_index() % TILES;
    Camera camera = cameras[camera_of_bin(bin, camera_count)];
    uint coarse = bin - camera.first_bin;
    uvec2 corner = uvec2(coarse % camera.coarse_tiles.x, coarse / camera.coarse_tiles.x) * uvec2(COARSE_WIDTH_PX, COARSE_HEIGHT_PX)
        + uvec2(tile % COARSE_COLUMNS, tile / COARSE_COLUMNS) * FINE_TILE_PX;
    if (any(greaterThanEqual(corner, camera.size_px))) {
        return;
    }
    uint thread = block_thread();
    uvec2 cell = corner + uvec2(thread % FINE_TILE_PX, thread / FINE_TILE_PX);
    bool inside = all(lessThan(cell, camera.size_px));
    uint index = camera.first_pixel + cell.y * camera.size_px.x + cell.x;
    LidarBeam beam = LidarBeam(vec3(0.0), 0u);
    BeamState state = BeamState(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0u);
    const Echo NONE = Echo(0.0, 0.0, 0.0, 0u);
    BeamEchoes found = BeamEchoes(NONE, 0.0, NONE, NONE);
    if (inside) {
        beam = beams[index];
        if (first_entry > 0u) {
            state = states[index];
            if (ECHOES) {
                found = echoes[index];
            }
        } else {
            state.transmittance = 1.0;
        }
    }
    bool real = beam.direction != vec3(0.0);
    Firing firing = Firing(vec3(0.0), 0.0);
    if (MOVING && real) {
        firing = firings[beam.firing];
    }
    uvec2 list = tile_lists[bin];
    uint end_entry = min(list.y, first_entry + entries_max);
    vec4 tile_cells = vec4(corner.x, corner.x + FINE_TILE_PX - 1u, corner.y, corner.y + FINE_TILE_PX - 1u);
    for (uint first = first_entry; first < end_entry; first += WORKGROUP_THREADS) {
        uint record = 0u;
        bool reached = false;
        if (first + thread < end_entry) {
            record = sorted_records[list.x + first + thread];
            vec4 cells = uintBitsToFloat(footprints[2u * record]);
            reached = cells.x <= tile_cells.y && cells.y >= tile_cells.x && cells.z <= tile_cells.w && cells.w >= tile_cells.z;
        }
        bool alive = real && state.transmittance > TRANSMITTANCE_END;
        // One sum for both: records in the low half, beams that go on in the high half.
        uint total;
        uint before = block_exclusive_sum((reached ? 1u : 0u) + (alive ? 0x10000u : 0u), total) & 0xffffu;
        if (total >> 16u == 0u) {
            break;
        }
        if (reached) {
            shared_records[before] = record;
        }
        barrier();
        uint count = total & 0xffffu;
        for (uint i = 0u; i < count; ++i) {
            if (alive) {
                meet(shared_records[i], beam.direction, firing, state, found);
            }
        }
        barrier(); // the list is read to its end
    }
    if (inside) {
        states[index] = state;
        if (ECHOES) {
            echoes[index] = found;
        }
    }
}
