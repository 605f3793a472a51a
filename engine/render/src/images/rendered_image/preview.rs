//! Previews of planes: images in which people see what a plane holds.

use super::Image;
use crate::plane::{Plane, PlaneValues};

/// Distances near and far, equal steps of their logarithm apart (after Turbo by Anton Mikhailov,
/// 2019).
const DISTANCES: [[f32; 3]; 6] = [
    [0.9, 0.3, 0.1],
    [0.95, 0.75, 0.2],
    [0.5, 0.95, 0.3],
    [0.1, 0.8, 0.75],
    [0.25, 0.45, 0.95],
    [0.2, 0.1, 0.35],
];

/// Range of distances that previews tell apart, meters.
const DISTANCE_RANGE_M: [f32; 2] = [1.0, 200.0];

/// Most of the pixels are shown below full color: the largest hundredth is not.
const SHOWN_SHARE: f64 = 0.99;

/// A preview of `plane` of `image`; `None` where it was not asked for.
///
/// Distances go from red (1 m) over green to blue (200 m). Normals are 0.5 (n + 1). Flow and scene
/// flow have the hue of their direction, from above for scene flow, and grow brighter with their
/// length, up to that of the pixel at 99 % of all. Instances have a color each.
#[must_use]
pub fn preview(image: &Image, plane: Plane) -> Option<Image> {
    let rgb: Vec<[f32; 3]> = match (plane, image.planes.get(&plane)?) {
        (_, PlaneValues::U16(values)) => values.iter().map(|&value| of_instance(value)).collect(),
        (Plane::Normal, PlaneValues::F32(values)) => (values.chunks_exact(3))
            .map(|n| [n[0], n[1], n[2]].map(|value| 0.5 * (value + 1.0)))
            .collect(),
        (_, PlaneValues::F32(values)) => match plane.channels() {
            1 => values.iter().map(|&value| distance_color(value)).collect(),
            channels => of_vectors(values, channels),
        },
    };
    let alpha = image.alpha.iter();
    Some(Image {
        rgb: (rgb.into_iter().zip(alpha))
            .map(|(rgb, &alpha)| if alpha > 0.0 { rgb } else { [0.0; 3] })
            .collect(),
        ..Image::filled(image.width, image.height, [0.0; 3])
    })
}

/// Color of a distance: from red (1 m) over green to blue (200 m).
#[must_use]
pub fn distance_color(distance_m: f32) -> [f32; 3] {
    let [near_m, far_m] = DISTANCE_RANGE_M;
    let share = (distance_m.max(near_m) / near_m).ln() / (far_m / near_m).ln();
    let position = share.clamp(0.0, 1.0) * (DISTANCES.len() - 1) as f32;
    let below = (position as usize).min(DISTANCES.len() - 2);
    let share = position - below as f32;
    std::array::from_fn(|channel| {
        DISTANCES[below][channel] * (1.0 - share) + DISTANCES[below + 1][channel] * share
    })
}

/// Hues a golden section apart; the background is dark gray.
fn of_instance(instance: u16) -> [f32; 3] {
    if instance == 0 {
        return [0.15; 3];
    }
    of_hue(f32::from(instance) * 0.618_034, 1.0)
}

/// Colors of vectors by the direction and length of their first two values.
fn of_vectors(values: &[f32], channels: usize) -> Vec<[f32; 3]> {
    let vectors = || values.chunks_exact(channels);
    let mut lengths: Vec<f32> = vectors()
        .map(|vector| vector[0].hypot(vector[1]))
        .filter(|length| *length > 0.0)
        .collect();
    lengths.sort_by(f32::total_cmp);
    let last = lengths.len().saturating_sub(1);
    let full = lengths.get((last as f64 * SHOWN_SHARE) as usize);
    let full = full.copied().unwrap_or(1.0);
    let color = |vector: &[f32]| {
        let turns = vector[1].atan2(vector[0]) / std::f32::consts::TAU;
        of_hue(turns, (vector[0].hypot(vector[1]) / full).min(1.0))
    };
    vectors().map(color).collect()
}

/// The color of a hue, in turns from red, of the given brightness.
fn of_hue(turns: f32, brightness: f32) -> [f32; 3] {
    [0.0, 1.0 / 3.0, 2.0 / 3.0].map(|of_channel| {
        let away = (turns - of_channel).rem_euclid(1.0);
        let away = away.min(1.0 - away);
        brightness * (2.0 - 6.0 * away).clamp(0.0, 1.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plane::PlaneMap;

    fn image(plane: Plane, values: PlaneValues, pixels: u32) -> Image {
        Image {
            planes: PlaneMap::from([(plane, values)]),
            alpha: vec![1.0; pixels as usize],
            ..Image::filled(pixels, 1, [0.0; 3])
        }
    }

    #[test]
    fn directions_have_hues_and_lengths_brightness() {
        let values = vec![2.0, 0.0, 0.0, 0.0, -2.0, 0.0];
        let flow = image(Plane::FlowForward, PlaneValues::F32(values), 3);
        let shown = preview(&flow, Plane::FlowForward).unwrap().rgb;
        assert!((shown[0][0], shown[0][1]) == (1.0, 0.0) && shown[0][2] < 1e-6);
        assert_eq!(shown[1], [0.0; 3]);
        assert!(
            shown[2][0] == 0.0 && shown[2][1] > 0.9 && shown[2][2] > 0.9,
            "{shown:?}"
        );
    }

    #[test]
    fn distances_normals_and_instances_are_told_apart() {
        let range = image(Plane::Range, PlaneValues::F32(vec![1.0, 200.0, 5000.0]), 3);
        let shown = preview(&range, Plane::Range).unwrap().rgb;
        assert!(shown[0] == DISTANCES[0] && shown[1] == DISTANCES[5] && shown[2] == shown[1]);
        let normal = image(Plane::Normal, PlaneValues::F32(vec![0.0, 0.0, -1.0]), 1);
        assert_eq!(
            preview(&normal, Plane::Normal).unwrap().rgb,
            [[0.5, 0.5, 0.0]]
        );
        let instance = image(Plane::Instance, PlaneValues::U16(vec![0, 1, 2]), 3);
        let shown = preview(&instance, Plane::Instance).unwrap().rgb;
        assert!(shown[0] != shown[1] && shown[1] != shown[2]);
        assert!(preview(&instance, Plane::Normal).is_none());
    }
}
