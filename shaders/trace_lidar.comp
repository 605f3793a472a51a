#version 460
// Beams of a LiDAR through their sorted splats: alpha compositing along exact rays.
//
// BEAM_LANES workgroups per fine tile of 8 x 8 beams, as many threads per beam. Subgroups work by
// themselves. Their lanes look at the records whose bits list_lidar.comp has set for the tile, and
// queue those that reach beams of the subgroup that have not ended. A full round of these is read,
// a record a lane, and placed in shared memory. Ballots of the columns and rows that the records
// reach tell each lane which of them may meet its beam. The lanes of a beam take these in turns,
// and each of them adds up what all of them have met, in order. Long lists are walked in several
// dispatches: the state of each beam is kept in between.
//
// What takes long is not the arithmetic but the longest list, which is walked one round after the
// other: so many candidates are examined together, and few beams share a subgroup.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_memory_scope_semantics : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require
#extension GL_KHR_shader_subgroup_vote : require
#include "frame.glsl"
#include "footprint.glsl"
#include "projection.glsl"

const uint THREADS = 64u;
layout(local_size_x = 64) in;

layout(constant_id = 5) const uint LANES = 32u;     // of a subgroup: 4 to 64
layout(constant_id = 6) const uint BEAM_LANES = 1u; // of a beam: 1, 2, 4 or 8, and no more than LANES
layout(constant_id = 2) const float ALPHA_MAX = 0.99;
layout(constant_id = 21) const bool MOVING = false;
layout(constant_id = 22) const bool ECHOES = false; // found for dual returns

