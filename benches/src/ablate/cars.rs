//! The cars as they were captured: in neutral light, whole and compressed.

use std::thread;

use anyhow::{Context, Result};
use decouplegs::gpu::Gpu;
use decouplegs::scene::{CodedCloud, SplatCloud};
use decouplegs::synth::street::{Street, StreetOptions};
use decouplegs::train::compress::{CompressOptions, compress};

use crate::{progress, views, visibility};

/// Side of the views from which the visibility of a car's splats is measured, pixels: as `compress`
/// by default.
const VIEW_SIZE_PX: u32 = 256;

/// All distinct cars of a street; the same in every weather.
pub struct Cars {
    /// Original splats in spatial order.
    pub originals: Vec<SplatCloud>,
    /// Permutation from the street's order of splats into that order.
    pub orders: Vec<Vec<u32>>,
    /// Mean blending weight of each original splat in views all around, summed over pixels.
    pub visibility: Vec<Vec<f32>>,
    /// The originals, compressed by the defaults.
    pub coded: Vec<CodedCloud>,
    seed: u64,
}

impl Cars {
    /// The cars of `options`' street, compressed by what is seen of them in `views` views.
    pub fn captured(gpu: &Gpu, options: &StreetOptions, views: u32) -> Result<Self> {
        let street = Street::generate(&StreetOptions {
            background: 1,
            ..*options
        });
        let mut cars = Self {
            originals: Vec::new(),
            orders: Vec::new(),
            visibility: Vec::new(),
            coded: Vec::new(),
            seed: options.seed,
        };
        for (car, cloud) in street.assets.iter().enumerate() {
            let working = progress::spinner(format!(
                "what is seen of car {} of {}",
                car + 1,
                street.assets.len()
            ));
            let order = cloud.spatial_order();
            let original = cloud.select(&order);
            let cameras = views::sphere(&original.bounds(), views as usize, VIEW_SIZE_PX, 0.0);
            cars.visibility
                .push(visibility::visibility(gpu, &original, &cameras)?);
            cars.originals.push(original);
            cars.orders.push(order);
            working.finish_and_clear();
        }
        let working = progress::spinner(format!("compressing {} cars", cars.originals.len()));
        cars.coded = cars.compressed(&cars.originals.iter().enumerate().collect::<Vec<_>>())?;
        working.finish_and_clear();
        Ok(cars)
    }

    /// Clouds with the splats of these cars in whatever colors, compressed as the cars themselves
    /// are; several at once.
    pub fn compressed(&self, clouds: &[(usize, &SplatCloud)]) -> Result<Vec<CodedCloud>> {
        let options = CompressOptions {
            seed: self.seed,
            ..CompressOptions::default()
        };
        let one = &|car: usize, cloud: &SplatCloud| -> Result<CodedCloud> {
            let compressed = compress(cloud, &self.visibility[car], &options, &|_| {});
            Ok(compressed
                .with_context(|| format!("car {car} cannot be compressed"))?
                .cloud)
        };
        let threads = thread::available_parallelism().map_or(1, usize::from);
        let mut coded = Vec::new();
        for clouds in clouds.chunks(threads) {
            thread::scope(|scope| {
                let running: Vec<_> = clouds
                    .iter()
                    .map(|&(car, cloud)| scope.spawn(move || one(car, cloud)))
                    .collect();
                coded.extend(
                    running
                        .into_iter()
                        .map(|thread| thread.join().expect("compression does not panic")),
                );
            });
        }
        coded.into_iter().collect()
    }
}
