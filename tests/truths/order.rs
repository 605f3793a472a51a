//! Occlusion: splats in front cover those behind, and a full pixel stays as it is.

use decouplegs::scene::{DepthOrder, Rules};

use super::{
    BLUE, Easel, RED, ROUNDING, Splat, WHITE, middle_of, sheet, square_camera, world_of,
    worst_difference,
};

#[test]
fn the_nearer_covers_the_farther_whatever_their_places_in_the_file() {
    let (near, far) = (sheet(2.0, 0.6, RED), sheet(3.0, 0.5, BLUE));
    for splats in [[near, far], [far, near]] {
        let ([red, _, blue], alpha) = middle_of(&splats, Rules::DEFAULT);
        assert!(
            (red - 0.6).abs() < ROUNDING
                && (blue - 0.4 * 0.5).abs() < ROUNDING
                && (alpha - 0.8).abs() < ROUNDING
        );
    }
}

#[test]
fn splats_of_one_depth_are_blended_in_the_order_of_the_file() {
    for (first, second, channel) in [(RED, BLUE, 0), (BLUE, RED, 2)] {
        let splats: Vec<Splat> = (0..64)
            .map(|i| sheet(4.0, 0.9, if i == 0 { first } else { second }))
            .collect();
        let (rgb, _) = middle_of(&splats, Rules::DEFAULT);
        assert!(
            (rgb[channel] - 0.9).abs() < ROUNDING && (rgb[2 - channel] - 0.1).abs() < ROUNDING,
            "{rgb:?}"
        );
    }
}

#[test]
fn splats_of_many_depths_may_stand_in_the_file_in_any_order() {
    let splats: Vec<Splat> = (0..500u16)
        .map(|i| {
            let place = (f32::from(i) * 0.618).fract();
            Splat {
                opacity: 0.1 + 0.8 * place,
                rgb: [place, 1.0 - place, 0.5],
                ..Splat::at(place - 0.5, 0.2 * place, 2.0 + 0.01 * f32::from(i))
            }
        })
        .collect();
    let mut shuffled = splats.clone();
    shuffled.rotate_left(211);
    shuffled.reverse();
    let mut easel = Easel::new(Rules::DEFAULT);
    let images =
        [&splats, &shuffled].map(|splats| easel.draw(&world_of(splats), &square_camera(64)));
    assert!(
        images[0] == images[1],
        "the same sums in the same order are the same bits"
    );
    let mut farther = splats;
    farther[0].mean_m[2] += 6.0;
    assert!(
        worst_difference(
            &images[0],
            &easel.draw(&world_of(&farther), &square_camera(64))
        ) > 0.01,
        "depth matters"
    );
}

#[test]
fn layers_of_one_opacity_leave_a_power() {
    for (layers, opacity) in [(1u16, 0.5f32), (7, 0.5), (60, 0.01), (1000, 0.005)] {
        let splats: Vec<Splat> = (0..layers)
            .map(|i| sheet(2.0 + 0.01 * f32::from(i), opacity, WHITE))
            .collect();
        let ([red, ..], alpha) = middle_of(&splats, Rules::DEFAULT);
        let expected = (1.0 - (1.0 - f64::from(opacity)).powi(i32::from(layers))) as f32;
        assert!(
            (alpha - expected).abs() < ROUNDING && (red - expected).abs() < ROUNDING,
            "{layers} layers: {alpha}, {expected}"
        );
    }
}

#[test]
fn a_full_pixel_shows_nothing_of_what_is_behind() {
    // Six layers at the bound of 0.99 leave 1e-12; a thousand blue ones behind them are worth no
    // more than the early stop.
    let mut splats: Vec<Splat> = (0..6u8)
        .map(|i| sheet(2.0 + 0.1 * f32::from(i), 1.0, RED))
        .collect();
    splats.extend((0..1000u16).map(|i| sheet(5.0 + 0.01 * f32::from(i), 1.0, BLUE)));
    let ([red, _, blue], alpha) = middle_of(&splats, Rules::DEFAULT);
    assert!(
        (red - 1.0).abs() <= 1.1e-4
            && blue.abs() <= 1.1e-4
            && (1.0 - 1.1e-4..=1.0).contains(&alpha),
        "{red} {blue} {alpha}"
    );
}

#[test]
fn radial_order_can_turn_two_splats_around() {
    // Red is nearer by z (3 against 3.2) and farther by distance (3.97 against 3.2).
    let red = Splat {
        scale_m: [3.0, 3.0, 1e-6],
        opacity: 0.9,
        rgb: RED,
        ..Splat::at(2.6, 0.0, 3.0)
    };
    let blue = Splat {
        scale_m: [3.0, 3.0, 1e-6],
        opacity: 0.9,
        rgb: BLUE,
        ..Splat::at(0.0, 0.0, 3.2)
    };
    let (by_z, _) = middle_of(&[red, blue], Rules::DEFAULT);
    let (by_distance, _) = middle_of(
        &[red, blue],
        Rules {
            order: DepthOrder::Radial,
            ..Rules::DEFAULT
        },
    );
    assert!(by_z[0] > 0.55 && by_z[2] < 0.5, "{by_z:?}");
    assert!(by_distance[2] > 0.85, "{by_distance:?}");
}
