//! Joins the segments of a macro tile that was cut, front to back, until it is full: `composite.comp`.

use super::output::{PIXEL_EMPTY, Pixel, TRANSMITTANCE_FULL, over};
use crate::layout::{Composite, MACRO_PIXELS};

/// The pixels of the macro tile, in the order of `partials`: `MACRO_PIXELS` a slot, as [`super::blend`] keeps them.
#[must_use]
pub fn composite(composite: &Composite, partials: &[Pixel]) -> Vec<Pixel> {
    let slots = composite.first_partial as usize..(composite.first_partial + composite.partials) as usize;
    (0..MACRO_PIXELS)
        .map(|place| {
            let nearer_first = slots.clone().map(|slot| &partials[slot * MACRO_PIXELS + place]);
            // Segments behind a full pixel may never have been blended.
            nearer_first.fold(
                PIXEL_EMPTY,
                |pixel, farther| {
                    if pixel.transmittance > TRANSMITTANCE_FULL { over(pixel, farther) } else { pixel }
                },
            )
        })
        .collect()
}
