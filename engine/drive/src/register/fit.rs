//! The motion of a track onto its lanes.
//!
//! A lane says where a track is across it, never where it is along it. So the final motion is the
//! one with the least distance from points to lines (Chen and Medioni, Object Modelling by
//! Registration of Multiple Range Images, 1992), not from points to points, robustly (Tukey's
//! biweight) and with a prior: what lanes do not show stays as it was logged. On a straight lane
//! that is the position along it; on an arc of a circle, sliding along the arc. The errors that are
//! left are told with the motion.

use glam::{DMat3, DVec2, DVec3};

use super::smooth::median;
use crate::planar::PlanarTransform;

/// A point of a track and the line that it should lie on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinePair {
    /// Logged position, world coordinates, meters.
    pub from: DVec2,
    /// A position on the line.
    pub on_line: DVec2,
    /// Across the line there, to its left; of length 1.
    pub across: DVec2,
    /// Weight, usually 1.
    pub weight: f64,
}

/// Prior of motions before any track is seen: standard deviations around zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionPrior {
    /// Standard deviation of the shift along either axis, meters.
    pub shift_m: f64,
    /// Standard deviation of the turn around the middle of the track, radians.
    pub yaw_rad: f64,
}

/// A motion and how well it is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanarFit {
    /// Registered from logged.
    pub motion: PlanarTransform,
    /// Median distance of the moved points from their lines, times 1.48: a deviation that outliers
    /// do not move.
    pub residual_m: f64,
    /// Standard deviation of the shift along the track's mean direction: near that of the prior,
    /// the lanes did not show it.
    pub along_m: f64,
    /// Standard deviation of the moved points across their lanes, by shift and turn together, as a
    /// root mean square over the track. Drivers who keep to one side of their lane are not in it:
    /// what all points share looks like drift.
    pub across_m: f64,
    /// Standard deviation of the turn, radians.
    pub yaw_deviation_rad: f64,
}

/// The least deviation that is believed, meters.
pub const RESIDUAL_MIN_M: f64 = 0.02;
/// Tukey's biweight at 95 % of the efficiency of least squares.
const BIWEIGHT: f64 = 4.685;
const ROUNDS: usize = 12;

/// The most probable motion given `pairs`, of which there must be one, beginning at `start`.
///
/// Pairs far beyond the usual deviation count for nothing; what is usual is told by the pairs
/// themselves, but is `scale_min_m` at least. From a start that is not near, that must be large, or
/// the few pairs that show the position along the lane are taken for outliers.
#[must_use]
pub fn fit(
    pairs: &[LinePair],
    start: &PlanarTransform,
    prior: &MotionPrior,
    scale_min_m: f64,
) -> PlanarFit {
    let mut motion = *start;
    let prior_information = DVec3::new(
        prior.yaw_rad.powi(-2),
        prior.shift_m.powi(-2),
        prior.shift_m.powi(-2),
    );
    let mut covariance = DMat3::IDENTITY;
    let mut residual_m = RESIDUAL_MIN_M;
    for _ in 0..ROUNDS {
        let arms_m = arms_m(pairs, &motion);
        let off: Vec<f64> = pairs
            .iter()
            .zip(&arms_m)
            .map(|(pair, arm_m)| {
                let moved = arm_m + motion.pivot_m + motion.shift_m;
                pair.across.dot(moved - pair.on_line)
            })
            .collect();
        residual_m = 1.4826 * median(&mut off.iter().map(|off| off.abs()).collect::<Vec<_>>());
        let scale_m = residual_m.max(RESIDUAL_MIN_M).max(scale_min_m);
        let correlated = correlation_length(&off, BIWEIGHT * scale_m);
        let mut information = DMat3::from_diagonal(prior_information);
        let mut pull =
            -prior_information * DVec3::new(motion.yaw_rad, motion.shift_m.x, motion.shift_m.y);
        for ((pair, arm_m), off) in pairs.iter().zip(&arms_m).zip(&off) {
            let left = (off / (BIWEIGHT * scale_m)).min(1.0);
            let weight = pair.weight * (1.0 - left * left).max(0.0).powi(2)
                / (correlated * scale_m * scale_m);
            let row = row(pair, *arm_m);
            information += DMat3::from_cols(
                row * (row.x * weight),
                row * (row.y * weight),
                row * (row.z * weight),
            );
            pull -= row * (weight * off);
        }
        covariance = information.inverse();
        let step = covariance * pull;
        motion.yaw_rad += step.x;
        motion.shift_m += DVec2::new(step.y, step.z);
        if step.abs().max_element() < 1e-10 {
            break;
        }
    }
    let mean = pairs.iter().map(|pair| pair.across).sum::<DVec2>();
    let along = -mean.perp().normalize_or(DVec2::NEG_X);
    let variance = |row: DVec3| row.dot(covariance * row).max(0.0);
    let rows = pairs.iter().zip(arms_m(pairs, &motion));
    let across: f64 = rows.map(|(pair, arm_m)| variance(row(pair, arm_m))).sum();
    PlanarFit {
        motion,
        residual_m,
        along_m: variance(DVec3::new(0.0, along.x, along.y)).sqrt(),
        across_m: (across / pairs.len().max(1) as f64).sqrt(),
        yaw_deviation_rad: covariance.x_axis.x.max(0.0).sqrt(),
    }
}

