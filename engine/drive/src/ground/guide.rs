//! Heights by order of trust: a survey, splats that are a road, the map, the recorded way of the
//! ego, splats that are none.
//!
//! Images alone leave few splats on a road, and half of these decimeters above or below it. A
//! column of them is noise, four corners are four noises, and a car on it pitches and rolls. A
//! vehicle that was there stood on the road: the way of its wheels is known to centimeters. So
//! where splats are no road ([`GroundQuality::is_road`]), they are a bounded correction of what is
//! known better: the height above the road of a way without one, and heights beside the way.

use decouplegs_scene::{LaneKind, LaneMap, SplatCloud, TimedPose};
use glam::{DMat2, DVec2, DVec3};

use super::quality::{self, GroundQuality, Place, quantile};
use super::surfel::Sample;
use super::way::Way;
use super::{GroundHeight, GroundOptions, SplatGround};
use crate::road_surface::RoadSurface;

/// Height of a vehicle's middle above the road where nothing tells it, meters.
const HEIGHT_M: f64 = 0.75;
/// Largest correction of the height of a way above the road, where it is estimated, meters.
const HEIGHT_OFF_M: f64 = 0.6;
/// Distance to the side within which the way is the road, meters, and that from which on splats
/// correct it in full.
const CORRIDOR_M: [f64; 2] = [2.0, 4.0];
/// Largest correction at the edge of the corridor, meters, and its growth a meter to the side.
const BOUND_M: [f64; 2] = [0.05, 0.08];
/// Standard deviation of wide columns, meters.
const WIDE_SIGMA_M: f64 = 0.7;
/// Columns in which splats are compared with the way: meters to its left.
const LEFTS_M: [f64; 5] = [-1.6, -0.8, 0.0, 0.8, 1.6];
/// Nodes of the way from one row of columns to the next.
const ROW_NODES: usize = 2;
/// Spread beyond which splats do not count: where the fit begins and where it ends, meters.
const SPREADS_M: [f64; 2] = [0.15, 0.06];
/// Rounds of the fit.
const ROUNDS: i32 = 25;
/// A map whose heights depart from the way by less needs no shift, meters.
const SHIFT_MIN_M: f64 = 0.1;
/// Nine of ten heights of a good map depart from the way by less than this, once shifted, meters.
const MAP_OFF_MAX_M: f64 = 0.1;
/// Distance between places on lanes, meters.
const LANE_STEP_M: f64 = 2.0;
/// Places on lanes at most.
const LANE_PLACES_MAX: usize = 20_000;

/// Source of a height.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GroundSource {
    /// A ground mesh or points that come with the scene.
    Survey,
    /// Heights and crossfall of the lanes of a map.
    Map,
    /// The way of the recorded vehicle.
    Way,
    /// Splats of the background.
    Splats,
}

/// Points of the ground, or the middles of the triangles of its mesh, as splats about an origin.
#[derive(Clone, Debug, PartialEq)]
pub struct Survey {
    /// Points, world coordinates, meters.
    pub points_m: Vec<DVec3>,
}

/// The poses of a recorded vehicle.
#[derive(Clone, Copy, Debug)]
pub struct RecordedWay<'a> {
    /// Poses of the vehicle's origin, world coordinates.
    pub poses: &'a [TimedPose],
    /// Height of that origin above the road, meters. `None`: estimated from splats.
    pub height_m: Option<f64>,
}

/// Knowledge of a ground beside its splats.
#[derive(Clone, Copy, Debug, Default)]
pub struct GroundGuides<'a> {
    /// Points of the ground.
    pub survey: Option<&'a Survey>,
    /// Lanes; those that know their heights guide.
    pub map: Option<&'a LaneMap>,
    /// The recorded way.
    pub way: Option<RecordedWay<'a>>,
}

impl<'a> GroundGuides<'a> {
    /// The way of a recorded vehicle alone: its poses, and their height above the road, meters,
    /// where it is known.
    #[must_use]
    pub fn for_way(poses: &'a [TimedPose], height_m: Option<f64>) -> Self {
        Self {
            way: Some(RecordedWay { poses, height_m }),
            ..Self::default()
        }
    }
}

/// Guides, made ready.
pub struct Guide {
    survey: Option<SplatGround>,
    map: Option<MapHeights>,
    way: Option<Way>,
    /// Wide columns, where splats are no road.
    wide: Option<SplatGround>,
    quality: Option<GroundQuality>,
}

struct MapHeights {
    surface: RoadSurface,
    /// Shift that puts the map's heights on the scene, meters.
    up_m: f64,
}

