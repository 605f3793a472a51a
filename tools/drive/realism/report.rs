//! Results of comparing a scene: gaps, one number each, and the details behind them.

use std::path::PathBuf;

use decouplegs::render::metrics::PhotographDifference;
use decouplegs::render::rendered_image::Image;
use serde_json::{Value, json};

use super::detections::{Agreement, Detections};
use super::gap::{Gap, Statistic};
use super::photographs::Photograph;
use super::plans::ComparedPlans;
use super::road::ComparedRoad;
use crate::lidar::scan_comparison::ScanComparison;

/// A photograph and the image of the scene from the same view.
pub struct Compared {
    pub photograph: Photograph,
    pub rendered: Image,
    pub difference: PhotographDifference,
}

/// A scan and its name.
pub struct ComparedScan {
    pub name: String,
    pub comparison: ScanComparison,
}

/// Detections in images beside those in photographs.
pub struct ComparedDetections {
    /// The detector, where the program ran it.
    pub detector: Option<String>,
    pub in_photographs: Detections,
    pub in_rendered: Detections,
    pub rendered: Agreement,
    /// Detections in photographs of half the size, as a control.
    pub half_size: Option<Agreement>,
}

/// Everything that was found.
pub struct Realism {
    pub scene: PathBuf,
    pub device: String,
    pub views: usize,
    pub compared: Vec<Compared>,
    pub scans: Vec<ComparedScan>,
    pub detections: Option<ComparedDetections>,
    pub plans: Option<ComparedPlans>,
    pub road: Option<ComparedRoad>,
}

/// A difference of an image from its photograph: its name and unit, and its value.
struct ImageGap {
    name: &'static str,
    /// True for values from 0 to 1.
    is_share: bool,
    value: fn(&PhotographDifference) -> Option<f64>,
}

/// Gaps that every photograph has.
const IMAGE_GAPS: [ImageGap; 5] = [
    ImageGap {
        name: "PSNR, dB",
        is_share: false,
        value: |found| Some(found.psnr_db),
    },
    ImageGap {
        name: "PSNR after one gain per image and channel, dB",
        is_share: false,
        value: |found| Some(found.gained_psnr_db),
    },
    ImageGap {
        name: "SSIM",
        is_share: true,
        value: |found| found.ssim,
    },
    ImageGap {
        name: "SSIM after the gain",
        is_share: true,
        value: |found| found.gained_ssim,
    },
    ImageGap {
        name: "opacity of the lower half",
        is_share: true,
        value: |found| Some(found.lower_half_opacity),
    },
];

impl ImageGap {
    fn over(&self, compared: &[Compared]) -> Gap {
        let values = compared
            .iter()
            .filter_map(|one| (self.value)(&one.difference));
        // Equal images have no finite ratio.
        let values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
        let (digits, high) = if self.is_share {
            (3, 1.0)
        } else {
            (2, f64::INFINITY)
        };
        Gap::new(self.name, Statistic::Mean, &values, digits).within(0.0, high)
    }
}

impl ComparedScan {
    fn gaps(&self) -> Vec<Gap> {
        let (name, met) = (&self.name, &self.comparison.met);
        let errors_m = met
            .iter()
            .filter_map(|met| Some((met.rendered_m? - met.real_m).abs()));
        let missing = met
            .iter()
            .map(|met| f64::from(u8::from(met.rendered_m.is_none())));
        let heights_m = met.iter().filter(|met| met.is_ground).filter_map(|met| {
            let error_m = met.rendered_m? - met.real_m;
            Some((error_m * met.direction.z).abs())
        });
        let gap = |what: &str, statistic, values: Vec<f64>| {
            Gap::new(format!("{what}, scan {name}"), statistic, &values, 3)
        };
        vec![
            gap(
                "error of ranges, median, m",
                Statistic::Median,
                errors_m.collect(),
            ),
            gap(
                "error of the ground's height in ranges, median, m",
                Statistic::Median,
                heights_m.collect(),
            ),
            gap(
                "beams without a return",
                Statistic::Share,
                missing.collect(),
            ),
        ]
    }
}

