//! Lanes: where vehicles drive, as every map format is read into.

use std::collections::HashSet;

use crate::traffic_light::TrafficLight;
use crate::traffic_sign::TrafficSign;
use crate::{Invalid, Pose};
use glam::DVec3;

/// Purpose of a lane.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LaneKind {
    /// Vehicles drive on it.
    #[default]
    Driving,
    /// Lane for bicycles.
    Bicycle,
    /// Pedestrians: sidewalks and crosswalks.
    Walking,
    /// Vehicles stand on it.
    Parking,
    /// Shoulders, borders, medians and whatever else a format names.
    Other,
}

impl LaneKind {
    /// The name it has in files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Driving => "driving",
            Self::Bicycle => "bicycle",
            Self::Walking => "walking",
            Self::Parking => "parking",
            Self::Other => "other",
        }
    }

    /// The kind that a file names so.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        [
            Self::Driving,
            Self::Bicycle,
            Self::Walking,
            Self::Parking,
            Self::Other,
        ]
        .into_iter()
        .find(|kind| kind.name() == name)
    }
}

/// One lane, its lines in driving direction.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Lane {
    /// Id in the file; unique in its map.
    pub id: String,
    /// Purpose of the lane.
    pub kind: LaneKind,
    /// Points of the centerline, at least two, no two neighbors the same, world coordinates in
    /// meters. z is 0 where [`Lane::has_height`] is false.
    pub centerline: Vec<DVec3>,
    /// Left border, none where the file tells nothing of it.
    pub left: Vec<DVec3>,
    /// Right border.
    pub right: Vec<DVec3>,
    /// True if z is the road's height; false if heights are absent.
    pub has_height: bool,
    /// Lanes that it continues in, places in [`LaneMap::lanes`].
    pub successors: Vec<usize>,
    /// Lanes that continue in it.
    pub predecessors: Vec<usize>,
    /// The lane to the left with the same direction.
    pub left_neighbor: Option<usize>,
    /// The lane to the right with the same direction.
    pub right_neighbor: Option<usize>,
    /// Speed limit, meters per second.
    pub speed_limit_mps: Option<f64>,
}

/// All lanes of a place.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LaneMap {
    /// Lanes in the order of the file.
    pub lanes: Vec<Lane>,
    /// Offset that was added to the file's coordinates: zero if these are the file's own. Latitude
    /// and longitude have none, as they are projected.
    pub offset: DVec3,
    /// Traffic lights; without phases where the file tells none.
    pub lights: Vec<TrafficLight>,
    /// Stop and yield signs.
    pub signs: Vec<TrafficSign>,
}

impl LaneMap {
    /// The map moved by `world_from_map`. Lanes without heights keep none.
    #[must_use]
    pub fn placed(mut self, world_from_map: &Pose) -> Self {
        for lane in &mut self.lanes {
            let lines = [&mut lane.centerline, &mut lane.left, &mut lane.right];
            for point in lines.into_iter().flatten() {
                *point = world_from_map.transform(*point);
                if !lane.has_height {
                    point.z = 0.0;
                }
            }
        }
        self
    }

    /// Checks the map and describes the first fault: lines too short, numbers that are not finite,
    /// links beyond the list.
    ///
    /// # Errors
    /// A sentence naming the lane at fault.
    pub fn check(&self) -> Result<(), Invalid> {
        for lane in &self.lanes {
            let id = &lane.id;
            if lane.centerline.len() < 2 {
                return Err(Invalid::new(format!(
                    "lane {id}: a centerline of {} points; expected at least 2",
                    lane.centerline.len()
                )));
            }
            let mut points = lane.centerline.iter().chain(&lane.left).chain(&lane.right);
            if let Some(point) = points.find(|point| !point.is_finite()) {
                return Err(Invalid::new(format!(
                    "lane {id}: a point at {point}; expected finite numbers"
                )));
            }
            let links = lane
                .successors
                .iter()
                .chain(&lane.predecessors)
                .chain(&lane.left_neighbor)
                .chain(&lane.right_neighbor);
            if let Some(link) = links.copied().find(|&link| link >= self.lanes.len()) {
                return Err(Invalid::new(format!(
                    "lane {id}: names lane number {link} of {}",
                    self.lanes.len()
                )));
            }
        }
        if self.lights.is_empty() && self.signs.is_empty() {
            return Ok(());
        }
        let ids: HashSet<&str> = self.lanes.iter().map(|lane| lane.id.as_str()).collect();
        for light in &self.lights {
            let mut lines = light.stop_lines.iter();
            if let Some(line) = lines.find(|line| !ids.contains(line.lane.as_str())) {
                return Err(Invalid::new(format!(
                    "traffic light {}: a stop line on lane {}; expected a lane of the map",
                    light.name, line.lane
                )));
            }
        }
        let mut signs = self.signs.iter();
        if let Some(sign) = signs.find(|sign| !ids.contains(sign.line.lane.as_str())) {
            return Err(Invalid::new(format!(
                "a {} sign on lane {}; expected a lane of the map",
                sign.kind.name(),
                sign.line.lane
            )));
        }
        Ok(())
    }
}
