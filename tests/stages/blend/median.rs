//! Medians: pixels have the color of the splat in which half of their light is gone.

use decouplegs::render::twins::output::{MEDIAN_FOUND, Pixel};

use super::{Blended, Case, PixelEnd, Rules, open, written_alone};

/// Share of the pixels of `items` in which kernel and twin chose another splat, or only one of them
/// found one. Elsewhere colors are equal to the last bit, as they are copied.
fn share_of_others(found: &[[f32; 4]], twin: &[[f32; 4]]) -> f64 {
    let others = found.iter().zip(twin).filter(|(found, twin)| {
        let is_median = |pixel: &[f32; 4]| pixel[3] == 1.0;
        is_median(found) != is_median(twin) || (is_median(found) && found != twin)
    });
    others.count() as f64 / found.len() as f64
}

/// Pixels of tiles of one segment, as they are written and as the twin has them.
fn written(case: &Case, images: &[[f32; 4]], twin: &Blended) -> [Vec<[f32; 4]>; 2] {
    let mut pixels = [vec![], vec![]];
    let whole = case
        .items
        .iter()
        .zip(twin)
        .filter(|(item, _)| item.partial == u32::MAX);
    for (item, twin) in whole {
        for (index, pixel) in twin.iter().enumerate() {
            if let Some((camera, at)) = case.pixel_in_images(item, index) {
                let target = camera.first_pixel + at[1] * camera.size_px[0] + at[0];
                pixels[0].push(images[target as usize]);
                pixels[1].push(written_alone(pixel).images_f32[0]);
            }
        }
    }
    pixels
}

#[test]
fn medians_are_the_colors_of_single_splats() {
    let gpu = open();
    for faintness in [1.0, 0.3] {
        let mut case = Case::new(&gpu, 1200, faintness, Rules::GSPLAT15);
        case.end = PixelEnd::Median;
        let twin = case.twin(None);
        let (images, partials) = case.kernel(&gpu, None);
        let [found, expected] = written(&case, &images.images_f32, &twin);
        let medians = expected.iter().filter(|pixel| pixel[3] == 1.0).count();
        let others = share_of_others(&found, &expected);
        println!(
            "{medians} medians of {} pixels, {others:.5} others",
            found.len()
        );
        assert!(medians > 1000 && others < 0.002, "{others}");
        // Colors that are sums are seen.
        case.end = PixelEnd::Exclusive;
        let [_, sums] = written(&case, &images.images_f32, &case.twin(None));
        assert!(share_of_others(&found, &sums) > 0.1);
        // The sign of cut lists says where a pixel ends, and the color is that of a splat.
        let cut = case
            .items
            .iter()
            .zip(&twin)
            .filter(|(item, _)| item.partial != u32::MAX);
        let value = |pixel: &Pixel| {
            [
                pixel.color.x,
                pixel.color.y,
                pixel.color.z,
                pixel.transmittance,
            ]
        };
        let (mut pixels, mut other) = (0, 0);
        for (item, twin) in cut {
            for (index, (found, twin)) in
                partials[item.partial as usize].iter().zip(twin).enumerate()
            {
                let is_inside = case.pixel_in_images(item, index).is_some();
                if is_inside && twin.transmittance == -MEDIAN_FOUND {
                    pixels += 1;
                    other += usize::from(value(found) != value(twin));
                }
            }
        }
        println!("{other} of {pixels} medians of cut lists are others");
        assert!(pixels > 100 && other * 500 <= pixels);
    }
}
