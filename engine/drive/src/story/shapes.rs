//! Transitions between two values, in closed form.

use std::f64::consts::PI;

use decouplegs_scene::story::{Dynamics, Extent, Shape};

/// Share of the change after a share of its extent, both 0 to 1.
pub(super) fn share(shape: Shape, at: f64) -> f64 {
    let at = at.clamp(0.0, 1.0);
    match shape {
        Shape::Step => 1.0,
        Shape::Linear => at,
        Shape::Cubic => at * at * (3.0 - 2.0 * at),
        Shape::Sinusoidal => 0.5 * (1.0 - (PI * at).cos()),
    }
}

/// Slope of [`share`].
fn slope(shape: Shape, at: f64) -> f64 {
    match shape {
        _ if !(0.0..1.0).contains(&at) => 0.0,
        Shape::Step => 0.0,
        Shape::Linear => 1.0,
        Shape::Cubic => 6.0 * at * (1.0 - at),
        Shape::Sinusoidal => 0.5 * PI * (PI * at).sin(),
    }
}

/// Largest slope and curvature of [`share`].
fn peaks(shape: Shape) -> (f64, f64) {
    match shape {
        // A corner has no curvature of its own: a line counts as a cubic.
        Shape::Step | Shape::Linear => (1.0, 6.0),
        Shape::Cubic => (1.5, 6.0),
        Shape::Sinusoidal => (0.5 * PI, 0.5 * PI * PI),
    }
}

/// Transition that goes on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Transition {
    shape: Shape,
    from: f64,
    pub to: f64,
    /// Seconds, or meters if it counts the way.
    extent: f64,
    is_of_way: bool,
    /// Largest change per second, where that gives the extent.
    rate_per_s: Option<f64>,
    passed: f64,
}

impl Transition {
    pub(super) fn new(from: f64, to: f64, dynamics: Dynamics) -> Self {
        let change = (to - from).abs();
        let (_, curvature) = peaks(dynamics.shape);
        let rate_per_s = match dynamics.extent {
            Extent::RatePerS(rate) if rate.abs() > 0.0 => Some(rate.abs()),
            _ => None,
        };
        let (extent, is_of_way) = match dynamics.extent {
            Extent::TimeS(time_s) => (time_s, false),
            Extent::LateralMps2(most) if most > 0.0 => ((curvature * change / most).sqrt(), false),
            Extent::RatePerS(_) | Extent::LateralMps2(_) => (0.0, false),
            Extent::DistanceM(way_m) => (way_m, true),
        };
        let mut transition = Self {
            shape: dynamics.shape,
            from,
            to,
            extent: if dynamics.shape == Shape::Step {
                0.0
            } else {
                extent
            },
            is_of_way,
            rate_per_s,
            passed: 0.0,
        };
        transition.aim(to);
        transition
    }

    /// Replaces the value at its end. One of a rate keeps its rate, and takes another time.
    pub(super) fn aim(&mut self, to: f64) {
        self.to = to;
        if let Some(rate_per_s) = self.rate_per_s.filter(|_| self.shape != Shape::Step) {
            self.extent = peaks(self.shape).0 * (to - self.from).abs() / rate_per_s;
        }
    }

    /// Change of speed, whose way is that of a change at a constant rate.
    pub(super) fn of_speed(from_mps: f64, to_mps: f64, dynamics: Dynamics) -> Self {
        let extent = match dynamics.extent {
            Extent::DistanceM(way_m) => {
                let (from, to) = (from_mps, to_mps);
                // A way through a stop has two parts, as long as their speeds squared.
                let mean_mps = if from * to < 0.0 {
                    (from * from + to * to) / (2.0 * (from.abs() + to.abs()))
                } else {
                    0.5 * (from + to).abs()
                };
                let time_s = way_m / mean_mps;
                Extent::TimeS(if time_s.is_finite() { time_s } else { 0.0 })
            }
            extent => extent,
        };
        let shape = dynamics.shape;
        Self::new(from_mps, to_mps, Dynamics { shape, extent })
    }

