//! Summary of a cloud, for `inspect`.

use std::collections::BTreeMap;

use decouplegs_scene::{Bounds, SplatCloud, SplatDefect};
use rayon::prelude::*;
use serde::Serialize;

use crate::SplatExtent;

/// Counts of values in equal steps.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Histogram {
    /// Bin edges: one more than there are bins.
    pub edges: Vec<f64>,
    /// Values in each bin; a value on an inner edge belongs to the bin above it, the last edge to
    /// the last bin.
    pub counts: Vec<u64>,
    /// Values below the first edge.
    pub below: u64,
    /// Values above the last edge.
    pub above: u64,
}

impl Histogram {
    /// Counts `values` in `bins` equal steps from `min` to `max`. Values that are not a number are
    /// left out.
    fn new(values: impl Iterator<Item = f64>, min: f64, max: f64, bins: usize) -> Self {
        let edges = (0..=bins)
            .map(|i| min + (max - min) * i as f64 / bins as f64)
            .collect();
        let mut histogram = Self {
            edges,
            counts: vec![0; bins],
            below: 0,
            above: 0,
        };
        for value in values {
            if value < min {
                histogram.below += 1;
            } else if value > max {
                histogram.above += 1;
            } else if !value.is_nan() {
                let bin = ((value - min) / (max - min) * bins as f64) as usize;
                histogram.counts[bin.min(bins - 1)] += 1;
            }
        }
        histogram
    }
}

/// A box with finite corners, meters.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SummaryBounds {
    /// Lower corner.
    pub min: [f32; 3],
    /// Upper corner.
    pub max: [f32; 3],
}

/// Splats that cannot be drawn, by the first thing wrong with each.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct DefectCounts {
    /// Splats with any defect.
    pub total: u64,
    /// Splats of each defect: `mean`, `scale`, `rotation`, `opacity`, `color`. Defects that do not
    /// occur are left out.
    pub by_kind: BTreeMap<&'static str, u64>,
}

/// Summary of a cloud.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SplatSummary {
    /// Splats, defective ones included.
    pub splats: u64,
    /// Degree of the spherical harmonics stored.
    pub sh_degree: u8,
    /// The box around the finite means; none without any.
    pub bounds: Option<SummaryBounds>,
    /// Extent of most of them, and what is far or lonely; none without finite means.
    pub extent: Option<SplatExtent>,
    /// log10 of the standard deviations in meters, three a splat, in steps of a quarter decade.
    /// Zero counts as below.
    pub scale_log10_m: Histogram,
    /// log10 of each splat's largest over its smallest standard deviation.
    pub anisotropy_log10: Histogram,
    /// Opacities in steps of 0.05.
    pub opacity: Histogram,
    /// Splats that cannot be drawn.
    pub defects: DefectCounts,
    /// Bytes that the cloud takes in memory.
    pub memory_bytes: u64,
}

impl SplatSummary {
    /// Describes `cloud`.
    #[must_use]
    pub fn new(cloud: &SplatCloud) -> Self {
        let finite = || {
            cloud
                .means
                .iter()
                .filter(|mean| mean.iter().all(|x| x.is_finite()))
        };
        let bounds = finite().next().map(|_| {
            let Bounds { min, max } = Bounds::from_points(finite());
            SummaryBounds { min, max }
        });
        let log10 = |value: f32| f64::from(value).log10();
        let anisotropy = cloud.scales.iter().map(|scale| {
            let (least, most) = scale
                .iter()
                .fold((f32::INFINITY, 0.0f32), |(least, most), &s| {
                    (least.min(s), most.max(s))
                });
            f64::from(most).log10() - f64::from(least).log10()
        });
        let scales = cloud.scales.iter().flatten().map(|&scale| log10(scale));
        let ((extent, scale_log10_m), (anisotropy_log10, defects)) = rayon::join(
            || {
                rayon::join(
                    || SplatExtent::new(cloud),
                    || Histogram::new(scales, -6.0, 3.0, 36),
                )
            },
            || {
                rayon::join(
                    || Histogram::new(anisotropy, 0.0, 5.0, 20),
                    || count_defects(cloud),
                )
            },
        );
        Self {
            splats: cloud.len() as u64,
            sh_degree: cloud.sh_degree,
            bounds,
            extent,
            scale_log10_m,
            anisotropy_log10,
            opacity: Histogram::new(
                cloud.opacities.iter().map(|&opacity| f64::from(opacity)),
                0.0,
                1.0,
                20,
            ),
            defects,
            memory_bytes: memory_bytes(cloud),
        }
    }
}

