//! `decouplegs realism scene`: a scene beside the photographs and scans that it was made of.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use decouplegs::asset::{
    CameraOptions, LoadedScene, SceneFile, SeenFrom, is_scene_file, open_scene, read_cameras,
    write_atomically,
};
use decouplegs::drive::score::Moments;
use decouplegs::gpu::Gpu;
use decouplegs::render::metrics::PhotographDifference;
use decouplegs::render::rendered_image::{Image, ImageFileFormat};
use decouplegs::render::{LidarOptions, LidarRenderer, RenderOptions, Renderer};
use decouplegs::scene::Camera;
use decouplegs::session::LiveScene;
use serde_json::{Value, json};

use super::detections::Agreement;
use super::page;
use super::photographs::{self, Photograph};
use crate::arguments::{print, write_image};
use crate::background::BackgroundArguments;
use crate::device::{DeviceArguments, check_validation};
use crate::episode_report::{score, spread};
use crate::lidar::scan_comparison::ScanComparison;
use crate::lidar::scan_file::ScanFile;
use crate::outputs::Force;
use crate::progress;

/// Compare a scene with photographs at their own poses, and with scans of a LiDAR: one number per
/// gap with its interval, as a table, JSON and a page. Agents are left out
#[derive(clap::Args)]
pub struct Arguments {
    /// Splats, or a scene (.toml, .usdz)
    scene: PathBuf,
    /// Folder of photographs (.png, .jpg), named as their views. Pixels that are black in
    /// NAME_mask.png beside a photograph do not count
    #[arg(long, value_name = "DIR")]
    photographs: PathBuf,
    /// Views: INRIA cameras.json, nerfstudio transforms.json, or the folder of a COLMAP model
    /// (default: `seen_from` of the scene file)
    #[arg(long, value_name = "FILE|DIR")]
    views: Option<PathBuf>,
    /// Compare these photographs alone, those that were held out of training: their names, one per
    /// line (default: all that are in the folder)
    #[arg(long, value_name = "FILE")]
    held_out: Option<PathBuf>,
    /// Compare the ranges of this scan (.bin of KITTI, .pcd.bin of nuScenes, .npy, .npz) too.
    /// Where the file does not tell its pose, it is that of the scene's first LiDAR, at SECONDS;
    /// may be given several times
    #[arg(long, value_name = "FILE[@SECONDS]")]
    scan: Vec<ScanFile>,
    /// Detections in the photographs: COCO results (image_id, category_id, bbox, score)
    #[arg(long, value_name = "FILE.json", requires = "detections_rendered")]
    detections: Option<PathBuf>,
    /// Detections of the same detector in the rendered images, which are written to DIR/rendered
    #[arg(long, value_name = "FILE.json", requires = "detections")]
    detections_rendered: Option<PathBuf>,
    /// New folder for realism.html, realism.json and the rendered images
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    background: BackgroundArguments,
    #[command(flatten)]
    device: DeviceArguments,
}

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

/// Everything that was found.
pub struct Realism {
    pub scene: PathBuf,
    pub device: String,
    pub views: usize,
    pub compared: Vec<Compared>,
    pub scans: Vec<ComparedScan>,
    pub detections: Option<Agreement>,
}

/// A gap between photographs and the scene: its name and unit, and its value in each image.
pub struct Gap {
    pub name: &'static str,
    /// True for values from 0 to 1.
    is_share: bool,
    pub value: fn(&PhotographDifference) -> Option<f64>,
}

/// Gaps that every photograph has.
pub const GAPS: [Gap; 5] = [
    Gap {
        name: "PSNR, dB",
        is_share: false,
        value: |found| Some(found.psnr_db),
    },
    Gap {
        name: "PSNR after one gain per image and channel, dB",
        is_share: false,
        value: |found| Some(found.gained_psnr_db),
    },
    Gap {
        name: "SSIM",
        is_share: true,
        value: |found| found.ssim,
    },
    Gap {
        name: "SSIM after the gain",
        is_share: true,
        value: |found| found.gained_ssim,
    },
    Gap {
        name: "opacity of the lower half",
        is_share: true,
        value: |found| Some(found.lower_half_opacity),
    },
];

