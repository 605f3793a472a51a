//! Differences of a cloud from its original.

use decouplegs_scene::SplatCloud;

/// The angle by which three components of 10 bits may turn a rotation. Each is off by half a step
/// of sqrt(1/2)/511, and the largest follows from them: when all four are 1/2, three errors e give
/// it 3 e, a chord of sqrt(12) e, an angle of twice that.
pub const SMALLEST_THREE_MAX_RAD: f64 =
    4.0 * 1.732_050_8 * (0.5 * std::f64::consts::FRAC_1_SQRT_2 / 511.0) * 1.001;

/// Largest errors of one cloud against another, per attribute.
#[derive(Clone, Copy, Debug)]
pub struct Errors {
    /// Meters along an axis.
    pub mean_m: f32,
    /// Error of the natural logarithm of a standard deviation.
    pub scale_ln: f64,
    /// Angle of the rotation between the two.
    pub angle_rad: f64,
    /// Error of the opacity, 0 to 1.
    pub opacity: f32,
    /// Error of a DC coefficient.
    pub dc: f32,
    /// Error of a further coefficient.
    pub rest: f32,
    /// Root mean square of the same.
    pub rest_rms: f64,
}

impl Errors {
    /// The errors of `back` against `original`, which has as many splats of the same degree.
    pub fn between(original: &SplatCloud, back: &SplatCloud) -> Self {
        assert_eq!(
            (original.len(), original.sh_degree),
            (back.len(), back.sh_degree)
        );
        let (rest, rest_back) = (original.sh_rest.as_flattened(), back.sh_rest.as_flattened());
        let squares: f64 = rest
            .iter()
            .zip(rest_back)
            .map(|(a, b)| f64::from(a - b).powi(2))
            .sum();
        let scales = original
            .scales
            .as_flattened()
            .iter()
            .zip(back.scales.as_flattened());
        let rotations = original.rotations.iter().zip(&back.rotations);
        Self {
            mean_m: largest(original.means.as_flattened(), back.means.as_flattened()),
            scale_ln: scales
                .map(|(&a, &b)| (f64::from(a).ln() - f64::from(b).ln()).abs())
                .fold(0.0, f64::max),
            angle_rad: rotations.map(|(a, b)| angle_rad(a, b)).fold(0.0, f64::max),
            opacity: largest(&original.opacities, &back.opacities),
            dc: largest(original.sh_dc.as_flattened(), back.sh_dc.as_flattened()),
            rest: largest(rest, rest_back),
            rest_rms: (squares / rest.len().max(1) as f64).sqrt(),
        }
    }
}

fn largest(a: &[f32], b: &[f32]) -> f32 {
    a.iter()
        .zip(b)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max)
}

/// Angle between two rotations, w, x, y, z. By half chords, which small angles do not cancel out of
/// as they do of `acos`.
fn angle_rad(a: &[f32; 4], b: &[f32; 4]) -> f64 {
    let length = |sign: f64| {
        a.iter()
            .zip(b)
            .map(|(&a, &b)| (f64::from(a) + sign * f64::from(b)).powi(2))
            .sum::<f64>()
            .sqrt()
    };
    let (sum, difference) = (length(1.0), length(-1.0));
    4.0 * difference.min(sum).atan2(difference.max(sum))
}
