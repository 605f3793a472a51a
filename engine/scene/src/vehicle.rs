//! Vehicles on the plane: how large they are and how they move.

use glam::DVec2;

/// Outer dimensions of a vehicle, meters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VehicleSize {
    /// Length along x of the vehicle's frame, meters.
    pub length_m: f64,
    /// Width along y without mirrors, meters.
    pub width_m: f64,
    /// Height along z, meters; wheels touch the ground half of it below the middle.
    pub height_m: f64,
}

impl VehicleSize {
    /// A family car: 4.5 by 1.8 by 1.5 meters.
    pub const CAR: Self = Self {
        length_m: 4.5,
        width_m: 1.8,
        height_m: 1.5,
    };

    /// A pedestrian: 0.5 by 0.6 by 1.75 meters.
    pub const PEDESTRIAN: Self = Self {
        length_m: 0.5,
        width_m: 0.6,
        height_m: 1.75,
    };

    /// Size of length, width and height, meters.
    #[must_use]
    pub fn from_array([length_m, width_m, height_m]: [f64; 3]) -> Self {
        Self {
            length_m,
            width_m,
            height_m,
        }
    }

    /// Length, width and height, meters.
    #[must_use]
    pub fn to_array(self) -> [f64; 3] {
        [self.length_m, self.width_m, self.height_m]
    }
}

/// Pose and motion of a vehicle on the plane.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct VehicleState {
    /// Middle of its box from above, world coordinates, meters.
    pub position_m: DVec2,
    /// Heading, from x towards y.
    pub yaw_rad: f64,
    /// Speed along the heading, m/s, never below zero: no vehicle here drives backwards.
    pub speed_mps: f64,
    /// Rate of the speed.
    pub acceleration_mps2: f64,
}

impl VehicleState {
    /// Unit vector of its heading.
    #[must_use]
    pub fn ahead(&self) -> DVec2 {
        DVec2::from_angle(self.yaw_rad)
    }

    /// Velocity, meters per second.
    #[must_use]
    pub fn velocity(&self) -> DVec2 {
        self.ahead() * self.speed_mps
    }

    /// A point of the vehicle's frame (x forward, y left) in the world.
    #[must_use]
    pub fn to_world(&self, local_m: DVec2) -> DVec2 {
        self.position_m + self.ahead().rotate(local_m)
    }

    /// A point of the world in the vehicle's frame.
    #[must_use]
    pub fn to_local(&self, world_m: DVec2) -> DVec2 {
        DVec2::from_angle(-self.yaw_rad).rotate(world_m - self.position_m)
    }
}
