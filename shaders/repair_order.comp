#version 460
// One round of putting an almost sorted list right: every window of 1024 places is sorted by itself.
//
// Two rounds, the second with windows shifted by half of one, sort a list in which nothing is farther than half a window from
// its place (by the 0-1 principle, Knuth, The Art of Computer Programming 3, 5.3.4: around any threshold the disorder spans
// at most a window, and after the first round what is left of it lies on both sides of one of its edges, nearer than half a
// window). More rounds carry farther. Whether it was enough is for check_order to say.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_scalar_block_layout : require
#include "frame.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, scalar) readonly buffer view_orders_block { ViewOrder view_orders[]; };
layout(set = 0, binding = 1, scalar) readonly buffer firsts_block { uint firsts[]; };
layout(set = 0, binding = 2, scalar) buffer keys_block { uint keys[]; };
layout(set = 0, binding = 3, scalar) buffer values_block { uint values[]; };

layout(push_constant, scalar) uniform push_block { uint camera_count; uint chunk_count; uint records_max; uint shift; };

#include "static_lists.glsl"

const uint WINDOW = 1024u;
shared uint window_keys[WINDOW];
shared uint window_values[WINDOW];

// The list and the number in it of a window; false when there are fewer.
bool find_window(uint window, out uvec2 list, out uint number) {
    for (uint camera = 0u; camera < camera_count; ++camera) {
        if (view_orders[camera].path != ORDER_REPAIRED) {
            continue;
        }
        list = static_list(camera);
        uint windows = (list.y + shift + WINDOW - 1u) / WINDOW;
        if (window < windows) {
            number = window;
            return true;
        }
        window -= windows;
    }
    return false;
}

bool comes_after(uint a, uint b) {
    return window_keys[a] > window_keys[b] || (window_keys[a] == window_keys[b] && window_values[a] > window_values[b]);
}

void exchange(uint a, uint b) {
    uint key = window_keys[a];
    uint value = window_values[a];
    window_keys[a] = window_keys[b];
    window_values[a] = window_values[b];
    window_keys[b] = key;
    window_values[b] = value;
}

// Bitonic (Batcher, Sorting Networks and their Applications, 1968), all exchanges upwards.
void sort_window(uint thread) {
    for (uint size = 2u; size <= WINDOW; size *= 2u) {
        for (uint step = size / 2u; step > 0u; step /= 2u) {
            for (uint pair = thread; pair < WINDOW / 2u; pair += 256u) {
                uint low = pair / step * 2u * step + pair % step;
                // The first step of a size compares mirror images, so that no run has to be reversed.
                uint high = step == size / 2u ? (pair / step + 1u) * 2u * step - 1u - pair % step : low + step;
                if (comes_after(low, high)) {
                    exchange(low, high);
                }
            }
            barrier();
        }
    }
}

void main() {
    uint thread = gl_LocalInvocationIndex;
    uvec2 list;
    uint number;
    if (!find_window(group_index(), list, number)) {
        return;
    }
    for (uint entry = thread; entry < WINDOW; entry += 256u) {
        // Places before the list (in a shifted round) and behind it are filled with what stays there.
        uint place = number * WINDOW + entry - shift;
        bool before = number == 0u && entry < shift;
        bool real = !before && place < list.y;
        window_keys[entry] = real ? keys[list.x + place] : before ? 0u : 0xffffffffu;
        window_values[entry] = real ? values[list.x + place] : before ? 0u : 0xffffffffu;
    }
    barrier();
    sort_window(thread);
    for (uint entry = thread; entry < WINDOW; entry += 256u) {
        uint place = number * WINDOW + entry - shift;
        if (!(number == 0u && entry < shift) && place < list.y) {
            keys[list.x + place] = window_keys[entry];
            values[list.x + place] = window_values[entry];
        }
    }
}
