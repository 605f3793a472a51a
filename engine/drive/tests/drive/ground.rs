//! Heights of synthetic roads.

use decouplegs_drive::{Ground, GroundOptions};
use decouplegs_scene::SplatCloud;
use glam::{DVec2, DVec3};

use crate::roads::{ROAD, Random, RoadOptions, add_clutter, add_surface, cluttered, positions};

const CLEARANCE_MAX_M: f64 = 0.02;

/// Sorted sizes of the differences from `truth` at `positions`, asked with `expected`; every
/// position must have ground.
fn errors(
    ground: &Ground,
    truth: &dyn Fn(DVec2) -> f64,
    at: &[DVec2],
    expected: &dyn Fn(DVec2) -> Option<f64>,
) -> Vec<f64> {
    let queries: Vec<_> = at.iter().map(|&at| (at, expected(at))).collect();
    let heights = ground.heights_at(&queries);
    let missing = heights.iter().filter(|height| height.is_none()).count();
    assert_eq!(missing, 0, "of {} positions", at.len());
    let mut errors: Vec<f64> = heights
        .iter()
        .zip(at)
        .map(|(height, &at)| (height.unwrap().z_m - truth(at)).abs())
        .collect();
    errors.sort_by(f64::total_cmp);
    errors
}

fn p95(errors: &[f64]) -> f64 {
    errors[errors.len() * 95 / 100]
}

fn tilted(at: DVec2) -> f64 {
    0.06 * at.x + 0.03 * at.y
}

fn crowned(at: DVec2) -> f64 {
    -0.02 * at.y.abs()
}

fn wavy(at: DVec2) -> f64 {
    0.3 * (at.x * 0.2).sin()
}

#[test]
fn tilted_crowned_and_wavy_roads_are_found_under_canopy_and_floaters() {
    let shapes: [(&str, &dyn Fn(DVec2) -> f64); 3] =
        [("tilted", &tilted), ("crowned", &crowned), ("wavy", &wavy)];
    for (name, truth) in shapes {
        for (flat, noise_m) in [(true, 0.01), (true, 0.02), (false, 0.02)] {
            let options = RoadOptions {
                flat,
                noise_m,
                ..ROAD
            };
            let ground = Ground::new(
                &cluttered(&options, truth, 7),
                DVec3::ZERO,
                &GroundOptions::default(),
            );
            let at = positions(&options, 4000, 1);
            // The map is a third of a meter off.
            let expected = errors(&ground, truth, &at, &|at| Some(truth(at) + 0.35));
            let unasked = errors(&ground, truth, &at, &|_| None);
            let said = |errors: &[f64]| {
                format!("p95 {:.4} max {:.4}", p95(errors), errors[errors.len() - 1])
            };
            println!(
                "{name} flat {flat} noise {noise_m}: expected {}, unasked {}",
                said(&expected),
                said(&unasked)
            );
            assert!(
                p95(&expected) < CLEARANCE_MAX_M && expected[expected.len() - 1] < 0.1,
                "{name}: {}",
                said(&expected)
            );
            assert!(
                p95(&unasked) < CLEARANCE_MAX_M,
                "{name}, nothing expected: {}",
                said(&unasked)
            );
        }
    }
}

fn two_decks() -> (SplatCloud, impl Fn(DVec2) -> f64, impl Fn(DVec2) -> f64) {
    let lower = |at: DVec2| -0.01 * at.x;
    let upper = |at: DVec2| 5.2 + 0.03 * at.x + 0.02 * at.y;
    let (mut cloud, mut random) = (SplatCloud::default(), Random(3));
    for deck in [&lower as &dyn Fn(DVec2) -> f64, &upper] {
        add_surface(&mut cloud, &mut random, &ROAD, deck);
    }
    // The underside of the upper deck is seen, too.
    add_surface(&mut cloud, &mut random, &ROAD, &|at| upper(at) - 0.9);
    add_clutter(&mut cloud, &mut random, &ROAD, &lower);
    (cloud, lower, upper)
}

#[test]
fn each_deck_is_found_by_the_lane_on_it_and_none_is_ever_mistaken() {
    let (cloud, lower, upper) = two_decks();
    let ground = Ground::new(&cloud, DVec3::ZERO, &GroundOptions::default());
    let at = positions(&ROAD, 4000, 2);
    for (deck, name) in [
        (&lower as &dyn Fn(DVec2) -> f64, "lower"),
        (&upper, "upper"),
    ] {
        for off in [-0.3, 0.0, 0.3] {
            let errors = errors(&ground, deck, &at, &|at| Some(deck(at) + off));
            println!(
                "{name} expected {off} off: p95 {:.4} max {:.4}",
                p95(&errors),
                errors[errors.len() - 1]
            );
            assert!(
                p95(&errors) < CLEARANCE_MAX_M,
                "{name}: p95 {}",
                p95(&errors)
            );
            assert!(
                errors[errors.len() - 1] < 0.5,
                "{name}: another deck, {} m away",
                errors[errors.len() - 1]
            );
        }
    }
    let unasked = errors(&ground, &lower, &at, &|_| None);
    assert!(
        p95(&unasked) < CLEARANCE_MAX_M && unasked[unasked.len() - 1] < 0.5,
        "the lowest is the lower deck"
    );
    // The comparison can fail: the upper deck is not the lower one.
    assert!(p95(&errors(&ground, &lower, &at, &|at| Some(upper(at)))) > 4.0);
}

