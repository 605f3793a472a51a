//! A synthetic street as Gaussians: for demonstrations, tests and measurements that need a driving
//! scene of any size.
//!
//! It looks like a street on a sunny afternoon or in another [`Weather`], and its splats have the
//! statistics of trained driving scenes: discs with log-normal scales, two modes of opacity with 45
//! % faint, spherical harmonics with noise that falls by band, detail near the road and a coarse
//! shell far away. The same options give the same bits on any number of threads.
//!
//! The street runs along x, its detailed part from -100 m to 100 m; another crosses it at x = 40 m.
//! The ground is z = 0, traffic keeps right. Surfaces (`surface`) are textured functions; `emit`
//! samples splats from them.

mod building;
mod car;
mod car_paint;
mod emit;
mod facade;
mod focus;
mod footprint;
mod furniture;
mod lanes;
mod layout;
mod light;
mod loft;
mod obstacles;
mod occluder;
pub(crate) mod random;
mod road;
pub mod road_users;
pub mod signals;
mod sky;
pub(crate) mod surface;
#[cfg(test)]
mod tests;
mod traffic;
mod tree;
mod truth;
mod weather;

pub use decouplegs_scene::Weather;
pub use focus::Capture;
pub use truth::Truth;
pub use weather::AssetLight;

use decouplegs_scene::light::CastingLights;
use decouplegs_scene::{AgentPlacement, LaneMap, Obstacle, Pose, Rig, SplatCloud};
use glam::{Quat, Vec3};
use rayon::prelude::*;

use car::Build;
use focus::Focus;
use layout::{Layout, Lot, Spot};
use light::Light;
use occluder::Occluder;
use signals::SignalHead;
use surface::Element;
use weather::Air;

/// Options of a synthetic street.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StreetOptions {
    /// Splats of the static background. Surfaces close from about 50,000 on, and look sharp from
    /// about a million.
    pub background: usize,
    /// Cars that drive.
    pub agents: usize,
    /// Splats of each asset.
    pub agent_splats: usize,
    /// Degree of the spherical harmonics; values above 3 count as 3.
    pub sh_degree: u8,
    /// Seed of all randomness.
    pub seed: u64,
    /// The light over the street. The splats are the same in each but for their colors.
    pub weather: Weather,
    /// The light in the assets.
    pub asset_light: AssetLight,
    /// Positions of the cameras: splats are small around them.
    pub capture: Capture,
}

impl Default for StreetOptions {
    /// 200,000 splats of street and ten cars of 10,000, degree 3, on a sunny afternoon.
    fn default() -> Self {
        Self {
            background: 200_000,
            agents: 10,
            agent_splats: 10_000,
            sh_degree: 3,
            seed: 1,
            weather: Weather::Clear,
            asset_light: AssetLight::Sun,
            capture: Capture::Ego,
        }
    }
}

/// A street with its traffic and a vehicle that films it.
#[derive(Clone, Debug)]
pub struct Street {
    /// The static part, world frame, relative to the world's origin at zero.
    pub background: SplatCloud,
    /// Distinct cars, twelve at most, canonical frame: x forward, y left, z up, origin at the
    /// middle of the box, wheels touching z = -H/2.
    pub assets: Vec<SplatCloud>,
    /// Length, width and height of each asset's box, meters; mirrors stand out beyond the width.
    pub asset_dims_m: Vec<[f32; 3]>,
    /// Pose of each agent at time zero. No two overlap.
    pub agents: Vec<AgentPlacement>,
    /// The knots (seconds, world from agent) of each agent's way, straight along its lane; at least
    /// two each.
    pub agent_trajectories: Vec<Vec<(f64, Pose)>>,
    /// Six cameras on the roof of the ego, in the frame of its box.
    pub rig: Rig,
    /// The ego's way (seconds, world from ego): 90 m straight, then a right turn at the crossing.
    pub ego: Vec<(f64, Pose)>,
    /// Lanes of both streets and the ways over their crossing.
    pub lanes: LaneMap,
    /// Heads of the traffic lights.
    pub signal_heads: Vec<SignalHead>,
    /// Boxes of houses, trunks, lamp posts and parked cars.
    pub obstacles: Vec<Obstacle>,
    /// Seen where the dome of sky lets light through, display-referred RGB.
    pub sky: [f32; 3],
    /// Lights that cast shadows of agents on open ground.
    pub casting: CastingLights,
}

impl Street {
    /// The street of `options`.
    #[must_use]
    pub fn generate(options: &StreetOptions) -> Self {
        let layout = Layout::new(options.seed);
        let background = background(options, &layout, vec![]);
        let asset_count = traffic::asset_count(options.agents);
        let assets = (0..asset_count)
            .into_par_iter()
            .map(|asset| {
                let air = Air::of_assets(options.asset_light);
                asset_in(
                    options,
                    asset,
                    &Light::new(air, vec![]).on_asset(Quat::IDENTITY, Vec3::ZERO),
                )
            })
            .collect();
        let traffic = traffic::traffic(options.agents, asset_count, options.seed);
        Self {
            background,
            assets,
            asset_dims_m: (0..asset_count)
                .map(|asset| Build::for_variant(asset).0.size.to_array())
                .collect(),
            agents: traffic.agents,
            agent_trajectories: traffic.trajectories,
            rig: traffic::rig(),
            ego: traffic::ego(),
            lanes: lanes::lanes(),
            signal_heads: signals::heads(),
            obstacles: obstacles::obstacles(&layout),
            sky: weather::sky_rgb(options.weather),
            casting: open_light(options.weather, &layout, vec![]).casting(),
        }
    }
}

