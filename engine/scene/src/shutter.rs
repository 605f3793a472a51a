//! Shutters: the time at which each pixel of an image is exposed.

use crate::Invalid;

/// Longest readout of an image, seconds.
const READOUT_S_MAX: f64 = 1.0;

/// Order in which the rows or columns of an image are exposed; names as in gsplat.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ShutterDirection {
    /// All pixels at once.
    #[default]
    Global,
    /// The first row first.
    TopToBottom,
    /// The last row first.
    BottomToTop,
    /// The first column first.
    LeftToRight,
    /// The last column first.
    RightToLeft,
}

impl ShutterDirection {
    /// All directions.
    pub const ALL: [Self; 5] = [
        Self::Global,
        Self::TopToBottom,
        Self::BottomToTop,
        Self::LeftToRight,
        Self::RightToLeft,
    ];

    /// Name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Global => "global",
            Self::TopToBottom => "top_to_bottom",
            Self::BottomToTop => "bottom_to_top",
            Self::LeftToRight => "left_to_right",
            Self::RightToLeft => "right_to_left",
        }
    }

    /// The direction of that name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|direction| direction.name() == name)
    }
}

/// Time of exposure of each pixel position, relative to the time of the camera's pose: an affine
/// function of pixel coordinates, along one axis.
///
/// The row with index r of H rows has its center at r + 1/2, so a readout of T seconds exposes it
/// at ((r + 1/2) / H - 1/2) T: the pose of the camera is the one at the middle of the readout.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Shutter {
    /// Time at pixel coordinates (0, 0), seconds.
    pub first_s: f64,
    /// Increase per pixel along x and y, seconds; at most one of them is not zero.
    pub s_per_px: [f64; 2],
}

impl Shutter {
    /// The shutter that exposes all pixels at once.
    pub const GLOBAL: Self = Self {
        first_s: 0.0,
        s_per_px: [0.0; 2],
    };

    /// The shutter that reads an image of `size_px` (width, height) in `readout_s`.
    #[must_use]
    pub fn new(direction: ShutterDirection, readout_s: f64, size_px: [u32; 2]) -> Self {
        let [columns, rows] = size_px.map(|size| readout_s / f64::from(size));
        let (s_per_px, sign) = match direction {
            ShutterDirection::Global => return Self::GLOBAL,
            ShutterDirection::TopToBottom => ([0.0, rows], 1.0),
            ShutterDirection::BottomToTop => ([0.0, -rows], -1.0),
            ShutterDirection::LeftToRight => ([columns, 0.0], 1.0),
            ShutterDirection::RightToLeft => ([-columns, 0.0], -1.0),
        };
        Self {
            first_s: -0.5 * sign * readout_s,
            s_per_px,
        }
    }

    /// True if all pixels are exposed at once.
    #[must_use]
    pub fn is_global(&self) -> bool {
        self.s_per_px == [0.0; 2]
    }

    /// Direction of the readout.
    #[must_use]
    pub fn direction(&self) -> ShutterDirection {
        match self.s_per_px {
            [x, _] if x > 0.0 => ShutterDirection::LeftToRight,
            [x, _] if x < 0.0 => ShutterDirection::RightToLeft,
            [_, y] if y > 0.0 => ShutterDirection::TopToBottom,
            [_, y] if y < 0.0 => ShutterDirection::BottomToTop,
            _ => ShutterDirection::Global,
        }
    }

    /// Duration of the readout of an image of `size_px` (width, height), seconds.
    #[must_use]
    pub fn readout_s(&self, size_px: [u32; 2]) -> f64 {
        let along = |axis: usize| (self.s_per_px[axis] * f64::from(size_px[axis])).abs();
        along(0) + along(1)
    }

    /// Time at which the position `at_px` is exposed, seconds.
    #[must_use]
    pub fn time_s(&self, at_px: [f64; 2]) -> f64 {
        self.first_s + self.s_per_px[0] * at_px[0] + self.s_per_px[1] * at_px[1]
    }

