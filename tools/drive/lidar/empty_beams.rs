//! Beams of a sensor that met nothing in a scan, and what a scene has there.

use std::collections::HashSet;

use anyhow::{Context, Result};
use decouplegs::render::{FrameSplats, LidarRenderer};
use decouplegs::scene::lidar::{Beam, ReturnMode, ReturnOptions};
use decouplegs::scene::{LidarModel, Pose};
use glam::DVec3;
use serde_json::{Value, json};

use super::scan_comparison::fired_at_once;

/// Angle about a beam within which a point of the scan is its own, degrees: a calibrated sensor's
/// rows are up to 0.2 degrees off.
const OWN_DEG: f64 = 0.3;
/// Side of the parts of the sphere that must have points of the scan, degrees: a scan may be of one
/// side of the vehicle alone.
const SEEN_DEG: f64 = 3.0;

/// Beams of a sensor without a point in a scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EmptyBeams {
    /// Beams in all directions.
    pub all: ExtraReturns,
    /// Beams of them that look up. Most others met dark ground nearby, or the vehicle itself.
    pub above_horizon: ExtraReturns,
}

/// Returns of a scene for beams that have none in a scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExtraReturns {
    /// Number of beams.
    pub beams: usize,
    /// Number of them for which the scene has a return all the same.
    pub extra: usize,
    /// Median range of these returns, meters; not a number without one.
    pub median_m: f64,
}

impl EmptyBeams {
    /// Traces the beams of `model` that have no point among `points_m`, all fired at
    /// `world_from_lidar` at once, through `splats`.
    ///
    /// # Errors
    /// Returns an error if the device has not the memory or was lost.
    pub fn new<'a>(
        lidars: &mut LidarRenderer,
        splats: impl Into<FrameSplats<'a>>,
        (model, points_m): (&LidarModel, &[DVec3]),
        world_from_lidar: Pose,
    ) -> Result<Self> {
        let rays = empty(&model.beams(), points_m);
        let looks_up = |beam: &Beam| (world_from_lidar.rotation * beam.direction).z > 0.0;
        let looks_up: Vec<bool> = rays.iter().map(looks_up).collect();
        let mut found_m: Vec<(bool, f32)> = Vec::new();
        if !rays.is_empty() {
            let lidar = fired_at_once(rays, model.range_m, world_from_lidar);
            let traced = lidars
                .trace(splats, &lidar, ReturnMode::Median)
                .context("the beams without a point in the scan cannot be traced")?;
            let sweep = traced.returns(&ReturnOptions::for_model(&lidar.model));
            let found = sweep.returns.iter();
            found_m.extend(found.map(|found| (looks_up[found.beam as usize], found.range_m)));
        }
        let above = looks_up.iter().filter(|looks_up| **looks_up).count();
        let above_m = found_m.iter().filter(|(looks_up, _)| *looks_up);
        Ok(Self {
            all: ExtraReturns::new(looks_up.len(), found_m.iter().map(|found| found.1)),
            above_horizon: ExtraReturns::new(above, above_m.map(|found| found.1)),
        })
    }

    pub fn to_json(self) -> Value {
        let mut value = self.all.to_json();
        value["above_horizon"] = self.above_horizon.to_json();
        value
    }

    /// Two lines for a person.
    pub fn to_text(self) -> String {
        format!(
            "beams without a return in the scan: {}\n  above the horizon, mostly the sky: {}\n",
            self.all.to_text(),
            self.above_horizon.to_text()
        )
    }
}

impl ExtraReturns {
    /// The returns at `ranges_m`, in any order, of `beams` beams.
    fn new(beams: usize, ranges_m: impl Iterator<Item = f32>) -> Self {
        let mut ranges_m: Vec<f32> = ranges_m.collect();
        ranges_m.sort_by(f32::total_cmp);
        let median_m = ranges_m.get(ranges_m.len() / 2);
        Self {
            beams,
            extra: ranges_m.len(),
            median_m: median_m.map_or(f64::NAN, |range_m| f64::from(*range_m)),
        }
    }

    /// Share of them that the scene has a return for; not a number of none.
    fn share(&self) -> f64 {
        self.extra as f64 / self.beams as f64
    }

