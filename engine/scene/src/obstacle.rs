//! Static things that a vehicle can hit.

use glam::DVec2;

/// Kind of an obstacle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ObstacleKind {
    /// A car that belongs to the background.
    ParkedCar,
    /// A building.
    House,
    /// The trunk of a tree.
    Tree,
    /// A lamp, sign or other post.
    Post,
    /// Part of a captured background.
    Captured,
}

impl ObstacleKind {
    /// All kinds.
    pub const ALL: [Self; 5] = [
        Self::ParkedCar,
        Self::House,
        Self::Tree,
        Self::Post,
        Self::Captured,
    ];

    /// Name in files and reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::ParkedCar => "parked car",
            Self::House => "house",
            Self::Tree => "tree",
            Self::Post => "post",
            Self::Captured => "captured object",
        }
    }

    /// The kind that a file names so.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }
}

/// A static box on the plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Obstacle {
    /// Kind of thing.
    pub kind: ObstacleKind,
    /// Middle, world coordinates, meters.
    pub center_m: DVec2,
    /// Heading of its length, from x towards y.
    pub yaw_rad: f64,
    /// Size along its heading, meters.
    pub length_m: f64,
    /// Size across its heading, meters.
    pub width_m: f64,
}
