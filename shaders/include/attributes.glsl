// Attributes of a splat whose means over the blended splats of a pixel are planes of an image:
// range, normal and motion. Those that were asked for lie one after the other, in the order of the
// constants, in vectors of four.

layout(constant_id = 30) const bool RANGE = false;         // distance from the camera, meters
layout(constant_id = 31) const bool NORMAL = false;        // unit vector, world axes
layout(constant_id = 32) const bool FLOW_FORWARD = false;  // displacement in the image after a time, pixels
layout(constant_id = 33) const bool FLOW_BACKWARD = false; // displacement before the same time, pixels
layout(constant_id = 34) const bool SCENE_FLOW = false;    // velocity, meters per second, world axes

// First word of each, and behind the last.
const uint NORMAL_WORD = RANGE ? 1u : 0u;
const uint FLOW_FORWARD_WORD = NORMAL_WORD + (NORMAL ? 3u : 0u);
const uint FLOW_BACKWARD_WORD = FLOW_FORWARD_WORD + (FLOW_FORWARD ? 2u : 0u);
const uint SCENE_FLOW_WORD = FLOW_BACKWARD_WORD + (FLOW_BACKWARD ? 2u : 0u);
const uint ATTRIBUTE_WORDS = SCENE_FLOW_WORD + (SCENE_FLOW ? 3u : 0u);

const uint ATTRIBUTE_VECTORS = (ATTRIBUTE_WORDS + 3u) / 4u;

// Named, not an array: what is indexed may end up outside of registers.
struct Attributes {
    vec4 first;
    vec4 second;
    vec4 third;
};

const Attributes NO_ATTRIBUTES = Attributes(vec4(0.0), vec4(0.0), vec4(0.0));

float attribute_word(Attributes attributes, uint word) {
    return word < 4u ? attributes.first[word % 4u] : word < 8u ? attributes.second[word % 4u] : attributes.third[word % 4u];
}

void set_attribute_word(inout Attributes attributes, uint word, float value) {
    if (word < 4u) {
        attributes.first[word % 4u] = value;
    } else if (word < 8u) {
        attributes.second[word % 4u] = value;
    } else {
        attributes.third[word % 4u] = value;
    }
}

// Sets `channels` words from `first` on.
void set_attribute_words(inout Attributes attributes, uint first, vec3 values, uint channels) {
    [[unroll]] for (uint channel = 0u; channel < channels; ++channel) {
        set_attribute_word(attributes, first + channel, values[channel]);
    }
}

// Adds `weight` * `more`.
void add_attributes(inout Attributes sums, float weight, Attributes more) {
    if (ATTRIBUTE_VECTORS > 0u) {
        sums.first += weight * more.first;
    }
    if (ATTRIBUTE_VECTORS > 1u) {
        sums.second += weight * more.second;
    }
    if (ATTRIBUTE_VECTORS > 2u) {
        sums.third += weight * more.third;
    }
}
