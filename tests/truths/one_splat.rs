//! A single splat has a closed form.

use decouplegs::scene::{Rules, SplatScene};

use super::{BLUE, Easel, ROUNDING, Splat, WHITE, square_camera, world_of, worst_difference};

/// `o exp(-r^2 / 2 v)`, nothing below 1/255, for a variance of `variance_px2` about the middle of
/// `size_px` pixels.
fn expected_alpha(size_px: u32, opacity: f64, variance_px2: f64) -> Vec<f64> {
    let middle = f64::from(size_px / 2);
    let alpha = |x: u32, y: u32| {
        let (dx, dy) = (f64::from(x) - middle, f64::from(y) - middle);
        let alpha = opacity * (-0.5 * (dx * dx + dy * dy) / variance_px2).exp();
        if alpha < 1.0 / 255.0 { 0.0 } else { alpha }
    };
    (0..size_px)
        .flat_map(|y| (0..size_px).map(move |x| (x, y)))
        .map(|(x, y)| alpha(x, y))
        .collect()
}

fn worst(found: &[f32], expected: &[f64]) -> f64 {
    found
        .iter()
        .zip(expected)
        .map(|(&found, &expected)| (f64::from(found) - expected).abs())
        .fold(0.0, f64::max)
}

#[test]
fn a_ball_on_the_axis_is_a_gaussian_as_wide_as_it_projects() {
    let sky = [0.0, 0.0, 0.25];
    let ball = Splat {
        scale_m: [0.08; 3],
        opacity: 0.8,
        rgb: WHITE,
        ..Splat::at(0.0, 0.0, 4.0)
    };
    let image = Easel::new(Rules::DEFAULT).draw(
        &SplatScene {
            sky,
            ..world_of(&[ball])
        },
        &square_camera(33),
    );
    // On the axis the Jacobian is f/z: the variance is (f s / z)^2 and the dilation of 0.3.
    let variance_px2 = (100.0f64 * 0.08 / 4.0).powi(2) + 0.3;
    let expected = expected_alpha(33, 0.8, variance_px2);
    assert!(
        worst(&image.alpha, &expected) < f64::from(ROUNDING),
        "{}",
        worst(&image.alpha, &expected)
    );
    for (at, &alpha) in expected.iter().enumerate() {
        let [red, _, blue] = image.rgb[at].map(f64::from);
        assert!(
            (red - alpha).abs() < f64::from(ROUNDING)
                && (blue - (alpha + 0.25 * (1.0 - alpha))).abs() < f64::from(ROUNDING)
        );
        let depth_m = image.depth().unwrap()[at];
        assert!(
            if alpha > 0.0 {
                (depth_m - 4.0).abs() < 1e-4
            } else {
                depth_m == 0.0
            },
            "{depth_m} m at {at}"
        );
    }
    // The comparison can fail: without the dilation, or with a threshold of 1/510, it is another
    // image.
    assert!(worst(&image.alpha, &expected_alpha(33, 0.8, variance_px2 - 0.3)) > 0.01);
    let faint = expected.iter().filter(|&&alpha| alpha == 0.0).count();
    assert!(
        (100..1000).contains(&faint),
        "{faint} pixels beyond the threshold"
    );
}

#[test]
fn a_splat_turned_by_a_right_angle_is_its_image_transposed() {
    let long = |rotation| {
        let splat = Splat {
            scale_m: [0.4, 0.05, 0.1],
            rotation,
            opacity: 0.9,
            rgb: BLUE,
            ..Splat::at(0.0, 0.0, 4.0)
        };
        Easel::new(Rules::DEFAULT).draw(&world_of(&[splat]), &square_camera(65))
    };
    let lying = long([1.0, 0.0, 0.0, 0.0]);
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let standing = long([half, 0.0, 0.0, half]);
    let mut transposed = lying.clone();
    for at in 0..65 * 65 {
        let from = at % 65 * 65 + at / 65;
        (transposed.rgb[at], transposed.alpha[at]) = (lying.rgb[from], lying.alpha[from]);
    }
    assert!(
        worst_difference(&standing, &transposed) < ROUNDING,
        "{}",
        worst_difference(&standing, &transposed)
    );
    assert!(
        worst_difference(&standing, &lying) > 0.5,
        "it must matter which way it lies"
    );
}

#[test]
fn antialiasing_keeps_the_light_of_a_splat_far_below_a_pixel() {
    // The integral of alpha is o 2 pi sqrt(det S'); times sqrt(det S / det S') it is that of the
    // splat without dilation.
    let light = |scale: f32, antialias: bool| {
        let ball = Splat {
            scale_m: [scale; 3],
            opacity: 0.9,
            ..Splat::at(0.003, -0.002, 4.0)
        };
        let image = Easel::new(Rules {
            antialias,
            ..Rules::DEFAULT
        })
        .draw(&world_of(&[ball]), &square_camera(33));
        image
            .alpha
            .iter()
            .map(|&alpha| f64::from(alpha))
            .sum::<f64>()
    };
    let area = |scale: f64| 0.9 * std::f64::consts::TAU * (100.0 * scale / 4.0).powi(2);
    // What lies below 1/255 is cut away: 2.7 % of the small splat, less of the large one.
    assert!((light(0.012, true) / area(0.012) - 1.0).abs() < 0.05);
    assert!((light(0.08, true) / area(0.08) - 1.0).abs() < 0.01);
    assert!(
        light(0.012, false) > 3.0 * area(0.012),
        "without it the widened splat is far too bright"
    );
}
