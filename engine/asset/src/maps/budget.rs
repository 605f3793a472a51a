//! Limit on the size of a map in memory relative to its file: roads are sampled, and borders are
//! shared.

use crate::DecodeError;

/// Points of all lines of a map: about 500 km of road with four lanes.
const POINTS_MAX: usize = 4_000_000;

/// Number of points that a map may still have.
pub(super) struct Budget {
    points: usize,
}

impl Budget {
    pub(super) const fn whole() -> Self {
        Self { points: POINTS_MAX }
    }

    /// Takes `points` off.
    ///
    /// # Errors
    /// A [`DecodeError`] where there are not so many left.
    pub(super) fn spend(&mut self, points: usize) -> Result<(), DecodeError> {
        let left = self.points.checked_sub(points);
        self.points = left.ok_or_else(|| {
            DecodeError::Unsupported(format!(
                "its lanes need more than {POINTS_MAX} points, about 500 km of road with four lanes; check the lengths \
                 of its roads, or cut it"
            ))
        })?;
        Ok(())
    }
}
