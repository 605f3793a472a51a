//! Loss of a cloud by a conversion between file formats.

use decouplegs_scene::SplatCloud;
use serde::Serialize;

/// Error of one attribute.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct AttributeLoss {
    /// Mean over all numbers.
    pub mean: f64,
    /// 99 of 100 numbers are off by no more, to one part in 8192.
    pub p99: f64,
    /// The largest.
    pub max: f64,
}

/// Tally of the errors of one attribute, whose memory does not grow with them.
///
/// The 99 % quantile is told by counts of errors of about the same size: each is at most one part
/// in 8192 above its class.
struct Tally {
    count: u64,
    sum: f64,
    max: f64,
    /// Errors by class, from [`Tally::class_of`].
    classes: Vec<u64>,
}

impl Tally {
    /// Bits of the mantissa that tell classes apart.
    const MANTISSA_BITS: u32 = 13;
    /// Exponents of two of the smallest and the largest errors that have classes of their own.
    /// Smaller ones are in the first class, larger ones in the last.
    const EXPONENTS: [i64; 2] = [-60, 60];

    fn new() -> Self {
        Self {
            count: 0,
            sum: 0.0,
            max: 0.0,
            classes: vec![0; Self::class_of(f64::INFINITY) + 1],
        }
    }

    /// Class of an error; the first holds 0.
    fn class_of(error: f64) -> usize {
        let [least, most] =
            Self::EXPONENTS.map(|exponent| ((exponent + 1023) as u64) << Self::MANTISSA_BITS);
        let bits = error.to_bits() >> (52 - Self::MANTISSA_BITS);
        (bits.clamp(least, most) - least) as usize
    }

    /// Smallest error of a class.
    fn least_of(class: usize) -> f64 {
        let least = ((Self::EXPONENTS[0] + 1023) as u64) << Self::MANTISSA_BITS;
        match class {
            0 => 0.0,
            _ => f64::from_bits((least + class as u64) << (52 - Self::MANTISSA_BITS)),
        }
    }

    /// Adds an error, zero or above. One that is not a number counts as infinite.
    #[inline]
    fn add(&mut self, error: f64) {
        let error = if error.is_nan() { f64::INFINITY } else { error };
        self.sum += error;
        self.max = if error > self.max { error } else { self.max };
        self.classes[Self::class_of(error)] += 1;
        self.count += 1;
    }

    /// The errors of several tallies in one.
    fn of_all(tallies: &[Self]) -> Self {
        let mut all = Self::new();
        for tally in tallies {
            all.count += tally.count;
            all.sum += tally.sum;
            all.max = all.max.max(tally.max);
            for (sum, of_class) in all.classes.iter_mut().zip(&tally.classes) {
                *sum += of_class;
            }
        }
        all
    }

    /// The statistics; zero without any error.
    fn loss(&self) -> AttributeLoss {
        if self.count == 0 {
            return AttributeLoss::default();
        }
        let rank = ((self.count as f64 * 0.99).ceil() as u64).clamp(1, self.count);
        let mut below = 0;
        let class = self.classes.iter().position(|of_class| {
            below += of_class;
            below >= rank
        });
        AttributeLoss {
            mean: self.sum / self.count as f64,
            // The last class has no end.
            p99: match class {
                Some(class) if class + 1 < self.classes.len() => {
                    Self::least_of(class).min(self.max)
                }
                _ => self.max,
            },
            max: self.max,
        }
    }
}

/// The loss of every attribute, splat by splat.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LossReport {
    /// Distance between means, meters.
    pub position_m: AttributeLoss,
    /// |after / before - 1| of standard deviations; the largest with the largest where axes have no order.
    pub scale_relative: AttributeLoss,
    /// Angle between the orientations, radians. None where axes have no order.
    pub rotation_rad: Option<AttributeLoss>,
    /// Error of opacities, which are 0 to 1.
    pub opacity: AttributeLoss,
    /// Error of DC coefficients.
    pub sh_dc: AttributeLoss,
    /// Error of the coefficients after DC; absent ones count as zero. None where there were none.
    pub sh_rest: Option<AttributeLoss>,
    /// Degree of the spherical harmonics before compression.
    pub sh_degree_before: u8,
    /// Degree of the spherical harmonics after compression.
    pub sh_degree_after: u8,
}

