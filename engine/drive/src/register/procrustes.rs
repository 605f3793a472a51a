//! Orthogonal Procrustes in the plane: the rigid motion that brings points nearest to their
//! partners.

use decouplegs_scene::Invalid;
use glam::DVec2;

use crate::planar::PlanarTransform;

/// A point, where it should go, and how much that counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WeightedPair {
    /// Position of the point.
    pub from: DVec2,
    /// Position of its partner.
    pub to: DVec2,
    /// Weight of the pair, at least zero.
    pub weight: f64,
}

/// Extent below which points show no direction, meters.
const EXTENT_MIN_M: f64 = 1e-6;

/// The turn and shift with the least sum of `weight |R from + t - to|^2`: no scale, and a turn of
/// determinant +1 (in the plane, the turn is the angle of the sum of `from x to` over that of `from
/// . to`, so a reflection cannot come out).
///
/// # Errors
/// A sentence, where the pairs do not tell a motion: fewer than two of weight, points that
/// coincide, a number that is not finite, or partners of which no turn is better than another.
pub fn procrustes(pairs: &[WeightedPair]) -> Result<PlanarTransform, Invalid> {
    let usable: Vec<&WeightedPair> = pairs.iter().filter(|pair| pair.weight > 0.0).collect();
    if usable.len() < 2 {
        return Err(Invalid::new(format!(
            "{} pairs of points; a motion in the plane needs at least 2",
            usable.len()
        )));
    }
    if let Some(pair) = usable
        .iter()
        .find(|pair| !(pair.from.is_finite() && pair.to.is_finite() && pair.weight.is_finite()))
    {
        return Err(Invalid::new(format!(
            "a pair of points that is not finite: {pair:?}"
        )));
    }
    let total: f64 = usable.iter().map(|pair| pair.weight).sum();
    let middle = |of: fn(&WeightedPair) -> DVec2| {
        // Relative to the first: sums of UTM coordinates would lose digits.
        let first = of(usable[0]);
        first
            + usable
                .iter()
                .map(|pair| (of(pair) - first) * pair.weight)
                .sum::<DVec2>()
                / total
    };
    let (from, to) = (middle(|pair| pair.from), middle(|pair| pair.to));
    let (mut dots, mut crosses, mut extent) = (0.0, 0.0, 0.0);
    for pair in &usable {
        let (a, b) = (pair.from - from, pair.to - to);
        dots += pair.weight * a.dot(b);
        crosses += pair.weight * a.perp_dot(b);
        extent += pair.weight * a.length_squared();
    }
    if extent <= total * EXTENT_MIN_M * EXTENT_MIN_M {
        return Err("the points coincide; their turn cannot be told".into());
    }
    if dots.hypot(crosses) <= 1e-9 * extent {
        return Err("the partners lie so that no turn is better than another".into());
    }
    Ok(PlanarTransform {
        pivot_m: from,
        yaw_rad: crosses.atan2(dots),
        shift_m: to - from,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pairs(motion: &PlanarTransform) -> Vec<WeightedPair> {
        let from =
            |at: i32| motion.pivot_m + DVec2::new(f64::from(at) * 3.0, f64::from(at * at % 7));
        (0..12)
            .map(|at| WeightedPair {
                from: from(at),
                to: motion.apply(from(at)),
                weight: 1.0 + f64::from(at % 3),
            })
            .collect()
    }

    #[test]
    fn a_motion_is_recovered_at_any_turn_and_far_from_the_origin() {
        for yaw_rad in [-3.1, -1.0, 0.0, 0.02, 2.0] {
            let motion = PlanarTransform {
                pivot_m: DVec2::new(4.5e5, 5.4e6),
                yaw_rad,
                shift_m: DVec2::new(1.0, -2.0),
            };
            let found = procrustes(&pairs(&motion)).unwrap();
            assert!((found.yaw_rad - yaw_rad).abs() < 1e-8);
            for pair in pairs(&motion) {
                assert!(found.apply(pair.from).distance(pair.to) < 1e-7);
            }
        }
    }

    #[test]
    fn a_mirror_is_met_by_a_turn() {
        let mut mirrored = pairs(&PlanarTransform::identity(DVec2::ZERO));
        mirrored
            .iter_mut()
            .for_each(|pair| pair.to = DVec2::new(pair.from.x, -pair.from.y));
        let found = procrustes(&mirrored).unwrap();
        let (x, y) = (
            found.apply(DVec2::X) - found.apply(DVec2::ZERO),
            found.apply(DVec2::Y) - found.apply(DVec2::ZERO),
        );
        assert!((x.perp_dot(y) - 1.0).abs() < 1e-12, "determinant +1");
    }

    #[test]
    fn what_shows_no_motion_is_refused_with_the_reason() {
        let pair = |from: DVec2, to: DVec2| WeightedPair {
            from,
            to,
            weight: 1.0,
        };
        assert!(procrustes(&[]).unwrap_err().reason().contains("0 pairs"));
        assert!(
            procrustes(&[pair(DVec2::X, DVec2::Y)])
                .unwrap_err()
                .reason()
                .contains("1 pairs")
        );
        assert!(
            procrustes(&[pair(DVec2::X, DVec2::Y); 9])
                .unwrap_err()
                .reason()
                .contains("coincide")
        );
        assert!(
            procrustes(&[pair(DVec2::X, DVec2::NAN), pair(DVec2::X, DVec2::Y)])
                .unwrap_err()
                .reason()
                .contains("finite")
        );
        let to_one = [pair(DVec2::X, DVec2::Y), pair(-DVec2::X, DVec2::Y)];
        assert!(
            procrustes(&to_one)
                .unwrap_err()
                .reason()
                .contains("no turn")
        );
        let nothing_counts = WeightedPair {
            weight: 0.0,
            ..pair(DVec2::X, DVec2::Y)
        };
        assert!(
            procrustes(&[nothing_counts; 5])
                .unwrap_err()
                .reason()
                .contains("0 pairs")
        );
    }
}
