//! More than the buffers hold: counted, grown, drawn again, and said.

use decouplegs::render::{Capacity, RenderOptions, Renderer};
use glam::DVec3;

use super::{Splat, camera_at, world_of};
use crate::device::Validated;

#[test]
fn every_list_grows_and_the_picture_is_whole() {
    let gpu = Validated::open();
    let splats: Vec<Splat> =
        (0..2000).map(|i| Splat { opacity: 0.05, scale_m: [2.0; 3], ..Splat::at(0.0, 0.0, 5.0 + i as f32 * 0.0005) }).collect();
    let world = world_of(&splats);
    let cameras = [camera_at(DVec3::ZERO, 150, 100)];
    let options = RenderOptions { segment_pairs: 256, ..RenderOptions::default() };

    let mut roomy = Renderer::new(&gpu, options);
    let resident = roomy.upload(&world).unwrap();
    roomy.render(&resident, &cameras).unwrap();
    let statistics = roomy.render(&resident, &cameras).unwrap();
    assert_eq!(statistics.redrawn, 0, "a frame like the one before needs no growth");
    assert_eq!(statistics.needs.records, 2000);
    assert_eq!(statistics.needs.pairs, 2000 * 12, "every splat reaches all 3 x 4 macro tiles");
    assert_eq!(
        (statistics.needs.partials, statistics.needs.composites),
        (12 * 8, 12),
        "2000 entries are 7 segments of 256 and one of 208"
    );
    let whole = roomy.read_pictures().unwrap();

    for capacity in [
        Capacity { records: 1, pairs: 1, partials: 1 },
        Capacity { records: 5000, pairs: 100, partials: 200 },
        Capacity { records: 5000, pairs: 50_000, partials: 3 },
    ] {
        let mut tight = Renderer::new(&gpu, options).with_capacity(capacity);
        let statistics = tight.render(&resident, &cameras).unwrap();
        assert!(statistics.redrawn > 0, "{capacity:?} cannot have been enough");
        assert!(statistics.capacity.holds(&statistics.needs));
        assert!(tight.read_pictures().unwrap() == whole, "{capacity:?}");
    }
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
    let mut pictures = [64, 256, 1024, u32::MAX].map(|segment_pairs| {
        let mut renderer = Renderer::new(&gpu, RenderOptions { segment_pairs, ..RenderOptions::default() });
        let resident = renderer.upload(&world).unwrap();
        let statistics = renderer.render(&resident, &cameras).unwrap();
        assert_eq!(statistics.needs.partials > 0, segment_pairs != u32::MAX);
        renderer.read_pictures().unwrap().remove(0)
    });
    let [first, rest @ ..] = &mut pictures;
    for other in rest {
        let worst = first.rgb.iter().flatten().zip(other.rgb.iter().flatten()).fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
        // Stopping when a pixel is full may come a segment later: at most the transmittance left, 1e-4.
        assert!(worst <= 1.5e-4, "{worst}");
    }
}
