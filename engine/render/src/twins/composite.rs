//! Joins the segments of a coarse tile that was cut, front to back, until it is full:
//! `composite.comp`.

use super::output::{PIXEL_EMPTY, Pixel, TRANSMITTANCE_FULL, over, pixels_of_tile};
use crate::layout::{COARSE_PIXELS, Composite, FINE_TILES};
use crate::stages::PixelEnd;

/// Pixel that composite leaves to a segment: its index there, and the color and transmittance
/// before it, transmittance negated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unfinished {
    /// Slot of the segment.
    pub slot: usize,
    /// Index of the pixel in the coarse tile, as [`super::blend`] keeps them.
    pub index: usize,
    /// All that lies before the segment.
    pub before: Pixel,
}

/// The pixels of the coarse tile, in the order of `partials`: `COARSE_PIXELS` a slot, as
/// [`super::blend`] keeps them. Pixels end at `end`. Every segment behind the first is left to be
/// finished where `counts`, in the fine tiles that it draws something in: with that, what is left.
#[must_use]
pub fn composite(
    composite: &Composite,
    partials: &[Pixel],
    end: PixelEnd,
    counts: bool,
) -> (Vec<Pixel>, Vec<Unfinished>) {
    let (limit, mut left) = (end.stop_limit(), Vec::new());
    let draws_in = |slot: usize, tile: usize| {
        pixels_of_tile(tile).any(|index| partials[slot * COARSE_PIXELS + index] != PIXEL_EMPTY)
    };
    let slots = (0..composite.partials).map(|segment| (composite.first_partial + segment) as usize);
    let drawn: Vec<[bool; FINE_TILES]> = slots
        .map(|slot| std::array::from_fn(|tile| draws_in(slot, tile)))
        .collect();
    let tile_of = |index: usize| index % (COARSE_PIXELS / 2) / (COARSE_PIXELS / FINE_TILES / 2);
    let mut joined = |index: usize| {
        let mut pixel = PIXEL_EMPTY;
        for (segment, drawn) in drawn.iter().enumerate() {
            let slot = composite.first_partial as usize + segment;
            let mut farther = partials[slot * COARSE_PIXELS + index];
            let ended = limit.is_some() && farther.transmittance < 0.0;
            farther.transmittance = farther.transmittance.abs();
            let before = pixel;
            pixel = over(before, &farther);
            let is_over = limit.is_some_and(|limit| pixel.transmittance <= limit);
            let ends = segment > 0 && is_over;
            if segment > 0 && (ends || counts) && drawn[tile_of(index)] {
                left.push(Unfinished {
                    slot,
                    index,
                    before: Pixel {
                        transmittance: -before.transmittance,
                        ..before
                    },
                });
            }
            if ended || ends || (limit.is_none() && pixel.transmittance <= TRANSMITTANCE_FULL) {
                break;
            }
        }
        pixel
    };
    ((0..COARSE_PIXELS).map(&mut joined).collect(), left)
}
