//! Depth, instances and 8-bit color.

use decouplegs::render::{ColorFormat, Outputs, RenderOptions, Renderer, reference};
use decouplegs::scene::{Rules, SplatScene};
use glam::DVec3;

use super::{Splat, all_outputs, camera_at, draw, world_of};
use crate::device::Validated;

fn scene() -> SplatScene {
    let splats: Vec<Splat> = (0..600)
        .map(|i| {
            let (a, b) = ((i as f32 * 0.618).fract(), (i as f32 * 0.324).fract());
            Splat {
                opacity: 0.3 + 0.6 * a,
                scale_m: [0.15; 3],
                rgb: [a, b, 0.5],
                ..Splat::at(4.0 * a - 2.0, 2.0 * b - 1.0, 3.0 + 4.0 * b)
            }
        })
        .collect();
    let mut world = world_of(&splats);
    world.instance_from_splat = (0..600).map(|i| (i / 200) as u16).collect();
    world.sky = [0.3, 0.5, 1.4];
    world
}

#[test]
fn depth_and_instance_are_the_definitions() {
    let gpu = Validated::open();
    let camera = camera_at(DVec3::ZERO, 160, 90);
    let world = scene();
    // In one run, and in many segments, which composite joins and which end by an early stop.
    for (rules, segment_pairs) in [
        (Rules::DEFAULT, 1024),
        (Rules::DEFAULT, 64),
        (Rules::GSPLAT16, 1024),
        (Rules::GSPLAT16, 64),
        (Rules::NUREC, 1024),
        (Rules::NUREC, 64),
    ] {
        let options = RenderOptions {
            rules,
            segment_pairs,
            outputs: all_outputs(),
            ..RenderOptions::default()
        };
        let mut renderer = Renderer::new(&gpu, options);
        let resident = renderer.upload(&world).unwrap();
        let required = renderer
            .render(&resident, std::slice::from_ref(&camera))
            .unwrap()
            .required;
        assert_eq!(
            required.partials > 0,
            segment_pairs < 1024,
            "{} in the longest list",
            required.longest
        );
        let image = &renderer.read_images().unwrap()[0];
        let truth = reference::render(&world, &camera, &rules);
        let depths = image.depth().unwrap();
        for (i, (&depth, &expected)) in depths.iter().zip(&truth.depth).enumerate() {
            // A pixel of one faint splat can gain or lose it at the 1/255 threshold; compare where
            // something was hit.
            if truth.alpha[i] > 0.05 {
                assert!(
                    (f64::from(depth) - expected).abs() <= 0.01 * expected,
                    "pixel {i}: {depth} m, not {expected} m"
                );
            }
        }
        let ids = image.instance().unwrap();
        let wrong = ids
            .iter()
            .zip(&truth.instance)
            .filter(|(a, b)| a != b)
            .count();
        // Two weights can be equal to rounding.
        assert!(
            wrong * 1000 <= ids.len(),
            "{wrong} of {} pixels name another instance",
            ids.len()
        );
        assert!(
            (0..3).all(|id| truth.instance.contains(&id)),
            "the scene must show all three"
        );
    }
}

#[test]
fn bytes_are_the_floats_clamped_and_rounded() {
    let gpu = Validated::open();
    let camera = [camera_at(DVec3::ZERO, 100, 60)];
    let world = scene();
    let floats = &draw(&gpu, &world, &camera, Rules::DEFAULT)[0];
    let outputs = Outputs {
        color: ColorFormat::U8,
        ..Outputs::default()
    };
    let mut renderer = Renderer::new(
        &gpu,
        RenderOptions {
            outputs,
            ..RenderOptions::default()
        },
    );
    let resident = renderer.upload(&world).unwrap();
    renderer.render(&resident, &camera).unwrap();
    let bytes = &renderer.read_images().unwrap()[0];
    assert!(bytes.planes.is_empty());
    for (a, b) in floats.rgb.iter().flatten().zip(bytes.rgb.iter().flatten()) {
        assert!(
            (a.clamp(0.0, 1.0) - b).abs() <= 0.5001 / 255.0,
            "{a} became {b}"
        );
    }
    assert!(
        floats.rgb.iter().flatten().any(|&c| c > 1.0),
        "the sky is brighter than white here"
    );
}

