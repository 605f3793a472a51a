//! A sweep of a real LiDAR beside the same beams through a scene.

use std::collections::HashMap;
use std::sync::Arc;

use anyhow::{Context, Result};
use decouplegs::asset::Scan;
use decouplegs::render::rendered_image::{Image, distance_color};
use decouplegs::render::{FrameSplats, LidarRenderer, TracedSweep};
use decouplegs::scene::lidar::{Beam, LidarPattern, ReturnMode, ReturnOptions};
use decouplegs::scene::{Lidar, LidarModel, Motion, Pose};
use glam::DVec3;
use serde_json::{Value, json};

use super::empty_beams::EmptyBeams;

/// Beams of one scan that are traced, at most; more are thinned out evenly.
const BEAMS_MAX: usize = 1 << 20;

/// Bounds of the distances that errors are told for, meters.
const DISTANCES_M: [f64; 5] = [0.0, 10.0, 20.0, 40.0, 80.0];

/// A range within this of the real one counts as right, meters.
const RIGHT_M: f64 = 0.2;

/// Side of the cells in which the lowest points are searched, meters.
const GROUND_CELL_M: f64 = 2.0;
/// Height of a point of the ground above the lowest point of its cell and those around it, at most,
/// meters.
const GROUND_ABOVE_M: f64 = 0.25;
/// Depth of the ground below the sensor, at least, meters: sensors stand on vehicles.
const GROUND_BELOW_M: f64 = 1.0;

/// Sizes of the image, pixels: columns around, and rows of each of its three parts.
const IMAGE_PX: [u32; 2] = [1024, 80];
/// An error that is drawn in full color, meters.
const ERROR_SHOWN_M: f32 = 1.0;

/// A beam that came back, and what the scene made of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Met {
    /// Unit direction in the frame of the sensor.
    pub direction: DVec3,
    /// Range of the scan, meters.
    pub real_m: f64,
    /// Range in the scene, meters; `None` where the beam meets nothing.
    pub rendered_m: Option<f64>,
    /// True if the scan's point is of the ground.
    pub is_ground: bool,
}

/// The beams of a scan.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ScanComparison {
    pub met: Vec<Met>,
    /// Beams that came back with nothing, where the sensor is known.
    pub empty: Option<EmptyBeams>,
}

/// Errors of the ranges of some beams.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeErrors {
    /// Beams of the scan.
    pub beams: usize,
    /// Share of them that the scene has no return for.
    pub missing: f64,
    /// Median of the errors, meters: rendered less real.
    pub bias_m: f64,
    /// Median of their sizes, meters.
    pub median_m: f64,
    /// The size that 95 % do not exceed, meters.
    pub p95_m: f64,
    /// Share of the returns within [`RIGHT_M`].
    pub right: f64,
}

impl RangeErrors {
    /// Errors of `met`; `None` of no beam. Without returns, errors are not numbers.
    fn from_met<'a>(met: impl Iterator<Item = &'a Met>) -> Option<Self> {
        let (mut beams, mut errors_m) = (0, Vec::new());
        for met in met {
            beams += 1;
            errors_m.extend(met.rendered_m.map(|rendered_m| rendered_m - met.real_m));
        }
        let returns = errors_m.len();
        let mut sizes_m: Vec<f64> = errors_m.iter().map(|error_m| error_m.abs()).collect();
        errors_m.sort_by(f64::total_cmp);
        sizes_m.sort_by(f64::total_cmp);
        let at = |sorted: &[f64], share: f64| {
            let last = sorted.len().saturating_sub(1);
            sorted
                .get((share * last as f64).round() as usize)
                .copied()
                .unwrap_or(f64::NAN)
        };
        let right = sizes_m.iter().filter(|size_m| **size_m <= RIGHT_M).count();
        (beams > 0).then(|| Self {
            beams,
            missing: (beams - returns) as f64 / beams as f64,
            bias_m: at(&errors_m, 0.5),
            median_m: at(&sizes_m, 0.5),
            p95_m: at(&sizes_m, 0.95),
            right: right as f64 / returns as f64,
        })
    }

    fn to_json(self) -> Value {
        json!({
            "beams": self.beams,
            "missing": self.missing,
            "bias_m": self.bias_m,
            "median_m": self.median_m,
            "p95_m": self.p95_m,
            "within_0.2_m": self.right,
        })
    }
}

