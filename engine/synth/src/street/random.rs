//! Random numbers addressed by what they are for, so that any order of work on any number of
//! threads gives the same street.

use decouplegs_scene::random::{GOLDEN, mix, next};
use glam::Vec3;

/// A short sequence of random numbers that belongs to one item of one element.
#[derive(Clone, Debug)]
pub(crate) struct Stream {
    state: u64,
}

impl Stream {
    /// The sequence of item `index` of `element` in the street of `seed`.
    pub(crate) fn new(seed: u64, element: u64, index: u64) -> Self {
        let keyed = mix(seed ^ 0x5bf0_3635).wrapping_add(element.wrapping_mul(GOLDEN));
        Self {
            state: mix(mix(keyed).wrapping_add(index.wrapping_mul(GOLDEN))),
        }
    }

    /// A sequence of its own that leaves this one where it is.
    pub(crate) fn aside(&self) -> Self {
        Self {
            state: mix(self.state ^ 0x6c69_6768_7473),
        }
    }

    pub(crate) fn bits(&mut self) -> u64 {
        next(&mut self.state)
    }

    /// Uniform in [0, 1).
    pub(crate) fn unit(&mut self) -> f32 {
        (self.bits() >> 40) as f32 / 16_777_216.0
    }

    /// Uniform in [low, high).
    pub(crate) fn range(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
    }

    /// Approximately standard normal: the sum of four 16-bit uniforms, so never beyond 3.47. Three
    /// normals cost what one Box-Muller draw does, and a splat needs dozens.
    pub(crate) fn normal(&mut self) -> f32 {
        let bits = self.bits();
        let sum: u32 = (0..4)
            .map(|part| (bits >> (16 * part)) as u32 & 0xffff)
            .sum();
        (sum as f32 - 131_070.0) / 37_837.0
    }

    /// Three uniforms in [-1, 1) from one draw.
    pub(crate) fn signed3(&mut self) -> Vec3 {
        let bits = self.bits();
        let part = |shift: u32| ((bits >> shift) & 0x1f_ffff) as f32 / 1_048_576.0 - 1.0;
        Vec3::new(part(0), part(21), part(42))
    }

    pub(crate) fn chance(&mut self, probability: f32) -> bool {
        self.unit() < probability
    }

    /// One of `choices`, which must not be empty.
    pub(crate) fn pick<'a, T>(&mut self, choices: &'a [T]) -> &'a T {
        &choices[(self.bits() % choices.len() as u64) as usize]
    }
}

/// A uniform in [0, 1) that belongs to an integer cell: a brick, a window, a paving stone.
pub(crate) fn cell(seed: u64, i: i32, j: i32) -> f32 {
    let key = (u64::from(i as u32) << 32) | u64::from(j as u32);
    (mix(mix(seed.wrapping_add(GOLDEN)) ^ key) >> 40) as f32 / 16_777_216.0
}

/// Smooth value noise in [0, 1], features one unit across.
pub(crate) fn noise(seed: u64, x: f32, y: f32) -> f32 {
    let (i, j) = (x.floor(), y.floor());
    let smooth = |t: f32| t * t * (3.0 - 2.0 * t);
    let (s, t) = (smooth(x - i), smooth(y - j));
    let at = |di: i32, dj: i32| cell(seed, i as i32 + di, j as i32 + dj);
    let low = at(0, 0) + (at(1, 0) - at(0, 0)) * s;
    let high = at(0, 1) + (at(1, 1) - at(0, 1)) * s;
    low + (high - low) * t
}

/// Octaves of [`noise`], each half as strong and twice as fine as the one before; in [0, 1] with
/// mean 0.5.
pub(crate) fn fractal_noise(seed: u64, x: f32, y: f32, octaves: u32) -> f32 {
    let (mut sum, mut weight, mut total, mut frequency) = (0.0, 0.5, 0.0, 1.0);
    for octave in 0..octaves {
        sum += weight
            * noise(
                seed.wrapping_add(u64::from(octave)),
                x * frequency,
                y * frequency,
            );
        total += weight;
        weight *= 0.5;
        // Not exactly two, so that the lattices of the octaves do not line up.
        frequency *= 2.03;
    }
    sum / total
}

/// 0 below `from`, 1 above `to`, smooth between; `from > to` falls instead.
pub(crate) fn smoothstep(from: f32, to: f32, x: f32) -> f32 {
    let t = ((x - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normals_have_unit_spread_and_uniforms_fill_their_range() {
        let (mut mean, mut square, mut low) = (0.0f64, 0.0f64, 0);
        let count = 20_000;
        for index in 0..count {
            let mut stream = Stream::new(7, 3, index);
            low += u64::from(stream.unit() < 0.25);
            let value = f64::from(stream.normal());
            mean += value / count as f64;
            square += value * value / count as f64;
        }
        assert!(
            mean.abs() < 0.03 && (square - 1.0).abs() < 0.03,
            "mean {mean}, variance {square}"
        );
        assert!((low as f64 / count as f64 - 0.25).abs() < 0.015);
    }

    #[test]
    fn neighboring_keys_share_nothing() {
        let draw = |seed, element, index| Stream::new(seed, element, index).bits();
        let base = draw(1, 1, 1);
        for other in [draw(2, 1, 1), draw(1, 2, 1), draw(1, 1, 2), draw(1, 0, 2)] {
            assert_ne!(base, other);
        }
        assert_eq!(base, draw(1, 1, 1));
    }

    #[test]
    fn noise_is_continuous_across_cells() {
        for k in -20..20 {
            let x = k as f32;
            assert!((noise(5, x - 1e-4, 0.3) - noise(5, x + 1e-4, 0.3)).abs() < 1e-3);
        }
    }
}
