//! The second pass of `blend.comp`, which ends pixels in segments from what lies before these.

use decouplegs::render::layout::COARSE_PIXELS;
use decouplegs::render::twins::output::Pixel;
use decouplegs::scene::Rules;
use glam::Vec3;

use super::{Blended, Case, open};
use crate::stages::{Random, coded};
use decouplegs::render::twins::planes::PlaneSums;

/// Pixels before the segments of `case`: two of three are to be finished there, some of them almost
/// full.
pub fn before(case: &Case) -> Blended {
    let limit = case.end.stop_limit().unwrap_or(1e-4);
    let mut random = Random(5);
    let mut pixel = || {
        let transmittance = random.across_scales(1.2 * limit, 1.0);
        let alpha = 1.0 - transmittance;
        Pixel {
            color: coded(Vec3::from_array(std::array::from_fn(|_| {
                alpha * random.between(0.0, 1.0)
            }))),
            transmittance: if random.below(3) == 0 {
                transmittance
            } else {
                -transmittance
            },
            planes: PlaneSums {
                weighted_depth: alpha * random.between(0.5, 100.0),
                best_weight: alpha * random.between(0.1, 1.0),
                best_instance: random.below(3),
            },
            median: 0,
        }
    };
    (0..case.slots())
        .map(|_| (0..COARSE_PIXELS).map(|_| pixel()).collect())
        .collect()
}

#[test]
fn pixels_end_where_the_whole_list_would_end_them() {
    let gpu = open();
    for rules in [Rules::GSPLAT15, Rules::INRIA, Rules::NUREC] {
        let case = Case::new(&gpu, 1200, 1.0, rules);
        let before = before(&case);
        let (images, _) = case.kernel(&gpu, Some(&before));
        let twin = case.twin(Some(&before));
        let ended = twin
            .iter()
            .flatten()
            .filter(|pixel| pixel.transmittance < 0.0)
            .count();
        assert!(ended > 1000, "{ended} pixels end");
        case.check_finished(&before, &images, &twin).unwrap();
        // A pixel that began with something else is seen.
        let mut other = before.clone();
        other
            .iter_mut()
            .flatten()
            .for_each(|pixel| pixel.color.y += 0.001);
        assert!(
            case.check_finished(&before, &images, &case.twin(Some(&other)))
                .is_err()
        );
    }
}