impl Realism {
    /// Mean of a gap over the photographs.
    fn moments(&self, gap: &Gap) -> Option<Moments> {
        let values = self
            .compared
            .iter()
            .filter_map(|one| (gap.value)(&one.difference));
        // Equal images have no finite ratio.
        let values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
        Moments::from_values(&values)
    }

    /// Mean of a gap and its 95 % confidence interval.
    pub fn mean(&self, gap: &Gap) -> String {
        match self.moments(gap) {
            Some(moments) if gap.is_share => score(&moments),
            moments => spread(moments.as_ref(), 2),
        }
    }

    /// Gaps that were not measured, and why; a sentence each.
    pub fn not_measured(&self) -> Vec<&'static str> {
        let mut sentences = Vec::new();
        if self.scans.is_empty() {
            sentences.push("ranges of a LiDAR: no --scan was given");
        }
        if self.detections.is_none() {
            sentences.push(
                "detections: run a detector on the photographs and on the images in the folder `rendered`, and give both results with --detections and --detections-rendered",
            );
        }
        sentences.push("LPIPS: its weights are not part of the program");
        sentences
    }

    fn to_json(&self) -> Value {
        let gap = |gap: &Gap| {
            let moments = self.moments(gap);
            json!({
                "name": gap.name,
                "mean": moments.map(|moments| moments.mean),
                "interval_95": moments.and_then(|moments| moments.interval()),
                "images": moments.map_or(0, |moments| moments.count),
            })
        };
        let image =
            |one: &Compared| json!({ "name": one.photograph.name, "difference": one.difference });
        let scan =
            |scan: &ComparedScan| json!({ "name": scan.name, "ranges": scan.comparison.to_json() });
        json!({
            "version": env!("CARGO_PKG_VERSION"),
            "scene": self.scene,
            "device": self.device,
            "views": self.views,
            "photographs": self.compared.len(),
            "gaps": GAPS.iter().map(gap).collect::<Vec<_>>(),
            "images": self.compared.iter().map(image).collect::<Vec<_>>(),
            "scans": self.scans.iter().map(scan).collect::<Vec<_>>(),
            "detections": self.detections.as_ref().map(Agreement::to_json),
            "not_measured": self.not_measured(),
        })
    }

    fn to_text(&self) -> String {
        let mut text = format!(
            "{} photographs of {} views, and the scene at their poses; means with their 95 % confidence intervals\n",
            self.compared.len(),
            self.views
        );
        for gap in &GAPS {
            text += &format!("  {:<48} {}\n", gap.name, self.mean(gap));
        }
        for line in self.detection_lines() {
            text += &format!("  {:<48} {}\n", line.0, line.1);
        }
        for scan in &self.scans {
            text += &format!("scan {}\n{}", scan.name, scan.comparison.to_text());
        }
        for sentence in self.not_measured() {
            text += &format!("not measured: {sentence}\n");
        }
        text
    }

    /// Names and values of the gaps of detections.
    pub fn detection_lines(&self) -> Vec<(&'static str, String)> {
        let Some(found) = &self.detections else {
            return Vec::new();
        };
        let share = |share: Option<f64>| share.map_or("-".into(), |share| format!("{share:.3}"));
        vec![
            ("detections in photographs", found.wanted.to_string()),
            ("detections in rendered images", found.found.to_string()),
            (
                "of those in photographs, found in rendered",
                share(found.recall()),
            ),
            (
                "score of those, rendered less photograph",
                format!("{:+.3}", found.score_shift),
            ),
            ("overlap of those (IoU)", format!("{:.3}", found.iou)),
        ]
    }
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let out = &arguments.out;
    Force::default().outputs(&[]).whole_folder(out)?;
    let views = views(arguments)?;
    let chosen = arguments.held_out.as_deref().map(photographs::names_in);
    let found = photographs::find(
        &arguments.photographs,
        &views,
        chosen.transpose()?.as_deref(),
    )?;
    let detections = match (&arguments.detections, &arguments.detections_rendered) {
        (Some(photographs), Some(rendered)) => Some(Agreement::between(photographs, rendered)?),
        _ => None,
    };
    let reading = progress::spinner(format!("reading {}", arguments.scene.display()));
    let mut loaded = open_scene(&arguments.scene, 0.0)?;
    reading.finish_and_clear();
    let scans = arguments.scan.iter().map(|scan| scan.read(&loaded));
    let scans = scans.collect::<Result<Vec<_>>>()?;
    loaded.agents.clear();
    let gpu = arguments.device.open()?;
    let mut options = RenderOptions {
        rules: loaded.splat_scene.rules,
        ..RenderOptions::default()
    };
    arguments.background.apply_to(&mut options);
    let mut renderer = Renderer::new(&gpu, options);
    let live = LiveScene::new(&renderer, &loaded)?;
    let rendered_folder = out.join("rendered");
    fs::create_dir_all(&rendered_folder)
        .with_context(|| format!("{} cannot be made", rendered_folder.display()))?;
    let mut compared = Vec::new();
    let bar = progress::bar("photographs", found.len());
    for found in &found {
        let one = compare(found.read()?, &mut renderer, &live)?;
        let file = rendered_folder.join(format!("{}.png", one.photograph.name));
        write_image(&file, &one.rendered, ImageFileFormat::Png)?;
        compared.push(one);
        bar.inc(1);
    }
    bar.finish_and_clear();
    let named = arguments.scan.iter().zip(&scans);
    let scans = named
        .map(|(file, (scan, pose))| {
            let mut lidars = lidars(&gpu, &loaded);
            let comparison =
                ScanComparison::new(&mut lidars, live.with(&live.at(0.0)), scan, *pose)?;
            let name = file.name();
            Ok(ComparedScan { name, comparison })
        })
        .collect::<Result<Vec<_>>>()?;
    check_validation(&gpu)?;
    let realism = Realism {
        scene: arguments.scene.clone(),
        device: gpu.info().to_string(),
        views: views.len(),
        compared,
        scans,
        detections,
    };
    write_atomically(&out.join("realism.json"), |file| {
        writeln!(file, "{:#}", realism.to_json())
    })?;
    let page = page::page(&realism)?;
    let file = out.join("realism.html");
    write_atomically(&file, |written| written.write_all(page.as_bytes()))?;
    print(&realism.to_text())?;
    print(&format!("{}\n", file.display()))
}

