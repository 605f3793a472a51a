//! Accumulation and output of the planes of an image, all of them asked for: `planes.glsl`.

/// Sums of the planes of a pixel, front to back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneSums {
    /// Sum of weight times depth.
    pub weighted_depth: f32,
    /// Largest single weight so far.
    pub best_weight: f32,
    /// The instance it belongs to.
    pub best_instance: u32,
}

/// Sums that nothing was added to.
pub const PLANES_EMPTY: PlaneSums = PlaneSums {
    weighted_depth: 0.0,
    best_weight: 0.0,
    best_instance: 0,
};

/// Adds a splat.
pub fn add_to_planes(sums: &mut PlaneSums, weight: f32, depth_m: f32, instance: u32) {
    sums.weighted_depth += weight * depth_m;
    if weight > sums.best_weight {
        sums.best_weight = weight;
        sums.best_instance = instance;
    }
}

/// The sums after `nearer`, which lets `share` of the light through, then `farther` behind it.
#[must_use]
pub fn planes_over(mut nearer: PlaneSums, share: f32, farther: &PlaneSums) -> PlaneSums {
    nearer.weighted_depth += share * farther.weighted_depth;
    if share * farther.best_weight > nearer.best_weight {
        nearer.best_weight = share * farther.best_weight;
        nearer.best_instance = farther.best_instance;
    }
    nearer
}

/// Writes the pixel at `index` of `image_pixels`.
pub fn write_planes(
    planes: &mut [u32],
    index: usize,
    image_pixels: usize,
    alpha: f32,
    sums: &PlaneSums,
) {
    let depth_m = if alpha > 0.0 {
        sums.weighted_depth / alpha
    } else {
        0.0
    };
    planes[index] = depth_m.to_bits();
    planes[index + image_pixels] = sums.best_instance;
}

/// The words of a partial result.
#[must_use]
pub fn plane_words(sums: &PlaneSums) -> [u32; 3] {
    [
        sums.weighted_depth.to_bits(),
        sums.best_weight.to_bits(),
        sums.best_instance,
    ]
}

/// The sums in the words of a partial result.
#[must_use]
pub fn plane_sums(words: [u32; 3]) -> PlaneSums {
    PlaneSums {
        weighted_depth: f32::from_bits(words[0]),
        best_weight: f32::from_bits(words[1]),
        best_instance: words[2],
    }
}
