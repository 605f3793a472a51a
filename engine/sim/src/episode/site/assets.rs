//! Assets of synthetic places: cars, other road users, and their sizes.

use decouplegs_drive::generate::RoadUserAsset;
use decouplegs_scene::{CodedCloud, Rig, SplatCloud, VehicleSize};
use decouplegs_synth::street::road_users::RoadUserModel;
use decouplegs_synth::street::{AssetLight, Street, StreetOptions};
use decouplegs_train::compress::compress_quickly;
use rayon::prelude::*;

use super::SiteError;

/// The cars of the synthetic street, and the six cameras of its ego.
pub(super) struct Cars {
    pub(super) clouds: Vec<SplatCloud>,
    pub(super) sizes: Vec<VehicleSize>,
    pub(super) rig: Rig,
    /// Splats of each, and the light in them.
    pub(super) splats: usize,
    pub(super) light: AssetLight,
    /// Assets that show traffic lights.
    pub(super) signals: Vec<SplatCloud>,
}

/// Seed of the cars: the same in all places, so that scenarios differ by who drives and where.
pub(super) const CARS_SEED: u64 = 1;
/// More agents than there are different cars: all of them are made.
pub(super) const ALL_CARS: usize = 64;

pub(super) fn cars(splats: usize, asset_light: AssetLight) -> Cars {
    let options = StreetOptions {
        background: 0,
        agents: ALL_CARS,
        agent_splats: splats,
        seed: CARS_SEED,
        asset_light,
        ..StreetOptions::default()
    };
    let street = Street::generate(&options);
    let sizes = street
        .asset_dims_m
        .iter()
        .map(|dims| size_of(*dims))
        .collect();
    Cars {
        clouds: street.assets,
        sizes,
        rig: street.rig,
        splats,
        light: asset_light,
        signals: Vec::new(),
    }
}

/// Splats of each road user that is not a car in captured scenes.
pub(super) const ROAD_USER_SPLATS: usize = 6_000;

/// Road users that are not cars: the same in all places.
pub(super) fn road_users() -> Vec<RoadUserAsset> {
    let models = RoadUserModel::ALL.into_iter();
    models
        .map(|RoadUserModel { kind, variant }| RoadUserAsset {
            kind,
            asset: variant,
            size: size_of(RoadUserModel { kind, variant }.size_m()),
        })
        .collect()
}

/// Compressed assets of those road users.
pub(super) fn road_users_coded(
    splats: usize,
    light: AssetLight,
) -> Result<Vec<CodedCloud>, SiteError> {
    let models = RoadUserModel::ALL.par_iter();
    models
        .map(|model| coded(&model.asset(splats, light), &size_of(model.size_m())))
        .collect()
}

/// Size rounded to millimeters, so that a person can read what a scenario says of it.
pub(super) fn size_of(dims_m: [f32; 3]) -> VehicleSize {
    VehicleSize::from_array(dims_m.map(|side_m| (f64::from(side_m) * 1e3).round() / 1e3))
}

/// A car with every splat it has, in the renderer's form.
pub(super) fn coded(cloud: &SplatCloud, size: &VehicleSize) -> Result<CodedCloud, SiteError> {
    let mut coded = compress_quickly(cloud)?;
    coded.dims_m = size.to_array().map(|side_m| side_m as f32);
    Ok(coded)
}

/// Cars of the street, and their boxes; boxes alone where nothing `is_drawn`.
///
/// # Errors
/// Returns an error if a car cannot be compressed.
pub(super) fn street_cars(
    is_drawn: bool,
) -> Result<(Vec<CodedCloud>, Vec<VehicleSize>), SiteError> {
    let splats = ROAD_USER_SPLATS * usize::from(is_drawn);
    let cars = cars(splats, AssetLight::Neutral);
    if !is_drawn {
        return Ok((Vec::new(), cars.sizes));
    }
    let assets = cars.clouds.par_iter().zip(&cars.sizes);
    let assets: Result<_, _> = assets.map(|(cloud, size)| coded(cloud, size)).collect();
    Ok((assets?, cars.sizes))
}