/// A renderer of sweeps by the rules of the scene.
fn lidars(gpu: &Gpu, loaded: &LoadedScene) -> LidarRenderer {
    LidarRenderer::new(
        gpu,
        LidarOptions {
            rules: loaded.splat_scene.rules,
            ..LidarOptions::default()
        },
    )
}

/// The scene from the view of a photograph.
fn compare(photograph: Photograph, renderer: &mut Renderer, live: &LiveScene) -> Result<Compared> {
    let camera = std::slice::from_ref(&photograph.camera);
    renderer.render(live.with(&live.at(0.0)), camera)?;
    let rendered = renderer.read_images()?.swap_remove(0);
    let name = &photograph.name;
    let difference =
        PhotographDifference::between(&photograph.image, &rendered, &photograph.counts)
            .with_context(|| format!("photograph {name} cannot be compared"))?;
    let difference =
        difference.with_context(|| format!("photograph {name}: its mask leaves no pixel"))?;
    Ok(Compared {
        photograph,
        rendered,
        difference,
    })
}

/// The views that are given, or that the scene file names.
fn views(arguments: &Arguments) -> Result<Vec<Camera>> {
    let file = match &arguments.views {
        Some(file) => file.clone(),
        None => seen_from(&arguments.scene)?,
    };
    Ok(read_cameras(&file, &CameraOptions::default())?)
}

/// File of the cameras that the scene file `path` says the scene was seen from.
fn seen_from(path: &Path) -> Result<PathBuf> {
    let none = || {
        format!(
            "{} does not name the views of its photographs: give their cameras with --views",
            path.display()
        )
    };
    ensure!(is_scene_file(path), none());
    match SceneFile::read(path)?.recording.seen_from {
        Some(SeenFrom::Cameras(file)) => Ok(path.parent().unwrap_or(Path::new("")).join(file)),
        _ => Err(anyhow::anyhow!(none())),
    }
}
