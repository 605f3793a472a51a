//! Speed profile of a plan: its arc length over time as a smooth curve.

/// A plan whose rest of the way is shorter is at rest, meters.
const REST_M: f64 = 0.02;
/// A plan that ends slower than this ends at rest, meters per second.
const REST_MPS: f64 = 0.1;

/// The way driven over time, through the times and positions of a plan: a piecewise cubic that
/// never falls (Fritsch and Carlson, "Monotone Piecewise Cubic Interpolation", 1980) and is exact
/// where the acceleration is constant.
#[derive(Clone, Debug)]
pub(super) struct SpeedProfile {
    /// Time in seconds, way in meters, speed in meters per second; at time 0 the ego's own.
    knots: Vec<[f64; 3]>,
}

/// Target of a profile at a moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Wanted {
    pub arc_m: f64,
    pub speed_mps: f64,
    pub acceleration_mps2: f64,
    /// True if nothing is left of the way.
    pub rests: bool,
}

impl SpeedProfile {
    /// The profile through `points` (time in seconds, rising from above 0; way in meters, never
    /// falling) from `speed_mps` on.
    pub(super) fn new(points: impl Iterator<Item = (f64, f64)>, speed_mps: f64) -> Self {
        let mut knots = vec![[0.0, 0.0, speed_mps]];
        knots.extend(points.map(|(time_s, arc_m)| [time_s, arc_m, 0.0]));
        let slope = |a: [f64; 3], b: [f64; 3]| (b[1] - a[1]) / (b[0] - a[0]);
        for at in 1..knots.len() {
            let before = slope(knots[at - 1], knots[at]);
            knots[at][2] = match knots.get(at + 1) {
                // The slope of the parabola through three knots.
                Some(&next) => {
                    let (after, spans) = (
                        slope(knots[at], next),
                        [knots[at][0] - knots[at - 1][0], next[0] - knots[at][0]],
                    );
                    (before * spans[1] + after * spans[0]) / (spans[0] + spans[1])
                }
                // That of the parabola with the last speed but one.
                None => (2.0 * before - knots[at - 1][2]).max(0.0),
            };
        }
        for at in 1..knots.len() {
            let mean = slope(knots[at - 1], knots[at]);
            // A speed of at most three times the mean on both sides keeps the cubic from falling.
            for end in [at - 1, at] {
                knots[end][2] = knots[end][2].clamp(0.0, 3.0 * mean);
            }
        }
        Self { knots }
    }

    /// End of the plan, seconds.
    pub(super) fn end_s(&self) -> f64 {
        self.knots[self.knots.len() - 1][0]
    }

    /// Target at `time_s` after the observation.
    pub(super) fn at(&self, time_s: f64) -> Wanted {
        let last = self.knots[self.knots.len() - 1];
        let next = self
            .knots
            .partition_point(|knot| knot[0] <= time_s)
            .clamp(1, self.knots.len() - 1);
        let (a, b) = (self.knots[next - 1], self.knots[next]);
        let span_s = b[0] - a[0];
        let t = ((time_s - a[0]) / span_s).clamp(0.0, 1.0);
        let u = 1.0 - t;
        let mean = (b[1] - a[1]) / span_s;
        let arc_m = a[1]
            + t * t * (1.0 + 2.0 * u) * (b[1] - a[1])
            + span_s * (a[2] * u * u * t - b[2] * t * t * u);
        let speed_mps =
            6.0 * t * u * mean + a[2] * u * (1.0 - 3.0 * t) + b[2] * t * (3.0 * t - 2.0);
        let acceleration_mps2 =
            (6.0 * (1.0 - 2.0 * t) * mean + a[2] * (6.0 * t - 4.0) + b[2] * (6.0 * t - 2.0))
                / span_s;
        Wanted {
            arc_m,
            speed_mps,
            acceleration_mps2,
            rests: last[1] - arc_m < REST_M && last[2] < REST_MPS,
        }
    }
}
