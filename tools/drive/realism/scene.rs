//! `decouplegs realism scene`: a scene beside the photographs and scans that it was made of.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use decouplegs::asset::{
    CameraOptions, LoadedScene, SceneFile, SeenFrom, is_scene_file, open_scene, read_cameras,
    read_tracks, write_atomically,
};
use decouplegs::episode::Site;
use decouplegs::gpu::Gpu;
use decouplegs::planner::PlannerChoice;
use decouplegs::render::metrics::PhotographDifference;
use decouplegs::render::rendered_image::ImageFileFormat;
use decouplegs::render::{LidarOptions, LidarRenderer, RenderOptions, Renderer};
use decouplegs::scene::Camera;
use decouplegs::scene::scenario::Place;
use decouplegs::session::{Session, World};

use super::detections::{Agreement, Detections};
use super::detector::{Detector, DetectorArguments};
use super::page;
use super::photographs::{self, Found, Photograph};
use super::plans;
use super::report::{Compared, ComparedDetections, ComparedScan, Realism};
use super::road::ComparedRoad;
use super::scan_points::{ScanPoints, moving_boxes};
use crate::arguments::{print, write_image};
use crate::background::BackgroundArguments;
use crate::device::{DeviceArguments, check_validation};
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
    #[command(flatten)]
    detector: DetectorArguments,
    /// Planner that sees the photographs and the scene from the same poses, by its name in `drive`:
    /// how far its plans differ. Needs the rig and the [[ego]] poses of a scene file
    #[arg(long, value_name = "PLANNER")]
    planner: Option<PlannerChoice>,
    /// Lanes on the scene: with --scan, the ground and the obstacles that `drive` finds there are
    /// compared with the points of the scans
    #[arg(long, value_name = "FILE", requires = "scan")]
    map: Option<PathBuf>,
    /// Labeled road users, as `import` writes them: points of scans on those that move are no
    /// obstacles of the scene
    #[arg(long, value_name = "FILE", requires = "map")]
    tracks: Option<PathBuf>,
    /// New folder for realism.html, realism.json and the rendered images
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    background: BackgroundArguments,
    #[command(flatten)]
    device: DeviceArguments,
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
    let files = match (&arguments.detections, &arguments.detections_rendered) {
        (Some(photographs), Some(rendered)) => {
            Some([Detections::read(photographs)?, Detections::read(rendered)?])
        }
        _ => None,
    };
    let mut detector = arguments.detector.start()?;
    let reading = progress::spinner(format!("reading {}", arguments.scene.display()));
    let mut loaded = open_scene(&arguments.scene, 0.0)?;
    reading.finish_and_clear();
    let scans = arguments.scan.iter().map(|scan| scan.read(&loaded));
    let scans = scans.collect::<Result<Vec<_>>>()?;
    let tracks = arguments.tracks.as_deref().map(read_tracks).transpose()?;
    let tracks = tracks.unwrap_or_default();
    let site = arguments.map.as_ref();
    let site = site.map(|map| site_on(&arguments.scene, map)).transpose()?;
    loaded.agents.clear();
    let gpu = arguments.device.open()?;
    let mut options = RenderOptions {
        rules: loaded.splat_scene.rules,
        ..RenderOptions::default()
    };
    arguments.background.apply_to(&mut options);
    let mut renderer = Renderer::new(&gpu, options);
    let session = Session::on(&gpu, &options.into());
    let world = World::new(&session.add_scene(&loaded)?);
    let compared = compare_all(&found, &mut renderer, &world, &out.join("rendered"))?;
    let detections = match (&mut detector, files) {
        (Some(detector), _) => Some(detected(detector, &compared)?),
        (None, Some([photographs, rendered])) => Some(ComparedDetections {
            detector: None,
            rendered: Agreement::between(&photographs, &rendered),
            half_size: None,
            in_photographs: photographs,
            in_rendered: rendered,
        }),
        (None, None) => None,
    };
    let plans = arguments.planner.as_ref();
    let plans = plans.map(|planner| plans::compare(planner, &loaded, &compared));
    let plans = plans.transpose()?;
    let mut points = ScanPoints::default();
    let mut lidars = lidars(&gpu, &loaded);
    let mut compared_scans = Vec::new();
    for (file, (scan, pose)) in arguments.scan.iter().zip(&scans) {
        let comparison = world.lend(|splats| {
            let comparison = ScanComparison::new(&mut lidars, splats, scan, *pose)?;
            let Some(sensor) = loaded.rig.lidars().next() else {
                return Ok(comparison);
            };
            comparison.with_empty_beams(&mut lidars, splats, (&sensor.model, scan), *pose)
        })?;
        let passed_s = || plans::nearest_s(&loaded.ego, pose.translation);
        let moving = moving_boxes(&tracks, file.time_s.unwrap_or_else(passed_s));
        points.add(&comparison, pose, &moving);
        let name = file.name();
        compared_scans.push(ComparedScan { name, comparison });
    }
    let road = site.map(|site| ComparedRoad::new(&site, &views, &points));
    check_validation(&gpu)?;
    write(
        out,
        &Realism {
            scene: arguments.scene.clone(),
            device: gpu.info().to_string(),
            views: views.len(),
            compared,
            scans: compared_scans,
            detections,
            plans,
            road,
        },
    )
}

