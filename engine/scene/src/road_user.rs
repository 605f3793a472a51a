//! Kinds of road users.

/// Kind of a road user.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum RoadUser {
    /// Passenger car or van.
    #[default]
    Car,
    /// Truck without a trailer.
    Truck,
    /// City bus.
    Bus,
    /// Bicycle and its rider, on a lane.
    Cyclist,
    /// Person on foot, on a path of their own.
    Pedestrian,
}

impl RoadUser {
    /// All kinds.
    pub const ALL: [Self; 5] = [
        Self::Car,
        Self::Truck,
        Self::Bus,
        Self::Cyclist,
        Self::Pedestrian,
    ];

    /// Kinds that drive on lanes.
    pub const ON_LANES: [Self; 4] = [Self::Car, Self::Truck, Self::Bus, Self::Cyclist];

    /// Name in files, in the protocol of planners and in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Car => "car",
            Self::Truck => "truck",
            Self::Bus => "bus",
            Self::Cyclist => "cyclist",
            Self::Pedestrian => "pedestrian",
        }
    }

    /// The kind that a file names so.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }
}
