//! Medians of depth and range.

use decouplegs::render::stages::ResolvePlane;
use decouplegs::render::twins::resolve_plane::resolve_plane;
use decouplegs::render::{OutputBuffers, Outputs, Plane};

use super::{Random, UNTOUCHED, identical, open, run, upload};

#[test]
fn medians_that_were_found_are_written() {
    let gpu = open();
    let mut random = Random(5);
    // More than a workgroup; in every seventh pixel nothing was blended, in others no median found.
    let medians: Vec<[f32; 4]> = (0..700)
        .map(|pixel| match pixel % 7 {
            0 => [0.0; 4],
            1 => [0.0, 0.0, 0.0, random.between(0.01, 0.5)],
            _ => [
                random.between(0.01, 9.0),
                random.between(9.0, 12.0),
                0.0,
                1.0,
            ],
        })
        .collect();
    let asked = [Plane::Instance, Plane::RangeMedian];
    let outputs = Outputs {
        planes: asked.into(),
        ..Outputs::default()
    };
    let images = OutputBuffers::new(&gpu, medians.len(), 0, &outputs).unwrap();
    gpu.write(&images.planes, 0, &vec![UNTOUCHED; images.planes.len()])
        .unwrap();
    let (resolve, blended) = (ResolvePlane::new(&gpu).unwrap(), upload(&gpu, &medians));
    run(&gpu, |r| {
        // The last was not asked for.
        for plane in [Plane::RangeMedian, Plane::DepthMedian] {
            resolve.record(r, plane, &blended, &images);
        }
    });
    let words = gpu.read(&images.planes).unwrap();
    assert_eq!(words.len(), 2 * medians.len());
    let instances = &words[images.plane_words(Plane::Instance).unwrap()];
    assert!(instances.iter().all(|&word| word == UNTOUCHED));
    assert!(images.plane_words(Plane::DepthMedian).is_none());
    let bits = |plane| -> Vec<u32> {
        let values = resolve_plane(&medians, plane);
        values.iter().map(|value| value.to_bits()).collect()
    };
    let found = &words[images.plane_words(Plane::RangeMedian).unwrap()];
    identical("medians", found, &bits(Plane::RangeMedian)).unwrap();
    let others = identical("medians", found, &bits(Plane::DepthMedian));
    assert!(others.is_err(), "the other median is seen");
}