impl Guide {
    /// `guides` beside `splats`, which are those of `cloud`; `None` where they guide nothing.
    pub fn new(splats: &SplatGround, cloud: &SplatCloud, guides: GroundGuides<'_>) -> Option<Self> {
        let survey = guides.survey.map(survey_ground);
        let recorded = guides.way.filter(|way| way.poses.len() > 1);
        let height_m = recorded.and_then(|way| way.height_m);
        let mut way = recorded.and_then(|way| Way::new(way.poses, height_m.unwrap_or(HEIGHT_M)));
        let places = match &way {
            Some(way) => way_places(way),
            None => guides.map.map(lane_places).unwrap_or_default(),
        };
        let measured = quality::measure(splats, &places);
        let mut quality = measured.map(|(places, supported, tilt_deg)| GroundQuality {
            places,
            supported,
            tilt_deg,
            source: GroundSource::Splats,
            height_known: height_m.is_some() || way.is_none(),
        });
        let poor = quality.as_ref().is_some_and(|quality| !quality.is_road());
        if !poor {
            if let Some(quality) = quality.as_mut().filter(|_| survey.is_some()) {
                quality.source = GroundSource::Survey;
            }
            let guide = Self {
                survey,
                map: None,
                way: None,
                wide: None,
                quality,
            };
            return (guide.survey.is_some() || guide.quality.is_some()).then_some(guide);
        }
        if let Some(way) = way.as_mut().filter(|_| height_m.is_none()) {
            way.raise(height_off_m(splats, way));
        }
        let map = guides
            .map
            .and_then(|map| MapHeights::new(map, way.as_ref()));
        if let Some(quality) = &mut quality {
            quality.source = match (&survey, &map, &way) {
                (Some(_), ..) => GroundSource::Survey,
                (None, Some(_), _) => GroundSource::Map,
                (None, None, Some(_)) => GroundSource::Way,
                (None, None, None) => GroundSource::Splats,
            };
        }
        let wide = GroundOptions {
            column_sigma_m: WIDE_SIGMA_M,
            ..splats.options
        };
        Some(Self {
            survey,
            map,
            way,
            wide: Some(SplatGround::new(cloud, splats.origin, &wide)),
            quality,
        })
    }

    pub fn quality(&self) -> Option<&GroundQuality> {
        self.quality.as_ref()
    }

    /// [`Ground::height_at`] by order of trust.
    pub fn height_at(
        &self,
        splats: &SplatGround,
        xy_m: DVec2,
        expected_z_m: Option<f64>,
    ) -> Option<GroundHeight> {
        let surveyed = self
            .survey
            .as_ref()
            .and_then(|survey| survey.height_at(xy_m, expected_z_m));
        if let Some(found) = surveyed {
            return Some(GroundHeight {
                source: GroundSource::Survey,
                ..found
            });
        }
        let Some(wide) = &self.wide else {
            return splats.height_at(xy_m, expected_z_m);
        };
        let (band_m, beside) = (
            splats.options.band_m,
            self.way
                .as_ref()
                .and_then(|way| way.beside(xy_m, expected_z_m)),
        );
        let on_level =
            |z_m: &f64| expected_z_m.is_none_or(|expected| (z_m - expected).abs() <= band_m);
        let mapped = self.map.as_ref().and_then(|map| {
            let near = expected_z_m.or(beside.map(|beside| beside.z_m))?;
            Some(map.surface.height_at(xy_m, near - map.up_m)? + map.up_m)
        });
        let known = |z_m: f64, source: GroundSource| GroundHeight {
            z_m,
            support: 1.0,
            spread_m: 0.0,
            source,
        };
        if let Some(z_m) = mapped.filter(on_level) {
            return Some(known(z_m, GroundSource::Map));
        }
        let Some(beside) = beside.filter(|beside| on_level(&beside.z_m)) else {
            return wide.height_at(xy_m, expected_z_m);
        };
        let away_m = (beside.left_m.abs() - CORRIDOR_M[0]).max(0.0);
        let mut z_m = beside.z_m;
        if away_m > 0.0
            && let Some(found) = wide.height_at(xy_m, Some(z_m))
        {
            let bound_m = BOUND_M[0] + BOUND_M[1] * away_m;
            let share = (away_m / (CORRIDOR_M[1] - CORRIDOR_M[0])).min(1.0);
            z_m += share * (found.z_m - z_m).clamp(-bound_m, bound_m);
        }
        Some(known(z_m, GroundSource::Way))
    }
}

impl MapHeights {
    /// The heights of `map`, if it has some that agree with the way but for a shift.
    fn new(map: &LaneMap, way: Option<&Way>) -> Option<Self> {
        let driving = |lane: &&decouplegs_scene::Lane| lane.kind == LaneKind::Driving;
        if !map.lanes.iter().filter(driving).any(|lane| lane.has_height) {
            return None;
        }
        let surface = RoadSurface::new(map);
        let mut off_m: Vec<f64> = way
            .map(Way::nodes)
            .unwrap_or_default()
            .iter()
            .filter(|node| surface.contains(node.point.truncate()))
            .filter_map(|node| {
                Some(node.point.z - surface.height_at(node.point.truncate(), node.point.z)?)
            })
            .collect();
        if off_m.is_empty() {
            return Some(Self { surface, up_m: 0.0 });
        }
        let middle_m = quantile(&mut off_m, 0.5);
        let mut left_m: Vec<f64> = off_m.iter().map(|off_m| (off_m - middle_m).abs()).collect();
        let up_m = if middle_m.abs() > SHIFT_MIN_M {
            middle_m
        } else {
            0.0
        };
        (quantile(&mut left_m, 0.9) <= MAP_OFF_MAX_M).then_some(Self { surface, up_m })
    }
}

