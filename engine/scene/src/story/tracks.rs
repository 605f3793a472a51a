//! Road users of a story that follow recorded tracks.

use serde::{Deserialize, Serialize};

use super::kind_by_name;
use crate::Invalid;
use crate::road_user::RoadUser;
use crate::vehicle::VehicleSize;

/// Rule by which recorded vehicles are handed over to the driver model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Handover {
    /// Never: all follow their tracks, whatever is in their way.
    Never,
    /// Near the ego, or a vehicle that was handed over: where one is in the way of what was
    /// recorded.
    #[default]
    Near,
    /// All vehicles, from their first moment on.
    All,
}

impl Handover {
    /// All rules.
    pub const ALL: [Self; 3] = [Self::Never, Self::Near, Self::All];

    /// Name in files and on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Never => "never",
            Self::Near => "near",
            Self::All => "all",
        }
    }

    /// Rule with a name.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|rule| rule.name() == name)
    }
}

/// Recorded road users of a scenario.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tracks {
    /// Rule of handovers.
    #[serde(default)]
    pub handover: Handover,
    /// Road users, each with its track.
    #[serde(default, rename = "agent", skip_serializing_if = "Vec::is_empty")]
    pub agents: Vec<TrackedAgent>,
}

impl Tracks {
    pub(super) fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// Road user with its recorded track.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrackedAgent {
    /// Unique among the agents of the scenario.
    pub name: String,
    /// Kind of road user. Pedestrians are never handed over.
    #[serde(with = "kind_by_name")]
    pub kind: RoadUser,
    /// Index among the assets of its kind; indices beyond the last start over.
    pub asset: usize,
    /// Length, width and height of the box, meters.
    pub size_m: [f64; 3],
    /// Times of the poses since the start of the scenario, seconds; they rise. It is on the map
    /// from the first to the last.
    pub times_s: Vec<f64>,
    /// Middle of the box from above, world coordinates in meters, and heading, radians from x
    /// towards y.
    pub poses: Vec<[f64; 3]>,
}

impl TrackedAgent {
    /// Size of the box.
    #[must_use]
    pub fn size(&self) -> VehicleSize {
        VehicleSize::from_array(self.size_m)
    }

    /// Checks that there is a pose for each time, that times rise, and that numbers are finite.
    ///
    /// # Errors
    /// A sentence naming the pose at fault.
    pub fn check(&self) -> Result<(), Invalid> {
        let (name, times, poses) = (&self.name, self.times_s.len(), self.poses.len());
        if times == 0 || times != poses {
            return Err(Invalid::new(format!(
                "{name} has {times} times and {poses} poses; expected as many, and at least one"
            )));
        }
        let numbers = self.poses.iter().flatten().chain(&self.times_s);
        if numbers.into_iter().any(|number| !number.is_finite()) {
            return Err(Invalid::new(format!(
                "{name} has a pose or time that is not finite"
            )));
        }
        let falls = self.times_s.windows(2).position(|pair| pair[1] <= pair[0]);
        falls.map_or(Ok(()), |at| {
            Err(Invalid::new(format!(
                "{name}: time {} of its track, {} s, is not after the one before",
                at + 1,
                self.times_s[at + 1]
            )))
        })
    }
}
