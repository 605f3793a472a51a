use super::*;
use crate::{Plane, PlaneValues};

/// Two images of 53 by 37 pixels: waves, and the same with a ripple and a patch of another color.
fn waves_and_ripple() -> (Image, Image) {
    let (width, height) = (53, 37);
    let mut waves = Image::filled(width, height, [0.0; 3]);
    let mut ripple = waves.clone();
    for row in 0..height {
        for column in 0..width {
            let at = (row * width + column) as usize;
            let (x, y) = (f64::from(column), f64::from(row));
            for channel in 0..3 {
                let k = channel as f64;
                let wave = 0.5
                    + 0.3 * (0.21 * x * (1.0 + 0.3 * k)).sin()
                    + 0.2 * (0.17 * y * (1.0 + 0.2 * k)).cos();
                waves.rgb[at][channel] = wave as f32;
                ripple.rgb[at][channel] =
                    (wave + 0.04 * (1.3 * x + 0.7 * y).sin() * [1.0, 0.5, -1.0][channel]) as f32;
            }
            if (10..16).contains(&row) && (20..30).contains(&column) {
                ripple.rgb[at] = [1.0, 0.0, 0.2];
            }
        }
    }
    (waves, ripple)
}

/// A gray image of 20 by 20, and the same with one red value of one pixel raised.
fn one_pixel_changed(by: f32) -> (Image, Image) {
    let gray = Image::filled(20, 20, [0.5; 3]);
    let mut changed = gray.clone();
    changed.rgb[9 * 20 + 11][0] += by;
    (gray, changed)
}

#[test]
fn equal_images_are_perfect_by_every_measure() {
    let (waves, _) = waves_and_ripple();
    let found = Difference::between(&waves, &waves).unwrap();
    assert_eq!(
        (
            found.max_abs,
            found.rmse,
            found.psnr_db,
            found.flip,
            found.share_off
        ),
        (0.0, 0.0, f64::INFINITY, 0.0, 0.0)
    );
    assert!((found.ssim.unwrap() - 1.0).abs() < 1e-12);
}

#[test]
fn one_changed_pixel_is_seen_by_every_measure() {
    let (gray, changed) = one_pixel_changed(0.1);
    let found = Difference::between(&gray, &changed).unwrap();
    let by = f64::from(0.6f32) - 0.5;
    let rmse = by / 1200.0f64.sqrt();
    assert!((found.max_abs - by).abs() < 1e-7 && (found.rmse - rmse).abs() < 1e-8);
    assert!((found.psnr_db + 20.0 * rmse.log10()).abs() < 1e-5);
    assert_eq!(found.share_off, 1.0 / 1200.0);
    // scikit-image 0.26 and flip-evaluator 1.7 on the same two images, as below.
    assert!(
        (found.ssim.unwrap() - 0.973_629_900_727_642_8).abs() < 1e-9,
        "{:?}",
        found.ssim
    );
    // In f32, as the authors' tool computes, a lightness of 50 has steps of 4e-6, which the
    // exponent 0.7 makes 2e-6 of error in the faint surroundings of the pixel.
    assert!((found.flip - 0.002_524_136).abs() < 2e-6, "{}", found.flip);
}

#[test]
fn a_change_in_any_corner_lowers_the_structural_similarity() {
    for corner in [0, 19, 380, 399] {
        let gray = Image::filled(20, 20, [0.5; 3]);
        let mut changed = gray.clone();
        changed.rgb[corner][1] = 0.9;
        let found = Difference::between(&gray, &changed).unwrap();
        assert!(
            found.ssim.unwrap() < 1.0 - 1e-7 && found.flip > 1e-4,
            "corner {corner}: {found:?}"
        );
    }
}

#[test]
fn similarity_and_flip_agree_with_their_authors_tools() {
    let (waves, ripple) = waves_and_ripple();
    let found = Difference::between(&waves, &ripple).unwrap();
    // scikit-image 0.26: structural_similarity(gaussian_weights=True, sigma=1.5,
    // use_sample_covariance=False, data_range=1, channel_axis=2) of the clamped images.
    assert!(
        (found.ssim.unwrap() - 0.854_136_655_425_985).abs() < 1e-6,
        "{:?}",
        found.ssim
    );
    // flip-evaluator 1.7 (the authors'): evaluate(..., "LDR"), in f32, hence the tolerance.
    assert!((found.flip - 0.094_705_05).abs() < 1e-5, "{}", found.flip);
}