impl Realism {
    /// All gaps, one number each.
    pub fn gaps(&self) -> Vec<Gap> {
        let mut gaps: Vec<Gap> = IMAGE_GAPS
            .iter()
            .map(|gap| gap.over(&self.compared))
            .collect();
        if let Some(found) = &self.detections {
            gaps.push(Gap::count(
                "detections in photographs",
                found.rendered.wanted,
            ));
            gaps.extend(found.rendered.gaps("rendered images"));
            let control = found.half_size.iter();
            gaps.extend(control.flat_map(|control| control.gaps("half-size photographs")));
        }
        gaps.extend(self.plans.iter().flat_map(ComparedPlans::gaps));
        gaps.extend(self.scans.iter().flat_map(ComparedScan::gaps));
        gaps.extend(self.road.iter().flat_map(ComparedRoad::gaps));
        gaps
    }

    /// Gaps that were not measured, and why; a sentence each.
    pub fn not_measured(&self) -> Vec<String> {
        let mut sentences: Vec<&str> = Vec::new();
        if self.scans.is_empty() {
            sentences.push("ranges of a LiDAR: no --scan was given");
        }
        if self.detections.is_none() {
            sentences.push(
                "detections: name a model in ONNX with --detector, or run a detector on the photographs and on the images in the folder `rendered`, and give both results with --detections and --detections-rendered",
            );
        }
        if self.plans.is_none() {
            sentences.push("plans: no --planner was given");
        }
        if self.road.is_none() {
            sentences.push("the ground and obstacles: no --map was given beside --scan");
        }
        sentences.push(
            "LPIPS: it needs the weights of AlexNet or VGG that ImageNet was learned with, which are not part of the program",
        );
        let mut sentences: Vec<String> = sentences.into_iter().map(str::to_owned).collect();
        let unanswered = self.plans.as_ref().filter(|plans| plans.unanswered > 0);
        sentences.extend(unanswered.map(|plans| {
            format!(
                "plans at {} moments: {} had no plan of its own at the first step of an episode",
                plans.unanswered, plans.planner
            )
        }));
        sentences
    }

    pub fn to_json(&self) -> Value {
        let image =
            |one: &Compared| json!({ "name": one.photograph.name, "difference": one.difference });
        let scan =
            |scan: &ComparedScan| json!({ "name": scan.name, "ranges": scan.comparison.to_json() });
        let detections = self.detections.as_ref().map(|found| {
            json!({
                "detector": found.detector,
                "rendered": found.rendered.to_json(),
                "half_size_photographs": found.half_size.as_ref().map(Agreement::to_json),
            })
        });
        json!({
            "version": env!("CARGO_PKG_VERSION"),
            "scene": self.scene,
            "device": self.device,
            "views": self.views,
            "photographs": self.compared.len(),
            "gaps": self.gaps().iter().map(Gap::to_json).collect::<Vec<_>>(),
            "images": self.compared.iter().map(image).collect::<Vec<_>>(),
            "scans": self.scans.iter().map(scan).collect::<Vec<_>>(),
            "detections": detections,
            "plans": self.plans.as_ref().map(ComparedPlans::to_json),
            "road": self.road.as_ref().map(ComparedRoad::to_json),
            "not_measured": self.not_measured(),
        })
    }

    pub fn to_text(&self) -> String {
        let mut text = format!(
            "{} photographs of {} views, and the scene at their poses; figures with their 95 % confidence intervals\n",
            self.compared.len(),
            self.views
        );
        for gap in self.gaps() {
            text += &format!("  {:<60} {}\n", gap.name, gap.text());
        }
        for scan in &self.scans {
            text += &format!("scan {}\n{}", scan.name, scan.comparison.to_text());
        }
        for sentence in self.not_measured() {
            text += &format!("not measured: {sentence}\n");
        }
        text
    }
}
