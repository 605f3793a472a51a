// The planes of an image beside its color: all that a pixel accumulates, leaves and writes of them.
// A plane that was not asked for is neither computed nor written.

layout(constant_id = 1) const bool DEPTH = false;    // expected depth, meters
layout(constant_id = 2) const bool INSTANCE = false; // instance of the splat with the largest weight

// The planes of all images, one plane after the other, in the order of the constants above.
layout(set = 0, binding = 2, std430) writeonly buffer planes_block { uint planes[]; };

// Words per pixel in the partial result of a segment.
const uint PLANE_PARTIAL_WORDS = (DEPTH ? 1u : 0u) + (INSTANCE ? 2u : 0u);

struct PlaneSums {
    float weighted_depth; // sum of weight * depth
    float best_weight;    // largest single weight so far
    uint best_instance;
};

const PlaneSums PLANES_EMPTY = PlaneSums(0.0, 0.0, 0u);

// Adds a splat.
void add_to_planes(inout PlaneSums sums, float weight, float depth_m, uint instance) {
    if (DEPTH) {
        sums.weighted_depth += weight * depth_m;
    }
    if (INSTANCE && weight > sums.best_weight) {
        sums.best_weight = weight;
        sums.best_instance = instance;
    }
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
    return nearer;
}

// Writes the pixel at `index` of `image_pixels`.
void write_planes(uint index, uint image_pixels, float alpha, PlaneSums sums) {
    if (DEPTH) {
        planes[index] = floatBitsToUint(alpha > 0.0 ? sums.weighted_depth / alpha : 0.0);
        index += image_pixels;
    }
    if (INSTANCE) {
        planes[index] = sums.best_instance;
    }
}

// The words of a partial result, in the order of the constants above.
uint[3] plane_words(PlaneSums sums) {
    uint best = floatBitsToUint(sums.best_weight);
    return DEPTH ? uint[3](floatBitsToUint(sums.weighted_depth), best, sums.best_instance) : uint[3](best, sums.best_instance, 0u);
}

PlaneSums plane_sums(uint words[3]) {
    PlaneSums sums = PLANES_EMPTY;
    if (DEPTH) {
        sums.weighted_depth = uintBitsToFloat(words[0]);
    }
    if (INSTANCE) {
        uint first = DEPTH ? 1u : 0u;
        sums.best_weight = uintBitsToFloat(words[first]);
        sums.best_instance = words[first + 1u];
    }
    return sums;
}