#[test]
fn flip_of_flat_images_is_the_color_error_alone() {
    let flip = |a: [f32; 3], b: [f32; 3]| {
        Difference::between(&Image::filled(8, 8, a), &Image::filled(8, 8, b))
            .unwrap()
            .flip
    };
    // Green against blue is the largest error by definition; black against white as flip-evaluator
    // 1.7 has it.
    assert!((flip([0.0, 1.0, 0.0], [0.0, 0.0, 1.0]) - 1.0).abs() < 1e-9);
    assert!((flip([0.0; 3], [1.0; 3]) - 0.967_388_3).abs() < 1e-5);
}

#[test]
fn the_order_of_the_images_does_not_matter() {
    let (waves, ripple) = waves_and_ripple();
    let (there, back) = (
        Difference::between(&waves, &ripple).unwrap(),
        Difference::between(&ripple, &waves).unwrap(),
    );
    assert_eq!(
        (there.max_abs, there.rmse, there.share_off, there.flip),
        (back.max_abs, back.rmse, back.share_off, back.flip)
    );
    assert!((there.ssim.unwrap() - back.ssim.unwrap()).abs() < 1e-12);
    assert!((0.0..=1.0).contains(&there.flip));
}

#[test]
fn one_level_of_an_8_bit_image_is_not_off_and_two_are() {
    let level = |n: u8| Image::filled(2, 1, [f32::from(n) / 255.0; 3]);
    for n in 0..=253u8 {
        let share = |m: u8| Difference::between(&level(n), &level(m)).unwrap().share_off;
        assert_eq!((share(n + 1), share(n + 2)), (0.0, 1.0), "level {n}");
    }
}

#[test]
fn values_above_one_count_unclamped() {
    let found = Difference::between(
        &Image::filled(1, 1, [1.0; 3]),
        &Image::filled(1, 1, [3.0, 1.0, 1.0]),
    )
    .unwrap();
    assert_eq!((found.max_abs, found.ssim, found.flip), (2.0, None, 0.0));
}

#[test]
fn a_value_that_is_not_a_number_has_no_score() {
    let (good, _) = waves_and_ripple();
    let hostile: [fn(&mut Image); 4] = [
        |p| p.rgb[54][2] = f32::NAN,
        |p| p.rgb[54][0] = f32::INFINITY,
        |p| p.alpha[54] = f32::NAN,
        |p| {
            let depth = |at| if at == 54 { f32::NEG_INFINITY } else { 1.0 };
            let depths = (0..p.alpha.len()).map(depth).collect();
            p.planes.insert(Plane::Depth, PlaneValues::F32(depths));
        },
    ];
    for change in hostile {
        let mut bad = good.clone();
        change(&mut bad);
        let expected = |which| DifferenceError::NotFinite {
            which,
            count: 1,
            column: 1,
            row: 1,
        };
        assert_eq!(Difference::between(&bad, &good), Err(expected("first")));
        assert_eq!(Difference::between(&good, &bad), Err(expected("second")));
        assert_eq!(Difference::between(&bad, &bad), Err(expected("first")));
    }
}

#[test]
fn images_of_two_sizes_are_refused_with_both() {
    let message = Difference::between(
        &Image::filled(3, 2, [0.0; 3]),
        &Image::filled(2, 3, [0.0; 3]),
    )
    .unwrap_err()
    .to_string();
    assert!(
        message.contains("3x2") && message.contains("2x3"),
        "{message}"
    );
}

#[test]
fn infinity_is_null_in_json_and_figures_are_numbers() {
    let (gray, changed) = one_pixel_changed(0.1);
    let json = |a, b| serde_json::to_value(Difference::between(a, b).unwrap()).unwrap();
    assert!(json(&gray, &gray)["psnr_db"].is_null());
    assert!(json(&gray, &changed)["psnr_db"].as_f64().unwrap() > 50.0);
    assert_eq!(json(&gray, &gray)["max_abs"], 0.0);
}

#[test]
fn the_difference_image_shows_the_one_pixel_and_its_size() {
    let (gray, changed) = one_pixel_changed(0.05);
    let faint = difference_image(&gray, &changed, 1.0).unwrap();
    let strong = difference_image(&gray, &changed, 100.0).unwrap();
    let lit = |image: &Image| {
        (0..400)
            .filter(|&at| image.rgb[at] != [0.0; 3])
            .collect::<Vec<_>>()
    };
    assert_eq!((lit(&faint), lit(&strong)), (vec![191], vec![191]));
    assert_eq!(strong.rgb[191], [1.0; 3]);
    assert!(
        faint.rgb[191][2] > 0.1 && faint.rgb[191][2] < 0.2,
        "0.05 is a fifth of the way to blue"
    );
    let mut broken = gray.clone();
    broken.rgb[7][1] = f32::NAN;
    assert_eq!(
        difference_image(&gray, &broken, 1.0).unwrap().rgb[7],
        [0.0, 1.0, 0.0]
    );
    assert!(difference_image(&gray, &Image::filled(2, 2, [0.0; 3]), 1.0).is_err());
}
