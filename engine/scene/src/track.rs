//! Tracks: what was seen of a road user over time, before it is known to stand on a road.

use crate::Invalid;
use glam::{DVec2, DVec3};

/// Observed pose of a road user at a moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackPoint {
    /// The moment, seconds.
    pub time_s: f64,
    /// Center of its box from above, world coordinates in meters.
    pub position_m: DVec2,
    /// Height of its center, where the file tells.
    pub z_m: Option<f64>,
    /// Heading, from x towards y.
    pub yaw_rad: Option<f64>,
}

impl TrackPoint {
    /// Position, with height 0 if the height is unknown.
    #[must_use]
    pub fn position(&self) -> DVec3 {
        self.position_m.extend(self.z_m.unwrap_or(0.0))
    }
}

/// One road user over time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Track {
    /// Id in the file; unique there.
    pub id: String,
    /// `car`, `truck`, `pedestrian`: the file's own word, in lower case.
    pub class: String,
    /// Length, width and height, meters, where the file tells.
    pub dims_m: Option<[f64; 3]>,
    /// Points of the track, at least one, times finite and strictly rising.
    pub points: Vec<TrackPoint>,
}

impl Track {
    /// Checks the track and describes the first fault.
    ///
    /// # Errors
    /// A sentence naming the point at fault.
    pub fn check(&self) -> Result<(), Invalid> {
        let id = &self.id;
        if self.points.is_empty() {
            return Err(Invalid::new(format!("track {id}: no points")));
        }
        for (index, point) in self.points.iter().enumerate() {
            let numbers = [
                Some(point.time_s),
                Some(point.position_m.x),
                Some(point.position_m.y),
                point.z_m,
                point.yaw_rad,
            ];
            if numbers.iter().flatten().any(|number| !number.is_finite()) {
                return Err(Invalid::new(format!(
                    "track {id}: point {index} holds a number that is not finite"
                )));
            }
            if index > 0 && point.time_s <= self.points[index - 1].time_s {
                let before = self.points[index - 1].time_s;
                return Err(Invalid::new(format!(
                    "track {id}: point {index} at {} s does not follow the one at {before} s",
                    point.time_s
                )));
            }
        }
        match self.dims_m {
            Some(dims) if dims.iter().any(|dim| !(dim.is_finite() && *dim > 0.0)) => {
                Err(Invalid::new(format!(
                    "track {id}: dimensions {dims:?}; expected length, width and height above zero"
                )))
            }
            _ => Ok(()),
        }
    }
}