impl ScanComparison {
    /// Traces the beams of `scan`, fired at `world_from_lidar` all at once, through `splats`.
    ///
    /// # Errors
    /// Returns an error if the pose makes no sense, or the device has not the memory or was lost.
    pub fn new<'a>(
        lidars: &mut LidarRenderer,
        splats: impl Into<FrameSplats<'a>>,
        scan: &Scan,
        world_from_lidar: Pose,
    ) -> Result<Self> {
        let every = scan.points_m.len().div_ceil(BEAMS_MAX);
        let points: Vec<DVec3> = scan.points_m.iter().copied().step_by(every).collect();
        let beam = |(column, point): (u32, &DVec3)| Beam {
            direction: point.normalize(),
            time_s: 0.0,
            ring: 0,
            laser: 0,
            column,
        };
        let rays = (0..).zip(&points).map(beam).collect();
        let lidar = fired_at_once(rays, [0.0, 1e5], world_from_lidar);
        let traced = lidars
            .trace(splats, &lidar, ReturnMode::Median)
            .context("the beams of the scan cannot be traced")?;
        Ok(Self::of_sweep(&points, &traced))
    }

    /// This comparison with the beams of `model` that have no point in `scan`.
    ///
    /// # Errors
    /// Returns an error if the device has not the memory or was lost.
    pub fn with_empty_beams<'a>(
        mut self,
        lidars: &mut LidarRenderer,
        splats: impl Into<FrameSplats<'a>>,
        (model, scan): (&LidarModel, &Scan),
        world_from_lidar: Pose,
    ) -> Result<Self> {
        let given = (model, scan.points_m.as_slice());
        self.empty = Some(EmptyBeams::new(lidars, splats, given, world_from_lidar)?);
        Ok(self)
    }

    fn of_sweep(points: &[DVec3], traced: &TracedSweep) -> Self {
        let mut met: Vec<Met> = points
            .iter()
            .zip(of_ground(points))
            .map(|(point, is_ground)| Met {
                direction: point.normalize(),
                real_m: point.length(),
                rendered_m: None,
                is_ground,
            })
            .collect();
        let sweep = traced.returns(&ReturnOptions::for_model(&traced.lidar.model));
        for found in &sweep.returns {
            met[found.beam as usize].rendered_m = Some(f64::from(found.range_m));
        }
        Self { met, empty: None }
    }

    /// Errors of all beams.
    pub fn all(&self) -> Option<RangeErrors> {
        RangeErrors::from_met(self.met.iter())
    }

    /// Errors by distance: the least and greatest of the scan's ranges, meters, and the errors of
    /// the beams between.
    pub fn by_distance(&self) -> Vec<([f64; 2], RangeErrors)> {
        let bins = DISTANCES_M.windows(2).map(|ends| [ends[0], ends[1]]);
        let of_bin = |[from_m, to_m]: [f64; 2]| {
            let within = |met: &&Met| (from_m..to_m).contains(&met.real_m);
            let errors = RangeErrors::from_met(self.met.iter().filter(within));
            errors.map(|errors| ([from_m, to_m], errors))
        };
        bins.filter_map(of_bin).collect()
    }

    /// Errors by class: of points of the ground, and of all others.
    pub fn by_class(&self) -> Vec<(&'static str, RangeErrors)> {
        let of = |is_ground: bool| {
            let own = self
                .met
                .iter()
                .filter(move |met| met.is_ground == is_ground);
            RangeErrors::from_met(own)
        };
        let classes = [("ground", of(true)), ("all else", of(false))];
        classes
            .into_iter()
            .filter_map(|(name, errors)| Some((name, errors?)))
            .collect()
    }

    /// Median distance of the scene's ground from the scan's across the beams' heights, meters;
    /// `None` without returns of the ground.
    pub fn ground_height_error_m(&self) -> Option<f64> {
        let error = |met: &Met| {
            let range_error_m = met.rendered_m? - met.real_m;
            met.is_ground
                .then(|| (range_error_m * met.direction.z).abs())
        };
        let mut errors_m: Vec<f64> = self.met.iter().filter_map(error).collect();
        errors_m.sort_by(f64::total_cmp);
        errors_m.get(errors_m.len() / 2).copied()
    }

    pub fn to_json(&self) -> Value {
        let class = |(name, errors): (&str, RangeErrors)| {
            let mut value = errors.to_json();
            value["class"] = json!(name);
            value
        };
        let bin = |([from_m, to_m], errors): ([f64; 2], RangeErrors)| {
            let mut value = errors.to_json();
            value["from_m"] = json!(from_m);
            value["to_m"] = json!(to_m);
            value
        };
        json!({
            "all": self.all().map(RangeErrors::to_json),
            "by_distance": self.by_distance().into_iter().map(bin).collect::<Vec<_>>(),
            "by_class": self.by_class().into_iter().map(class).collect::<Vec<_>>(),
            "ground_height_error_m": self.ground_height_error_m(),
            "empty_beams": self.empty.map(EmptyBeams::to_json),
        })
    }

    /// Lines of a table.
    pub fn to_text(&self) -> String {
        let mut text = format!(
            "{:<14} {:>8} {:>9} {:>9} {:>10} {:>8} {:>13}\n",
            "range", "beams", "missing", "bias, m", "median, m", "95 %, m", "within 0.2 m"
        );
        let line = |what: &str, errors: &RangeErrors| {
            format!(
                "{what:<14} {:>8} {:>7.1} % {:>9.3} {:>10.3} {:>8.2} {:>11.1} %\n",
                errors.beams,
                100.0 * errors.missing,
                errors.bias_m,
                errors.median_m,
                errors.p95_m,
                100.0 * errors.right
            )
        };
        for ([from_m, to_m], errors) in &self.by_distance() {
            text += &line(&format!("{from_m:.0} to {to_m:.0} m"), errors);
        }
        for (name, errors) in &self.by_class() {
            text += &line(name, errors);
        }
        if let Some(errors) = self.all() {
            text += &line("all", &errors);
        }
        if let Some(error_m) = self.ground_height_error_m() {
            text += &format!("height of the ground: {error_m:.3} m off (median)\n");
        }
        text += &self.empty.map_or_else(String::new, EmptyBeams::to_text);
        text
    }

    /// Ranges of the scan, those of the scene, and their differences, one below the other: around
    /// from behind over the left, the front and the right, and from the highest beam down. Errors
    /// are red where the scene is too far, blue where it is too near, and white where it has no
    /// return.
    pub fn image(&self) -> Image {
        let [width, rows] = IMAGE_PX;
        let mut image = Image::filled(width, 3 * rows, [0.1; 3]);
        let elevation = |met: &Met| met.direction.z.asin();
        let (low, high) = self
            .met
            .iter()
            .map(elevation)
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), angle| {
                (low.min(angle), high.max(angle))
            });
        let place =
            |share: f64, count: u32| (share * f64::from(count)).min(f64::from(count) - 1.0) as u32;
        for met in &self.met {
            let around = 0.5 - met.direction.y.atan2(met.direction.x) / std::f64::consts::TAU;
            let down = (high - elevation(met)) / (high - low).max(1e-9);
            let (column, row) = (place(around.clamp(0.0, 1.0), width), place(down, rows));
            let mut set = |part: u32, rgb: [f32; 3]| {
                image.rgb[((part * rows + row) * width + column) as usize] = rgb;
            };
            set(0, distance_color(met.real_m as f32));
            match met.rendered_m {
                None => set(2, [1.0; 3]),
                Some(rendered_m) => {
                    set(1, distance_color(rendered_m as f32));
                    set(2, error_color((rendered_m - met.real_m) as f32));
                }
            }
        }
        image
    }
}

