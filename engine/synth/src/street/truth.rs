//! Ground truth of insertion: cars under the light of the street, and the street with their
//! shadows.

use decouplegs_scene::{AgentPlacement, Pose, SplatCloud};
use glam::{DQuat, DVec3, Quat, Vec3};
use rayon::prelude::*;

use super::car::{Build, VARIANTS};
use super::layout::Layout;
use super::occluder::Occluder;
use super::{Street, StreetOptions, asset_in, background, street_light};

/// Height of a car's underside over the road, meters.
const CLEARANCE_M: f32 = 0.15;

/// A street and cars in it as its light shows them.
#[derive(Clone, Debug)]
pub struct Truth {
    /// [`Street::background`], darker where the cars take its light; all but colors is the same.
    pub background: SplatCloud,
    /// For each placement the splats of its asset, the same but for their colors: those that it has
    /// where it stands. In the asset's frame, spherical harmonics included: to be placed as the
    /// asset is.
    pub cars: Vec<SplatCloud>,
}

impl Street {
    /// The street of `options` with cars at `placements` in its light: sun and the shadows of
    /// houses, trees and other cars, sky, lamps and sheen.
    ///
    /// Cars stand flat, at any place and heading; their roll and pitch count as none.
    /// [`AgentPlacement::asset`] is the place in [`Street::assets`], beyond the last starting over;
    /// names and frames of spherical harmonics do not matter.
    #[must_use]
    pub fn lit(options: &StreetOptions, placements: &[AgentPlacement]) -> Truth {
        let layout = Layout::new(options.seed);
        let shadows_of = |placement: &AgentPlacement| {
            occluders(
                &Build::for_variant(placement.asset).0,
                &placement.world_from_agent,
            )
        };
        let all = placements.iter().flat_map(shadows_of).collect();
        let cars = placements
            .par_iter()
            .enumerate()
            .map(|(number, placement)| {
                // A car's own box would shade what it is made of.
                let others = placements
                    .iter()
                    .enumerate()
                    .filter(|(other, _)| *other != number);
                let others = others
                    .flat_map(|(_, placement)| shadows_of(placement))
                    .collect();
                let Pose {
                    rotation,
                    translation,
                } = placement.world_from_agent;
                let rotation = Quat::from_rotation_z(yaw_rad(rotation) as f32);
                let light = street_light(options.weather, &layout, others)
                    .on_asset(rotation, translation.as_vec3());
                asset_in(options, placement.asset % VARIANTS, &light)
            });
        Truth {
            cars: cars.collect(),
            background: background(options, &layout, all),
        }
    }
}

/// Heading, counted from x towards y.
fn yaw_rad(rotation: DQuat) -> f64 {
    let ahead = rotation * DVec3::X;
    ahead.y.atan2(ahead.x)
}

/// A body on the ground and a cabin on the body.
fn occluders(build: &Build, world_from_car: &Pose) -> [Occluder; 2] {
    let yaw_rad = yaw_rad(world_from_car.rotation) as f32;
    let turn = Quat::from_rotation_z(yaw_rad);
    let foot = world_from_car.translation.as_vec3() - Vec3::Z * (0.5 * build.size.z);
    let between = |x: [f32; 2], half_width_m: f32, z: [f32; 2], grounded: bool| Occluder::Turned {
        center: foot + turn * Vec3::new(0.5 * (x[0] + x[1]), 0.0, 0.5 * (z[0] + z[1])),
        half: Vec3::new(0.5 * (x[0] - x[1]).abs(), half_width_m, 0.5 * (z[1] - z[0])),
        yaw_rad,
        grounded,
    };
    let (half, belt_m) = (0.48 * build.size.x, build.belt_z());
    [
        between(
            [half, -half],
            0.47 * build.size.y,
            [CLEARANCE_M, 0.92 * belt_m],
            true,
        ),
        between(
            build.cabin_x(0.6),
            0.41 * build.size.y,
            [0.8 * belt_m, 0.98 * build.size.z],
            false,
        ),
    ]
}

