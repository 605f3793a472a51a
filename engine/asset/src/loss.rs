//! Loss of a cloud by a conversion between file formats.

use decouplegs_scene::SplatCloud;
use rayon::prelude::*;
use serde::Serialize;

/// Error of one attribute.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct AttributeLoss {
    /// Mean over all numbers.
    pub mean: f64,
    /// 99 of 100 numbers are off by no more.
    pub p99: f64,
    /// The largest.
    pub max: f64,
}

impl AttributeLoss {
    /// The statistics of `errors`; zero without any. An error that is not a number counts as
    /// infinite.
    #[must_use]
    pub fn from_errors(mut errors: Vec<f64>) -> Self {
        if errors.is_empty() {
            return Self::default();
        }
        errors
            .iter_mut()
            .filter(|error| error.is_nan())
            .for_each(|error| *error = f64::INFINITY);
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        let rank = ((errors.len() as f64 * 0.99).ceil() as usize).clamp(1, errors.len()) - 1;
        let (_, &mut p99, above) = errors.select_nth_unstable_by(rank, f64::total_cmp);
        let max = above.iter().copied().fold(p99, f64::max);
        Self { mean, p99, max }
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
        let scales = |scales: &[f32; 3]| {
            let mut scales = *scales;
            if !axes_are_kept {
                scales.sort_unstable_by(f32::total_cmp);
            }
            scales
        };
        let distance = |(a, b): (&[f32; 3], &[f32; 3])| {
            a.iter()
                .zip(b)
                .map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2))
                .sum::<f64>()
                .sqrt()
        };
        let scale_pairs = before.scales.par_iter().zip(&after.scales);
        let scale_relative = scale_pairs.flat_map_iter(|(a, b)| {
            let (a, b) = (scales(a), scales(b));
            (0..3).map(move |i| relative(a[i], b[i]))
        });
        let angles = before
            .rotations
            .par_iter()
            .zip(&after.rotations)
            .map(|(a, b)| angle_rad(a, b));
        let degree = before.sh_degree.max(after.sh_degree);
        let sh_rest = (degree > 0).then(|| {
            let [a, b] = [before, after].map(|cloud| {
                let mut cloud = SplatCloud {
                    means: cloud.means.clone(),
                    sh_rest: cloud.sh_rest.clone(),
                    sh_degree: cloud.sh_degree,
                    ..SplatCloud::default()
                };
                cloud.set_degree(degree);
                cloud.sh_rest
            });
            differences(&a, &b)
        });
        Self {
            position_m: AttributeLoss::from_errors(
                before
                    .means
                    .par_iter()
                    .zip(&after.means)
                    .map(distance)
                    .collect(),
            ),
            scale_relative: AttributeLoss::from_errors(scale_relative.collect()),
            rotation_rad: axes_are_kept.then(|| AttributeLoss::from_errors(angles.collect())),
            opacity: AttributeLoss::from_errors(
                before
                    .opacities
                    .iter()
                    .zip(&after.opacities)
                    .map(|(a, b)| f64::from((a - b).abs()))
                    .collect(),
            ),
            sh_dc: differences(&before.sh_dc, &after.sh_dc),
            sh_rest,
            sh_degree_before: before.sh_degree,
            sh_degree_after: after.sh_degree,
        }
    }
}

fn differences(a: &[[f32; 3]], b: &[[f32; 3]]) -> AttributeLoss {
    let pairs = a.as_flattened().par_iter().zip(b.as_flattened());
    AttributeLoss::from_errors(
        pairs
            .map(|(a, b)| (f64::from(*a) - f64::from(*b)).abs())
            .collect(),
    )
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

    #[test]
    fn ninety_nine_of_a_hundred_are_below_the_percentile() {
        let loss = AttributeLoss::from_errors((1..=1000).map(f64::from).collect());
        assert_eq!((loss.p99, loss.max, loss.mean), (990.0, 1000.0, 500.5));
        assert_eq!(
            AttributeLoss::from_errors(vec![f64::NAN]).max,
            f64::INFINITY
        );
        assert_eq!(AttributeLoss::from_errors(vec![]), AttributeLoss::default());
    }
}