    fn at(&self) -> f64 {
        if self.extent > 0.0 {
            self.passed / self.extent
        } else {
            1.0
        }
    }

    /// Goes on by a time and a way.
    pub(super) fn advance(&mut self, dt_s: f64, way_m: f64) {
        self.passed += if self.is_of_way { way_m } else { dt_s };
    }

    pub(super) fn value(&self) -> f64 {
        self.from + (self.to - self.from) * share(self.shape, self.at())
    }

    /// Change per second at a speed.
    pub(super) fn rate(&self, speed_mps: f64) -> f64 {
        let per_extent = (self.to - self.from) * slope(self.shape, self.at());
        match self.is_done() {
            true => 0.0,
            false if self.is_of_way => per_extent / self.extent * speed_mps,
            false => per_extent / self.extent,
        }
    }

    pub(super) fn is_done(&self) -> bool {
        self.passed >= self.extent - 1e-9 || self.to == self.from
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shapes_have_the_values_of_their_formulas() {
        for (shape, quarter) in [
            (Shape::Step, 1.0),
            (Shape::Linear, 0.25),
            (Shape::Cubic, 0.15625),
            (Shape::Sinusoidal, 0.5 - 0.5 * (PI / 4.0).cos()),
        ] {
            assert!((share(shape, 0.25) - quarter).abs() < 1e-15, "{shape:?}");
            assert_eq!(share(shape, 1.0), 1.0);
            if shape == Shape::Step {
                continue;
            }
            // The slope is the derivative; peaks are its largest values.
            let (most, curvature) = peaks(shape);
            let (mut slopes, mut bends) = (0.0_f64, 0.0_f64);
            for step in 1..999 {
                let at = f64::from(step) / 1000.0;
                let (low, high) = (share(shape, at - 5e-4), share(shape, at + 5e-4));
                let found = (high - low) / 1e-3;
                assert!((found - slope(shape, at)).abs() < 1e-5, "{shape:?} {at}");
                slopes = slopes.max(found);
                bends = bends.max((low + high - 2.0 * share(shape, at)).abs() / 2.5e-7);
            }
            assert!((slopes - most).abs() < 1e-4, "{shape:?}: {slopes}");
            if shape != Shape::Linear {
                assert!((bends - curvature).abs() < 0.02, "{shape:?}: {bends}");
            }
        }
    }

    #[test]
    fn extents_follow_from_rates_accelerations_and_ways() {
        let extent = |shape: Shape, extent: Extent| {
            Transition::new(1.0, 4.0, Dynamics { shape, extent }).extent
        };
        assert_eq!(extent(Shape::Linear, Extent::RatePerS(1.5)), 2.0);
        assert_eq!(extent(Shape::Cubic, Extent::RatePerS(1.5)), 3.0);
        assert_eq!(extent(Shape::Sinusoidal, Extent::RatePerS(PI)), 1.5);
        assert_eq!(extent(Shape::Cubic, Extent::LateralMps2(2.0)), 3.0);
        assert_eq!(extent(Shape::Step, Extent::TimeS(2.0)), 0.0);
        let shape = Shape::Linear;
        let extent = Extent::DistanceM(30.0);
        let slower = Transition::of_speed(20.0, 10.0, Dynamics { shape, extent });
        assert_eq!((slower.extent, slower.is_of_way), (2.0, false));
        // 12 m/s to a stop and 6 m/s back: (144 + 36) / 36 m a second.
        let back = Transition::of_speed(12.0, -6.0, Dynamics { shape, extent });
        assert_eq!(back.extent, 6.0);
        let aside = Transition::new(0.0, 3.0, Dynamics { shape, extent });
        assert_eq!(aside.rate(20.0), 2.0);
    }
}
