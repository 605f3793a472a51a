//! Axes: their ranges, their ticks, and the numbers at them.

/// Number of ticks on an axis, about.
const TICKS: f64 = 6.0;

/// Range of a linear axis, in shares of its values and at least of 1, below which they are all the
/// same: what differs by rounding is a flat line.
const FLAT: f64 = 1e-9;

/// One axis of a plot.
#[derive(Clone, Copy, Default)]
pub struct Axis<'a> {
    pub label: &'a str,
    /// True for a decimal logarithmic axis.
    pub log: bool,
    /// True if a linear axis begins at zero.
    pub from_zero: bool,
}

impl<'a> Axis<'a> {
    /// A linear axis.
    pub fn linear(label: &'a str) -> Self {
        Self {
            label,
            ..Self::default()
        }
    }

    /// A linear axis that begins at zero.
    pub fn from_zero(label: &'a str) -> Self {
        Self {
            from_zero: true,
            ..Self::linear(label)
        }
    }

    /// A logarithmic axis.
    pub fn logarithmic(label: &'a str) -> Self {
        Self {
            log: true,
            ..Self::linear(label)
        }
    }
}

/// An axis with its range: where values lie and which of them are written.
pub struct Scale {
    log: bool,
    min: f64,
    max: f64,
    /// Rising, the first and the last at the ends.
    pub ticks: Vec<f64>,
}

impl Scale {
    /// Scale of `values`; those that the axis cannot show are passed over.
    pub fn over(values: impl Iterator<Item = f64>, axis: Axis<'_>) -> Self {
        let shown = values.filter(|&value| value.is_finite() && (!axis.log || value > 0.0));
        let (min, max) = shown.fold((f64::INFINITY, f64::NEG_INFINITY), |(min, max), value| {
            (min.min(value), max.max(value))
        });
        let (min, max) = if min <= max { (min, max) } else { (1.0, 10.0) };
        if axis.log {
            Self::logarithmic(min, max)
        } else {
            Self::linear(if axis.from_zero { min.min(0.0) } else { min }, max)
        }
    }

    fn linear(min: f64, max: f64) -> Self {
        let size = min.abs().max(max.abs()).max(1.0);
        let (min, max) = if max - min > FLAT * size {
            (min, max)
        } else {
            // Values of nothing but rounding are zero.
            let min = if min.abs() > FLAT { min } else { 0.0 };
            (min, min + size)
        };
        let rough = (max - min) / TICKS;
        let power = 10f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0]
            .map(|factor| factor * power)
            .into_iter()
            .find(|step| *step >= rough)
            .unwrap_or(10.0 * power);
        let (first, last) = ((min / step).floor(), (max / step - 1e-9).ceil());
        let ticks: Vec<f64> = (0..=(last - first) as usize)
            .map(|at| (first + at as f64) * step)
            .collect();
        Self {
            log: false,
            min: first * step,
            max: last * step,
            ticks,
        }
    }

    fn logarithmic(min: f64, max: f64) -> Self {
        let decades = (min.log10().floor() as i32, max.log10().ceil() as i32);
        let factors: &[f64] = match decades.1 - decades.0 {
            ..=1 => &[1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0],
            2..=3 => &[1.0, 2.0, 5.0],
            _ => &[1.0],
        };
        let all: Vec<f64> = (decades.0..=decades.1)
            .flat_map(|power| factors.iter().map(move |factor| factor * 10f64.powi(power)))
            .collect();
        let below = all
            .iter()
            .copied()
            .filter(|tick| *tick <= min * 1.0001)
            .fold(f64::NEG_INFINITY, f64::max);
        let above = all
            .iter()
            .copied()
            .find(|tick| *tick >= max * 0.9999 && *tick > below)
            .unwrap_or(max * 2.0);
        let ticks = all
            .into_iter()
            .filter(|tick| (below..=above).contains(tick))
            .collect();
        Self {
            log: true,
            min: below,
            max: above,
            ticks,
        }
    }

    /// The place of `value` between `from` and `to`; `None` where it has none.
    pub fn place(&self, value: f64, from: f64, to: f64) -> Option<f64> {
        let on = |value: f64| if self.log { value.log10() } else { value };
        let share = (on(value) - on(self.min)) / (on(self.max) - on(self.min));
        share.is_finite().then_some(from + share * (to - from))
    }
}

/// Three digits that count.
pub fn number(value: f64) -> String {
    let size = value.abs();
    if size != 0.0 && !(1e-3..1e6).contains(&size) {
        return format!("{value:.1e}");
    }
    let decimals = if size == 0.0 {
        0
    } else {
        (2 - size.log10().floor() as i32).clamp(0, 5) as usize
    };
    let text = format!("{value:.decimals$}");
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_hold_the_values() {
        let scale = Scale::linear(0.0, 52.4);
        assert_eq!(scale.ticks, [0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0]);
        let scale = Scale::logarithmic(3.0, 70.0);
        assert_eq!(
            (scale.min, scale.max, scale.ticks.as_slice()),
            (2.0, 100.0, [2.0, 5.0, 10.0, 20.0, 50.0, 100.0].as_slice())
        );
        let one = Scale::linear(5.0, 5.0);
        assert!(one.min <= 5.0 && one.max > one.min && one.ticks.len() < 20);
        for (values, expected) in [
            ([-1.5e-15, 2e-15], (0.0, 1.0)),
            ([5.0, 5.0 + 1e-14], (5.0, 10.0)),
        ] {
            let flat = Scale::over(values.into_iter(), Axis::linear("steering"));
            assert_eq!((flat.min, flat.max), expected, "{values:?}");
        }
        let small = Scale::linear(0.0, 2e-6);
        assert!(small.max < 3e-6, "small values are no rounding");
        let one = Scale::logarithmic(10.0, 10.0);
        assert!(one.min <= 10.0 && one.max > one.min);
    }

    #[test]
    fn numbers_are_short() {
        let written = [0.0, 0.5, 1.0, 12.34, 123.4, 2e7, -0.25, 0.0015, 0.0025].map(number);
        assert_eq!(
            written,
            [
                "0", "0.5", "1", "12.3", "123", "2.0e7", "-0.25", "0.0015", "0.0025"
            ]
        );
    }
}
