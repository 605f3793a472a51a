//! Tracks freed of the noise of their observation.
//!
//! Cars do not jump by decimeters between frames, detections do. Each point is replaced by a
//! parabola in time fitted to its neighbors (local regression after Cleveland, Robust Locally
//! Weighted Regression, 1979): what cars do within a second or two is kept, outliers are passed
//! over. Wide windows average more and cut corners more; each point has the widest one that does
//! not contradict narrower ones by more than noise does (the intersection of confidence intervals,
//! after Goldenshluger and Nemirovski, On Spatial Adaptive Estimation of Nonparametric Regression,
//! 1997).

use decouplegs_scene::{Track, TrackPoint};
use glam::{DMat3, DVec2, DVec3};

use crate::polyline::wrapped;

/// Half the widest window in seconds for each meter of noise: noise of a decimeter is averaged over
/// three seconds.
const WINDOW_S_PER_M: f64 = 15.0;
/// Half the widest window of all, seconds: within it a lane change is still nearly a parabola.
const WINDOW_MAX_S: f64 = 1.5;
/// Narrower windows are each this of the next wider one, down to half so many seconds.
const WINDOW_STEP: f64 = 0.7;
const WINDOW_MIN_S: f64 = 0.25;
/// Number of deviations from what narrower windows said within which a wider one is believed.
const AGREED: f64 = 1.5;
/// Least noise that is assumed, meters.
const NOISE_MIN_M: f64 = 0.01;
/// Neighbors to each side, whatever the rate of the log.
const NEIGHBORS_MAX: usize = 60;
/// Fits for a point, each after the first without the outliers of the one before.
const ROUNDS: usize = 3;
/// Distance from the fit beyond which a point is an outlier, as a factor on the spread.
const OUTLIER_SPREADS: f64 = 5.0;
/// Least speed at which motion tells where a car points, meters per second.
const MOVING_MPS: f64 = 0.7;

/// A track without noise, in the frame of its log.
#[derive(Clone, Debug, PartialEq)]
pub struct Smoothed {
    /// One for each point of the track.
    pub positions: Vec<DVec2>,
    /// Heading at each point, radians, if known: as logged, or else the direction of motion.
    pub yaws: Vec<Option<f64>>,
    /// Points far from where their neighbors say.
    pub outliers: Vec<bool>,
    /// Standard deviation of the noise along one axis, meters, as told by differences of four
    /// points in a row.
    pub noise_m: f64,
}

/// `track` smoothed for noise of `noise_m`, which is estimated where it is not given.
#[must_use]
pub fn smooth(track: &Track, noise_m: Option<f64>) -> Smoothed {
    let noise_m = noise_m.unwrap_or_else(|| estimated_noise_m(track));
    let positions = track.points.iter().map(|point| point.position_m).collect();
    let count = track.points.len();
    let mut smoothed = Smoothed {
        positions,
        yaws: Vec::new(),
        outliers: vec![false; count],
        noise_m,
    };
    let half_s = (WINDOW_S_PER_M * noise_m.max(NOISE_MIN_M)).min(WINDOW_MAX_S);
    // Outliers are seen in wide windows: a narrow one would follow them.
    for at in 0..count {
        if let Some(fit) = local_fit(track, at, half_s, None) {
            let off = fit.position.distance(track.points[at].position_m);
            smoothed.outliers[at] = off > OUTLIER_SPREADS * fit.spread_m.max(noise_m).max(0.05);
        }
    }
    let fits: Vec<Option<Fit>> = (0..count)
        .map(|at| widest_fit(track, at, half_s, noise_m, &smoothed.outliers))
        .collect();
    for (at, fit) in fits.iter().enumerate() {
        if let Some(fit) = fit
            && (noise_m >= NOISE_MIN_M || smoothed.outliers[at])
        {
            smoothed.positions[at] = fit.position;
        }
    }
    smoothed.yaws = yaws(track, &fits, &smoothed.positions);
    smoothed
}

/// Noise estimated from third differences of neighbors at an even pace, which motion hardly shows
/// in; the median withstands outliers. 0 for tracks too short or too uneven to tell.
fn estimated_noise_m(track: &Track) -> f64 {
    // The variance of x0 - 3 x1 + 3 x2 - x3 is 20 times that of one. Lengths in the plane, whose
    // median is 1.1774 deviations: axes would make the answer depend on which way is north.
    let mut sizes: Vec<f64> = Vec::new();
    for four in track.points.windows(4) {
        let steps = [1, 2, 3].map(|at| four[at].time_s - four[at - 1].time_s);
        if steps
            .iter()
            .all(|step| (step / steps[0] - 1.0).abs() < 0.05)
            && steps[0] < 0.35
        {
            let third = four[0].position_m - 3.0 * four[1].position_m + 3.0 * four[2].position_m
                - four[3].position_m;
            sizes.push(third.length());
        }
    }
    if sizes.len() < 6 {
        return 0.0;
    }
    median(&mut sizes) / (1.1774 * 20f64.sqrt())
}