/// A LiDAR that stands at `world_from_lidar` and fires `rays` at once, without noise.
pub(super) fn fired_at_once(rays: Vec<Beam>, range_m: [f64; 2], world_from_lidar: Pose) -> Lidar {
    Lidar {
        name: "scan".into(),
        model: Arc::new(LidarModel {
            name: "scan".into(),
            pattern: LidarPattern::Rays(rays),
            sweep_s: 0.1,
            range_m,
            returns: ReturnMode::Median,
            range_noise_m: 0.0,
        }),
        rig_from_lidar: Pose::IDENTITY,
        world_from_rig: world_from_lidar,
        motion: Motion::REST,
    }
}

/// Points of the ground: near the lowest ones around them, and well below the sensor.
fn of_ground(points: &[DVec3]) -> Vec<bool> {
    let cell = |point: &DVec3| [point.x, point.y].map(|at| (at / GROUND_CELL_M).floor() as i32);
    let mut lowest: HashMap<[i32; 2], f64> = HashMap::new();
    for point in points {
        let low = lowest.entry(cell(point)).or_insert(f64::INFINITY);
        *low = low.min(point.z);
    }
    let is_ground = |point: &DVec3| {
        let [x, y] = cell(point);
        let around = (0..9).filter_map(|at| lowest.get(&[x + at % 3 - 1, y + at / 3 - 1]));
        let low_m = around.copied().fold(f64::INFINITY, f64::min);
        point.z <= -GROUND_BELOW_M && point.z <= low_m + GROUND_ABOVE_M
    };
    points.iter().map(is_ground).collect()
}

