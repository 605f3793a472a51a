//! Surfaces over one position: modes of the heights in a column, each with a plane.

use std::cell::RefCell;

use glam::{DMat3, DVec2, DVec3};

use super::surfel::{Sample, SurfelGrid};

/// Largest difference of heights that belong to one surface, meters: several times the noise of
/// reconstructed roads, and less than a kerb is high twice.
const WINDOW_M: f32 = 0.12;
/// Surfaces that one column may have. A canopy takes one for each half meter.
const LAYERS_MAX: usize = 12;
/// Times that a plane is fitted and its outliers found again.
const ROUNDS: usize = 4;
/// Heights farther from the plane than this times their spread count nothing (Tukey's biweight).
const OUTLIER_SPREADS: f64 = 4.0;
/// The least spread that outliers are told by, meters.
const SPREAD_MIN_M: f64 = 0.02;
/// Holds slopes where samples lie on a line or on a point: this share of the column's own extent.
const SLOPE_HOLD: f64 = 0.05;

/// A surface near a node: a plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layer {
    /// Height at the node, meters, relative to the cloud's origin.
    pub z: f32,
    /// Height a meter along x and y.
    pub slope: [f32; 2],
    /// Shares that it is made of, added up.
    pub support: f32,
    /// Standard deviation about the plane, meters.
    pub spread: f32,
}

impl Layer {
    /// Height at `offset` from the node, meters.
    pub fn height_at(&self, offset: DVec2) -> f64 {
        f64::from(self.z)
            + f64::from(self.slope[0]) * offset.x
            + f64::from(self.slope[1]) * offset.y
    }
}

thread_local! {
    /// Kept between nodes: a column may hold thousands of samples.
    static SAMPLES: RefCell<Vec<Sample>> = const { RefCell::new(Vec::new()) };
}

/// The surfaces over `node` that cover at least `support_min`, rising.
pub fn at_node(surfels: &SurfelGrid, node: DVec2, support_min: f64) -> Vec<Layer> {
    SAMPLES.with_borrow_mut(|samples| {
        samples.clear();
        surfels.samples_at(node, samples);
        samples.sort_by(|a, b| a.height.total_cmp(&b.height));
        layers_of(samples, support_min)
    })
}

/// The surfaces among `samples`, which are sorted by height.
fn layers_of(samples: &[Sample], support_min: f64) -> Vec<Layer> {
    let mut densities = densities(samples);
    let mut layers: Vec<Layer> = Vec::new();
    while layers.len() < LAYERS_MAX {
        let best = (0..samples.len())
            .max_by(|&a, &b| densities[a].total_cmp(&densities[b]).then(b.cmp(&a)));
        let Some(best) = best.filter(|&best| f64::from(densities[best]) >= support_min) else {
            break;
        };
        let middle = samples[best].height;
        let from = samples.partition_point(|sample| sample.height < middle - 2.0 * WINDOW_M);
        let to = samples.partition_point(|sample| sample.height <= middle + 2.0 * WINDOW_M);
        densities[from..to].fill(0.0);
        layers.extend(
            plane_of(&samples[from..to], middle)
                .filter(|layer| f64::from(layer.support) >= support_min),
        );
    }
    layers.sort_by(|a, b| a.z.total_cmp(&b.z));
    layers
}

/// For each sample the shares within the window about its height.
fn densities(samples: &[Sample]) -> Vec<f32> {
    let (mut from, mut to, mut sum) = (0, 0, 0.0_f64);
    let density = |sample: &Sample| {
        while to < samples.len() && samples[to].height <= sample.height + WINDOW_M {
            sum += f64::from(samples[to].share);
            to += 1;
        }
        while samples[from].height < sample.height - WINDOW_M {
            sum -= f64::from(samples[from].share);
            from += 1;
        }
        sum as f32
    };
    samples.iter().map(density).collect()
}

/// The plane through `samples` about the height `middle`, outliers left out.
fn plane_of(samples: &[Sample], middle: f32) -> Option<Layer> {
    let window = f64::from(WINDOW_M);
    let mut plane = DVec3::ZERO;
    let mut cut = window;
    let mut found = None;
    for _ in 0..ROUNDS {
        let (mut normal, mut right, mut hold) = (DMat3::ZERO, DVec3::ZERO, 0.0);
        let residual = |sample: &Sample, plane: DVec3| {
            f64::from(sample.height - middle) - plane.dot(row(sample))
        };
        let weigh = |sample: &Sample, plane: DVec3| {
            let left = residual(sample, plane) / cut;
            f64::from(sample.share) * (1.0 - left * left).max(0.0).powi(2)
        };
        for sample in samples {
            let (weight, row) = (weigh(sample, plane), row(sample));
            normal += DMat3::from_cols(
                row * (row.x * weight),
                row * (row.y * weight),
                row * (row.z * weight),
            );
            right += row * (weight * f64::from(sample.height - middle));
            hold += weight;
        }
        if hold <= 0.0 {
            return None;
        }
        let held = SLOPE_HOLD * (0.5 * (normal.y_axis.y + normal.z_axis.z)).max(1e-4 * hold);
        let fitted = (normal + DMat3::from_diagonal(DVec3::new(0.0, held, held))).inverse() * right;
        let counted = |sample: &Sample| (weigh(sample, plane), residual(sample, fitted));
        let (support, squares) = samples
            .iter()
            .map(counted)
            .fold((0.0, 0.0), |(s, q), (w, r)| (s + w, q + w * r * r));
        let spread = (squares / support).sqrt();
        plane = fitted;
        cut = (OUTLIER_SPREADS * spread.max(SPREAD_MIN_M)).min(window);
        found = Some((support, spread));
    }
    let (support, spread) = found?;
    let finite = plane.is_finite() && spread.is_finite();
    let slope = [plane.y as f32, plane.z as f32];
    finite.then_some(Layer {
        z: (f64::from(middle) + plane.x) as f32,
        slope,
        support: support as f32,
        spread: spread as f32,
    })
}

fn row(sample: &Sample) -> DVec3 {
    DVec3::new(
        1.0,
        f64::from(sample.offset[0]),
        f64::from(sample.offset[1]),
    )
}
