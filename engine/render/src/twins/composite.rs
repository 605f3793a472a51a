//! Joins the segments of a macro tile that was cut, front to back: `composite.comp`.

use super::output::{PIXEL_EMPTY, Pixel, over};
use crate::layout::{Composite, MACRO_PIXELS};

/// The pixels of the macro tile, in the order of `partials`: `MACRO_PIXELS` a slot, as [`super::blend`] keeps them.
#[must_use]
pub fn composite(composite: &Composite, partials: &[Pixel]) -> Vec<Pixel> {
    let slots = composite.first_partial as usize..(composite.first_partial + composite.partials) as usize;
    (0..MACRO_PIXELS)
        .map(|place| slots.clone().fold(PIXEL_EMPTY, |pixel, slot| over(pixel, &partials[slot * MACRO_PIXELS + place])))
        .collect()
}
