//! Colors of the light of the sky and of direct light, estimated from the colors of the ground.

use glam::DVec3;

use crate::light::{CastingLights, GroundPatch, Lamps, luminance};

/// Deviations of the logarithms of luminance and of red over blue, between ground in one light: the
/// first is that of albedo, while the hue of roads hardly varies.
const SPREAD: [f64; 2] = [0.35, 0.15];

/// Largest deviation of the logarithm of luminance at which ground tells of a light: markings and
/// grates are not of the road's albedo.
const NEAR: f64 = 0.35;

/// Levels that explain the ground worse than the best by no more than this share are as good.
const TIE: f64 = 0.01;

/// Step of that logarithm in the search of the two levels.
const STEP: f64 = 0.02;

/// Area of ground in one light, over all, below which it does not tell the color of that light.
const AREA_MIN: f64 = 0.002;

/// Shares of direct light between none and all.
const SHARES: usize = 20;

/// Linear value that counts as black.
const BLACK: f64 = 1e-6;

/// Light on open level ground, as the ground shows it: light times the albedo of the ground,
/// linear RGB.
#[derive(Clone, Debug, PartialEq)]
pub struct GroundLight {
    /// Light in the shade of the sun, or far from all lamps.
    pub sky: [f64; 3],
    /// Added by the sun, or by a lamp straight above at its range.
    pub direct: [f64; 3],
    /// [`features`] of `sky + share direct` for shares from 0 to 1.
    by_share: [[f64; 2]; SHARES + 1],
}

/// Features that tell lights apart, in deviations: logarithms of luminance and of red over blue.
fn features(color: [f64; 3]) -> [f64; 2] {
    let [red, green, blue] = color.map(|value| value.max(BLACK));
    let values = [luminance([red, green, blue]).ln(), (red / blue).ln()];
    [values[0] / SPREAD[0], values[1] / SPREAD[1]]
}

impl GroundLight {
    /// Distance from the middle of an agent's way at which ground tells of light: most of a lane.
    pub const LANE_M: f64 = 2.5;

    fn new(sky: [f64; 3], direct: [f64; 3]) -> Self {
        let color = |share: usize| -> [f64; 3] {
            let share = share as f64 / SHARES as f64;
            std::array::from_fn(|channel| sky[channel] + share * direct[channel])
        };
        Self {
            sky,
            direct,
            by_share: std::array::from_fn(|share| features(color(share))),
        }
    }

    /// The light that `patches` of ground show under `lights`; `None` without direct light, or if
    /// the patches do not tell.
    #[must_use]
    pub fn from_patches(patches: &[GroundPatch], lights: &CastingLights) -> Option<Self> {
        match lights.sun {
            Some(sun) => Self::of_sun(patches, sun.share),
            None if lights.lamps.positions.is_empty() => None,
            None => Self::of_lamps(patches, &lights.lamps),
        }
    }

