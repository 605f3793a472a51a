//! The largest car of a weather, cut out of its images.

use decouplegs::render::Image;
use decouplegs::render::metrics::difference_image;

use super::reinsert::Sample;

/// White in images of angles, degrees.
pub const ANGLE_MAX_DEG: f64 = 20.0;

/// Margin around the car's box, as a share of it.
const MARGIN: f64 = 0.25;

/// One window of one camera's image, as several drew it; no image where there is no car.
#[derive(Default)]
pub struct ExampleCrops {
    pub time_s: f64,
    pub camera: String,
    pub car: u16,
    /// Caption and image of each panel.
    pub images: Vec<(&'static str, Image)>,
}

/// A part of an image: columns and rows, ends excluded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Window {
    columns: (usize, usize),
    rows: (usize, usize),
}

/// Crops with more pixels of one car: `known`, whose first number counts them, or those of
/// `sample`.
pub fn better(
    known: Option<(usize, ExampleCrops)>,
    sample: &Sample,
    ours: &[Image],
    plain: &[Image],
    floor: f64,
) -> Option<(usize, ExampleCrops)> {
    let found = largest(&sample.truth).and_then(|(pixels, view, car)| {
        let window = window_about(&sample.truth[view], car)?;
        Some((pixels, view, car, window))
    });
    let most = known.as_ref().map_or(0, |(pixels, _)| *pixels);
    let Some((pixels, view, car, window)) = found.filter(|(pixels, ..)| *pixels > most) else {
        return known;
    };
    let truth = &sample.truth[view];
    let angles = angle_image(&ours[view], truth, &sample.vehicles[view], floor);
    let all = [
        ("truth", truth),
        ("ours", &ours[view]),
        ("no relighting", &plain[view]),
        ("angle between ours and truth", &angles),
    ];
    let images = all.map(|(what, image)| (what, cut(image, window))).into();
    Some((
        pixels,
        ExampleCrops {
            time_s: sample.time_s,
            camera: sample.cameras[view].name.clone(),
            car,
            images,
        },
    ))
}

/// The car with the most pixels in one image: how many, which image, which car. One that is cut off
/// by the image's side counts for less.
fn largest(truth: &[Image]) -> Option<(usize, usize, u16)> {
    let mut found: Option<(usize, usize, u16)> = None;
    for (view, image) in truth.iter().enumerate() {
        let instances = image.instance().unwrap_or(&[]);
        let mut counts = std::collections::BTreeMap::<u16, usize>::new();
        instances
            .iter()
            .filter(|&&id| id != 0)
            .for_each(|&id| *counts.entry(id).or_default() += 1);
        for (car, count) in counts {
            let width = image.width as usize;
            let cut_off = instances
                .iter()
                .enumerate()
                .any(|(at, &id)| id == car && (at % width == 0 || at % width == width - 1));
            let worth = if cut_off { count.div_ceil(4) } else { count };
            if found.is_none_or(|(most, ..)| worth > most) {
                found = Some((worth, view, car));
            }
        }
    }
    found
}

fn window_about(image: &Image, car: u16) -> Option<Window> {
    let (width, height) = (image.width as usize, image.height as usize);
    let instances = image.instance()?;
    let positions = || {
        instances
            .iter()
            .enumerate()
            .filter(|(_, id)| **id == car)
            .map(|(at, _)| (at % width, at / width))
    };
    let columns = (
        positions().map(|position| position.0).min()?,
        positions().map(|position| position.0).max()? + 1,
    );
    let rows = (
        positions().map(|position| position.1).min()?,
        positions().map(|position| position.1).max()? + 1,
    );
    let wider = |(from, to): (usize, usize), margin: usize, end: usize| {
        (from.saturating_sub(margin), (to + margin).min(end))
    };
    let margin = (MARGIN * (columns.1 - columns.0).max(rows.1 - rows.0) as f64) as usize + 2;
    Some(Window {
        columns: wider(columns, margin, width),
        rows: wider(rows, margin, height),
    })
}

fn cut(image: &Image, Window { columns, rows }: Window) -> Image {
    let width = image.width as usize;
    let pixels = (rows.0..rows.1)
        .flat_map(|row| (columns.0..columns.1).map(move |column| row * width + column));
    let rgb = pixels.map(|at| image.rgb[at]).collect();
    Image {
        rgb,
        ..Image::filled(
            (columns.1 - columns.0) as u32,
            (rows.1 - rows.0) as u32,
            [0.0; 3],
        )
    }
}