#[cfg(test)]
mod tests {
    use decouplegs_scene::ShFrame;
    use glam::DVec2;

    use super::*;
    use crate::street::{AssetLight, Capture, Weather};

    const SMALL: StreetOptions = StreetOptions {
        background: 60_000,
        agents: 3,
        agent_splats: 3_000,
        sh_degree: 3,
        seed: 9,
        weather: Weather::Clear,
        asset_light: AssetLight::Neutral,
        capture: Capture::Ego,
    };

    /// Cars on the main street's sunny part, headings of all kinds.
    fn placements() -> Vec<AgentPlacement> {
        let places = [
            (0, 0.3, -20.0, -1.65),
            (1, 3.0, -5.0, 1.65),
            (2, -1.2, 8.0, 4.95),
        ];
        let placed = |(asset, yaw_rad, x, y): (usize, f64, f64, f64)| AgentPlacement {
            name: format!("car_{asset}"),
            asset,
            world_from_agent: Pose::from_yaw(
                yaw_rad,
                DVec3::new(x, y, 0.5 * f64::from(Build::for_variant(asset).0.size.z)),
            ),
            sh_frame: ShFrame::Canonical,
        };
        places.map(placed).to_vec()
    }

    fn bits(values: &[[f32; 3]]) -> Vec<u32> {
        values
            .as_flattened()
            .iter()
            .map(|value| value.to_bits())
            .collect()
    }

    fn same_but_colors(a: &SplatCloud, b: &SplatCloud) {
        assert_eq!(
            (bits(&a.means), bits(&a.scales)),
            (bits(&b.means), bits(&b.scales))
        );
        assert!(a.rotations == b.rotations && a.opacities == b.opacities);
    }

    fn gray(cloud: &SplatCloud, splat: usize) -> f64 {
        cloud.sh_dc[splat]
            .iter()
            .map(|dc| 0.5 + 0.282_094_8 * f64::from(*dc))
            .sum::<f64>()
            / 3.0
    }

    /// Mean of what ground within `margin_m` beyond the car's sides shows in the truth over what it
    /// shows without cars.
    fn kept(street: &Street, truth: &Truth, placement: &AgentPlacement, margin_m: f64) -> f64 {
        let half = Build::for_variant(placement.asset)
            .0
            .size
            .as_dvec3()
            .truncate()
            * 0.5
            + DVec2::splat(margin_m);
        let car_from_world = placement.world_from_agent.inverse();
        let (mut with, mut without) = (0.0, 0.0);
        for (splat, mean) in street
            .background
            .means
            .iter()
            .enumerate()
            .filter(|(_, mean)| mean[2].abs() < 0.03)
        {
            let at = car_from_world.transform(DVec3::from_array(mean.map(f64::from)));
            if at.truncate().abs().cmple(half).all() {
                with += gray(&truth.background, splat);
                without += gray(&street.background, splat);
            }
        }
        assert!(without > 5.0, "hardly any ground below the car");
        with / without
    }

    #[test]
    fn splats_are_those_of_street_and_assets_in_every_weather_and_capture() {
        let small = StreetOptions {
            background: 15_000,
            agent_splats: 1_000,
            ..SMALL
        };
        let clear = Street::generate(&small);
        for weather in Weather::ALL {
            for asset_light in [AssetLight::Sun, AssetLight::Neutral] {
                let options = StreetOptions {
                    weather,
                    asset_light,
                    ..small
                };
                let (street, truth) = (
                    Street::generate(&options),
                    Street::lit(&options, &placements()),
                );
                same_but_colors(&street.background, &clear.background);
                same_but_colors(&truth.background, &street.background);
                for (car, asset) in truth.cars.iter().zip(&street.assets) {
                    same_but_colors(car, asset);
                    assert_ne!(car.sh_dc, asset.sh_dc, "the light matters");
                }
            }
        }
    }

