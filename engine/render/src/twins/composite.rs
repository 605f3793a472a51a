//! Joins the segments of a coarse tile that was cut, front to back, until it is full:
//! `composite.comp`.

use super::output::{PIXEL_EMPTY, Pixel, TRANSMITTANCE_FULL, TRANSMITTANCE_MIN, over};
use crate::layout::{COARSE_PIXELS, Composite};

/// Pixel that composite leaves to a segment: its index there, and the color and transmittance
/// before it, transmittance negated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unfinished {
    /// Slot of the segment.
    pub slot: usize,
    /// Place of the pixel in the coarse tile, as [`super::blend`] keeps them.
    pub place: usize,
    /// All that lies before the segment.
    pub before: Pixel,
}

/// The pixels of the coarse tile, in the order of `partials`: `COARSE_PIXELS` a slot, as
/// [`super::blend`] keeps them. By an exclusive stop where `stops`, and with every segment behind
/// the first left to be finished where `counts`: with that, what is left.
#[must_use]
pub fn composite(
    composite: &Composite,
    partials: &[Pixel],
    stops: bool,
    counts: bool,
) -> (Vec<Pixel>, Vec<Unfinished>) {
    let mut left = Vec::new();
    let mut joined = |place: usize| {
        let mut pixel = PIXEL_EMPTY;
        for segment in 0..composite.partials as usize {
            let slot = composite.first_partial as usize + segment;
            let mut farther = partials[slot * COARSE_PIXELS + place];
            let ended = stops && farther.transmittance < 0.0;
            farther.transmittance = farther.transmittance.abs();
            let before = pixel;
            pixel = over(before, &farther);
            let ends = stops && segment > 0 && pixel.transmittance <= TRANSMITTANCE_MIN;
            if segment > 0 && (ends || counts) {
                left.push(Unfinished {
                    slot,
                    place,
                    before: Pixel {
                        transmittance: -before.transmittance,
                        ..before
                    },
                });
            }
            if ended || ends || (!stops && pixel.transmittance <= TRANSMITTANCE_FULL) {
                break;
            }
        }
        pixel
    };
    ((0..COARSE_PIXELS).map(&mut joined).collect(), left)
}