    /// Ground in the sun is `1 / (1 - share)` times as bright as ground in the shade, which fixes
    /// the two levels of luminance but for a factor: that which the area within reach of them tells
    /// best. Ground near each level tells its hue. Where all ground is in one light, the other has
    /// the same hue.
    fn of_sun(patches: &[GroundPatch], share: f64) -> Option<Self> {
        let level = |patch: &GroundPatch| (luminance(patch.color).max(BLACK).ln() / STEP) as i32;
        let step = (-(1.0 - share).ln() / STEP).round() as i32;
        let lowest = patches.iter().map(level).min()? - step;
        let highest = patches.iter().map(level).max()?;
        let mut areas = vec![0.0; (highest - lowest + 1) as usize];
        for patch in patches {
            areas[(level(patch) - lowest) as usize] += patch.area_m2;
        }
        let off = |level: i32, shade: i32| {
            let (in_shade, in_sun) = (level - shade, level - shade - step);
            f64::from(in_shade.abs().min(in_sun.abs())) * STEP
        };
        let cost = |shade: i32| -> f64 {
            let levels = areas.iter().zip(lowest..);
            levels
                .map(|(area, level)| area * off(level, shade).min(NEAR).powi(2))
                .sum()
        };
        let costs: Vec<f64> = (lowest..=highest).map(cost).collect();
        let least = costs.iter().copied().fold(f64::INFINITY, f64::min);
        // Of those as good the darkest: all ground is in the sun rather than in the shade.
        let good = costs.iter().position(|cost| *cost <= (1.0 + TIE) * least)?;
        let shade = lowest + good as i32;
        let mut sums = [([0.0; 3], 0.0); 2];
        for patch in patches {
            let level = level(patch);
            if off(level, shade) < NEAR {
                let (color, area) = &mut sums[usize::from(2 * (level - shade) > step)];
                *area += patch.area_m2;
                (0..3).for_each(|channel| color[channel] += patch.area_m2 * patch.color[channel]);
            }
        }
        let seen = AREA_MIN * areas.iter().sum::<f64>();
        let [sky, sunny] = sums.map(|(color, area)| {
            (area > seen).then(|| color.map(|value| (value / area).max(BLACK)))
        });
        let scaled = |color: [f64; 3], factor: f64| color.map(|value| factor * value);
        let sky = sky.or_else(|| sunny.map(|sunny| scaled(sunny, 1.0 - share)))?;
        let sunny = sunny.unwrap_or(scaled(sky, 1.0 / (1.0 - share)));
        let direct = std::array::from_fn(|channel| (sunny[channel] - sky[channel]).max(0.0));
        Some(Self::new(sky, direct))
    }

    /// The least squares of `color = sky + arriving direct` over all patches, errors being in
    /// proportion to the light.
    fn of_lamps(patches: &[GroundPatch], lamps: &Lamps) -> Option<Self> {
        let at = |position: DVec3| -> f64 {
            let of_lamp = |lamp: &DVec3| lamps.arriving(*lamp - position);
            lamps.positions.iter().map(of_lamp).sum()
        };
        let arriving: Vec<f64> = patches.iter().map(|patch| at(patch.center)).collect();
        let (mut sky, mut direct) = ([0.0; 3], [0.0; 3]);
        for channel in 0..3 {
            let (mut sum, mut x, mut y, mut xx, mut xy) = (0.0, 0.0, 0.0, 0.0, 0.0);
            for (patch, arriving) in patches.iter().zip(&arriving) {
                let weight = patch.area_m2 / (1.0 + arriving).powi(2);
                let color = patch.color[channel];
                sum += weight;
                x += weight * arriving;
                y += weight * color;
                xx += weight * arriving * arriving;
                xy += weight * arriving * color;
            }
            let determinant = sum * xx - x * x;
            let is_determined = determinant > 1e-9 * sum * xx;
            if !is_determined {
                return None;
            }
            direct[channel] = ((sum * xy - x * y) / determinant).max(0.0);
            sky[channel] = ((y - direct[channel] * x) / sum).max(BLACK);
        }
        Some(Self::new(sky, direct))
    }