impl LossReport {
    /// Compares splat `i` of `before` with splat `i` of `after`. `axes_are_kept`: whether the file
    /// kept which of a splat's axes is the first, second and third; formats that store shapes do
    /// not.
    ///
    /// # Panics
    /// Panics if there are not equally many.
    #[must_use]
    pub fn between(before: &SplatCloud, after: &SplatCloud, axes_are_kept: bool) -> Self {
        assert_eq!(before.len(), after.len(), "loss is told of the same splats");
        let mut comparison = Comparison::new(axes_are_kept);
        comparison.add(before, None, after);
        comparison.report()
    }
}

/// Splats that are compared piece by piece.
pub struct Comparison {
    axes_are_kept: bool,
    position_m: Tally,
    scale_relative: Tally,
    rotation_rad: Tally,
    opacity: Tally,
    sh_dc: Tally,
    /// A tally for each channel: three threads count what is most of a cloud.
    sh_rest: [Tally; 3],
    sh_degrees: [u8; 2],
    compared: usize,
}

impl Comparison {
    /// A comparison of no splat yet. `axes_are_kept`: as for [`LossReport::between`].
    #[must_use]
    pub fn new(axes_are_kept: bool) -> Self {
        Self {
            axes_are_kept,
            position_m: Tally::new(),
            scale_relative: Tally::new(),
            rotation_rad: Tally::new(),
            opacity: Tally::new(),
            sh_dc: Tally::new(),
            sh_rest: std::array::from_fn(|_| Tally::new()),
            sh_degrees: [0; 2],
            compared: 0,
        }
    }

    /// Compares the splats `after` with the next ones of `before`: behind those that were compared,
    /// or behind them in `order`, which holds places in `before`. Returns false, and compares
    /// nothing, where there are not as many.
    pub fn add(&mut self, before: &SplatCloud, order: Option<&[u32]>, after: &SplatCloud) -> bool {
        let first = self.compared;
        if order.map_or(before.len(), <[u32]>::len) < first + after.len() {
            return false;
        }
        self.sh_degrees = [before.sh_degree, after.sh_degree];
        self.add_pairs(before, after, |splat| match order {
            Some(order) => order[first + splat] as usize,
            None => first + splat,
        });
        self.compared += after.len();
        true
    }

    /// Number of splats that were compared.
    #[must_use]
    pub fn compared(&self) -> usize {
        self.compared
    }

    /// Compares each splat of `after` with the one of `before` that `place_of` names. Attributes
    /// are compared side by side, each by one thread: sums are the same for any number of threads.
    fn add_pairs(
        &mut self,
        before: &SplatCloud,
        after: &SplatCloud,
        place_of: impl Fn(usize) -> usize + Sync,
    ) {
        let pairs = || (0..after.len()).map(|splat| (place_of(splat), splat));
        let pairs = &pairs;
        let off = |a: f32, b: f32| (f64::from(a) - f64::from(b)).abs();
        let axes_are_kept = self.axes_are_kept;
        let sorted = |mut scales: [f32; 3]| {
            if !axes_are_kept {
                scales.sort_unstable_by(f32::total_cmp);
            }
            scales
        };
        rayon::scope(|scope| {
            for (channel, tally) in self.sh_rest.iter_mut().enumerate() {
                scope.spawn(move |_| {
                    for (a, b) in pairs() {
                        let (a, b) = (before.rest_of(a), after.rest_of(b));
                        let both = a.iter().zip(b);
                        both.for_each(|(a, b)| tally.add(off(a[channel], b[channel])));
                        // Bands that only one of them has.
                        let common = a.len().min(b.len());
                        let left = a[common..].iter().chain(&b[common..]);
                        left.for_each(|rgb| tally.add(off(rgb[channel], 0.0)));
                    }
                });
            }
            scope.spawn(|_| {
                for (a, b) in pairs() {
                    let (a, b) = (before.means[a], after.means[b]);
                    let squares = a.iter().zip(b).map(|(a, b)| off(*a, b).powi(2));
                    self.position_m.add(squares.sum::<f64>().sqrt());
                }
            });
            scope.spawn(|_| {
                for (a, b) in pairs() {
                    let (a, b) = (sorted(before.scales[a]), sorted(after.scales[b]));
                    (0..3).for_each(|i| self.scale_relative.add(relative(a[i], b[i])));
                }
            });
            scope.spawn(|_| {
                for (a, b) in pairs().filter(|_| axes_are_kept) {
                    let angle_rad = angle_rad(&before.rotations[a], &after.rotations[b]);
                    self.rotation_rad.add(angle_rad);
                }
            });
            scope.spawn(|_| {
                for (a, b) in pairs() {
                    let error = off(before.opacities[a], after.opacities[b]);
                    self.opacity.add(error);
                    let (a, b) = (before.sh_dc[a], after.sh_dc[b]);
                    (0..3).for_each(|i| self.sh_dc.add(off(a[i], b[i])));
                }
            });
        });
    }

