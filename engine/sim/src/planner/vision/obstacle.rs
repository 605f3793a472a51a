//! The vehicle ahead: where on the expected way the road ends at the foot of something upright.
//!
//! An upright block, about as large as the rear of a car, is put at each of many distances along
//! the way. Its brightness and color, in bands of height, are compared with those of the road just
//! before its foot, and a linear classifier (`weights`) says how likely a vehicle stands there.
//! Shadows and markings lie flat: their bands seldom change as those of a car do, from the dark
//! below it to its paint, its windows and what is behind its roof.

use super::camera_image::{Color, Image};
use super::way::{RoadPath, WayPoint};
use super::weights::{BIAS, WEIGHTS};

/// Heights of the bands' borders, meters.
const BANDS_M: [f64; BANDS + 1] = [0.0, 0.2, 0.45, 0.75, 1.05, 1.4];
const BANDS: usize = 5;
/// Lines of positions in each band.
const LINES: usize = 3;
/// Positions across the block.
const ACROSS: usize = 7;
/// Half its width, meters.
const HALF_WIDTH_M: f64 = 0.6;
/// The road before the foot that it is compared with, meters.
const APRON_M: [f64; 4] = [0.35, 0.7, 1.2, 1.9];
/// Features for each band: how bright, how differently bright, how differently colored, how uneven,
/// how unlike the strips beside it.
const PER_BAND: usize = 5;
/// Length of a list of features: those of bands, the least departures from the road, and three of
/// the whole block.
pub(super) const FEATURES: usize = PER_BAND * BANDS + 5;
/// Features are kept within this.
const FEATURE_MAX: f32 = 1.5;
/// First and last distance that is tried, meters along the way.
const RANGE_M: std::ops::Range<f64> = 3.5..42.0;
/// Ratio of each distance that is tried to the one before.
const RANGE_RATIO: f64 = 1.03;
/// Blocks stand in the middle of the way and beside it, meters.
const BESIDE_M: [f64; 3] = [0.0, 0.55, -0.55];

/// Something that stands on the way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sighting {
    /// Position of its foot, meters along the path from beside the middle of the ego.
    pub arc_m: f64,
    /// Log odds that it is a vehicle.
    pub score: f64,
}

/// Sums that make a mean and a spread.
#[derive(Clone, Copy, Default)]
struct Sums {
    count: f32,
    log_luma: f32,
    square: f32,
    red: f32,
    blue: f32,
}

impl Sums {
    fn add(&mut self, color: Color) {
        let log_luma = color.luma.ln();
        self.count += 1.0;
        self.log_luma += log_luma;
        self.square += log_luma * log_luma;
        self.red += color.red;
        self.blue += color.blue;
    }

    fn mean(&self) -> f32 {
        self.log_luma / self.count
    }

    fn spread(&self) -> f32 {
        (self.square / self.count - self.mean() * self.mean())
            .max(0.0)
            .sqrt()
    }

    fn color_distance(&self, other: &Self) -> f32 {
        let red = self.red / self.count - other.red / other.count;
        let blue = self.blue / self.count - other.blue / other.count;
        10.0 * red.hypot(blue)
    }
}

/// Features of the block at `arc_m`, `beside_m` to the left of the path; `None` if the image does
/// not show all of it.
pub(super) fn features(
    image: &Image,
    way: &RoadPath,
    arc_m: f64,
    beside_m: f64,
) -> Option<[f32; FEATURES]> {
    let foot = way.at(arc_m);
    let apron = apron(image, way, arc_m, beside_m)?;
    let mut features = [0.0; FEATURES];
    let (mut before, mut changes) = (0.0_f32, 0.0_f32);
    let mut departures = [0.0_f32; BANDS];
    for band in 0..BANDS {
        let (inside, outside) = band_of(image, &foot, beside_m, band)?;
        let brighter = inside.mean() - apron.mean();
        let unlike = if outside.count > 0.0 {
            (inside.mean() - outside.mean()).abs() + inside.color_distance(&outside)
        } else {
            0.3
        };
        let of_band = [
            brighter,
            brighter.abs(),
            inside.color_distance(&apron),
            inside.spread(),
            unlike,
        ];
        features[band * PER_BAND..(band + 1) * PER_BAND].copy_from_slice(&of_band);
        departures[band] = brighter.abs() + inside.color_distance(&apron) + 0.5 * inside.spread();
        changes += (brighter - before).abs();
        before = brighter;
    }
    // What is upright departs from the road in every band, paint only in those near the foot.
    features[FEATURES - 5] = departures.iter().copied().fold(FEATURE_MAX, f32::min);
    features[FEATURES - 4] = departures[2..].iter().copied().fold(FEATURE_MAX, f32::min);
    features[FEATURES - 3] = apron.spread();
    features[FEATURES - 2] = 0.5 * changes;
    features[FEATURES - 1] = (arc_m as f32 / 40.0).min(1.0);
    Some(features.map(|feature| feature.clamp(-FEATURE_MAX, FEATURE_MAX)))
}

/// The road before the foot of a block.
fn apron(image: &Image, way: &RoadPath, arc_m: f64, beside_m: f64) -> Option<Sums> {
    let mut sums = Sums::default();
    for before_m in APRON_M {
        let point = way.at(arc_m - before_m * (1.0 + 0.03 * arc_m));
        for position in 0..ACROSS {
            if let Some(color) = image.color_of(point.beside(beside_m + across_m(position)), 0.0) {
                sums.add(color);
            }
        }
    }
    (sums.count >= ACROSS as f32).then_some(sums)
}

fn across_m(position: usize) -> f64 {
    HALF_WIDTH_M * (2.0 * position as f64 / (ACROSS - 1) as f64 - 1.0)
}

/// A band of the block, and the strips to its left and right.
fn band_of(image: &Image, foot: &WayPoint, beside_m: f64, band: usize) -> Option<(Sums, Sums)> {
    let (mut inside, mut outside) = (Sums::default(), Sums::default());
    for line in 0..LINES {
        let height_m = BANDS_M[band]
            + (BANDS_M[band + 1] - BANDS_M[band]) * (line as f64 + 0.5) / LINES as f64;
        for position in 0..ACROSS {
            inside.add(image.color_of(foot.beside(beside_m + across_m(position)), height_m)?);
        }
        for side_m in [-1.5, -1.25, 1.25, 1.5] {
            if let Some(color) = image.color_of(foot.beside(beside_m + side_m), height_m) {
                outside.add(color);
            }
        }
    }
    Some((inside, outside))
}

/// Log odds that a vehicle stands there.
fn score(features: &[f32; FEATURES]) -> f64 {
    f64::from(
        BIAS + features
            .iter()
            .zip(&WEIGHTS)
            .map(|(feature, weight)| feature * weight)
            .sum::<f32>(),
    )
}

/// Scores along the way: each distance with the best of the blocks beside each other there.
pub(super) fn scan(image: &Image, way: &RoadPath) -> Vec<Sighting> {
    let mut sightings = Vec::new();
    let mut arc_m = RANGE_M.start;
    while arc_m < RANGE_M.end {
        let scores = BESIDE_M
            .iter()
            .filter_map(|&beside_m| features(image, way, arc_m, beside_m))
            .map(|features| score(&features));
        if let Some(score) = scores.max_by(f64::total_cmp) {
            sightings.push(Sighting { arc_m, score });
        }
        arc_m *= RANGE_RATIO;
    }
    sightings
}