#[test]
fn a_splat_counts_where_it_reaches_not_where_its_mean_is() {
    let mut cloud = SplatCloud::default();
    // One slanted disc, two meters wide: z rises by 0.1 along x.
    let slant = glam::DQuat::from_rotation_y(-(0.1f64).atan());
    crate::roads::add_splat(
        &mut cloud,
        DVec3::new(5.0, 5.0, 1.0),
        [1.0, 1.0, 0.005],
        slant,
        1.0,
    );
    let ground = Ground::new(&cloud, DVec3::ZERO, &GroundOptions::default());
    for dx in [-1.2, -0.5, 0.0, 0.7, 1.3] {
        let height = ground
            .height_at(DVec2::new(5.0 + dx, 5.2), None)
            .expect("the disc is there");
        // The part of a lone disc in a column lies nearer to the disc's mean than the column does,
        // by c^2 / (1 + c^2) of the way.
        assert!(
            (height.z_m - (1.0 + 0.1 * dx)).abs() < 3e-3,
            "{dx}: {height:?}"
        );
    }
    assert_eq!(ground.height_at(DVec2::new(12.0, 5.0), None), None);
}

#[test]
fn utm_sized_origins_keep_millimeters_and_nonsense_has_no_height() {
    let origin = DVec3::new(456_000.25, 5_427_000.5, 113.0);
    let options = RoadOptions {
        length_m: 10.0,
        ..ROAD
    };
    let near = Ground::new(
        &cluttered(&options, &tilted, 1),
        DVec3::ZERO,
        &GroundOptions::default(),
    );
    let far = Ground::new(
        &cluttered(&options, &tilted, 1),
        origin,
        &GroundOptions::default(),
    );
    let at = DVec2::new(5.3, 0.4);
    let (a, b) = (
        near.height_at(at, None).unwrap(),
        far.height_at(at + origin.truncate(), None).unwrap(),
    );
    assert!((b.z_m - origin.z - a.z_m).abs() < 1e-6, "{a:?} {b:?}");
    for bad in [f64::NAN, f64::INFINITY, -1e300, 1e9] {
        assert_eq!(near.height_at(DVec2::new(bad, 0.0), None), None);
        assert_eq!(near.height_at(DVec2::new(0.0, bad), Some(1.0)), None);
        assert_eq!(near.height_at(at, Some(bad)), None);
    }
    assert_eq!(
        Ground::new(&SplatCloud::default(), origin, &GroundOptions::default()).height_at(at, None),
        None
    );
}

#[test]
fn broken_and_huge_splats_are_survived() {
    let mut cloud = cluttered(
        &RoadOptions {
            length_m: 5.0,
            ..ROAD
        },
        &crowned,
        5,
    );
    for (at, bad) in [f32::NAN, f32::INFINITY, 1e30, -1e9]
        .into_iter()
        .enumerate()
    {
        cloud.means[at][0] = bad;
        cloud.scales[at + 4][1] = bad.abs();
        cloud.rotations[at + 8][2] = bad;
        cloud.opacities[at + 12] = bad;
    }
    cloud.scales[20] = [1e20; 3];
    cloud.scales[21] = [0.0; 3];
    cloud.rotations[22] = [0.0; 4];
    let ground = Ground::new(&cloud, DVec3::ZERO, &GroundOptions::default());
    let height = ground.height_at(DVec2::new(2.5, 1.0), None).unwrap();
    assert!(
        (height.z_m - crowned(DVec2::new(2.5, 1.0))).abs() < 0.03,
        "{height:?}"
    );
}

#[test]
fn answers_do_not_depend_on_the_order_of_queries() {
    let cloud = cluttered(
        &RoadOptions {
            length_m: 12.0,
            ..ROAD
        },
        &wavy,
        9,
    );
    let at = positions(
        &RoadOptions {
            length_m: 12.0,
            ..ROAD
        },
        3000,
        4,
    );
    let [first, second] =
        [0, 1].map(|_| Ground::new(&cloud, DVec3::ZERO, &GroundOptions::default()));
    let all = first.heights_at(&at.iter().map(|&at| (at, None)).collect::<Vec<_>>());
    for (&at, expected) in at.iter().zip(&all).rev() {
        assert_eq!(second.height_at(at, None), *expected);
    }
}