/// Products that are added up for one autocorrelation, and autocorrelations that are examined.
const SAMPLES_MAX: usize = 4096;
const LAGS_MAX: usize = 4096;

/// Points of `pairs` from the pivot, turned by `motion`, meters.
fn arms_m(pairs: &[LinePair], motion: &PlanarTransform) -> Vec<DVec2> {
    let turn = DVec2::from_angle(motion.yaw_rad);
    let arm_m = |pair: &LinePair| turn.rotate(pair.from - motion.pivot_m);
    pairs.iter().map(arm_m).collect()
}

/// Gradient of a pair's distance by turn and shift.
fn row(pair: &LinePair, arm_m: DVec2) -> DVec3 {
    DVec3::new(pair.across.dot(arm_m.perp()), pair.across.x, pair.across.y)
}

/// Number of neighbors in `off` with correlated deviations. Sensor noise is new at each point, but
/// a driver who keeps left does so for many points. One and twice the sum of autocorrelations up to
/// the first that is none; what is beyond `cut_m` is left out. Of long lists, products of evenly
/// spread samples stand for all, so that time grows with the length alone.
fn correlation_length(off: &[f64], cut_m: f64) -> f64 {
    let kept = |off: &f64| if off.abs() < cut_m { *off } else { 0.0 };
    let off: Vec<f64> = off.iter().map(kept).collect();
    let stride = off.len().div_ceil(SAMPLES_MAX).max(1);
    let product = |lag: usize| {
        off[lag..]
            .iter()
            .zip(&off)
            .step_by(stride)
            .map(|(a, b)| a * b)
            .sum::<f64>()
    };
    let all = product(0);
    if all <= 0.0 {
        return 1.0;
    }
    let correlations = (1..(off.len() / 2).min(LAGS_MAX)).map(|lag| product(lag) / all);
    1.0 + 2.0
        * correlations
            .take_while(|correlation| *correlation > 0.0)
            .sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    const PRIOR: MotionPrior = MotionPrior {
        shift_m: 1.0,
        yaw_rad: 0.035,
    };

    /// Points of a line through `at(s)`, moved away by `drift`; `outliers` of them somewhere else.
    fn pairs(
        drift: &PlanarTransform,
        at: impl Fn(f64) -> (DVec2, f64),
        outliers: usize,
    ) -> Vec<LinePair> {
        let pair = |i: usize| {
            let (on_line, heading_rad) = at(i as f64);
            let moved = drift.apply(on_line);
            let from = if i % 7 == 3 && i / 7 < outliers {
                moved + DVec2::new(3.0, 7.0)
            } else {
                moved
            };
            LinePair {
                from,
                on_line,
                across: DVec2::from_angle(heading_rad).perp(),
                weight: 1.0,
            }
        };
        (0..100).map(pair).collect()
    }

    #[test]
    fn across_a_straight_lane_all_is_recovered_and_along_it_nothing_is_invented() {
        let drift = PlanarTransform {
            pivot_m: DVec2::new(50.0, 0.0),
            yaw_rad: 0.03,
            shift_m: DVec2::new(0.8, -0.6),
        };
        let pairs = pairs(&drift, |s| (DVec2::new(s, 0.0), 0.0), 8);
        let found = fit(
            &pairs,
            &PlanarTransform::identity(drift.apply(drift.pivot_m)),
            &PRIOR,
            RESIDUAL_MIN_M,
        );
        for pair in pairs.iter().filter(|pair| pair.from.y.abs() < 3.0) {
            let moved = found.motion.apply(pair.from);
            assert!(moved.y.abs() < 0.01, "{found:?}");
            // What was logged along the lane stays: 0.8 m ahead.
            assert!(
                (moved.x - pair.on_line.x - 0.8).abs() < 0.05,
                "{moved} for {pair:?}"
            );
        }
        assert!(found.along_m > 0.9 && found.across_m < 0.1, "{found:?}");
    }

    #[test]
    fn a_bend_shows_the_whole_motion() {
        // Straight, then a quarter of a circle of 30 m, then straight.
        let bend = 30.0 * std::f64::consts::FRAC_PI_2;
        let at = |s: f64| {
            let turned = ((s - 25.0) / 30.0).clamp(0.0, std::f64::consts::FRAC_PI_2);
            let start = DVec2::new(s.min(25.0), 0.0);
            let arc = DVec2::new(turned.sin(), 1.0 - turned.cos()) * 30.0;
            (start + arc + DVec2::Y * (s - 25.0 - bend).max(0.0), turned)
        };
        let drift = PlanarTransform {
            pivot_m: DVec2::new(40.0, 10.0),
            yaw_rad: -0.03,
            shift_m: DVec2::new(0.8, 0.6),
        };
        let pairs = pairs(&drift, at, 8);
        let found = fit(
            &pairs,
            &PlanarTransform::identity(DVec2::new(40.0, 10.0)),
            &PRIOR,
            RESIDUAL_MIN_M,
        );
        for (i, pair) in pairs.iter().enumerate().filter(|(i, _)| i % 7 != 3) {
            assert!(
                found.motion.apply(pair.from).distance(at(i as f64).0) < 0.02,
                "{i}: {found:?}"
            );
        }
        assert!(found.along_m < 0.1, "{found:?}");
    }

    #[test]
    fn a_short_bend_is_an_outlier_for_a_narrow_scale_and_none_for_one_that_narrows() {
        // 90 m straight and 10 m across: from half a meter too far, the last part looks half a
        // meter off.
        let at = |s: f64| {
            if s < 90.0 {
                (DVec2::new(s, 0.0), 0.0)
            } else {
                (DVec2::new(90.0, s - 90.0), std::f64::consts::FRAC_PI_2)
            }
        };
        let drift = PlanarTransform {
            pivot_m: DVec2::new(40.0, 0.0),
            yaw_rad: 0.0,
            shift_m: DVec2::new(0.5, 0.0),
        };
        let pairs = pairs(&drift, at, 0);
        let start = PlanarTransform::identity(DVec2::new(40.0, 0.0));
        let off_m = |scales_m: &[f64]| {
            let found = scales_m.iter().fold(start, |motion, scale_m| {
                fit(&pairs, &motion, &PRIOR, *scale_m).motion
            });
            (found.shift_m.x + 0.5).abs()
        };
        let (narrow_m, narrowing_m) = (
            off_m(&[RESIDUAL_MIN_M; 4]),
            off_m(&[1.0, 0.3, 0.1, RESIDUAL_MIN_M]),
        );
        assert!(
            narrow_m > 0.4 && narrowing_m < 0.02,
            "{narrow_m} {narrowing_m}"
        );
    }

    #[test]
    fn neighbors_that_say_the_same_count_once() {
        let new_each = |at: u64| {
            (at.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40) as f64 / f64::from(1 << 24) - 0.5
        };
        let alone: Vec<f64> = (0..400).map(new_each).collect();
        let tens: Vec<f64> = (0..400).map(|at| new_each(at / 10)).collect();
        let (alone, tens) = (
            correlation_length(&alone, 1.0),
            correlation_length(&tens, 1.0),
        );
        assert!(alone < 2.0 && tens > 5.0, "{alone} {tens}");
        assert_eq!(correlation_length(&[0.0; 9], 1.0), 1.0);
        assert_eq!(correlation_length(&[], 1.0), 1.0);
        // A minute of a slow weave at a kilohertz: each autocorrelation looks at a sample of it,
        // and no more than some thousand are.
        let long: Vec<f64> = (0..200_000)
            .map(|at| (f64::from(at) * 1e-4).sin())
            .collect();
        let since = std::time::Instant::now();
        assert!(correlation_length(&long, 2.0) > 1000.0);
        assert!(since.elapsed().as_secs_f64() < 30.0);
    }
}