    /// Share of the direct light that ground of `color`, linear, is in, 0 to 1.
    #[must_use]
    pub fn share(&self, color: [f64; 3]) -> f64 {
        let [bright, red] = features(color);
        let off = |at: &[f64; 2]| (at[0] - bright).powi(2) + (at[1] - red).powi(2);
        let nearest = self
            .by_share
            .iter()
            .enumerate()
            .min_by(|a, b| off(a.1).total_cmp(&off(b.1)));
        nearest.map_or(0.0, |(share, _)| share as f64 / SHARES as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::Sun;
    use crate::random;

    const SKY: [f64; 3] = [0.20, 0.19, 0.33];
    const SUN: [f64; 3] = [0.51, 0.25, 0.09];

    fn sun() -> CastingLights {
        CastingLights {
            sun: Some(Sun {
                towards: DVec3::new(1.0, 0.0, 0.3),
                share: luminance(SUN) / (luminance(SUN) + luminance(SKY)),
            }),
            ..CastingLights::default()
        }
    }

    /// Ground of mean albedo 0.15 with markings, of which `light` falls on the patch at x meters.
    fn ground(light: impl Fn(f64) -> [f64; 3]) -> Vec<GroundPatch> {
        let mut state = 5;
        let mut patch = |index: usize| {
            let x = 0.05 * index as f64;
            let marking = index.is_multiple_of(12);
            let albedo = if marking { 0.6 } else { 0.15 };
            let worn = (0.15 * (2.0 * random::unit(random::next(&mut state)) - 1.0)).exp();
            GroundPatch {
                center: DVec3::new(x, 0.0, 0.0),
                color: light(x).map(|value| albedo * worn * value),
                area_m2: 0.5,
            }
        };
        (0..2000).map(&mut patch).collect()
    }

    fn sunlit(share: f64) -> [f64; 3] {
        std::array::from_fn(|channel| SKY[channel] + share * SUN[channel])
    }

    fn off(found: [f64; 3], expected: [f64; 3]) -> f64 {
        let off = |channel: usize| (found[channel] / (0.15 * expected[channel]) - 1.0).abs();
        (0..3).map(off).fold(0.0, f64::max)
    }

    /// Warm sun and blue sky are found where a part of the ground is in the shade, however small or
    /// large.
    #[test]
    fn sun_and_sky_are_told_apart_by_ground_in_the_shade() {
        for shaded_m in [5.0, 50.0, 85.0] {
            let patches = ground(|x| sunlit(if x < shaded_m { 0.0 } else { 1.0 }));
            let found = GroundLight::from_patches(&patches, &sun()).unwrap();
            let worst = off(found.sky, SKY).max(off(found.direct, SUN));
            assert!(worst < 0.1, "{shaded_m}: {found:?}");
            for share in [0.0, 0.4, 1.0] {
                let color = sunlit(share).map(|value| 0.17 * value);
                let estimate = found.share(color);
                assert!((estimate - share).abs() < 0.12, "{estimate} for {share}");
            }
        }
    }

    #[test]
    fn ground_in_one_light_is_in_the_sun() {
        let found = GroundLight::from_patches(&ground(|_| sunlit(1.0)), &sun()).unwrap();
        let gray = luminance(found.sky) / luminance(found.direct);
        assert!((gray - luminance(SKY) / luminance(SUN)).abs() < 0.05);
        assert!(off(found.sky, sunlit(1.0).map(|value| value * 0.44)) < 0.1);
        assert!(GroundLight::from_patches(&[], &sun()).is_none());
        assert!(
            GroundLight::from_patches(&ground(sunlit_by_none), &CastingLights::default()).is_none()
        );
    }

    fn sunlit_by_none(_: f64) -> [f64; 3] {
        SKY
    }

    #[test]
    fn lamps_are_as_bright_as_the_ground_around_them() {
        let lamps = Lamps {
            positions: vec![DVec3::new(20.0, 2.0, 7.0), DVec3::new(60.0, -2.0, 7.0)],
            range_m: 20.0,
        };
        let (night, lamp) = ([0.017, 0.021, 0.036], [0.06, 0.04, 0.02]);
        let light = |x: f64| {
            let of_lamp = |at: &DVec3| lamps.arriving(*at - DVec3::new(x, 0.0, 0.0));
            let arriving: f64 = lamps.positions.iter().map(of_lamp).sum();
            std::array::from_fn(|channel| night[channel] + arriving * lamp[channel])
        };
        let patches = ground(light);
        let lights = CastingLights { sun: None, lamps };
        let found = GroundLight::from_patches(&patches, &lights).unwrap();
        // Markings are as bright as their share in the area says.
        let albedo = 1.0 + 0.6 / 0.15 / 12.0 - 1.0 / 12.0;
        for (found, expected) in [(found.sky, night), (found.direct, lamp)] {
            let worst = off(found, expected.map(|value| albedo * value));
            assert!(worst < 0.15, "{found:?}");
        }
        // Ground in even light tells nothing of lamps that are far away.
        let far = CastingLights {
            sun: None,
            lamps: Lamps {
                positions: vec![DVec3::new(0.0, 0.0, 1e9)],
                ..Lamps::default()
            },
        };
        assert!(GroundLight::from_patches(&ground(sunlit_by_none), &far).is_none());
    }
}