/// Heights of a survey's points: flat discs that overlap.
fn survey_ground(survey: &Survey) -> SplatGround {
    let origin = survey.points_m.first().copied().unwrap_or_default();
    let cloud = survey.cloud(origin);
    SplatGround::new(&cloud, origin, &GroundOptions::default())
}

impl Survey {
    /// The survey of `points_m`; `None` of none.
    #[must_use]
    pub fn from_points(points_m: Vec<DVec3>) -> Option<Self> {
        (!points_m.is_empty()).then_some(Self { points_m })
    }

    /// Radius of the ground that a point stands for, meters.
    const POINT_SIGMA_M: f32 = 0.1;

    /// The points as flat opaque splats about `origin`.
    #[must_use]
    pub fn cloud(&self, origin: DVec3) -> SplatCloud {
        let count = self.points_m.len();
        let relative = |point: &DVec3| (*point - origin).as_vec3().to_array();
        SplatCloud {
            means: self.points_m.iter().map(relative).collect(),
            // Flat, so that the ground is where the points are.
            scales: vec![[Self::POINT_SIGMA_M, Self::POINT_SIGMA_M, 0.01]; count],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; count],
            opacities: vec![1.0; count],
            sh_dc: vec![[0.0; 3]; count],
            ..SplatCloud::default()
        }
    }
}

fn way_places(way: &Way) -> Vec<Place> {
    let place = |(at, node): (usize, &super::way::Node)| Place {
        xy_m: node.point.truncate(),
        z_m: node.point.z,
        ahead: way.ahead(at),
    };
    way.nodes().iter().enumerate().map(place).collect()
}

/// Places along the driving lanes that know their heights.
fn lane_places(map: &LaneMap) -> Vec<Place> {
    let driving = map
        .lanes
        .iter()
        .filter(|lane| lane.kind == LaneKind::Driving && lane.has_height);
    let pairs = driving.flat_map(|lane| lane.centerline.windows(2));
    let mut places = Vec::new();
    for pair in pairs {
        let along = (pair[1] - pair[0]).truncate();
        let steps = (along.length() / LANE_STEP_M).ceil();
        if !steps.is_finite() || places.len() >= LANE_PLACES_MAX {
            break;
        }
        let steps = steps.clamp(1.0, LANE_PLACES_MAX as f64) as u32;
        places.extend((0..steps).map(|step| {
            let at = pair[0].lerp(pair[1], f64::from(step) / f64::from(steps));
            Place {
                xy_m: at.truncate(),
                z_m: at.z,
                ahead: along.normalize_or(DVec2::X),
            }
        }));
    }
    places
}

/// A splat on the road: how far above the way's road it is, how far to the left, and its weight.
struct Residual {
    up_m: f64,
    left_m: f64,
    share: f64,
}

/// Height of the road above the way's, by splats, meters: for a way whose height is not known. What
/// they say of the slope across is worse than what the vehicle did.
fn height_off_m(splats: &SplatGround, way: &Way) -> f64 {
    let residuals = residuals(splats, way);
    let (mut fit, mut spread_m) = (DVec2::ZERO, 4.0 * SPREADS_M[0]);
    for _ in 0..ROUNDS {
        let (mut normal, mut right) = (DMat2::ZERO, DVec2::ZERO);
        for one in &residuals {
            let row = DVec2::new(1.0, one.left_m);
            let off = (one.up_m - fit.dot(row)) / spread_m;
            let weight = one.share * (1.0 - off * off).max(0.0).powi(2);
            normal += DMat2::from_cols(row * row.x, row * row.y) * weight;
            right += row * (weight * one.up_m);
        }
        fit = normal.inverse() * right;
        if !fit.is_finite() {
            return 0.0;
        }
        spread_m = (0.9 * spread_m).max(SPREADS_M[1]);
    }
    fit.x.clamp(-HEIGHT_OFF_M, HEIGHT_OFF_M)
}

fn residuals(splats: &SplatGround, way: &Way) -> Vec<Residual> {
    let (mut found, mut samples): (Vec<Residual>, Vec<Sample>) = (Vec::new(), Vec::new());
    let origin = splats.origin;
    for (at, node) in way.nodes().iter().enumerate().step_by(ROW_NODES) {
        let ahead = way.ahead(at);
        for left_m in LEFTS_M {
            let axis = node.point.truncate() + ahead.perp() * left_m - origin.truncate();
            samples.clear();
            splats.surfels.samples_at(axis, &mut samples);
            for sample in &samples {
                let offset = DVec2::new(f64::from(sample.offset[0]), f64::from(sample.offset[1]));
                let (along_m, left_m) = (ahead.dot(offset), left_m + ahead.perp().dot(offset));
                let road_m = node.point.z + node.grade * along_m + node.left * left_m;
                let up_m = f64::from(sample.height) + origin.z - road_m;
                if up_m.abs() <= HEIGHT_OFF_M {
                    found.push(Residual {
                        up_m,
                        left_m,
                        share: f64::from(sample.share),
                    });
                }
            }
        }
    }
    found
}
