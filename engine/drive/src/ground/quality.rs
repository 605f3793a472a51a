//! Measurement of how well splats show a road.

use glam::DVec2;

use super::{GroundSource, SplatGround};

/// Places that are examined at most, spread evenly.
const PLACES_MAX: usize = 160;
/// Corners of what is set on the road at a place: half its length and width, meters.
const HALF_M: [f64; 2] = [1.5, 0.9];
/// Share of corners with a surface below that a road has.
const SUPPORTED_MIN: f64 = 0.9;
/// Nine of ten places of a road are tilted by less, degrees.
const TILT_MAX_DEG: f64 = 2.0;
/// Places before and after whose median slope is that of the road.
const NEIGHBORS: usize = 5;

/// Figures of how well splats show the road along the recorded way, or along the lanes.
#[derive(Clone, Debug, PartialEq)]
pub struct GroundQuality {
    /// Places that were examined.
    pub places: usize,
    /// Share of the corners of cars there that have a surface below them.
    pub supported: f64,
    /// Slope across a car against that of the road around it: 90 % are below, degrees.
    pub tilt_deg: f64,
    /// Source of heights on the road.
    pub source: GroundSource,
    /// True if the height of the recorded vehicle above the road is given, and not estimated from
    /// splats; also where no way is used.
    pub height_known: bool,
}

impl GroundQuality {
    /// True if the splats are a road by themselves.
    #[must_use]
    pub fn is_road(&self) -> bool {
        self.supported >= SUPPORTED_MIN && self.tilt_deg <= TILT_MAX_DEG
    }

    /// A sentence where heights of the ground may be wrong. `None` where they are well known.
    #[must_use]
    pub fn warning(&self) -> Option<String> {
        if self.is_road() || self.source == GroundSource::Survey {
            return None;
        }
        let figures = format!(
            "splats show the road poorly ({:.0} % of corners have a surface below them, cars would be tilted by up to {:.1} degrees)",
            100.0 * self.supported,
            self.tilt_deg
        );
        Some(match (self.source, self.height_known) {
            (GroundSource::Way, true) => {
                format!("{figures}: heights are those of the recorded way of the ego")
            }
            (GroundSource::Way, false) => format!(
                "{figures}: heights are those of the recorded way of the ego, whose height above the road is estimated; \
                 give `ego_height_m` in the scene file"
            ),
            (GroundSource::Map, _) => format!("{figures}: heights are those of the map"),
            (GroundSource::Splats | GroundSource::Survey, _) => format!(
                "{figures}, and nothing better is known: vehicles may tilt and float; give a map with heights, or [[ego]] poses in \
                 the scene file"
            ),
        })
    }
}

/// A place on the road.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    pub xy_m: DVec2,
    pub z_m: f64,
    pub ahead: DVec2,
}

/// Share of corners with a surface below and the tilt that 90 % of `places` stay below, degrees;
/// `None` without places.
pub fn measure(splats: &SplatGround, places: &[Place]) -> Option<(usize, f64, f64)> {
    if places.is_empty() {
        return None;
    }
    let step = places.len().div_ceil(PLACES_MAX);
    let examined: Vec<Place> = places.iter().step_by(step).copied().collect();
    let heights = |place: &Place| {
        [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]].map(|side: [f64; 2]| {
            let offset = DVec2::new(side[0] * HALF_M[0], side[1] * HALF_M[1]);
            let at = place.xy_m + place.ahead.rotate(offset);
            splats.height_at(at, Some(place.z_m)).map(|found| found.z_m)
        })
    };
    let found: Vec<[Option<f64>; 4]> = examined.iter().map(heights).collect();
    let known = found.iter().flatten().flatten().count();
    // The slope across of two corners, at the front and at the back.
    let slopes: Vec<f64> = found
        .iter()
        .flat_map(|[a, b, c, d]| [(a, b), (c, d)])
        .filter_map(|(left, right)| Some(((*left)? - (*right)?) / (2.0 * HALF_M[1])))
        .collect();
    let mut tilts: Vec<f64> = (0..slopes.len())
        .map(|at| {
            let (from, to) = (
                at.saturating_sub(NEIGHBORS),
                (at + NEIGHBORS + 1).min(slopes.len()),
            );
            let mut near = slopes[from..to].to_vec();
            (slopes[at] - quantile(&mut near, 0.5)).abs()
        })
        .collect();
    let tilt = if tilts.is_empty() {
        0.0
    } else {
        quantile(&mut tilts, 0.9)
    };
    let supported = known as f64 / (4 * examined.len()) as f64;
    Some((examined.len(), supported, tilt.atan().to_degrees()))
}

/// The value that a share of `values`, which are not empty, stays below.
pub fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * share).round() as usize]
}
