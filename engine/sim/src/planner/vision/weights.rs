//! Weights of the classifier that tells the rear of a vehicle from the road.
//!
//! Logistic regression with an L2 penalty, fitted by Newton's method to blocks of images of the
//! synthetic street (seed 1; clear, overcast, dusk and night; 100,000 and 200,000 splats; 320 by
//! 180 pixels) with six cars and none ahead, crosswalks and shadows. Blocks that stand at a car's
//! rear are the one class; all others, those before, behind and without a car, the other.

use super::obstacle::FEATURES;

/// Log odds where all features are zero.
pub(super) const BIAS: f32 = -3.925;
/// Log odds for each unit of a feature: a line for each band from the foot up, then those of the
/// whole block.
pub(super) const WEIGHTS: [f32; FEATURES] = [
    -6.249, -6.613, -4.854, 16.895, -2.794, -8.481, 1.097, -0.296, 5.819, 0.771, 4.368, -2.489,
    -1.046, -3.428, -1.025, 3.860, -0.874, 2.181, -2.434, 1.040, -2.453, -0.995, -0.685, 4.632,
    0.399, 2.695, 2.369, -21.223, -3.024, -0.847,
];