#[test]
fn a_lower_degree_is_the_image_without_its_bands() {
    let gpu = Validated::open();
    let camera = camera_at(DVec3::ZERO, 80, 50);
    let mut world = scene();
    world.splats.sh_degree = 2;
    world.splats.sh_rest = (0..600 * 8)
        .map(|i| [0.05 * (i as f32).sin(), 0.1, -0.05])
        .collect();
    for degree in 0..=2 {
        let mut renderer = Renderer::new(
            &gpu,
            RenderOptions {
                sh_degree_max: degree,
                ..RenderOptions::default()
            },
        );
        let resident = renderer.upload(&world).unwrap();
        renderer
            .render(&resident, std::slice::from_ref(&camera))
            .unwrap();
        let image = renderer.read_images().unwrap().remove(0);
        let mut lower = world.clone();
        lower.splats.set_degree(degree);
        let truth = reference::render(&lower, &camera, &Rules::DEFAULT).to_image();
        let worst = image
            .rgb
            .iter()
            .flatten()
            .zip(truth.rgb.iter().flatten())
            .fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
        assert!(worst <= 0.005, "degree {degree}: {worst}");
    }
}

#[test]
fn contributions_add_up_to_what_pixels_cover() {
    let gpu = Validated::open();
    let splats: Vec<Splat> = (0..300)
        .map(|i| Splat {
            scale_m: [0.3; 3],
            ..Splat::at(
                (i % 17) as f32 * 0.2 - 1.6,
                (i % 5) as f32 * 0.3 - 0.6,
                3.0 + i as f32 * 0.01,
            )
        })
        .chain([Splat::at(0.0, 0.0, -5.0)])
        .collect();
    let world = world_of(&splats);
    let cameras = [
        camera_at(DVec3::ZERO, 97, 61),
        camera_at(DVec3::new(0.5, 0.0, -1.0), 97, 61),
    ];
    let mut whole = Vec::new();
    let rule_sets = [Rules::DEFAULT, Rules::GSPLAT15];
    for (rules, segment_pairs) in rule_sets
        .into_iter()
        .flat_map(|rules| [1024, 64, 100].map(|pairs| (rules, pairs)))
    {
        let mut renderer = Renderer::new(
            &gpu,
            RenderOptions {
                rules,
                segment_pairs,
                ..RenderOptions::default()
            },
        );
        let resident = renderer.upload(&world).unwrap();
        let weights = renderer.contribution_weights(&resident, &cameras).unwrap();
        let required = renderer.render(&resident, &cameras).unwrap().required;
        assert_eq!(required.partials > 0, segment_pairs < 1024);
        let covered: f64 = renderer
            .read_images()
            .unwrap()
            .iter()
            .flat_map(|p| p.alpha.clone())
            .map(f64::from)
            .sum();
        let sum: f64 = weights.iter().map(|&weight| f64::from(weight)).sum();
        println!("{rules:?}, segments of {segment_pairs}: {sum} of {covered} pixels");
        assert!(
            (sum / covered - 1.0).abs() < 1e-3,
            "weights sum to {sum}, pixels are covered by {covered}"
        );
        assert_eq!(weights[300], 0.0, "what is behind the cameras adds nothing");
        // The first is in front of all others: its weight is its own alpha.
        let alone = renderer.upload(&world_of(&splats[..1])).unwrap();
        let own = renderer.contribution_weights(&alone, &cameras).unwrap()[0];
        assert!(
            (weights[0] - own).abs() < 1e-3 * own,
            "{} against {own}",
            weights[0]
        );
        // Where lists are cut, each splat's weight is that of the whole list, but for the steps of
        // 2^-16 in which pixels are summed.
        if segment_pairs == 1024 {
            whole = weights;
            continue;
        }
        let apart = |(cut, whole): (&f32, &f32)| f64::from((cut - whole).abs() / (whole + 1.0));
        let worst = weights.iter().zip(&whole).map(apart).fold(0.0, f64::max);
        assert!(
            worst < 1e-3,
            "{rules:?}, segments of {segment_pairs}: {worst}"
        );
    }
}