    /// The loss of all splats that were compared.
    #[must_use]
    pub fn report(&self) -> LossReport {
        let [sh_degree_before, sh_degree_after] = self.sh_degrees;
        let has_rest = sh_degree_before.max(sh_degree_after) > 0;
        LossReport {
            position_m: self.position_m.loss(),
            scale_relative: self.scale_relative.loss(),
            rotation_rad: self.axes_are_kept.then(|| self.rotation_rad.loss()),
            opacity: self.opacity.loss(),
            sh_dc: self.sh_dc.loss(),
            sh_rest: has_rest.then(|| Tally::of_all(&self.sh_rest).loss()),
            sh_degree_before,
            sh_degree_after,
        }
    }
}

/// |b / a - 1|; of nothing that stays nothing, 0.
fn relative(a: f32, b: f32) -> f64 {
    if a == b {
        0.0
    } else {
        (f64::from(b) / f64::from(a) - 1.0).abs()
    }
}

/// The angle between two orientations, w, x, y, z of any sign. Not by the arc cosine, which loses
/// small angles.
fn angle_rad(a: &[f32; 4], b: &[f32; 4]) -> f64 {
    let (a, b) = (a.map(f64::from), b.map(f64::from));
    let length = |q: &[f64; 4]| q.iter().map(|x| x * x).sum::<f64>().sqrt();
    let (la, lb) = (length(&a), length(&b));
    if la == 0.0 || lb == 0.0 {
        return if la == lb { 0.0 } else { f64::INFINITY };
    }
    let dot: f64 = a.iter().zip(&b).map(|(a, b)| a * b).sum();
    let sign = if dot < 0.0 { -1.0 } else { 1.0 };
    let off: [f64; 4] = std::array::from_fn(|i| a[i] / la - sign * b[i] / lb);
    4.0 * (0.5 * length(&off)).min(1.0).asin()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one() -> SplatCloud {
        SplatCloud {
            means: vec![[1.0, 2.0, 3.0]],
            scales: vec![[0.1, 0.2, 0.4]],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]],
            opacities: vec![0.5],
            sh_degree: 1,
            sh_dc: vec![[0.3, 0.0, -0.3]],
            sh_rest: vec![[0.1; 3], [0.2; 3], [-0.4; 3]],
        }
    }

    #[test]
    fn nothing_lost_is_zero_and_everything_is_measured_in_its_unit() {
        let same = LossReport::between(&one(), &one(), true);
        assert_eq!(
            (
                same.position_m.max,
                same.rotation_rad.unwrap().max,
                same.sh_rest.unwrap().max
            ),
            (0.0, 0.0, 0.0)
        );
        let mut other = one();
        other.means[0] = [1.0, 5.0, 7.0];
        other.scales[0][1] = 0.3;
        // Turned by a milliradian, and the sign of the quaternion with it.
        other.rotations[0] = [
            -(0.0005f64.cos() as f32),
            -(0.0005f64.sin() as f32),
            0.0,
            0.0,
        ];
        other.opacities[0] = 0.25;
        other.set_degree(0);
        let loss = LossReport::between(&one(), &other, true);
        assert_eq!(
            (loss.position_m.max, loss.opacity.max, loss.sh_degree_after),
            (5.0, 0.25, 0)
        );
        assert!(
            (loss.scale_relative.max - 0.5).abs() < 1e-6
                && (loss.scale_relative.mean - 0.5 / 3.0).abs() < 1e-6
        );
        assert!(
            (loss.rotation_rad.unwrap().max - 0.001).abs() < 1e-6,
            "{loss:?}"
        );
        assert!((loss.sh_rest.unwrap().max - 0.4).abs() < 1e-7, "{loss:?}");
    }

    #[test]
    fn axes_without_an_order_are_compared_by_length() {
        let mut other = one();
        other.scales[0] = [0.4, 0.1, 0.2];
        let loss = LossReport::between(&one(), &other, false);
        assert_eq!((loss.scale_relative.max, loss.rotation_rad), (0.0, None));
    }

    fn loss_of(errors: impl IntoIterator<Item = f64>) -> AttributeLoss {
        let mut tally = Tally::new();
        errors.into_iter().for_each(|error| tally.add(error));
        tally.loss()
    }

    #[test]
    fn ninety_nine_of_a_hundred_are_below_the_percentile() {
        let loss = loss_of((1..=1000).map(f64::from));
        assert_eq!((loss.p99, loss.max, loss.mean), (990.0, 1000.0, 500.5));
        assert_eq!(loss_of([f64::NAN]).max, f64::INFINITY);
        assert_eq!(loss_of([f64::NAN]).p99, f64::INFINITY);
        assert_eq!(loss_of([]), AttributeLoss::default());
        assert_eq!(loss_of([0.0; 5]), AttributeLoss::default());
        // Errors of no class of their own.
        assert_eq!(loss_of([1e-30; 5]).p99, 0.0);
        assert_eq!(loss_of([1e30; 5]).p99, 1e30);
    }

    #[test]
    fn quantiles_are_those_of_sorted_errors_to_a_part_in_8192() {
        for count in [1, 2, 99, 100, 101, 4321] {
            let errors = (0..count).map(|i| (f64::from(i) * 0.7).sin().abs().powi(9));
            let mut sorted: Vec<f64> = errors.clone().collect();
            sorted.sort_by(f64::total_cmp);
            let rank = (f64::from(count) * 0.99).ceil() as usize - 1;
            let p99 = loss_of(errors).p99;
            let expected = sorted[rank];
            assert!(
                p99 <= expected && p99 >= expected * (1.0 - 1.0 / 8192.0),
                "{count}: {p99} {expected}"
            );
        }
    }

    #[test]
    fn pieces_and_orders_are_compared_like_the_whole() {
        let cloud = |shift: f32| {
            let splats = 0..1000u16;
            let splats = splats.map(|i| f32::from(i) * 0.37 + shift);
            SplatCloud {
                means: splats.clone().map(|x| [x, x.sin(), 1.0]).collect(),
                scales: splats
                    .clone()
                    .map(|x| [0.1 + x.sin().abs(), 0.2, 0.3])
                    .collect(),
                rotations: splats.clone().map(|x| [1.0, x.cos(), 0.0, 0.3]).collect(),
                opacities: splats.clone().map(|x| x.cos().abs()).collect(),
                sh_degree: 1,
                sh_dc: splats.clone().map(|x| [x.cos(); 3]).collect(),
                sh_rest: splats.flat_map(|x| [[x.sin(); 3]; 3]).collect(),
            }
        };
        let (before, after) = (cloud(0.0), cloud(0.01));
        let whole = LossReport::between(&before, &after, true);
        let mut pieces = Comparison::new(true);
        let part = |from: u32, to: u32| after.select(&(from..to).collect::<Vec<_>>());
        assert!(pieces.add(&before, None, &part(0, 300)));
        assert!(pieces.add(&before, None, &part(300, 1000)));
        assert_eq!(pieces.report(), whole);
        assert!(!pieces.add(&before, None, &part(0, 1)), "there are no more");
        assert_eq!(pieces.compared(), 1000);
        // Splats that stand in the file in another order.
        let order: Vec<u32> = (0..1000).map(|i| i * 7 % 1000).collect();
        let mut ordered = Comparison::new(true);
        let moved = after.select(&order);
        assert!(ordered.add(&before, Some(&order), &moved));
        assert_eq!(ordered.report().position_m.max, whole.position_m.max);
        let mut wrong = Comparison::new(true);
        wrong.add(&before, None, &moved);
        assert!(wrong.report().position_m.max > 10.0);
    }
}