// A beam of the grid, at the place of its cell.
struct LidarBeam {
    vec3 direction; // sector axes at its time of firing; zero where the cell has no beam
    uint firing;    // index of its time of firing
    uint index;     // among the beams of the sensor
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
layout(set = 0, binding = 2, scalar) readonly buffer pairs_block { uvec2 pairs[]; }; // record and cells of each
layout(set = 0, binding = 3, std430) readonly buffer footprints_block { uvec4 footprints[]; };
layout(set = 0, binding = 4, scalar) readonly buffer looks_block { vec3 looks[]; };
layout(set = 0, binding = 5, std430) readonly buffer lidar_shapes_block { vec4 lidar_shapes[]; };
layout(set = 0, binding = 6, scalar) readonly buffer beams_block { LidarBeam beams[]; };
layout(set = 0, binding = 7, scalar) readonly buffer firings_block { Firing firings[]; };
layout(set = 0, binding = 8, scalar) buffer states_block { BeamState states[]; };
layout(set = 0, binding = 9, scalar) buffer echoes_block { BeamEchoes echoes[]; };
layout(set = 0, binding = 10, scalar) readonly buffer tile_words_block { uint tile_words[]; };
layout(set = 0, binding = 11, scalar) readonly buffer required_block { RequiredCounts required; };
#include "camera_of_bin.glsl"
#include "lidar_words.glsl"
#include "bit_list.glsl"

layout(push_constant, scalar) uniform push_block {
    uint camera_count;
    uint bin_count;
    uint first_entry; // of each list that this dispatch walks
    uint entries_max;
    float range_min_m;
    uint records_max;
    uint pairs_max;
};

// A beam that has this little left ends.
const float TRANSMITTANCE_END = 1e-4;

const float ECHO_SEPARATION_M = 0.6;
const float ECHO_WEIGHT_MIN = 0.1;

// Entries of a list after which it is asked whether a beam has ended. The place does not depend on
// the order of work, so that sweeps are the same.
const uint BATCH = 64u;

const uint ROUND = LANES < 32u ? LANES : 32u; // records that a subgroup meets together

// Records that a subgroup's lanes have read, a place each: direction and distance of the mean; the
// inverse factor and the velocity; log2 opacity, intensity, instance.
shared vec4 place_toward[THREADS];
shared vec4 place_x[THREADS];
shared vec4 place_y[THREADS];
shared vec4 place_look[THREADS];

// Candidates that a lane looks at together: their reads overlap.
const uint AHEAD = 4u;

// Pairs whose records a subgroup meets next: less than a round that is left over, and those that
// come.
const uint QUEUE = ROUND + AHEAD * LANES;
shared uint queue[THREADS / LANES * QUEUE];

// What the subgroup's lanes have written to shared memory is seen by all of them. Reads of buffers
// need not have come back.
void wait_for_subgroup() {
    controlBarrier(gl_ScopeSubgroup, gl_ScopeSubgroup, gl_StorageSemanticsShared, gl_SemanticsAcquireRelease);
}

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

// What a beam meets of a splat; nothing where alpha is 0.
struct Met {
    float alpha;
    float range_m;
    vec2 look; // intensity, bits of the instance
};

// A placed splat, met by the beam with direction `direction`, fired at `firing`.
Met meet(uint place, vec3 direction, Firing firing) {
    vec4 toward = place_toward[place];
    vec4 x = place_x[place];
    vec4 y = place_y[place];
    vec4 look = place_look[place];
    // Whitening: the inverse W of the triangular factor. W toward is W direction less the whitened
    // difference of the two, which is formed before it is whitened.
    mat3 whiten = mat3(x.x, x.y, x.z, 0.0, y.x, y.y, 0.0, 0.0, y.z);
    vec3 a = whiten * toward.xyz;
    vec3 b = whiten * (direction - toward.xyz);
    vec3 e = a + b;
    vec3 h = toward.w * a;
    vec3 across = toward.w * cross(a, b);
    if (MOVING) {
        vec3 drift_mps = vec3(x.w, y.w, look.w);
        vec3 moved = whiten * (firing.time_s * drift_mps - firing.offset_m);
        h += moved;
        across += cross(moved, e);
    }
    float square = dot(e, e);
    float range_m = dot(e, h) / square;
    float exponent = look.x - HALF_LOG2_E * dot(across, across) / square;
    bool met = exponent >= -LOG2_255 && range_m > range_min_m;
    return Met(met ? min(exp2(exponent), ALPHA_MAX) : 0.0, met ? range_m : 0.0, look.yz);
}

// What lane `lane` of the subgroup has met, which is the splat at `place`.
Met of_lane(Met mine, uint lane, uint place) {
    if (BEAM_LANES == 1u) {
        return mine;
    }
    return Met(subgroupShuffle(mine.alpha, lane), subgroupShuffle(mine.range_m, lane), place_look[place].yz);
}

// Adds what was met to the beam. Sums are rounded after each step on every device, whether echoes
// are found beside them or not: a state does not depend on the returns that were asked for.
void add(Met met, inout BeamState state, inout BeamEchoes found) {
    float intensity = met.look.x;
    uint instance = floatBitsToUint(met.look.y);
    precise float weight = state.transmittance * met.alpha;
    precise float left = state.transmittance * (1.0 - met.alpha);
    precise float range_sum_m = state.range_sum_m + weight * met.range_m;
    precise float intensity_sum = state.intensity_sum + weight * intensity;
    state.transmittance = left;
    state.range_sum_m = range_sum_m;
    state.intensity_sum = intensity_sum;
    if (state.median_m == 0.0 && state.transmittance <= 0.5) {
        state.median_m = met.range_m;
        state.instances = state.instances & 0xffff0000u | instance;
    }
    if (weight > state.strongest_weight) {
        state.strongest_weight = weight;
        state.strongest_m = met.range_m;
        state.instances = state.instances & 0xffffu | instance << 16u;
    }
    if (ECHOES && met.alpha > 0.0) {
        add_to_echo(weight, met.range_m, intensity, instance, found);
    }
}

// Beams of a subgroup, at most 8 in a row of the tile.
const uint BEAMS = LANES / BEAM_LANES;
const uint COLUMNS = BEAMS < FINE_TILE_PX ? BEAMS : FINE_TILE_PX;
const uint ROWS = BEAMS < FINE_TILE_PX ? 1u : BEAMS / FINE_TILE_PX;

// The beam of a lane, and what is known of those of its subgroup.
struct Walk {
    vec3 direction;
    Firing firing;
    BeamState state;
    BeamEchoes found;
    uvec2 beam;        // of the lane, from the subgroup's first column and row on
    bool alive;        // the beam had not ended when the last batch began
    uint last_batch;   // of the list, of the last record that was met
    // Columns and rows of beams that had not ended when that batch began, and of those that have
    // not ended now, as bits.
    uvec2 alive_columns;
    uvec2 alive_rows;
};

// Columns of beams that have not ended when the last batch began, and now; then rows.
void find_alive(inout Walk walk) {
    bool goes_on = walk.alive && walk.state.transmittance > TRANSMITTANCE_END;
    walk.alive_columns = uvec2(subgroupOr(walk.alive ? 1u << walk.beam.x : 0u), subgroupOr(goes_on ? 1u << walk.beam.x : 0u));
    walk.alive_rows = uvec2(subgroupOr(walk.alive ? 1u << walk.beam.y : 0u), subgroupOr(goes_on ? 1u << walk.beam.y : 0u));
}

// Bits of the numbers `first` to `last` that lie from `begin` on, less that, and below `count`.
uint span(uint first, uint last, uint begin, uint count) {
    int low = max(int(first) - int(begin), 0);
    int high = min(int(last) - int(begin), int(count) - 1);
    return low <= high ? (2u << high) - (1u << low) : 0u;
}

// Meets the records of `count` pairs of the queue from place `first` on, at most a round.
// `in_coarse` is the subgroup's first beam in the coarse tile. Every lane calls it.
void meet_queued(uint first, uint count, uint first_pair, uint first_place, uvec2 in_coarse, inout Walk walk) {
    uint lane = gl_SubgroupInvocationID;
    bool some = lane < count;
    uint pair = queue[first + (some ? lane : 0u)];
    uint batch = (pair - first_pair) / BATCH;
    uvec2 queued = pairs[pair];
    if (some) {
        uint record = queued.x;
        place_toward[first_place + lane] = uintBitsToFloat(footprints[2u * record + 1u]);
        place_x[first_place + lane] = lidar_shapes[3u * record];
        place_y[first_place + lane] = lidar_shapes[3u * record + 1u];
        place_look[first_place + lane] = vec4(looks[record], MOVING ? lidar_shapes[3u * record + 2u].x : 0.0);
    }
    uvec4 cells = unpack_cells(queued.y);
    uint own_columns = some ? span(cells.x, cells.y, in_coarse.x, COLUMNS) : 0u;
    uint own_rows = some ? span(cells.z, cells.w, in_coarse.y, ROWS) : 0u;
    uint columns = 0u;
    [[unroll]] for (uint column = 0u; column < COLUMNS; ++column) {
        uint bits = subgroupBallot((own_columns >> column & 1u) != 0u).x;
        columns = walk.beam.x == column ? bits : columns;
    }
    uint rows = 0u;
    [[unroll]] for (uint row = 0u; row < ROWS; ++row) {
        uint bits = subgroupBallot((own_rows >> row & 1u) != 0u).x;
        rows = walk.beam.y == row ? bits : rows;
    }
    // Records that are the first of their batch.
    uint batch_before = subgroupShuffle(batch, max(lane, 1u) - 1u);
    uint starts = subgroupBallot(some && batch != (lane == 0u ? walk.last_batch : batch_before)).x;
    walk.last_batch = subgroupShuffle(batch, count - 1u);
    wait_for_subgroup(); // the records are placed
    uint meets = walk.alive ? columns & rows : 0u;
    while (subgroupAny(meets != 0u)) {
        uint own = meets;
        for (uint skipped = 0u; skipped < lane % BEAM_LANES; ++skipped) {
            own &= own - 1u;
        }
        Met mine = meet(first_place + (own != 0u ? uint(findLSB(own)) : 0u), walk.direction, walk.firing);
        [[unroll]] for (uint turn = 0u; turn < BEAM_LANES; ++turn) {
            bool has = meets != 0u;
            uint at = has ? uint(findLSB(meets)) : 0u;
            meets &= meets - 1u;
            Met met = of_lane(mine, lane / BEAM_LANES * BEAM_LANES + turn, first_place + at);
            uint passed = has ? starts & ((2u << at) - 1u) : 0u;
            starts &= ~passed;
            walk.alive = passed != 0u ? walk.state.transmittance > TRANSMITTANCE_END : walk.alive;
            met.alpha = has && walk.alive ? met.alpha : 0.0;
            add(met, walk.state, walk.found);
        }
        meets = walk.alive ? meets : 0u;
    }
    walk.alive = starts != 0u ? walk.alive && walk.state.transmittance > TRANSMITTANCE_END : walk.alive;
    find_alive(walk);
    wait_for_subgroup(); // they are read, and places may be written again
}

void main() {
    const uint TILES = COARSE_COLUMNS * COARSE_ROWS;
    uint bin = group_index() / (TILES * BEAM_LANES);
    if (bin >= bin_count || !lists_have_room(records_max, pairs_max)) {
        return;
    }
    uint tile = group_index() / BEAM_LANES % TILES;
    Camera camera = cameras[camera_of_bin(bin, camera_count)];
    uint coarse = bin - camera.first_bin;
    uvec2 corner = uvec2(coarse % camera.coarse_tiles.x, coarse / camera.coarse_tiles.x) * uvec2(COARSE_WIDTH_PX, COARSE_HEIGHT_PX)
        + uvec2(tile % COARSE_COLUMNS, tile / COARSE_COLUMNS) * FINE_TILE_PX;
    if (any(greaterThanEqual(corner, camera.size_px))) {
        return;
    }
    uint lane = gl_SubgroupInvocationID;
    uint first_place = gl_SubgroupID * LANES;
    uint first_index = group_index() % BEAM_LANES * (THREADS / BEAM_LANES) + first_place / BEAM_LANES;
    uvec2 first_beam = uvec2(first_index % FINE_TILE_PX, first_index / FINE_TILE_PX); // of the subgroup, in the tile
    uvec2 own_beam = uvec2(lane / BEAM_LANES % COLUMNS, lane / BEAM_LANES / COLUMNS);
    uvec2 cell = corner + first_beam + own_beam;
    LidarBeam beam = LidarBeam(vec3(0.0), 0u, 0u);
    if (all(lessThan(cell, camera.size_px))) {
        beam = beams[camera.first_pixel + cell.y * camera.size_px.x + cell.x];
    }
    bool real = beam.direction != vec3(0.0);
    const Echo NONE = Echo(0.0, 0.0, 0.0, 0u);
    Walk walk = Walk(beam.direction, Firing(vec3(0.0), 0.0), BeamState(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0u), BeamEchoes(NONE, 0.0, NONE, NONE),
                     own_beam, false, 0u, uvec2(0u), uvec2(0u));
    if (real) {
        if (MOVING) {
            walk.firing = firings[beam.firing];
        }
        walk.state.transmittance = 1.0;
        if (first_entry > 0u) {
            walk.state = states[beam.index];
            if (ECHOES) {
                walk.found = echoes[beam.index];
            }
        }
        walk.alive = walk.state.transmittance > TRANSMITTANCE_END;
    }
    find_alive(walk);
    uvec2 in_coarse = uvec2(tile % COARSE_COLUMNS, tile / COARSE_COLUMNS) * FINE_TILE_PX + first_beam;
    uvec2 list = tile_lists[bin];
    uint first_pair = list.x + min(first_entry, list.y);
    uint end_pair = first_pair + min(list.x + list.y - first_pair, entries_max);
    uint end_word = (end_pair + 31u) / 32u;
    uint first_queued = first_place / LANES * QUEUE;
    uint queued = 0u;
    bool open = walk.alive_columns.x != 0u;
    for (uint first_word = first_pair / 32u; first_word < end_word && open; first_word += LANES) {
        uint word = first_word + lane;
        uint bits = word < end_word ? tile_words[place_of_word(word, bin, list, pairs_max) + tile] : 0u;
        // Pairs of this window.
        bits &= 32u * word < first_pair ? 0xffffffffu << (first_pair - 32u * word) : 0xffffffffu;
        bits &= 32u * word + 32u > end_pair ? (1u << (end_pair - 32u * word)) - 1u : 0xffffffffu;
        uint count = uint(bitCount(bits));
        uint before = subgroupInclusiveAdd(count);
        uint candidates = subgroupBroadcast(before, LANES - 1u);
        before -= count;
        for (uint done = 0u; done < candidates && open; done += AHEAD * LANES) {
            uint found[AHEAD];
            uint cells_of[AHEAD];
            [[unroll]] for (uint next = 0u; next < AHEAD; ++next) {
                uint rank = done + next * LANES + lane;
                found[next] = 32u * first_word + entry_of_rank(rank < candidates ? rank : 0u, bits, before);
                cells_of[next] = pairs[found[next]].y;
            }
            [[unroll]] for (uint next = 0u; next < AHEAD; ++next) {
                uvec4 cells = unpack_cells(cells_of[next]);
                bool later = (found[next] - first_pair) / BATCH != walk.last_batch;
                uint columns = span(cells.x, cells.y, in_coarse.x, COLUMNS) & (later ? walk.alive_columns.y : walk.alive_columns.x);
                uint rows = span(cells.z, cells.w, in_coarse.y, ROWS) & (later ? walk.alive_rows.y : walk.alive_rows.x);
                bool needed = done + next * LANES + lane < candidates && columns != 0u && rows != 0u;
                uvec4 all = subgroupBallot(needed);
                if (needed) {
                    queue[first_queued + queued + subgroupBallotExclusiveBitCount(all)] = found[next];
                }
                queued += subgroupBallotBitCount(all);
            }
            wait_for_subgroup(); // the queue is written
            uint met = 0u;
            for (; queued - met >= ROUND; met += ROUND) {
                meet_queued(first_queued + met, ROUND, first_pair, first_place, in_coarse, walk);
            }
            // The rest moves to the front.
            queued -= met;
            if (met > 0u && lane < queued) {
                queue[first_queued + lane] = queue[first_queued + met + lane];
            }
            wait_for_subgroup();
            // What comes belongs to the batch of the last candidate or to later ones, and there
            // only beams that have not ended go on.
            uint last = min(candidates - done, AHEAD * LANES) - 1u;
            uint last_pair = subgroupShuffle(found[0], last % LANES);
            [[unroll]] for (uint next = 1u; next < AHEAD; ++next) {
                uint pair = subgroupShuffle(found[next], last % LANES);
                last_pair = last / LANES == next ? pair : last_pair;
            }
            bool same_batch = (last_pair - first_pair) / BATCH == walk.last_batch;
            open = (same_batch ? walk.alive_columns.x : walk.alive_columns.y) != 0u;
        }
    }
    if (queued > 0u) {
        meet_queued(first_queued, queued, first_pair, first_place, in_coarse, walk);
    }
    if (real && lane % BEAM_LANES == 0u) {
        states[beam.index] = walk.state;
        if (ECHOES) {
            echoes[beam.index] = walk.found;
        }
    }
}
