// The planes of an image beside its color: all that a pixel accumulates, leaves and writes of them.
// A plane that was not asked for is neither computed nor written.
//
// Medians are of one splat: a pixel keeps the record in which half of its light is gone.

#include "attributes.glsl"

layout(constant_id = 1) const bool DEPTH = false;    // expected depth, meters
layout(constant_id = 2) const bool INSTANCE = false; // instance of the splat with the largest weight
layout(constant_id = 35) const bool DEPTH_MEDIAN = false; // depth of the splat in which half of the light is gone, meters
layout(constant_id = 36) const bool RANGE_MEDIAN = false; // its distance from the camera, meters
const bool MEDIANS = DEPTH_MEDIAN || RANGE_MEDIAN;

// The planes of all images, one plane after the other: depth and instance, the means of attributes,
// then medians.
layout(set = 0, binding = 2, std430) writeonly buffer planes_block { uint planes[]; };

// Words per pixel in the partial result of a segment.
const uint PLANE_PARTIAL_WORDS = (DEPTH ? 1u : 0u) + (INSTANCE ? 2u : 0u) + ATTRIBUTE_WORDS;
const uint PLANE_PARTIAL_WORDS_MAX = 15u;

struct PlaneSums {
    float weighted_depth; // sum of weight * depth
    float best_weight;    // largest single weight so far
    uint best_instance;
    Attributes weighted_attributes;
};

const PlaneSums PLANES_EMPTY = PlaneSums(0.0, 0.0, 0u, NO_ATTRIBUTES);

// Adds a splat.
void add_to_planes(inout PlaneSums sums, float weight, float depth_m, uint instance, Attributes attributes) {
    if (DEPTH) {
        sums.weighted_depth += weight * depth_m;
    }
    if (INSTANCE && weight > sums.best_weight) {
        sums.best_weight = weight;
        sums.best_instance = instance;
    }
    add_attributes(sums.weighted_attributes, weight, attributes);
}

// The sums after `nearer`, which lets `share` of the light through, then `farther` behind it.
PlaneSums planes_over(PlaneSums nearer, float share, PlaneSums farther) {
    if (DEPTH) {
        nearer.weighted_depth += share * farther.weighted_depth;
    }
    if (INSTANCE && share * farther.best_weight > nearer.best_weight) {
        nearer.best_weight = share * farther.best_weight;
        nearer.best_instance = farther.best_instance;
    }
    add_attributes(nearer.weighted_attributes, share, farther.weighted_attributes);
    return nearer;
}

// Writes the mean of an attribute, `channels` words from `word` on, at pixel `index` of the plane
// that begins at `first`; returns where the next plane begins.
uint write_mean(uint first, uint index, uint image_pixels, float alpha, Attributes sums, uint word, uint channels) {
    [[unroll]] for (uint channel = 0u; channel < channels; ++channel) {
        float sum = attribute_word(sums, word + channel);
        planes[first + channels * index + channel] = floatBitsToUint(alpha > 0.0 ? sum / alpha : 0.0);
    }
    return first + channels * image_pixels;
}

// Writes the pixel at `index` of `image_pixels`.
void write_planes(uint index, uint image_pixels, float alpha, PlaneSums sums) {
    uint first = 0u; // word of the next plane
    if (DEPTH) {
        planes[index] = floatBitsToUint(alpha > 0.0 ? sums.weighted_depth / alpha : 0.0);
        first += image_pixels;
    }
    if (INSTANCE) {
        planes[first + index] = sums.best_instance;
        first += image_pixels;
    }
    Attributes attributes = sums.weighted_attributes;
    if (RANGE) {
        first = write_mean(first, index, image_pixels, alpha, attributes, 0u, 1u);
    }
    if (NORMAL) {
        first = write_mean(first, index, image_pixels, alpha, attributes, NORMAL_WORD, 3u);
    }
    if (FLOW_FORWARD) {
        first = write_mean(first, index, image_pixels, alpha, attributes, FLOW_FORWARD_WORD, 2u);
    }
    if (FLOW_BACKWARD) {
        first = write_mean(first, index, image_pixels, alpha, attributes, FLOW_BACKWARD_WORD, 2u);
    }
    if (SCENE_FLOW) {
        write_mean(first, index, image_pixels, alpha, attributes, SCENE_FLOW_WORD, 3u);
    }
}

// Writes the medians of the pixel at `index`: `depth_and_range_m` of the splat in which half of its
// light is gone, or zeros.
void write_medians_at(uint index, uint image_pixels, vec2 depth_and_range_m) {
    uint first = ((DEPTH ? 1u : 0u) + (INSTANCE ? 1u : 0u) + ATTRIBUTE_WORDS) * image_pixels;
    if (DEPTH_MEDIAN) {
        planes[first + index] = floatBitsToUint(depth_and_range_m.x);
        first += image_pixels;
    }
    if (RANGE_MEDIAN) {
        planes[first + index] = floatBitsToUint(depth_and_range_m.y);
    }
}

const uint FIRST_INSTANCE_WORD = DEPTH ? 1u : 0u;
const uint FIRST_ATTRIBUTE_WORD = FIRST_INSTANCE_WORD + (INSTANCE ? 2u : 0u);

// The words of a partial result, in the order of the planes.
uint[PLANE_PARTIAL_WORDS_MAX] plane_words(PlaneSums sums) {
    uint words[PLANE_PARTIAL_WORDS_MAX];
    if (DEPTH) {
        words[0] = floatBitsToUint(sums.weighted_depth);
    }
    if (INSTANCE) {
        words[FIRST_INSTANCE_WORD] = floatBitsToUint(sums.best_weight);
        words[FIRST_INSTANCE_WORD + 1u] = sums.best_instance;
    }
    [[unroll]] for (uint word = 0u; word < ATTRIBUTE_WORDS; ++word) {
        words[FIRST_ATTRIBUTE_WORD + word] = floatBitsToUint(attribute_word(sums.weighted_attributes, word));
    }
    return words;
}

PlaneSums plane_sums(uint words[PLANE_PARTIAL_WORDS_MAX]) {
    PlaneSums sums = PLANES_EMPTY;
    if (DEPTH) {
        sums.weighted_depth = uintBitsToFloat(words[0]);
    }
    if (INSTANCE) {
        sums.best_weight = uintBitsToFloat(words[FIRST_INSTANCE_WORD]);
        sums.best_instance = words[FIRST_INSTANCE_WORD + 1u];
    }
    [[unroll]] for (uint word = 0u; word < ATTRIBUTE_WORDS; ++word) {
        set_attribute_word(sums.weighted_attributes, word, uintBitsToFloat(words[FIRST_ATTRIBUTE_WORD + word]));
    }
    return sums;
}
