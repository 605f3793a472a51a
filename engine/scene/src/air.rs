//! Light and air over a place.

use crate::fog::Fog;

/// Light over a synthetic place.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Weather {
    /// A sunny afternoon.
    #[default]
    Clear,
    /// Gray light from all of the sky.
    Overcast,
    /// A low, orange sun and long shadows.
    Dusk,
    /// Street lamps and lit windows.
    Night,
}

impl Weather {
    /// All weathers, from bright to dark.
    pub const ALL: [Self; 4] = [Self::Clear, Self::Overcast, Self::Dusk, Self::Night];

    /// The name it has in files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Clear => "clear",
            Self::Overcast => "overcast",
            Self::Dusk => "dusk",
            Self::Night => "night",
        }
    }

    /// The weather that a file names so.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|weather| weather.name() == name)
    }
}

/// Light and air over the roads of a map.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Air {
    /// Light where no probe is named. None: an overcast sky.
    pub weather: Option<Weather>,
    /// Distance at which a dark object has a contrast of 5 % to the fog before it, meters (WMO:
    /// meteorological optical range). None: no fog.
    pub visibility_m: Option<f64>,
}

impl Air {
    /// The fog before a horizon of the color `rgb`, display-referred.
    #[must_use]
    pub fn fog(&self, rgb: [f32; 3]) -> Option<Fog> {
        let visibility_m = self.visibility_m?;
        // A contrast of 5 % is left at that distance.
        Some(Fog::new(-0.05f64.ln() / visibility_m, rgb.map(f64::from)))
    }
}