/// Draws the scene from the views of the photographs, into the new folder `folder`.
fn compare_all(
    found: &[Found],
    renderer: &mut Renderer,
    world: &World,
    folder: &Path,
) -> Result<Vec<Compared>> {
    fs::create_dir_all(folder).with_context(|| format!("{} cannot be made", folder.display()))?;
    let mut compared = Vec::new();
    let bar = progress::bar("photographs", found.len());
    for found in found {
        let one = compare(found.read()?, renderer, world)?;
        let file = folder.join(format!("{}.png", one.photograph.name));
        write_image(&file, &one.rendered, ImageFileFormat::Png)?;
        compared.push(one);
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(compared)
}

/// Writes the report and prints it.
fn write(out: &Path, realism: &Realism) -> Result<()> {
    write_atomically(&out.join("realism.json"), |file| {
        writeln!(file, "{:#}", realism.to_json())
    })?;
    let page = page::page(realism)?;
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
fn compare(photograph: Photograph, renderer: &mut Renderer, world: &World) -> Result<Compared> {
    let camera = std::slice::from_ref(&photograph.camera);
    world.lend(|splats| renderer.render(splats, camera))?;
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

/// The scene with the lanes of `map`, as `drive` has it without images.
fn site_on(scene: &Path, map: &Path) -> Result<Site> {
    ensure!(
        is_scene_file(scene),
        "{} is no scene file: the ground needs its [[ego]] poses",
        scene.display()
    );
    let place = Place::Scene {
        scene: scene.to_owned(),
        map: map.to_owned(),
        obstacles: None,
    };
    let reading = progress::spinner("reading the ground and the obstacles".into());
    let site = Site::open(&place, Path::new(""), None)?;
    reading.finish_and_clear();
    Ok(site)
}

/// Detections in photographs, in the images of the scene, and in photographs of half the size. What
/// masks leave out for the most part does not count: it moves, and the scene does not have it.
fn detected(detector: &mut Detector, compared: &[Compared]) -> Result<ComparedDetections> {
    let bar = progress::bar("detecting", compared.len());
    let mut found: [Detections; 3] = Default::default();
    for one in compared {
        let photograph = &one.photograph;
        let half = photograph.half_size();
        let images = [&photograph.image, &one.rendered, &half];
        for (found, image) in found.iter_mut().zip(images) {
            let list = detector.detect(image)?;
            found.add(&list, |_| Some(photograph.name.clone()))?;
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    let [photographs, rendered, half] = found;
    let counts = |name: &str, rectangle: &[f64; 4]| {
        let mut photographs = compared.iter().map(|one| &one.photograph);
        let photograph = photographs.find(|photograph| photograph.name == name);
        photograph.is_none_or(|photograph| photograph.counted(rectangle) > 0.5)
    };
    let photographs = photographs.filtered(counts);
    let rendered = rendered.filtered(counts);
    let half = half.enlarged(2.0).filtered(counts);
    Ok(ComparedDetections {
        detector: Some(detector.name()),
        rendered: Agreement::between(&photographs, &rendered),
        half_size: Some(Agreement::between(&photographs, &half)),
        in_photographs: photographs,
        in_rendered: rendered,
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
