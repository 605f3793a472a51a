//! Attributes are blended with the weights of the color.

use decouplegs::scene::Rules;

use super::finish::before;
use super::{Case, open};
use crate::stages::UNTOUCHED;
use crate::stages::attributes::{check_means, check_partials, outputs};

#[test]
fn attributes_have_the_weights_of_depth() {
    let gpu = open();
    for rules in [Rules::DEFAULT, Rules::GSPLAT15] {
        let case = Case::new(&gpu, 1200, 1.0, rules);
        let pixels = case.scene.view.pixels;
        let (images, partials) = case.kernel_by(&gpu, None, &outputs());
        let written = check_means(&images.planes, pixels).unwrap();
        let sums = check_partials(&gpu, &partials).unwrap();
        assert!(written > 1000 && sums > 1000, "{written}, {sums}");
        // Color and the other planes are what they are alone.
        let (alone, _) = case.kernel(&gpu, None);
        let colors = images.images_f32.iter().zip(&alone.images_f32);
        let written = alone.planes.iter().map(|&depth| depth != UNTOUCHED);
        assert!(
            colors
                .zip(written)
                .all(|((a, b), written)| !written || a == b)
        );
        assert_eq!(images.planes[..2 * pixels], alone.planes[..]);
    }
}

#[test]
fn attributes_are_finished_with_color() {
    let gpu = open();
    let case = Case::new(&gpu, 1200, 1.0, Rules::GSPLAT15);
    let before = before(&case);
    let (images, _) = case.kernel_by(&gpu, Some(&before), &outputs());
    let written = check_means(&images.planes, case.scene.view.pixels).unwrap();
    assert!(written > 1000, "{written} pixels end");
}
