//! Joins the segments of a coarse tile that was cut, front to back, until it is full:
//! `composite.comp`.

use std::ops::Range;

use decouplegs_shaders::constants::{COMPOSITE_RUN, COMPOSITE_RUNS_MAX};

use super::output::{
    PIXEL_EMPTY, Pixel, TRANSMITTANCE_FULL, TRANSMITTANCE_MEDIAN, over, pixels_of_tile,
};
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

/// Runs into which `partials` segments of a coarse tile are divided, which are joined side by side;
/// also the parts of its pixels.
#[must_use]
pub fn composite_runs(partials: u32) -> u32 {
    let runs = partials.div_ceil(COMPOSITE_RUN).next_power_of_two();
    runs.min(COMPOSITE_RUNS_MAX)
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
    let draws_in = |slot: usize, tile: usize| {
        pixels_of_tile(tile).any(|index| partials[slot * COARSE_PIXELS + index] != PIXEL_EMPTY)
    };
    let slots = (0..composite.partials).map(|segment| (composite.first_partial + segment) as usize);
    let join = Join {
        first_partial: composite.first_partial as usize,
        partials,
        drawn: slots
            .map(|slot| std::array::from_fn(|tile| draws_in(slot, tile)))
            .collect(),
        limit: end.stop_limit(),
        counts,
    };
    let mut left = Vec::new();
    let pixels = (0..COARSE_PIXELS).map(|index| join.pixel(index, &mut left));
    (pixels.collect(), left)
}

/// Median of a pixel as composite finds it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Median {
    /// More than half of the light is left.
    None,
    /// That of a record.
    Record(u32),
    /// Left to be finished in the segment at a slot, before which this transmittance is left.
    Unfinished(usize, f32),
}

/// The medians of the coarse tile's pixels, in the order of `partials`. No pixel may end by an
/// exclusive stop.
#[must_use]
pub fn medians(composite: &Composite, partials: &[Pixel]) -> Vec<Median> {
    let segments = composite.partials as usize;
    let runs = composite_runs(composite.partials) as usize;
    let median = |index: usize| {
        let pixel = |segment: usize| {
            let slot = composite.first_partial as usize + segment;
            (slot, partials[slot * COARSE_PIXELS + index])
        };
        let mut before_run = 1.0;
        for run in (0..segments).step_by(segments.div_ceil(runs)) {
            let run = run..(run + segments.div_ceil(runs)).min(segments);
            let mut own = 1.0f32;
            for segment in run.clone() {
                if own > TRANSMITTANCE_FULL {
                    own *= pixel(segment).1.transmittance;
                }
            }
            // With one run, products begin at the first segment, too.
            let mut transmittance: f32 = before_run;
            before_run *= own;
            if before_run > TRANSMITTANCE_MEDIAN {
                continue;
            }
            let mut found = None;
            for (slot, pixel) in run.map(pixel).filter(|(_, pixel)| *pixel != PIXEL_EMPTY) {
                if transmittance > TRANSMITTANCE_MEDIAN {
                    found = Some((slot, transmittance, pixel.median));
                    transmittance *= pixel.transmittance;
                }
            }
            return match found {
                Some((_, 1.0, record)) => Median::Record(record),
                Some((slot, before, _)) => Median::Unfinished(slot, before),
                None => unreachable!("a segment takes light"),
            };
        }
        Median::None
    };
    (0..COARSE_PIXELS).map(median).collect()
}

/// The segments of a coarse tile.
struct Join<'a> {
    first_partial: usize,
    partials: &'a [Pixel],
    /// Fine tiles that each segment draws in.
    drawn: Vec<[bool; FINE_TILES]>,
    /// Transmittance at which a pixel ends by an early stop.
    limit: Option<f32>,
    counts: bool,
}

impl Join<'_> {
    /// The pixel at `index`.
    fn pixel(&self, index: usize, left: &mut Vec<Unfinished>) -> Pixel {
        let segments = self.drawn.len();
        let runs = composite_runs(segments as u32) as usize;
        let run_of = |run: usize| {
            let length = segments.div_ceil(runs);
            (run * length).min(segments)..((run + 1) * length).min(segments)
        };
        if runs == 1 {
            return self.run(PIXEL_EMPTY, run_of(0), index, Some(false), left).0;
        }
        let mut before = PIXEL_EMPTY;
        for run in 0..runs {
            let (own, stopped) = self.run(PIXEL_EMPTY, run_of(run), index, None, left);
            let mut all = over(before, &own);
            let full = all.transmittance <= self.limit.unwrap_or(TRANSMITTANCE_FULL);
            if (full && !stopped) || self.counts {
                let ends_here = self.limit.is_some() && (full || stopped);
                all = self
                    .run(before, run_of(run), index, Some(ends_here), left)
                    .0;
            }
            if full || stopped || run + 1 == runs {
                return all;
            }
            before = over(before, &own);
        }
        unreachable!("there is a last run");
    }

    /// Joins `segments` behind `pixel`; true where the first segment says that the pixel ends in
    /// it. `ends_here` is known where all that lies before is, and then what is to be finished goes
    /// to `left`; where it is true, the pixel ends in the last segment if not before.
    fn run(
        &self,
        mut pixel: Pixel,
        segments: Range<usize>,
        index: usize,
        ends_here: Option<bool>,
        left: &mut Vec<Unfinished>,
    ) -> (Pixel, bool) {
        let tile = index % (COARSE_PIXELS / 2) / (COARSE_PIXELS / FINE_TILES / 2);
        for segment in segments.clone() {
            let slot = self.first_partial + segment;
            let mut farther = self.partials[slot * COARSE_PIXELS + index];
            let stopped = self.limit.is_some() && farther.transmittance < 0.0;
            farther.transmittance = farther.transmittance.abs();
            let before = pixel;
            pixel = over(before, &farther);
            let mut ends = false;
            if let (Some(ends_here), true) = (ends_here, segment > 0) {
                let last = ends_here && segment + 1 == segments.end;
                ends = self
                    .limit
                    .is_some_and(|limit| pixel.transmittance <= limit || last);
                if (ends || self.counts) && self.drawn[segment][tile] {
                    let transmittance = -before.transmittance;
                    left.push(Unfinished {
                        slot,
                        index,
                        before: Pixel {
                            transmittance,
                            ..before
                        },
                    });
                }
            }
            if stopped {
                return (pixel, true);
            }
            if ends || (self.limit.is_none() && pixel.transmittance <= TRANSMITTANCE_FULL) {
                break;
            }
        }
        (pixel, false)
    }
}