/// The static part, with what else stands in its light.
fn background(options: &StreetOptions, layout: &Layout, others: Vec<Occluder>) -> SplatCloud {
    let focus = Focus::new(options.capture);
    let elements = background_elements(layout, options.seed, &focus, options.weather);
    let light = street_light(options.weather, layout, others);
    emit::emit(
        &elements,
        options.background,
        sh_degree(options),
        options.seed,
        &light,
        &focus,
    )
}

/// Asset `asset` in `light`, in its own frame.
fn asset_in(options: &StreetOptions, asset: usize, light: &Light) -> SplatCloud {
    let (build, paint) = Build::for_variant(asset);
    let mut elements = build.elements(paint);
    if options.asset_light == AssetLight::Sun {
        elements.push(build.shadow());
    }
    let seed = options.seed.wrapping_add(asset as u64 + 1);
    emit::emit(
        &elements,
        options.agent_splats,
        sh_degree(options),
        seed,
        light,
        &Focus::nowhere(),
    )
}

fn sh_degree(options: &StreetOptions) -> u8 {
    options.sh_degree.min(decouplegs_scene::sh::DEGREE_MAX)
}

/// The light on the street among its houses, trees and parked cars, and `others`.
fn street_light(weather: Weather, layout: &Layout, others: Vec<Occluder>) -> Light {
    let mut occluders = occluders(layout, weather);
    occluders.extend(others);
    open_light(weather, layout, occluders)
}

/// The light of the street past `occluders` alone.
fn open_light(weather: Weather, layout: &Layout, occluders: Vec<Occluder>) -> Light {
    let lamps = if weather == Weather::Night {
        layout.lamps.iter().map(furniture::lamp_light).collect()
    } else {
        vec![]
    };
    Light::new(Air::for_weather(weather), occluders).with_lamps(lamps)
}

/// The variant of a parked car.
fn variant_of(spot: &Spot) -> usize {
    (spot.seed % car::VARIANTS as u64) as usize
}

/// Casters of shadows: houses, tree crowns and parked cars.
fn occluders(layout: &Layout, weather: Weather) -> Vec<Occluder> {
    let mut occluders = Vec::new();
    // Only a low sun throws the shadows of far houses into the street that is examined.
    for lot in layout
        .lots
        .iter()
        .filter(|lot| !lot.far || weather == Weather::Dusk)
    {
        let (a, b) = (
            lot.translation(),
            lot.rotation() * lot.size + lot.translation(),
        );
        occluders.push(Occluder::Box {
            min: a.min(b),
            max: a.max(b),
        });
    }
    occluders.extend(layout.trees.iter().flat_map(tree::tree_occluders));
    for spot in &layout.parked {
        let (build, _) = Build::for_variant(variant_of(spot));
        // The box is narrower than the car, whose own roof edge would otherwise stand in its
        // shadow.
        let half = Vec3::new(0.46 * build.size.x, 0.42 * build.size.y, 0.0);
        let turned = (Quat::from_rotation_z(spot.yaw_rad) * half).abs();
        let (min, max) = (spot.position - turned, spot.position + turned);
        occluders.push(Occluder::Car {
            min: min + Vec3::Z * 0.15,
            max: max + Vec3::Z * (0.75 * build.belt_z()),
        });
    }
    occluders
}

fn background_elements(
    layout: &Layout,
    seed: u64,
    focus: &Focus,
    weather: Weather,
) -> Vec<Element> {
    // Textures add to the seed, which must leave room.
    let seed = seed & (u64::MAX >> 1);
    let (far, near): (Vec<&Lot>, Vec<&Lot>) = layout.lots.iter().partition(|lot| lot.far);
    let mut elements = road::road(seed);
    elements.extend(of_each(&near, |lot| building::building(lot)));
    elements.extend(of_each(&layout.trees, tree::tree));
    elements.extend(of_each(&layout.lamps, furniture::lamp));
    elements.extend(of_each(&layout.lamps, furniture::beside_lamp));
    elements.extend(signals::traffic_lights());
    let cars: Vec<(Build, Vec<Element>)> = (0..car::VARIANTS)
        .into_par_iter()
        .map(Build::for_variant)
        .map(|(build, paint)| (build, build.elements(paint)))
        .collect();
    for spot in &layout.parked {
        let (build, parts) = &cars[variant_of(spot)];
        let position = spot.position + Vec3::Z * (0.5 * build.size.z);
        let rotation = Quat::from_rotation_z(spot.yaw_rad);
        elements.extend(
            parts
                .iter()
                .map(|part| part.placed(rotation, position).denser(car::CAR_DENSITY)),
        );
    }
    let mut elements: Vec<Element> = elements
        .into_par_iter()
        .map(|element| focus.on(element))
        .collect();
    // What is far is as coarse as its distance allows from everywhere on the way.
    elements.extend(of_each(&far, |lot| building::building(lot)));
    elements.extend(sky::far_shell(seed, weather));
    elements
}

/// The elements that `make` makes of each of `items`, in their order, on all threads.
fn of_each<T: Sync>(items: &[T], make: fn(&T) -> Vec<Element>) -> Vec<Element> {
    let made: Vec<Vec<Element>> = items.par_iter().map(make).collect();
    made.into_iter().flatten().collect()
}
