//! More than the buffers hold: counted, grown, drawn again, and said.

use decouplegs::render::metrics::Difference;
use decouplegs::render::{Capacity, RenderOptions, Renderer, reference};
use decouplegs::scene::Rules;
use glam::DVec3;

use super::{PSNR_MIN_DB, Splat, camera_at, world_of};
use crate::device::Validated;

#[test]
fn every_list_grows_and_the_image_is_whole() {
    let gpu = Validated::open();
    let splats: Vec<Splat> = (0..2000)
        .map(|i| Splat {
            opacity: 0.05,
            scale_m: [2.0; 3],
            ..Splat::at(0.0, 0.0, 5.0 + i as f32 * 0.0005)
        })
        .collect();
    let world = world_of(&splats);
    let cameras = [camera_at(DVec3::ZERO, 150, 100)];
    let options = RenderOptions {
        segment_pairs: 64,
        ..RenderOptions::default()
    };

    let mut roomy = Renderer::new(&gpu, options);
    let resident = roomy.upload(&world).unwrap();
    roomy.render(&resident, &cameras).unwrap();
    let statistics = roomy.render(&resident, &cameras).unwrap();
    assert_eq!(
        statistics.redrawn, 0,
        "a frame like the one before needs no growth"
    );
    assert_eq!(statistics.required.records, 2000);
    assert_eq!(
        statistics.required.pairs,
        2000 * 12,
        "every splat reaches all 3 x 4 coarse tiles"
    );
    assert_eq!(
        (statistics.required.partials, statistics.required.composites),
        (12 * 32, 12 * 2),
        "2000 entries are 31 segments of 64 and one of 16, joined in two runs"
    );
    let whole = roomy.read_images().unwrap();

    for capacity in [
        Capacity {
            records: 1,
            pairs: 1,
            partials: 1,
            tiles: 1,
        },
        Capacity {
            records: 5000,
            pairs: 100,
            partials: 200,
            tiles: 10,
        },
        Capacity {
            records: 5000,
            pairs: 50_000,
            partials: 3,
            tiles: 1,
        },
        Capacity {
            records: 5000,
            pairs: 50_000,
            partials: 200,
            tiles: 3,
        },
    ] {
        let mut tight = Renderer::new(&gpu, options).with_capacity(capacity);
        let statistics = tight.render(&resident, &cameras).unwrap();
        assert!(
            statistics.redrawn > 0,
            "{capacity:?} cannot have been enough"
        );
        assert!(statistics.capacity.holds(&statistics.required));
        assert!(tight.read_images().unwrap() == whole, "{capacity:?}");
    }
}

#[test]
fn counts_that_grow_slowly_find_room() {
    let gpu = Validated::open();
    let splats: Vec<Splat> = (0..800)
        .map(|i| Splat {
            scale_m: [0.3; 3],
            ..Splat::at(0.0, 0.0, i as f32 * 0.05)
        })
        .collect();
    let options = RenderOptions {
        spare: 0.25,
        ..RenderOptions::default()
    };
    let small = Capacity {
        records: 1,
        pairs: 1,
        partials: 1,
        tiles: 1,
    };
    let mut renderer = Renderer::new(&gpu, options).with_capacity(small);
    let resident = renderer.upload(&world_of(&splats)).unwrap();
    // A camera that goes back along a row of splats sees a twentieth more of them in each frame.
    let mut seen = 40.0;
    let mut frames = Vec::new();
    while seen < 800.0 {
        let at = DVec3::Z * (0.05 * (800.0 - seen));
        let statistics = renderer
            .render(&resident, &[camera_at(at, 96, 64)])
            .unwrap();
        frames.push((statistics.redrawn, statistics.required.records));
        seen *= 1.05;
    }
    let records = frames.iter().map(|frame| frame.1);
    assert!(records.clone().max() > records.min().map(|least| 10 * least));
    assert!(
        frames[1..].iter().all(|&(redrawn, _)| redrawn == 0),
        "{frames:?}"
    );
}

#[test]
fn segments_have_results_only_where_they_draw() {
    let gpu = Validated::open();
    // All in the fine tile in the middle of the image, and too faint to cover it.
    let splats: Vec<Splat> = (0..600)
        .map(|i| Splat {
            opacity: 0.01,
            scale_m: [0.01; 3],
            ..Splat::at(0.0, 0.0, 4.0 + i as f32 * 0.001)
        })
        .collect();
    let options = RenderOptions {
        segment_pairs: 256,
        ..RenderOptions::default()
    };
    let mut renderer = Renderer::new(&gpu, options);
    let resident = renderer.upload(&world_of(&splats)).unwrap();
    let required = renderer
        .render(&resident, &[camera_at(DVec3::ZERO, 152, 104)])
        .unwrap()
        .required;
    assert_eq!((required.partials, required.tiles), (3, 3));
}