    #[test]
    fn cars_only_take_light_and_only_about_themselves() {
        for weather in Weather::ALL {
            let options = StreetOptions { weather, ..SMALL };
            let (street, truth) = (
                Street::generate(&options),
                Street::lit(&options, &placements()),
            );
            let empty = Street::lit(&options, &[]);
            assert!(
                empty.cars.is_empty() && empty.background == street.background,
                "without cars nothing changes"
            );
            let mut darkened = 0;
            for splat in 0..street.background.len() {
                if street.background.sh_dc[splat] == truth.background.sh_dc[splat] {
                    assert_eq!(
                        street.background.rest_of(splat),
                        truth.background.rest_of(splat)
                    );
                    continue;
                }
                darkened += 1;
                assert!(gray(&truth.background, splat) < gray(&street.background, splat) + 1e-6);
                let mean = DVec3::from_array(street.background.means[splat].map(f64::from));
                let to_car_m = placements()
                    .iter()
                    .map(|p| p.world_from_agent.translation.distance(mean))
                    .fold(f64::MAX, f64::min);
                assert!(to_car_m < 25.0, "{weather:?}: {to_car_m} m from any car");
            }
            assert!(
                darkened > 100 && darkened < street.background.len() / 10,
                "{weather:?}: {darkened}"
            );
        }
    }

    #[test]
    fn the_sun_throws_darker_shadows_than_clouds_do() {
        let kept_in = |weather: Weather| {
            let options = StreetOptions { weather, ..SMALL };
            let (street, truth) = (
                Street::generate(&options),
                Street::lit(&options, &placements()),
            );
            placements()
                .iter()
                .map(|placement| kept(&street, &truth, placement, 0.5))
                .sum::<f64>()
                / 3.0
        };
        let (clear, overcast) = (kept_in(Weather::Clear), kept_in(Weather::Overcast));
        assert!(
            clear < overcast - 0.05 && overcast < 0.95,
            "clear {clear}, overcast {overcast}"
        );
    }

    #[test]
    fn a_car_turned_about_has_its_other_side_lit() {
        let options = StreetOptions {
            weather: Weather::Dusk,
            ..SMALL
        };
        // Out of the shadow of all houses.
        let lit = |yaw_rad: f64| {
            let mut placement = placements().remove(0);
            placement.world_from_agent = Pose::from_yaw(yaw_rad, DVec3::new(300.0, 300.0, 0.7));
            Street::lit(&options, &[placement]).cars.remove(0)
        };
        let (ahead, back) = (lit(0.0), lit(std::f64::consts::PI));
        let rear = |cloud: &SplatCloud| {
            let rear: Vec<usize> = (0..cloud.len())
                .filter(|&splat| cloud.means[splat][0] < -2.1)
                .collect();
            rear.iter().map(|&splat| gray(cloud, splat)).sum::<f64>() / rear.len() as f64
        };
        // At dusk the sun is behind a camera that looks along x.
        assert!(
            rear(&ahead) > 1.2 * rear(&back),
            "{} and {}",
            rear(&ahead),
            rear(&back)
        );
    }

    #[test]
    fn cars_are_warm_below_lamps_and_dark_between_at_night() {
        let options = StreetOptions {
            weather: Weather::Night,
            ..SMALL
        };
        let lamp = super::super::furniture::lamp_light(&Layout::new(options.seed).lamps[1]);
        let at = |x: f32| {
            let mut placement = placements().remove(0);
            placement.world_from_agent =
                Pose::from_yaw(0.0, DVec3::new(f64::from(x), f64::from(lamp.y), 0.72));
            let car = Street::lit(&options, &[placement]).cars.remove(0);
            let mean = |channel: usize| {
                car.sh_dc
                    .iter()
                    .map(|dc| 0.5 + 0.282_094_8 * dc[channel])
                    .sum::<f32>()
                    / car.len() as f32
            };
            [mean(0), mean(2)]
        };
        let (below, between) = (at(lamp.x), at(lamp.x + 13.0));
        assert!(
            below[0] > 1.3 * between[0] && below[0] > 1.2 * below[1],
            "{below:?} below, {between:?} between"
        );
    }
}