    /// The shutter of the same camera whose image is scaled by `sx` and `sy`.
    #[must_use]
    pub fn scaled(&self, sx: f64, sy: f64) -> Self {
        Self {
            s_per_px: [self.s_per_px[0] / sx, self.s_per_px[1] / sy],
            ..*self
        }
    }

    /// The shutter of the window whose top left pixel is `(left_px, top_px)`: its rows keep their
    /// times.
    #[must_use]
    pub fn cropped(&self, left_px: f64, top_px: f64) -> Self {
        Self {
            first_s: self.time_s([left_px, top_px]),
            ..*self
        }
    }

    /// Checks the shutter of an image of `size_px` (width, height).
    ///
    /// # Errors
    /// A sentence naming the value at fault.
    pub fn check(&self, size_px: [u32; 2]) -> Result<(), Invalid> {
        let [x, y] = self.s_per_px;
        let readout_s = self.readout_s(size_px);
        if !(self.first_s.is_finite() && readout_s <= READOUT_S_MAX) {
            return Err(Invalid::new(format!(
                "shutter with a readout of {readout_s} s; expected at most {READOUT_S_MAX} s"
            )));
        }
        if x != 0.0 && y != 0.0 {
            return Err(Invalid::new(format!(
                "shutter of {x} s per column and {y} s per row; expected one of them to be 0"
            )));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE_PX: [u32; 2] = [8, 4];

    #[test]
    fn rows_and_columns_have_the_times_of_their_centers() {
        let at = |direction, position| Shutter::new(direction, 0.04, SIZE_PX).time_s(position);
        for (direction, position, time_s) in [
            (ShutterDirection::Global, [7.5, 3.5], 0.0),
            (ShutterDirection::TopToBottom, [7.5, 0.5], -0.015),
            (ShutterDirection::TopToBottom, [0.5, 3.5], 0.015),
            (ShutterDirection::BottomToTop, [0.5, 0.5], 0.015),
            (ShutterDirection::LeftToRight, [0.5, 3.5], -0.0175),
            (ShutterDirection::RightToLeft, [7.5, 0.5], -0.0175),
        ] {
            let found = at(direction, position);
            assert!((found - time_s).abs() < 1e-15, "{direction:?}: {found}");
        }
    }

    #[test]
    fn direction_and_readout_are_those_it_was_made_of() {
        for direction in ShutterDirection::ALL {
            let shutter = Shutter::new(direction, 0.03, SIZE_PX);
            assert_eq!(shutter.direction(), direction);
            assert_eq!(
                ShutterDirection::from_name(direction.name()),
                Some(direction)
            );
            let rolls = direction != ShutterDirection::Global;
            let readout_s = if rolls { 0.03 } else { 0.0 };
            assert!((shutter.readout_s(SIZE_PX) - readout_s).abs() < 1e-15);
            // Half as many pixels take as long, and a window keeps the times of its rows.
            let scaled = shutter.scaled(0.5, 0.5);
            assert!((scaled.readout_s([4, 2]) - readout_s).abs() < 1e-15);
            let window = shutter.cropped(3.0, 2.0);
            assert!((window.time_s([0.5, 0.5]) - shutter.time_s([3.5, 2.5])).abs() < 1e-15);
        }
    }

    #[test]
    fn nonsense_is_refused_with_its_value() {
        let refused = |shutter: Shutter| shutter.check(SIZE_PX).unwrap_err().to_string();
        let long = Shutter::new(ShutterDirection::TopToBottom, 3.0, SIZE_PX);
        assert!(refused(long).contains("3 s"));
        let never = Shutter::new(ShutterDirection::TopToBottom, f64::NAN, SIZE_PX);
        assert!(refused(never).contains("NaN"));
        let both = Shutter {
            s_per_px: [0.001, 0.002],
            ..Shutter::GLOBAL
        };
        assert!(refused(both).contains("0.002"));
    }
}