/// The angle between colors of vehicles in false colors, white from [`ANGLE_MAX_DEG`] on; the rest
/// in faint gray.
fn angle_image(found: &Image, truth: &Image, vehicles: &[bool], floor: f64) -> Image {
    let black = Image::filled(truth.width, truth.height, [0.0; 3]);
    let mut angles = black.clone();
    for (at, _) in vehicles
        .iter()
        .enumerate()
        .filter(|(_, is_vehicle)| **is_vehicle)
    {
        angles.rgb[at] =
            [(angle_deg(found.rgb[at], truth.rgb[at], floor) / ANGLE_MAX_DEG) as f32; 3];
    }
    let colored = difference_image(&angles, &black, 1.0).unwrap_or(black);
    let gray = |rgb: &[f32; 3]| [0.25 * rgb.iter().sum::<f32>() / 3.0; 3];
    let rgb =
        colored
            .rgb
            .iter()
            .zip(&truth.rgb)
            .zip(vehicles)
            .map(
                |((colored, truth), is_vehicle)| {
                    if *is_vehicle { *colored } else { gray(truth) }
                },
            );
    Image {
        rgb: rgb.collect(),
        ..colored.clone()
    }
}

/// 0 where the true color is too dark to have a hue.
fn angle_deg(found: [f32; 3], truth: [f32; 3], floor: f64) -> f64 {
    let [found, truth] = [found, truth].map(|rgb| glam::DVec3::from_array(rgb.map(f64::from)));
    if truth.length() < floor || found.length() == 0.0 {
        0.0
    } else {
        found.angle_between(truth).to_degrees()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs::render::{Plane, PlaneMap, PlaneValues};
    use decouplegs::scene::{Camera, Intrinsics, Motion, Pose};

    fn image(instance: Vec<u16>) -> Image {
        Image {
            planes: PlaneMap::from([(Plane::Instance, PlaneValues::U16(instance))]),
            ..Image::filled(8, 4, [0.5; 3])
        }
    }

    #[test]
    fn the_largest_whole_car_is_cut_out() {
        let mut first = vec![0; 32];
        first[2 * 8 + 3] = 7;
        first[2 * 8 + 4] = 7;
        // Larger, but at the left side.
        let mut second = vec![0; 32];
        (0..4).for_each(|row| second[row * 8] = 9);
        let images = [image(second), image(first)];
        assert_eq!(largest(&images), Some((2, 1, 7)));
        let window = window_about(&images[1], 7).unwrap();
        assert_eq!(
            window,
            Window {
                columns: (1, 7),
                rows: (0, 4)
            }
        );
        assert_eq!(cut(&images[1], window).rgb.len(), 24);
        assert_eq!(
            (largest(&[image(vec![0; 32])]), window_about(&images[1], 3)),
            (None, None)
        );
    }

    #[test]
    fn a_moment_without_cars_keeps_what_an_earlier_one_showed() {
        let sample = |instance: Vec<u16>| Sample {
            time_s: 1.5,
            cameras: vec![Camera {
                name: "front".into(),
                intrinsics: Intrinsics::centered([8, 4], 4.0),
                world_from_camera: Pose::IDENTITY,
                motion: Motion::REST,
            }],
            vehicles: vec![instance.iter().map(|&id| id != 0).collect()],
            ground: vec![vec![false; 32]],
            truth: vec![image(instance)],
        };
        let plain = [Image::filled(8, 4, [0.5; 3])];
        let mut shows_car = vec![0; 32];
        shows_car[11] = 7;
        let seen = better(None, &sample(shows_car), &plain, &plain, 0.05);
        assert_eq!(
            seen.as_ref().map(|(pixels, crops)| (*pixels, crops.car)),
            Some((1, 7))
        );
        let kept = better(seen, &sample(vec![0; 32]), &plain, &plain, 0.05).unwrap();
        assert!(kept.1.car == 7 && kept.1.images.len() == 4);
        assert!(better(None, &sample(vec![0; 32]), &plain, &plain, 0.05).is_none());
    }

    #[test]
    fn angles_are_shown_of_vehicles_that_are_bright() {
        let truth = Image::filled(2, 1, [0.5; 3]);
        let found = Image::filled(2, 1, [0.5, 0.0, 0.0]);
        let shown = angle_image(&found, &truth, &[true, false], 0.05);
        assert_eq!((shown.rgb[0], shown.rgb[1]), ([1.0; 3], [0.125; 3]));
        assert_eq!(angle_deg([1.0, 0.0, 0.0], [0.01; 3], 0.05), 0.0);
        assert!((angle_deg([1.0, 0.0, 0.0], [1.0, 1.0, 0.0], 0.05) - 45.0).abs() < 1e-4);
    }
}
