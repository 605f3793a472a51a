//! Synthetic environment probes: enough different light to calibrate a
//! [`LightTransfer`](decouplegs_scene::LightTransfer) without a probe from a file.

use std::f64::consts::{PI, TAU};

use decouplegs_scene::Weather;
use decouplegs_scene::light::{PROBE_WIDTH, Probe};
use glam::DVec3;

/// A source of light: a lobe of radiance `peak exp(sharpness (cos - 1))` about a direction.
#[derive(Clone, Copy)]
struct Lobe {
    towards: DVec3,
    /// Linear RGB of what it brings to a face towards it, over pi.
    reflected_by_white: [f64; 3],
    sharpness: f64,
}

/// A sky over a ground.
struct Environment {
    name: &'static str,
    /// Linear RGB radiance overhead and at the horizon.
    zenith: [f64; 3],
    horizon: [f64; 3],
    /// Rate at which the sky's color departs from the horizon's with height; large is fast.
    falloff: f64,
    /// Linear RGB radiance from below.
    ground: [f64; 3],
    lobes: Vec<Lobe>,
}

/// Sharpness that pixels of [`PROBE_WIDTH`] columns can show: a standard deviation of 2.9 degrees.
const SUN_SHARPNESS: f64 = 400.0;

/// Broad light: the glow about a low sun, a bright part of the clouds.
const GLOW_SHARPNESS: f64 = 8.0;

fn towards(azimuth_degrees: f64, height_degrees: f64) -> DVec3 {
    let (azimuth, height) = (azimuth_degrees.to_radians(), height_degrees.to_radians());
    DVec3::new(
        height.cos() * azimuth.cos(),
        height.cos() * azimuth.sin(),
        height.sin(),
    )
}

fn lobe(
    azimuth_degrees: f64,
    height_degrees: f64,
    reflected_by_white: [f64; 3],
    sharpness: f64,
) -> Lobe {
    Lobe {
        towards: towards(azimuth_degrees, height_degrees),
        reflected_by_white,
        sharpness,
    }
}

impl Environment {
    fn radiance(&self, direction: DVec3) -> [f64; 3] {
        let height = direction.z.max(0.0);
        let share = 1.0 - (-self.falloff * height).exp();
        let from_lobes = |channel: usize| -> f64 {
            let of = |lobe: &Lobe| {
                // A lobe holds tau / sharpness steradians of its peak (but for exp(-2 sharpness)).
                let peak = lobe.reflected_by_white[channel] * PI * lobe.sharpness / TAU;
                peak * (lobe.sharpness * (direction.dot(lobe.towards) - 1.0)).exp()
            };
            self.lobes.iter().map(of).sum()
        };
        std::array::from_fn(|channel| {
            let sky =
                self.horizon[channel] + (self.zenith[channel] - self.horizon[channel]) * share;
            // A step at the horizon, softer than a pixel.
            let above = (0.5 + 0.5 * direction.z / 0.03).clamp(0.0, 1.0);
            self.ground[channel] + (sky + from_lobes(channel) - self.ground[channel]) * above
        })
    }

    fn probe(&self) -> Probe {
        Probe::from_fn(self.name, PROBE_WIDTH, |direction| {
            self.radiance(direction).map(|value| value as f32)
        })
    }
}

/// A clear sky with the sun at a height; the lower, the redder and dimmer.
fn clear(name: &'static str, azimuth_degrees: f64, height_degrees: f64) -> Environment {
    let rise = height_degrees.to_radians().sin();
    // Direct light falls with the air it passes, blue first.
    let sun = [0.12, 0.2, 0.38].map(|depth| 1.7 * (-depth / (rise + 0.06)).exp());
    let sky = 0.35 + 0.65 * rise;
    Environment {
        name,
        zenith: [0.10, 0.19, 0.42].map(|value| value * sky),
        horizon: [0.46, 0.52, 0.60].map(|value| value * sky),
        falloff: 3.2,
        ground: [0.13, 0.12, 0.10].map(|value| value * sky),
        lobes: vec![
            lobe(azimuth_degrees, height_degrees, sun, SUN_SHARPNESS),
            lobe(
                azimuth_degrees,
                height_degrees,
                sun.map(|value| 0.12 * value),
                GLOW_SHARPNESS,
            ),
        ],
    }
}

fn overcast() -> Environment {
    Environment {
        name: "overcast",
        // Three times as bright overhead as at the horizon (Moon and Spencer, Illumination from a
        // non-uniform sky, 1942).
        zenith: [1.02, 1.06, 1.12],
        horizon: [0.34, 0.35, 0.37],
        falloff: 2.2,
        ground: [0.12, 0.12, 0.11],
        lobes: vec![],
    }
}

/// An overcast sky, white in it about as bright as it is displayed: the light of places that name
/// no probe.
#[must_use]
pub fn overcast_probe() -> Probe {
    overcast().probe()
}

/// The sky of a weather: the light of places that name no probe but a weather.
#[must_use]
pub fn probe_of(weather: Weather) -> Probe {
    let [dusk, ..] = twilights();
    let [night, _] = nights();
    match weather {
        Weather::Clear => clear("clear", 220.0, 50.0),
        Weather::Overcast => overcast(),
        Weather::Dusk => dusk,
        Weather::Night => night,
    }
    .probe()
}

