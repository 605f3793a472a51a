//! Traffic signs that decide who goes first: stop and yield.

use crate::traffic_light::StopLine;

/// Kind of a sign.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SignKind {
    /// Vehicles stand before the line, and then give way.
    Stop,
    /// Vehicles give way.
    Yield,
}

impl SignKind {
    /// All kinds.
    pub const ALL: [Self; 2] = [Self::Stop, Self::Yield];

    /// Name in files and in the protocol of planners.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Stop => "stop",
            Self::Yield => "yield",
        }
    }

    /// The kind that a file names so.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }
}

/// Sign for the traffic of a lane.
#[derive(Clone, Debug, PartialEq)]
pub struct TrafficSign {
    /// Kind of the sign.
    pub kind: SignKind,
    /// Line before which vehicles stop or give way.
    pub line: StopLine,
}