#[derive(Clone, Copy)]
struct Fit {
    position: DVec2,
    velocity: DVec2,
    spread_m: f64,
    /// Deviation of the position along an axis, for noise of deviation 1.
    deviation: f64,
}

/// The local fit over the widest window up to `half_s` that agrees with the narrower ones.
fn widest_fit(
    track: &Track,
    at: usize,
    half_s: f64,
    noise_m: f64,
    outliers: &[bool],
) -> Option<Fit> {
    let steps = ((WINDOW_MIN_S / half_s).ln() / WINDOW_STEP.ln())
        .floor()
        .max(0.0) as i32;
    let mut believed: Vec<Fit> = Vec::new();
    for step in (0..=steps).rev() {
        let Some(fit) = local_fit(track, at, half_s * WINDOW_STEP.powi(step), Some(outliers))
        else {
            continue;
        };
        let tolerance_m = |fit: &Fit| AGREED * noise_m.max(NOISE_MIN_M) * fit.deviation;
        if believed.iter().any(|narrow| {
            narrow.position.distance(fit.position) > tolerance_m(narrow) + tolerance_m(&fit)
        }) {
            break;
        }
        believed.push(fit);
    }
    believed.pop()
}

/// A parabola about point `at` over the neighbors within `half_s`, or over two to each side where
/// these are fewer; over those that are no `outliers`, where these are known.
fn local_fit(track: &Track, at: usize, half_s: f64, outliers: Option<&[bool]>) -> Option<Fit> {
    let points = &track.points;
    let time_s = points[at].time_s;
    let from = (at.saturating_sub(NEIGHBORS_MAX)..at)
        .find(|&i| time_s - points[i].time_s <= half_s)
        .unwrap_or(at);
    let to = (at..points.len().min(at + NEIGHBORS_MAX))
        .rfind(|&i| points[i].time_s - time_s <= half_s)
        .unwrap_or(at);
    let (from, to) = (
        from.min(at.saturating_sub(2)),
        to.max(at + 2).min(points.len() - 1),
    );
    let usable = |point: &usize| outliers.is_none_or(|outliers| !outliers[*point]);
    let near: Vec<&TrackPoint> = (from..=to)
        .filter(usable)
        .map(|point| &points[point])
        .collect();
    let window_s = near
        .iter()
        .map(|point| (point.time_s - time_s).abs())
        .fold(0.0, f64::max)
        * 1.0001;
    if near.len() < 4 || window_s <= 0.0 {
        return None;
    }
    let scaled: Vec<(f64, DVec2)> = near
        .iter()
        .map(|point| {
            (
                (point.time_s - time_s) / window_s,
                point.position_m - points[at].position_m,
            )
        })
        .collect();
    let kernel: Vec<f64> = scaled
        .iter()
        .map(|(t, _)| (1.0 - t.abs().powi(3)).powi(3))
        .collect();
    let mut weights = kernel.clone();
    let mut fit = None;
    for _ in 0..ROUNDS {
        let ([position, slope, bend], deviation) = parabola(&scaled, &weights)?;
        let distance = |(t, position_then): &(f64, DVec2)| {
            (position + slope * *t + bend * (t * t)).distance(*position_then)
        };
        let distances: Vec<f64> = scaled.iter().map(distance).collect();
        // The median length of a deviation in the plane is 1.18 times its deviation along an axis.
        let spread_m = median(&mut distances.clone()) / 1.18;
        let cut_m = (6.0 * spread_m).max(0.05);
        for ((weight, kernel), distance) in weights.iter_mut().zip(&kernel).zip(&distances) {
            let left = (distance / cut_m).min(1.0);
            // Never nothing at all: a parabola needs three points.
            *weight = kernel * (1.0 - left * left).powi(2) + 1e-12;
        }
        fit = Some(Fit {
            position: points[at].position_m + position,
            velocity: slope / window_s,
            spread_m,
            deviation,
        });
    }
    fit
}

