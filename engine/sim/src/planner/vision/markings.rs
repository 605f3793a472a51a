//! Detection of lane markings: bright lines on both sides of the expected path. Every pixel that is
//! brighter than the road on both of its sides has a vote.
//!
//! A lane is tried in every heading, bend, offset and width near the believed one, and the one with
//! the most evidence for it wins, less what it departs from belief (the maximum of the posterior;
//! noise about lines is taken for Gaussian).

use super::lane::LaneBelief;
use super::road_view::{COLUMN_M, COLUMNS, HALF_COLUMNS, Row};

/// Number of rows that vote together.
const GROUP: usize = 4;
/// Headings that are tried, from the expected one, radians.
const HEADING_STEP_RAD: f64 = 0.006;
/// Bends that are tried, from the expected one, 1/m.
const CURVATURE_STEP: f64 = 0.0012;
/// Bends to each side.
const CURVATURES: i32 = 2;
/// Widths of lanes, meters.
const WIDTHS_M: std::ops::RangeInclusive<f64> = 2.7..=4.0;
/// Difference between widths that are tried, meters.
const WIDTH_STEP_M: f64 = 0.1;
/// Largest distance from the expected lane at which lanes are looked for, standard deviations.
const SIGMAS_MAX: f64 = 2.5;
/// Number of standard deviations by which a marking stands out of the noise.
const BORDER_SIGMAS: f64 = 3.0;
/// More evidence than this for a border counts for no more.
const BORDER_SIGMAS_MAX: f64 = 8.0;
/// Weight of a standard deviation of evidence against one (squared, halved) of the prior.
const EVIDENCE: f64 = 0.9;
/// A row whose road between the markings responds like this on average is paint across the lane: a
/// crosswalk.
const CROSSWALK: f32 = 0.03;
/// Half the width of the road between the markings, meters.
const INTERIOR_M: f64 = 1.1;
/// The least noise of a response.
const NOISE_MIN: f32 = 0.002;

/// A lane as its markings tell, relative to the expected way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LaneFix {
    /// Offset of its center at the reference position, positive to the left, meters.
    pub offset_m: f64,
    /// Heading of the marking, radians.
    pub heading_rad: f64,
    /// Curvature, 1/m.
    pub curvature: f64,
    /// Width from border to border, meters.
    pub width_m: f64,
    /// Signal-to-noise ratio of the left and the right border, standard deviations.
    pub borders: [f64; 2],
}

/// A group of rows, their responses averaged.
struct Group {
    /// Meters beyond the reference position.
    ahead_m: f64,
    weight: f32,
    responses: Vec<f32>,
}

/// The lane that `rows` show, whose offset is told at `reference_m` along the way; `None` where
/// they show no marking.
pub(super) fn find_lane(rows: &[Row], belief: &LaneBelief, reference_m: f64) -> Option<LaneFix> {
    let groups = groups(rows, reference_m);
    let weight: f32 = groups.iter().map(|group| group.weight * group.weight).sum();
    if groups.len() < 3 {
        return None;
    }
    let straight = profile(&groups, 0.0, 0.0);
    let (level, noise) = level_and_noise(&straight);
    let noise = noise.max(NOISE_MIN * weight.sqrt());
    let headings = (SIGMAS_MAX * belief.heading_sigma_rad / HEADING_STEP_RAD).ceil() as i32;
    let mut best: Option<(f64, LaneFix)> = None;
    for heading in -headings..=headings {
        for bend in -CURVATURES..=CURVATURES {
            let (heading_rad, curvature) = (
                f64::from(heading) * HEADING_STEP_RAD,
                f64::from(bend) * CURVATURE_STEP,
            );
            let evidence: Vec<f64> = profile(&groups, heading_rad, curvature)
                .iter()
                .map(|&sum| f64::from((sum - level) / noise).clamp(-1.0, BORDER_SIGMAS_MAX))
                .collect();
            let doubt = squared(heading_rad / belief.heading_sigma_rad)
                + squared(curvature / belief.curvature_sigma);
            search(
                &evidence,
                belief,
                doubt,
                |score, offset_m, width_m, borders| {
                    if best.is_none_or(|(before, _)| score > before) {
                        best = Some((
                            score,
                            LaneFix {
                                offset_m,
                                heading_rad,
                                curvature,
                                width_m,
                                borders,
                            },
                        ));
                    }
                },
            );
        }
    }
    let (_, fix) = best?;
    (fix.borders[0].max(fix.borders[1]) >= BORDER_SIGMAS).then_some(fix)
}

