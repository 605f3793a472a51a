//! Axis-aligned boxes.

/// An axis-aligned box; empty when a minimum exceeds its maximum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Lower corner.
    pub min: [f32; 3],
    /// Upper corner.
    pub max: [f32; 3],
}

impl Bounds {
    /// The box with nothing in it.
    pub const EMPTY: Self = Self {
        min: [f32::INFINITY; 3],
        max: [f32::NEG_INFINITY; 3],
    };

    /// The smallest box around `points`.
    #[must_use]
    pub fn from_points<'a>(points: impl IntoIterator<Item = &'a [f32; 3]>) -> Self {
        let mut bounds = Self::EMPTY;
        for point in points {
            bounds.include(point);
        }
        bounds
    }

    /// Grows the box to hold `point`.
    pub fn include(&mut self, point: &[f32; 3]) {
        for (axis, &coordinate) in point.iter().enumerate() {
            self.min[axis] = self.min[axis].min(coordinate);
            self.max[axis] = self.max[axis].max(coordinate);
        }
    }

    /// Half the box's size along each axis.
    #[must_use]
    pub fn half_extent(&self) -> [f32; 3] {
        std::array::from_fn(|axis| 0.5 * (self.max[axis] - self.min[axis]))
    }

    /// The box's middle.
    #[must_use]
    pub fn center(&self) -> [f32; 3] {
        std::array::from_fn(|axis| 0.5 * self.max[axis] + 0.5 * self.min[axis])
    }
}
