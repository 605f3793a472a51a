//! Light in which the street and its assets stand: the sun, the sky, the lamps and the air, in
//! numbers.

pub use decouplegs_scene::Weather;
use glam::Vec3;

use super::surface::display;

/// The light that the assets are captured in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum AssetLight {
    /// A high sun under a clear sky, and the dark below the car as a part of it: fit to be
    /// shown as it is.
    #[default]
    Sun,
    /// White light from everywhere, irradiance pi, nothing thrown and nothing mirrored: the
    /// canonical capture, which relighting starts from.
    Neutral,
}

/// Direction towards the sun of [`Weather::Clear`]: half-way up, behind the ego on its right, so
/// that it drives into lit fronts and short shadows. Random numbers are drawn by this sun in every
/// weather, so that only the light differs.
pub(super) const TOWARDS_SUN: Vec3 = Vec3::new(-0.50, -0.36, 0.79);

/// Direction towards that sun in an asset's frame. High, since the asset may head anywhere.
pub(super) const TOWARDS_SUN_ASSET: Vec3 = Vec3::new(-0.22, 0.18, 0.95);

/// Direction towards the sun at dusk, 14 degrees high: it looks down the street from behind the ego
/// and lights the fronts on the left.
const TOWARDS_LOW_SUN: Vec3 = Vec3::new(-0.933, -0.267, 0.242);

/// The light of a place that nothing stands in the way of. Colors are linear RGB, in units in which
/// white turned to a light of 1 is displayed as white: exposure is in them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Air {
    /// Direction towards the sun; any length.
    pub towards_sun: Vec3,
    pub sun: Vec3,
    /// Factor on `sun`; at 0 there is none.
    pub sun_strength: f32,
    /// Light of the sky on upward faces.
    pub sky: Vec3,
    /// Light of the ground on downward faces.
    pub bounce: Vec3,
    /// The air between here and far away.
    pub haze: Vec3,
    /// Tint and strength of what glossy faces mirror of the sun.
    pub sheen: Vec3,
    /// Share of the sheen that faces in the shadow keep.
    pub shaded_sheen: f32,
    /// Light of a street lamp: irradiance times square meters.
    pub lamp: Vec3,
    /// Strength of the own light of windows and lamps.
    pub glow: f32,
}

impl Air {
    /// The light over a street.
    pub(super) fn for_weather(weather: Weather) -> Self {
        match weather {
            Weather::Clear => Self::clear(TOWARDS_SUN),
            Weather::Overcast => Self {
                sun_strength: 0.0,
                sky: Vec3::new(0.78, 0.82, 0.87),
                bounce: Vec3::new(0.21, 0.21, 0.20),
                haze: Vec3::new(0.55, 0.58, 0.62),
                sheen: Vec3::ZERO,
                shaded_sheen: 0.0,
                ..Self::clear(TOWARDS_SUN)
            },
            Weather::Dusk => Self {
                towards_sun: TOWARDS_LOW_SUN,
                sun: Vec3::new(1.0, 0.50, 0.17),
                sun_strength: 2.1,
                sky: Vec3::new(0.20, 0.19, 0.33),
                bounce: Vec3::new(0.15, 0.105, 0.095),
                haze: Vec3::new(0.50, 0.30, 0.27),
                sheen: Vec3::new(1.2, 0.7, 0.32),
                shaded_sheen: 0.0,
                lamp: Vec3::ZERO,
                glow: 0.3,
            },
            Weather::Night => Self {
                sun_strength: 0.0,
                sky: Vec3::new(0.017, 0.021, 0.036),
                bounce: Vec3::new(0.013, 0.011, 0.009),
                haze: Vec3::new(0.016, 0.016, 0.022),
                sheen: Vec3::ZERO,
                shaded_sheen: 0.0,
                lamp: Vec3::new(1.0, 0.62, 0.29) * 100.0,
                glow: 1.0,
                ..Self::clear(TOWARDS_SUN)
            },
        }
    }

    /// The light that assets are captured in.
    pub(super) fn of_assets(light: AssetLight) -> Self {
        let sunny = Self::clear(TOWARDS_SUN_ASSET);
        match light {
            AssetLight::Sun => sunny,
            AssetLight::Neutral => Self {
                sun_strength: 0.0,
                sky: Vec3::ONE,
                bounce: Vec3::ONE,
                sheen: Vec3::ZERO,
                shaded_sheen: 0.0,
                ..sunny
            },
        }
    }

    fn clear(towards_sun: Vec3) -> Self {
        Self {
            towards_sun,
            sun: Vec3::new(1.0, 0.92, 0.78),
            sun_strength: 1.35,
            sky: Vec3::new(0.31, 0.37, 0.47),
            bounce: Vec3::new(0.2, 0.185, 0.16),
            haze: Vec3::new(0.56, 0.66, 0.78),
            sheen: Vec3::ONE,
            shaded_sheen: 1.0,
            lamp: Vec3::ZERO,
            glow: 0.0,
        }
    }
}

/// Seen where the dome of sky lets light through: the color of the air above the horizon,
/// display-referred.
pub(super) fn sky_rgb(weather: Weather) -> [f32; 3] {
    match weather {
        Weather::Clear => [0.70, 0.79, 0.89],
        Weather::Overcast => [0.76, 0.78, 0.80],
        Weather::Dusk => [0.74, 0.52, 0.48],
        Weather::Night => [0.10, 0.095, 0.11],
    }
}

/// Light of windows with a lamp behind them, linear RGB.
pub(super) fn lamplight() -> Vec3 {
    display(255, 190, 105)
}
