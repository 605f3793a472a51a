//! Pruning: the choice of the splats that an asset keeps.

use decouplegs_scene::SplatCloud;
use decouplegs_scene::rules::ALPHA_MIN;

/// Rule by which splats are kept.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Prune {
    /// Keeps splats with at least this importance.
    Threshold(f32),
    /// This share of all splats, above 0 to 1, the most important ones; of equal ones the earlier.
    KeepRatio(f32),
}

/// The paper's threshold.
pub const THRESHOLD: f32 = 0.005;

/// Kept splats, and counts of the reasons for removal.
#[derive(Clone, Debug, PartialEq)]
pub struct Kept {
    /// Splats kept, in rising order.
    pub splats: Vec<u32>,
    /// Splats with a defect.
    pub defects: usize,
    /// Splats whose opacity no pixel shows.
    pub transparent: usize,
    /// The least importance that was kept; `None` when nothing was.
    pub least_importance: Option<f32>,
}

/// The splats of `cloud` that stay. Those with a defect or an opacity below 1/255 never do: no
/// image shows them.
///
/// # Panics
/// Panics if there are not as many importances as splats.
#[must_use]
pub fn prune(cloud: &SplatCloud, importance: &[f32], by: Prune) -> Kept {
    assert_eq!(cloud.len(), importance.len(), "one importance a splat");
    let (mut defects, mut transparent, mut drawn) = (0, 0, Vec::new());
    for splat in 0..cloud.len() {
        if cloud.defect_of(splat).is_some() {
            defects += 1;
        } else if f64::from(cloud.opacities[splat]) < ALPHA_MIN {
            transparent += 1;
        } else {
            drawn.push(splat as u32);
        }
    }
    let of = |splat: u32| importance[splat as usize];
    match by {
        Prune::Threshold(least) => drawn.retain(|&splat| of(splat) >= least),
        Prune::KeepRatio(ratio) => {
            drawn.sort_by(|&a, &b| of(b).total_cmp(&of(a)).then(a.cmp(&b)));
            drawn.truncate((f64::from(ratio) * cloud.len() as f64).ceil() as usize);
            drawn.sort_unstable();
        }
    }
    let least_importance = drawn.iter().map(|&splat| of(splat)).min_by(f32::total_cmp);
    Kept {
        splats: drawn,
        defects,
        transparent,
        least_importance,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compress::tests::plane;
    use proptest::prelude::*;

    #[test]
    fn what_no_image_shows_is_never_kept() {
        let mut cloud = plane(6, 1);
        cloud.opacities[1] = 0.003;
        cloud.scales[4] = [f32::NAN; 3];
        for by in [Prune::Threshold(0.0), Prune::KeepRatio(1.0)] {
            let kept = prune(&cloud, &[0.5; 6], by);
            assert_eq!(
                (kept.splats.as_slice(), kept.defects, kept.transparent),
                ([0, 2, 3, 5].as_slice(), 1, 1)
            );
        }
    }

    #[test]
    fn of_equal_splats_the_earlier_stay() {
        let cloud = plane(5, 0);
        let kept = prune(&cloud, &[0.2, 0.7, 0.2, 0.2, 0.1], Prune::KeepRatio(0.5));
        assert_eq!(
            (kept.splats.as_slice(), kept.least_importance),
            ([0, 1, 2].as_slice(), Some(0.2))
        );
        assert_eq!(
            prune(&cloud, &[0.2, 0.7, 0.2, 0.2, 0.1], Prune::Threshold(0.2)).splats,
            [0, 1, 2, 3]
        );
        assert_eq!(
            prune(&cloud, &[0.0; 5], Prune::Threshold(0.1)).least_importance,
            None
        );
    }

    proptest! {
        #[test]
        fn nothing_dropped_is_more_important_than_what_is_kept(
            importance in prop::collection::vec(0.0f32..1.0, 1..60), ratio in 0.01f32..1.0,
        ) {
            let kept = prune(&plane(importance.len(), 0), &importance, Prune::KeepRatio(ratio));
            prop_assert_eq!(kept.splats.len(), (f64::from(ratio) * importance.len() as f64).ceil() as usize);
            let dropped = (0..importance.len() as u32).filter(|splat| !kept.splats.contains(splat));
            let most = dropped.map(|splat| importance[splat as usize]).fold(0.0, f32::max);
            prop_assert!(most <= kept.least_importance.unwrap());
        }
    }
}