fn count_defects(cloud: &SplatCloud) -> DefectCounts {
    let mut counts = DefectCounts::default();
    let defects: Vec<SplatDefect> = (0..cloud.len())
        .into_par_iter()
        .filter_map(|splat| cloud.defect_of(splat))
        .collect();
    for defect in defects {
        counts.total += 1;
        *counts.by_kind.entry(defect_name(defect)).or_default() += 1;
    }
    counts
}

fn defect_name(defect: SplatDefect) -> &'static str {
    match defect {
        SplatDefect::Mean => "mean",
        SplatDefect::Scale => "scale",
        SplatDefect::Rotation => "rotation",
        SplatDefect::Opacity => "opacity",
        SplatDefect::Color => "color",
    }
}

fn memory_bytes(cloud: &SplatCloud) -> u64 {
    let bytes = size_of_val(&*cloud.means)
        + size_of_val(&*cloud.scales)
        + size_of_val(&*cloud.rotations)
        + size_of_val(&*cloud.opacities)
        + size_of_val(&*cloud.sh_dc)
        + size_of_val(&*cloud.sh_rest);
    bytes as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_is_counted_once() {
        let values = [
            -0.1,
            0.0,
            0.04999,
            0.05,
            0.999,
            1.0,
            1.1,
            f64::INFINITY,
            f64::NEG_INFINITY,
            f64::NAN,
        ];
        let histogram = Histogram::new(values.into_iter(), 0.0, 1.0, 20);
        assert_eq!(
            (histogram.below, histogram.above, histogram.edges.len()),
            (2, 2, 21)
        );
        assert_eq!(
            (
                histogram.counts[0],
                histogram.counts[1],
                histogram.counts[19]
            ),
            (2, 1, 2)
        );
    }

    #[test]
    fn a_cloud_is_described_with_its_defects() {
        let cloud = SplatCloud {
            means: vec![[0.0, 1.0, 2.0], [f32::NAN, 0.0, 0.0], [4.0, -1.0, 2.0]],
            scales: vec![[0.01, 0.1, 1.0], [0.1; 3], [0.1; 3]],
            rotations: vec![[1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0; 4]],
            opacities: vec![0.5; 3],
            sh_degree: 0,
            sh_dc: vec![[0.0; 3]; 3],
            sh_rest: vec![],
        };
        let summary = SplatSummary::new(&cloud);
        assert_eq!(
            summary.bounds,
            Some(SummaryBounds {
                min: [0.0, -1.0, 2.0],
                max: [4.0, 1.0, 2.0]
            })
        );
        assert_eq!(
            (
                summary.defects.total,
                summary.defects.by_kind["mean"],
                summary.defects.by_kind["rotation"]
            ),
            (2, 1, 1)
        );
        assert_eq!((summary.splats, summary.memory_bytes), (3, 3 * 56));
        assert_eq!(summary.scale_log10_m.counts.iter().sum::<u64>(), 9);
        assert_eq!(summary.anisotropy_log10.counts[8], 1, "two decades");
        let json = serde_json::to_string(&summary).unwrap();
        assert!(
            json.contains("\"by_kind\":{\"mean\":1,\"rotation\":1}"),
            "{json}"
        );
        assert_eq!(SplatSummary::new(&SplatCloud::default()).bounds, None);
    }
}
