//! Medians: the splat in which half of a pixel's light is gone.

use decouplegs::render::layout::{COARSE_PIXELS, NO_PARTIAL};
use decouplegs::render::twins::output::{PIXEL_EMPTY, Pixel};
use decouplegs::render::{Outputs, Plane, twins};

use super::{Blended, Case, Images, Rules, open, partials_by_slot};
use crate::stages::{Random, UNTOUCHED, depth_and_range_of};

/// Depth and instance, then both medians.
fn outputs() -> Outputs {
    Outputs {
        planes: [
            Plane::Depth,
            Plane::Instance,
            Plane::DepthMedian,
            Plane::RangeMedian,
        ]
        .into(),
        ..Outputs::default()
    }
}

/// Words of both medians at pixel `target` of `images`.
fn medians_at(images: &Images, target: usize) -> [u32; 2] {
    let pixels = images.images_f32.len();
    [2, 3].map(|plane| images.planes[plane * pixels + target])
}

/// Words of both medians of `pixel`, before which all light was there.
fn medians_of(pixel: &Pixel) -> [u32; 2] {
    match pixel.transmittance.abs() <= 0.5 {
        true => depth_and_range_of(pixel.median).map(f32::to_bits),
        false => [0; 2],
    }
}

/// Pixels of tiles of one segment, how many have medians, and how many other ones than those of
/// `twin`: a rounding decides whether a splat at the limit is blended, or half of the light gone.
fn others(case: &Case, images: &Images, twin: &Blended) -> [usize; 3] {
    let [mut pixels, mut medians, mut others] = [0; 3];
    let whole = case.items.iter().zip(twin);
    for (item, twin) in whole.filter(|(item, _)| item.partial == NO_PARTIAL) {
        for (index, pixel) in twin.iter().enumerate() {
            if let Some((camera, at)) = case.pixel_in_images(item, index) {
                let target = camera.first_pixel + at[1] * camera.size_px[0] + at[0];
                let found = medians_at(images, target as usize);
                pixels += 1;
                medians += usize::from(found != [0; 2]);
                others += usize::from(found != medians_of(pixel));
            }
        }
    }
    [pixels, medians, others]
}

#[test]
fn medians_are_of_single_splats() {
    let gpu = open();
    for (faintness, rules) in [(1.0, Rules::DEFAULT), (0.3, Rules::GSPLAT15)] {
        let case = Case::new(&gpu, 1200, faintness, rules);
        let twin = case.twin(None);
        let (images, partials) = case.kernel_by(&gpu, None, &outputs());
        let [pixels, medians, other] = others(&case, &images, &twin);
        println!("{medians} medians of {pixels} pixels, {other} others");
        assert!(medians > 1000 && other * 500 < pixels, "{other}");
        // Medians of fainter splats are seen.
        let fainter = Case::new(&gpu, 1200, 0.9 * faintness, rules).twin(None);
        assert!(others(&case, &images, &fainter)[2] * 20 > medians);
        // Color and the other planes are what they are alone.
        let (alone, _) = case.kernel(&gpu, None);
        let mut colors = images.images_f32.iter().zip(&alone.images_f32);
        let mut written = alone.planes.iter().map(|&depth| depth != UNTOUCHED);
        assert!(colors.all(|(a, b)| !written.next().unwrap() || a == b));
        let beside = 2 * images.images_f32.len();
        assert!(images.planes[..beside] == alone.planes[..beside]);
        // Segments of cut lists keep theirs.
        let partials = partials_by_slot(&gpu, &partials);
        let [mut pixels, mut other] = [0; 2];
        for (item, twin) in case.items.iter().zip(&twin) {
            let Some(found) = partials.get(item.partial as usize) else {
                continue;
            };
            for (index, (found, twin)) in found.iter().zip(twin).enumerate() {
                let is_inside = case.pixel_in_images(item, index).is_some();
                if is_inside && medians_of(twin) != [0; 2] {
                    pixels += 1;
                    other += usize::from(medians_of(found) != medians_of(twin));
                }
            }
        }
        println!("{other} of {pixels} medians of cut lists are others");
        assert!(pixels > 100 && other * 500 <= pixels);
    }
}

#[test]
fn medians_are_finished_from_what_lies_before() {
    let gpu = open();
    let case = Case::new(&gpu, 1200, 0.6, Rules::DEFAULT);
    let mut random = Random(8);
    // Two of three are to be finished; the word of the others is that of a record.
    let mut pixel = |_| Pixel {
        median: match random.below(3) {
            0 => random.below(1000),
            _ => (-random.between(0.501, 0.999)).to_bits(),
        },
        transmittance: 0.5,
        ..PIXEL_EMPTY
    };
    let before: Blended = (0..case.slots())
        .map(|_| (0..COARSE_PIXELS).map(&mut pixel).collect())
        .collect();
    let (images, _) = case.kernel_by(&gpu, Some(&before), &outputs());
    let share_of_others = |scale: f32| {
        let [mut pixels, mut others] = [0; 2];
        for item in case.items.iter().filter(|item| item.partial != NO_PARTIAL) {
            let before: Vec<f32> = before[item.partial as usize]
                .iter()
                .map(|pixel| f32::from_bits(pixel.median))
                .map(|before| if before < 0.0 { scale * before } else { before })
                .collect();
            let twin = twins::finish_medians(
                &case.scene.view.cameras,
                item,
                &case.records,
                &case.projected.footprints,
                &case.rules,
                &before,
            );
            for (index, record) in twin.into_iter().enumerate() {
                let Some((camera, at)) = case.pixel_in_images(item, index) else {
                    continue;
                };
                let target = camera.first_pixel + at[1] * camera.size_px[0] + at[0];
                let found = medians_at(&images, target as usize);
                let expected = match record {
                    Some(record) => depth_and_range_of(record).map(f32::to_bits),
                    None => [UNTOUCHED; 2],
                };
                pixels += usize::from(record.is_some());
                others += usize::from(found != expected);
            }
        }
        assert!(pixels > 1000, "{pixels} medians");
        others as f64 / pixels as f64
    };
    let (same, other) = (share_of_others(1.0), share_of_others(0.9));
    println!("{same:.5} others, {other:.3} from another light before");
    assert!(same < 0.002 && other > 0.05);
}