/// Position, slope and bend at zero of the weighted parabola through `points`, times and positions;
/// and the deviation of the position along an axis for noise of deviation 1.
fn parabola(points: &[(f64, DVec2)], weights: &[f64]) -> Option<([DVec2; 3], f64)> {
    let (mut normal, mut noise, mut x, mut y) =
        (DMat3::ZERO, DMat3::ZERO, DVec3::ZERO, DVec3::ZERO);
    for ((t, position), &weight) in points.iter().zip(weights) {
        let row = DVec3::new(1.0, *t, t * t);
        let outer = DMat3::from_cols(row * row.x, row * row.y, row * row.z);
        (normal, noise) = (normal + outer * weight, noise + outer * (weight * weight));
        (x, y) = (
            x + row * (weight * position.x),
            y + row * (weight * position.y),
        );
    }
    let inverse = (normal + DMat3::from_diagonal(DVec3::new(0.0, 1e-9, 1e-9))).inverse();
    let (x, y) = (inverse * x, inverse * y);
    let deviation = inverse.x_axis.dot(noise * inverse.x_axis).max(0.0).sqrt();
    (x.is_finite() && y.is_finite()).then(|| {
        (
            [
                DVec2::new(x.x, y.x),
                DVec2::new(x.y, y.y),
                DVec2::new(x.z, y.z),
            ],
            deviation,
        )
    })
}

/// The middle of `values`, of which there must be one; their order is lost.
pub(super) fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Logged yaws where there are any, otherwise directions of motion; where the car stands, as it
/// pointed before (or will point).
fn yaws(track: &Track, fits: &[Option<Fit>], positions: &[DVec2]) -> Vec<Option<f64>> {
    if track.points.iter().any(|point| point.yaw_rad.is_some()) {
        return track
            .points
            .iter()
            .map(|point| point.yaw_rad.map(wrapped))
            .collect();
    }
    let count = positions.len();
    let moving = |at: usize| {
        let velocity = match &fits[at] {
            Some(fit) => fit.velocity,
            None if count > 1 => {
                let (a, b) = (at.saturating_sub(1), (at + 1).min(count - 1));
                (positions[b] - positions[a]) / (track.points[b].time_s - track.points[a].time_s)
            }
            None => DVec2::ZERO,
        };
        (velocity.length() >= MOVING_MPS).then(|| velocity.to_angle())
    };
    let mut yaws: Vec<Option<f64>> = (0..count).map(moving).collect();
    for at in 1..count {
        yaws[at] = yaws[at].or(yaws[at - 1]);
    }
    for at in (0..count.saturating_sub(1)).rev() {
        yaws[at] = yaws[at].or(yaws[at + 1]);
    }
    yaws
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ten meters per second through a corner of 45 degrees, ten times a second, with noise of
    /// `noise_m`.
    fn corner(noise_m: f64) -> (Track, Vec<DVec2>) {
        let mut seed = 7_u64;
        let mut uniform = || {
            seed = seed
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (seed >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        };
        let mut normal = || (uniform() + uniform() + uniform() + uniform()) * 3f64.sqrt();
        let truth: Vec<DVec2> = (-40..=40)
            .map(|at| {
                if at < 0 {
                    DVec2::new(f64::from(at), 0.0)
                } else {
                    DVec2::ONE.normalize() * f64::from(at)
                }
            })
            .collect();
        let point = |(at, position): (usize, &DVec2)| TrackPoint {
            time_s: 0.1 * at as f64,
            position_m: *position + noise_m * DVec2::new(normal(), normal()),
            z_m: None,
            yaw_rad: None,
        };
        (
            Track {
                points: truth.iter().enumerate().map(point).collect(),
                ..Track::default()
            },
            truth,
        )
    }

    #[test]
    fn noise_is_averaged_and_corners_are_not_cut() {
        let (track, truth) = corner(0.08);
        let smoothed = smooth(&track, Some(0.08));
        let off: Vec<f64> = smoothed
            .positions
            .iter()
            .zip(&truth)
            .map(|(found, truth)| found.distance(*truth))
            .collect();
        let straight = off[5..30].iter().sum::<f64>() / 25.0;
        // Noise of 8 cm along each axis is 10 cm on average, and the widest window alone is off by
        // 55 cm at the corner.
        assert!(straight < 0.05 && off[40] < 0.25, "{straight} {}", off[40]);
        let wide = local_fit(&track, 40, WINDOW_S_PER_M * 0.08, None).unwrap();
        assert!(
            wide.position.distance(truth[40]) > 2.0 * off[40],
            "{} {}",
            wide.position.distance(truth[40]),
            off[40]
        );
    }
}