/// Shows `see` the score of every offset and width near the believed ones.
fn search(
    evidence: &[f64],
    belief: &LaneBelief,
    doubt: f64,
    mut see: impl FnMut(f64, f64, f64, [f64; 2]),
) {
    let offsets = (SIGMAS_MAX * belief.offset_sigma_m / COLUMN_M).ceil() as i32;
    let widths = ((WIDTHS_M.end() - WIDTHS_M.start()) / WIDTH_STEP_M).round() as i32;
    for offset in -offsets..=offsets {
        let offset_m = f64::from(offset) * COLUMN_M;
        let doubt = doubt + squared(offset_m / belief.offset_sigma_m);
        for width in 0..=widths {
            let width_m = WIDTHS_M.start() + f64::from(width) * WIDTH_STEP_M;
            let at = |left_m: f64| {
                let column = (left_m / COLUMN_M).round() + HALF_COLUMNS as f64;
                if column < 0.0 {
                    0.0
                } else {
                    evidence.get(column as usize).copied().unwrap_or(0.0)
                }
            };
            let borders = [at(offset_m + 0.5 * width_m), at(offset_m - 0.5 * width_m)];
            let doubt = doubt + squared((width_m - belief.width_m) / belief.width_sigma_m);
            see(
                EVIDENCE * (borders[0] + borders[1]) - 0.5 * doubt,
                offset_m,
                width_m,
                borders,
            );
        }
    }
}

fn squared(value: f64) -> f64 {
    value * value
}

fn groups(rows: &[Row], reference_m: f64) -> Vec<Group> {
    let clear: Vec<&Row> = rows.iter().filter(|row| !is_crosswalk(row)).collect();
    let group = |rows: &[&Row]| {
        let mut responses = vec![0.0; COLUMNS];
        for row in rows {
            for (sum, response) in responses.iter_mut().zip(&row.responses) {
                *sum += row.weight * response;
            }
        }
        let arc_m = rows.iter().map(|row| row.arc_m).sum::<f64>() / rows.len() as f64;
        Group {
            ahead_m: arc_m - reference_m,
            weight: rows.iter().map(|row| row.weight).sum(),
            responses,
        }
    };
    clear.chunks(GROUP).map(group).collect()
}

/// True if a row has paint in the middle of the lane, where no line along the path lies.
fn is_crosswalk(row: &Row) -> bool {
    let half = (INTERIOR_M / COLUMN_M) as usize;
    let interior = &row.responses[HALF_COLUMNS - half..=HALF_COLUMNS + half];
    interior
        .iter()
        .map(|response| response.max(0.0))
        .sum::<f32>()
        > CROSSWALK * interior.len() as f32
}

/// Sums of responses along lines of one heading and bend, by their column at the reference
/// position.
fn profile(groups: &[Group], heading_rad: f64, curvature: f64) -> Vec<f32> {
    let mut sums = vec![0.0_f32; COLUMNS];
    for group in groups {
        let left_m = heading_rad * group.ahead_m + 0.5 * curvature * group.ahead_m * group.ahead_m;
        let shift = (left_m / COLUMN_M).round() as i64;
        let first = (-shift).clamp(0, COLUMNS as i64) as usize;
        let last = (COLUMNS as i64 - shift).clamp(first as i64, COLUMNS as i64) as usize;
        let from = (first as i64 + shift).clamp(0, COLUMNS as i64) as usize;
        for (sum, response) in sums[first..last].iter_mut().zip(&group.responses[from..]) {
            *sum += response;
        }
    }
    sums
}

/// The median of a profile and the standard deviation of its noise, by the quartile below: lines
/// are only above.
fn level_and_noise(profile: &[f32]) -> (f32, f32) {
    let mut sorted = profile.to_vec();
    sorted.sort_by(f32::total_cmp);
    let (median, quartile) = (sorted[sorted.len() / 2], sorted[sorted.len() / 4]);
    // A quartile of a normal distribution lies 0.6745 standard deviations below its middle.
    (median, (median - quartile) / 0.6745)
}