fn twilights() -> [Environment; 3] {
    [
        Environment {
            name: "dusk",
            zenith: [0.06, 0.07, 0.16],
            horizon: [0.34, 0.20, 0.18],
            falloff: 4.0,
            ground: [0.05, 0.04, 0.04],
            lobes: vec![
                lobe(200.0, 4.0, [0.55, 0.24, 0.08], SUN_SHARPNESS),
                lobe(200.0, 6.0, [0.35, 0.16, 0.07], GLOW_SHARPNESS),
            ],
        },
        Environment {
            name: "dawn",
            zenith: [0.08, 0.11, 0.22],
            horizon: [0.30, 0.24, 0.28],
            falloff: 3.0,
            ground: [0.05, 0.05, 0.05],
            lobes: vec![lobe(75.0, 2.0, [0.30, 0.20, 0.18], GLOW_SHARPNESS)],
        },
        Environment {
            name: "blue-hour",
            zenith: [0.03, 0.05, 0.13],
            horizon: [0.08, 0.10, 0.19],
            falloff: 2.0,
            ground: [0.015, 0.017, 0.025],
            lobes: vec![lobe(310.0, 5.0, [0.05, 0.035, 0.04], GLOW_SHARPNESS)],
        },
    ]
}

fn nights() -> [Environment; 2] {
    const LAMP_SHARPNESS: f64 = 150.0;
    let night = |name, lobes| Environment {
        name,
        zenith: [0.004, 0.005, 0.010],
        horizon: [0.014, 0.011, 0.010],
        falloff: 6.0,
        ground: [0.010, 0.008, 0.006],
        lobes,
    };
    let (sodium, white) = ([0.03, 0.0186, 0.0087], [0.015, 0.0165, 0.018]);
    [
        night(
            "night-lamps",
            vec![
                lobe(20.0, 60.0, sodium, LAMP_SHARPNESS),
                lobe(170.0, 30.0, sodium.map(|v| 0.3 * v), LAMP_SHARPNESS),
            ],
        ),
        night(
            "night-shops",
            vec![
                lobe(90.0, 8.0, white, GLOW_SHARPNESS),
                lobe(250.0, 12.0, [0.012, 0.006, 0.0105], GLOW_SHARPNESS),
                lobe(330.0, 70.0, white, LAMP_SHARPNESS),
            ],
        ),
    ]
}

/// Twelve environments from noon to night, in the form in which probes from files come. Turned,
/// mirrored and exposed by a calibration they are some hundred lights of full rank.
#[must_use]
pub fn procedural_probes() -> Vec<Probe> {
    let hazy = Environment {
        name: "hazy",
        lobes: vec![lobe(135.0, 40.0, [0.6, 0.56, 0.5], GLOW_SHARPNESS)],
        ..overcast()
    };
    let days = [
        clear("clear-12", 160.0, 12.0),
        clear("clear-25", 40.0, 25.0),
        clear("clear-40", 280.0, 40.0),
        clear("clear-55", 110.0, 55.0),
        clear("clear-70", 220.0, 70.0),
        overcast(),
        hazy,
    ];
    days.iter()
        .chain(&twilights())
        .chain(&nights())
        .map(Environment::probe)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs_scene::light::reflected_by_white;

    #[test]
    fn a_lobe_brings_what_it_says_and_probes_are_as_bright_as_their_hour() {
        let alone = |sharpness| Environment {
            name: "lobe",
            zenith: [0.0; 3],
            horizon: [0.0; 3],
            falloff: 1.0,
            ground: [0.0; 3],
            lobes: vec![lobe(30.0, 60.0, [1.0, 0.5, 0.0], sharpness)],
        };
        let towards = towards(30.0, 60.0);
        // Broad lobes bring less: their light comes aslant.
        let [red, green, blue] = reflected_by_white(&alone(SUN_SHARPNESS).probe(), towards);
        assert!(
            (red - 1.0).abs() < 0.01 && (green - 0.5).abs() < 0.005 && blue == 0.0,
            "{red} {green} {blue}"
        );

        let up = |name: &str| {
            let probe = procedural_probes()
                .into_iter()
                .find(|probe| probe.name == name)
                .unwrap();
            reflected_by_white(&probe, DVec3::Z)
        };
        let green = |name: &str| up(name)[1];
        assert!(green("clear-70") > green("clear-25") && green("clear-25") > green("dusk"));
        assert!(green("dusk") > green("blue-hour") && green("blue-hour") > green("night-shops"));
        assert!(
            (0.6..1.0).contains(&green("overcast")),
            "{}",
            green("overcast")
        );
        assert!(up("blue-hour")[2] > up("blue-hour")[0] && green("night-shops") < 0.05);
        let dusk = procedural_probes()
            .into_iter()
            .find(|probe| probe.name == "dusk")
            .unwrap();
        let [red, _, blue] = reflected_by_white(&dusk, self::towards(200.0, 4.0));
        assert!(
            red > 1.3 * blue,
            "a wall that faces the low sun is red: {red} {blue}"
        );
    }
}