/// Red above zero, blue below, dark where small.
fn error_color(error_m: f32) -> [f32; 3] {
    let share = (error_m / ERROR_SHOWN_M).clamp(-1.0, 1.0);
    let faint = 0.25 * (1.0 - share.abs());
    [faint + share.max(0.0), faint, faint + (-share).max(0.0)].map(|value| value.min(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn met(real_m: f64, rendered_m: Option<f64>) -> Met {
        Met {
            direction: DVec3::X,
            real_m,
            rendered_m,
            is_ground: false,
        }
    }

    #[test]
    fn the_ground_is_low_and_told_apart() {
        // A flat road 1.7 m below the sensor, a kerb's wall on it, and a sign.
        let mut points: Vec<DVec3> = (0..40).map(|at| DVec3::new(at as f64, 1.0, -1.7)).collect();
        points.extend([DVec3::new(5.0, 1.0, -1.2), DVec3::new(6.0, 1.0, 0.5)]);
        let ground = of_ground(&points);
        assert!(ground[..40].iter().all(|is_ground| *is_ground));
        assert_eq!(ground[40..], [false, false]);
        let down = DVec3::new(0.8, 0.0, -0.6);
        let road = Met {
            direction: down,
            is_ground: true,
            ..met(10.0, Some(10.5))
        };
        let comparison = ScanComparison {
            met: vec![road, met(3.0, Some(4.0))],
            empty: None,
        };
        assert!((comparison.ground_height_error_m().unwrap() - 0.3).abs() < 1e-9);
        let classes = comparison.by_class();
        assert_eq!(
            (classes[0].0, classes[0].1.beams, classes[1].1.beams),
            ("ground", 1, 1)
        );
    }

    #[test]
    fn errors_are_told_by_distance() {
        let comparison = ScanComparison {
            met: vec![
                met(5.0, Some(5.1)),
                met(6.0, Some(5.9)),
                met(7.0, Some(8.0)),
                met(15.0, None),
                met(16.0, Some(16.0)),
                met(100.0, Some(100.0)),
            ],
            empty: None,
        };
        let bins = comparison.by_distance();
        assert_eq!(bins.len(), 2, "{bins:?}");
        let (ends, near) = &bins[0];
        assert_eq!((*ends, near.beams, near.missing), ([0.0, 10.0], 3, 0.0));
        assert!((near.bias_m - 0.1).abs() < 1e-9 && (near.median_m - 0.1).abs() < 1e-9);
        assert!((near.p95_m - 1.0).abs() < 1e-9 && (near.right - 2.0 / 3.0).abs() < 1e-9);
        assert_eq!((bins[1].1.beams, bins[1].1.missing), (2, 0.5));
        let all = comparison.all().unwrap();
        assert_eq!((all.beams, all.right), (6, 0.8));
        assert_eq!(ScanComparison::default().all(), None);
        assert!(comparison.to_text().contains("10 to 20 m"));
    }

    #[test]
    fn an_image_shows_ranges_and_errors() {
        let comparison = ScanComparison {
            met: vec![
                met(10.0, Some(12.0)),
                Met {
                    direction: DVec3::Z,
                    ..met(3.0, None)
                },
            ],
            empty: None,
        };
        let image = comparison.image();
        assert_eq!([image.width, image.height], [1024, 240]);
        // Forward is in the middle; the beam is the lowest of both.
        let at = |row: u32| image.rgb[(row * 1024 + 512) as usize];
        assert_eq!(at(79), distance_color(10.0));
        assert_eq!(at(159), distance_color(12.0));
        assert_eq!(at(239), [1.0, 0.0, 0.0]);
    }
}