    fn to_json(self) -> Value {
        json!({
            "beams": self.beams,
            "extra": self.extra,
            "share": self.share(),
            "median_m": self.median_m,
        })
    }

    fn to_text(self) -> String {
        match self.beams {
            0 => "none".into(),
            beams => format!(
                "{beams}; the scene has one for {:.1} %, at {:.1} m in the median",
                100.0 * self.share(),
                self.median_m
            ),
        }
    }
}

/// Part of the sphere around the sensor, by azimuth and elevation, that `direction` is in.
fn part(direction: DVec3, side_deg: f64) -> [i32; 2] {
    let azimuth_deg = direction.y.atan2(direction.x).to_degrees();
    let elevation_deg = direction.z.clamp(-1.0, 1.0).asin().to_degrees();
    [azimuth_deg, elevation_deg].map(|angle_deg| (angle_deg / side_deg).floor() as i32)
}

/// Parts next to `own`, and itself.
fn around([azimuth, elevation]: [i32; 2]) -> impl Iterator<Item = [i32; 2]> {
    (-1..=1).flat_map(move |a| (-1..=1).map(move |e| [azimuth + a, elevation + e]))
}

/// Beams with no point of a scan near them, on sides that the scan saw: fired at once.
fn empty(beams: &[Beam], points_m: &[DVec3]) -> Vec<Beam> {
    let directions = points_m.iter().filter_map(|point| point.try_normalize());
    let directions: Vec<DVec3> = directions.collect();
    let of = |side_deg: f64| -> HashSet<[i32; 2]> {
        let parts = directions.iter().map(|at| part(*at, side_deg));
        parts.collect()
    };
    let (own, seen) = (of(OWN_DEG), of(SEEN_DEG));
    let is_empty = |beam: &&Beam| {
        around(part(beam.direction, SEEN_DEG)).any(|part| seen.contains(&part))
            && !around(part(beam.direction, OWN_DEG)).any(|part| own.contains(&part))
    };
    let fired_at_once = |beam: &Beam| Beam {
        time_s: 0.0,
        ..*beam
    };
    beams.iter().filter(is_empty).map(fired_at_once).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn beam(azimuth_deg: f64, elevation_deg: f64) -> Beam {
        let (azimuth, elevation) = (azimuth_deg.to_radians(), elevation_deg.to_radians());
        let flat = elevation.cos();
        Beam {
            direction: DVec3::new(azimuth.cos() * flat, azimuth.sin() * flat, elevation.sin()),
            time_s: 0.01,
            ring: 0,
            laser: 0,
            column: 0,
        }
    }

    #[test]
    fn beams_without_a_point_are_empty_where_the_scan_looked() {
        // Ahead, every degree from -20 to 20, but for 3 to 8 degrees, which met the sky.
        let beams: Vec<Beam> = (-20..=20)
            .map(|at| beam(f64::from(at) + 0.1, 1.0))
            .collect();
        let points: Vec<DVec3> = (-20..=20)
            .filter(|at| !(3..=8).contains(at))
            .map(|at| 10.0 * beam(f64::from(at), 1.1).direction)
            .collect();
        let found = empty(&beams, &points);
        assert_eq!(found.len(), 6, "{found:?}");
        assert!(found.iter().all(|beam| beam.time_s == 0.0));
        // Nobody knows of what is behind, where the scan has no point at all.
        assert!(empty(&[beam(180.0, 1.0)], &points).is_empty());
        assert!(empty(&beams, &[]).is_empty());
    }

    #[test]
    fn they_are_told_in_words_and_numbers() {
        let all = ExtraReturns::new(200, (0..50).map(|at| 12.34 + at as f32 - 25.0));
        let above_horizon = ExtraReturns::new(0, std::iter::empty());
        assert_eq!((all.share(), all.extra), (0.25, 50));
        let some = EmptyBeams { all, above_horizon };
        let text = some.to_text();
        assert!(
            text.contains("200; the scene has one for 25.0 %, at 12.3 m"),
            "{text}"
        );
        assert!(text.contains("mostly the sky: none"), "{text}");
        let value = some.to_json();
        assert_eq!(value["extra"], 50);
        assert!(value["above_horizon"]["share"].is_null());
    }
}
