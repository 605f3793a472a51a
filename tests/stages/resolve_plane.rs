//! Means and medians of an attribute by pixel.

use decouplegs::render::stages::ResolvePlane;
use decouplegs::render::twins::resolve_plane::resolve_plane;
use decouplegs::render::{OutputBuffers, Outputs, Plane};

use super::{Random, UNTOUCHED, open, run, upload};

#[test]
fn planes_are_means_or_medians_of_what_was_blended() {
    let gpu = open();
    let asked = [
        Plane::Instance,
        Plane::Range,
        Plane::FlowForward,
        Plane::SceneFlow,
        Plane::RangeMedian,
    ];
    let outputs = Outputs {
        planes: asked.into(),
        ..Outputs::default()
    };
    let mut random = Random(5);
    // More than a workgroup; every seventh pixel is empty, and some have no light left.
    let sums: Vec<[f32; 4]> = (0..700)
        .map(|pixel| match pixel % 7 {
            0 => [0.0; 4],
            1 => [random.between(0.01, 9.0), 0.0, 0.0, 1.0],
            _ => std::array::from_fn(|_| random.between(0.01, 9.0)),
        })
        .collect();
    let images = OutputBuffers::new(&gpu, sums.len(), 0, &outputs).unwrap();
    gpu.write(&images.planes, 0, &vec![UNTOUCHED; images.planes.len()])
        .unwrap();
    let (resolve, of_sums) = (ResolvePlane::new(&gpu).unwrap(), upload(&gpu, &sums));
    run(&gpu, |r| {
        // The last was not asked for.
        for plane in [
            Plane::Range,
            Plane::FlowForward,
            Plane::SceneFlow,
            Plane::RangeMedian,
            Plane::Normal,
        ] {
            resolve.record(r, plane, &of_sums, &images);
        }
    });
    let words = gpu.read(&images.planes).unwrap();
    assert_eq!(words.len(), (1 + 1 + 2 + 3 + 1) * sums.len());
    assert!(
        words[images.plane_words(Plane::Instance).unwrap()]
            .iter()
            .all(|&word| word == UNTOUCHED)
    );
    assert!(images.plane_words(Plane::Normal).is_none());
    for plane in &asked[1..] {
        let plane = *plane;
        let found = &words[images.plane_words(plane).unwrap()];
        let expected = resolve_plane(&sums, plane);
        assert_eq!(found.len(), expected.len());
        for (&word, expected) in found.iter().zip(expected) {
            // A division may be off by 2.5 units in the last place.
            let found = f32::from_bits(word);
            assert!(
                (found - expected).abs() <= 4e-7 * expected.abs(),
                "{found}, {expected}"
            );
        }
    }
}