#[test]
fn cutting_lists_into_segments_changes_rounding_only() {
    let gpu = Validated::open();
    let splats: Vec<Splat> = (0..3000)
        .map(|i| Splat {
            opacity: 0.01 + 0.02 * (i % 7) as f32,
            scale_m: [0.6; 3],
            rgb: [(i % 3) as f32 * 0.5, 0.3, 0.8],
            ..Splat::at((i % 11) as f32 * 0.2 - 1.0, 0.0, 4.0 + i as f32 * 0.001)
        })
        .collect();
    let world = world_of(&splats);
    let cameras = [camera_at(DVec3::ZERO, 128, 64)];
    let mut images = [64, 256, 1024, u32::MAX].map(|segment_pairs| {
        let mut renderer = Renderer::new(
            &gpu,
            RenderOptions {
                segment_pairs,
                ..RenderOptions::default()
            },
        );
        let resident = renderer.upload(&world).unwrap();
        let statistics = renderer.render(&resident, &cameras).unwrap();
        assert_eq!(statistics.required.partials > 0, segment_pairs != u32::MAX);
        renderer.read_images().unwrap().remove(0)
    });
    let [first, rest @ ..] = &mut images;
    for other in rest {
        let worst = first
            .rgb
            .iter()
            .flatten()
            .zip(other.rgb.iter().flatten())
            .fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
        // Stopping when a pixel is full may come a segment later: at most the transmittance left,
        // 1e-4.
        assert!(worst <= 1.5e-4, "{worst}");
    }
}

/// Fine tiles of one coarse tile fill at different times: near splats fill its left edge, far ones
/// the rest, batches later.
#[test]
fn tiles_that_fill_late_are_drawn_to_the_end() {
    let gpu = Validated::open();
    let near = (0..700).map(|i| Splat {
        scale_m: [0.02; 3],
        ..Splat::at(-1.2, 0.01 * (i % 40) as f32 - 0.2, 2.0 + 1e-4 * i as f32)
    });
    let far = (0..3000).map(|i| Splat {
        scale_m: [0.3; 3],
        rgb: [0.1, 0.9, 0.3],
        ..Splat::at(
            4.0 * (i as f32 * 0.618).fract() - 2.0,
            0.0,
            4.0 + 1e-3 * i as f32,
        )
    });
    let world = world_of(&near.chain(far).collect::<Vec<_>>());
    let camera = camera_at(DVec3::ZERO, 64, 32);
    for (rules, segment_pairs) in [Rules::DEFAULT, Rules::GSPLAT15, Rules::INRIA, Rules::NUREC]
        .into_iter()
        .flat_map(|rules| [64, 1024, u32::MAX].map(|pairs| (rules, pairs)))
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
        renderer
            .render(&resident, std::slice::from_ref(&camera))
            .unwrap();
        let image = renderer.read_images().unwrap().remove(0);
        let difference = Difference::between(
            &image,
            &reference::render(&world, &camera, &rules).to_image(),
        )
        .unwrap();
        println!(
            "{rules:?}, segments of {segment_pairs}: {:.1} dB, max {}",
            difference.psnr_db, difference.max_abs
        );
        assert!(
            difference.psnr_db >= PSNR_MIN_DB,
            "{rules:?}, segments of {segment_pairs}: {:.1} dB",
            difference.psnr_db
        );
    }
}

/// More splats on one coarse tile than a software device blends in one run: they are cut by every
/// rule.
#[test]
fn a_list_too_long_for_one_run_in_software_is_drawn_right() {
    let gpu = Validated::open();
    let splats: Vec<Splat> = (0..17_000)
        .map(|i| Splat {
            opacity: 0.005,
            scale_m: [1.0; 3],
            ..Splat::at(0.0, 0.0, 5.0 + 1e-4 * i as f32)
        })
        .collect();
    let world = world_of(&splats);
    let camera = camera_at(DVec3::ZERO, 16, 16);
    for (rules, segment_pairs) in [
        (Rules::DEFAULT, 1024),
        (Rules::GSPLAT15, 1024),
        (Rules::GSPLAT15, u32::MAX),
        (Rules::NUREC, 1024),
    ] {
        let mut renderer = Renderer::new(
            &gpu,
            RenderOptions {
                rules,
                segment_pairs,
                ..RenderOptions::default()
            },
        );
        let resident = renderer.upload(&world).unwrap();
        let statistics = renderer
            .render(&resident, std::slice::from_ref(&camera))
            .unwrap();
        assert_eq!(statistics.required.longest, 17_000);
        let image = renderer.read_images().unwrap().remove(0);
        let difference = Difference::between(
            &image,
            &reference::render(&world, &camera, &rules).to_image(),
        )
        .unwrap();
        assert!(
            difference.psnr_db >= PSNR_MIN_DB,
            "{rules:?}: {:.1} dB",
            difference.psnr_db
        );
    }
}
