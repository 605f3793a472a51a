//! The ground about vehicles in an image, where their shadows lie.

use decouplegs::render::Image;
use decouplegs::scene::light::LUMA;

/// Distance around a vehicle within which the ground is examined, as a share of the image's width:
/// 25 px of 800.
const RING_WIDTH: f64 = 25.0 / 800.0;

/// True for each pixel of an image `width_px` wide that lies near `vehicles`, and is not of them.
pub fn around(vehicles: &[bool], width_px: usize) -> Vec<bool> {
    let ring_px = ((RING_WIDTH * width_px as f64).round() as usize).max(1);
    let height_px = vehicles.len() / width_px.max(1);
    let rows = spread(vehicles, (height_px, width_px), (width_px, 1), ring_px);
    let near = spread(&rows, (width_px, height_px), (1, width_px), ring_px);
    near.iter()
        .zip(vehicles)
        .map(|(near, vehicle)| *near && !vehicle)
        .collect()
}

/// `mask` with all within `width` along lines set: `lines` lines of `length` pixels, one `steps.0`
/// from the next, its pixels `steps.1`.
fn spread(
    mask: &[bool],
    (lines, length): (usize, usize),
    steps: (usize, usize),
    width: usize,
) -> Vec<bool> {
    let mut found = vec![false; mask.len()];
    for line in 0..lines {
        let position = |at: usize| line * steps.0 + at * steps.1;
        // The first pixel that nothing has reached yet.
        let mut next = 0;
        for at in (0..length).filter(|&at| mask[position(at)]) {
            let end = (at + width + 1).min(length);
            (next.max(at.saturating_sub(width))..end).for_each(|at| found[position(at)] = true);
            next = end;
        }
    }
    found
}

/// Darkening of pixels relative to images without vehicles.
#[derive(Clone, Copy, Debug, Default)]
pub struct Darkness {
    with: f64,
    without: f64,
}

impl Darkness {
    /// Adds the pixels of `mask`.
    pub fn add(&mut self, with: &Image, without: &Image, mask: &[bool]) {
        let luminance = |rgb: &[f32; 3]| {
            f64::from(
                rgb.iter()
                    .zip(LUMA)
                    .map(|(value, weight)| value * weight as f32)
                    .sum::<f32>(),
            )
        };
        for ((with, without), _) in with
            .rgb
            .iter()
            .zip(&without.rgb)
            .zip(mask)
            .filter(|(_, is_in)| **is_in)
        {
            self.with += luminance(with);
            self.without += luminance(without);
        }
    }

    /// Share of the luminance that is gone; `None` where there was none.
    pub fn share(&self) -> Option<f64> {
        (self.without > 0.0).then(|| 1.0 - self.with / self.without)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ring_is_a_box_about_the_mask_without_it() {
        // 64 wide: two pixels about.
        let mut mask = vec![false; 64 * 9];
        mask[4 * 64] = true;
        mask[4 * 64 + 30] = true;
        mask[4 * 64 + 31] = true;
        let ring = around(&mask, 64);
        let row = |y: usize| (0..64).filter(|x| ring[y * 64 + x]).collect::<Vec<_>>();
        assert_eq!(row(2), [0, 1, 2, 28, 29, 30, 31, 32, 33]);
        assert_eq!(
            (row(4), row(6).len(), row(7)),
            (vec![1, 2, 28, 29, 32, 33], 9, vec![])
        );
        assert!(around(&[], 64).is_empty());
    }

    #[test]
    fn darkness_is_the_share_that_is_gone() {
        let mut darkness = Darkness::default();
        assert_eq!(darkness.share(), None);
        let mut with = Image::filled(2, 1, [0.8; 3]);
        with.rgb[0] = [0.4; 3];
        darkness.add(&with, &Image::filled(2, 1, [0.8; 3]), &[true, false]);
        assert!((darkness.share().unwrap() - 0.5).abs() < 1e-6);
    }
}
