//! `decouplegs lidar`: sweeps of a LiDAR through a scene.

pub mod empty_beams;
pub mod previews;
pub mod scan_comparison;
pub mod scan_file;

use std::collections::{BTreeSet, HashSet};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::ValueEnum;
use decouplegs::asset::{
    LoadedScene, SceneFile, is_scene_file, lidar_names, open_scene, write_atomically,
};
use decouplegs::episode::chosen_lidars;
use decouplegs::render::rendered_image::ImageFileFormat;
use decouplegs::render::{FrameSplats, LidarOptions, LidarRenderer, RenderOptions, Renderer};
use decouplegs::scene::lidar::{PointFrame, ReturnMode, ReturnOptions};
use decouplegs::scene::{LidarSweep, Motion, Rig, RigLidar, Rules};
use decouplegs::session::{Session, World};
use decouplegs_recording::point_cloud::{McapSweeps, PointFormat, write_points};
use glam::{DQuat, DVec3};
use serde_json::json;

use crate::arguments::{finite, print, three_numbers, write_image};
use crate::background::BackgroundArguments;
use crate::device::{DeviceArguments, check_validation};
use crate::outputs::Force;
use crate::progress;
use scan_comparison::ScanComparison;
use scan_file::ScanFile;

/// Sweep a scene with a LiDAR: one file of points per sweep, listed as they are written
#[derive(clap::Args)]
pub struct Arguments {
    /// Splats, or a scene (.toml, .usdz)
    scene: PathBuf,
    #[arg(long, value_name = "NAME|FILE", help = format!("LiDAR: one of the scene; {}; a TOML file, or the parameters of NVIDIA NCore as JSON (default: the first of the scene)", lidar_names().join(", ")))]
    sensor: Option<String>,
    /// Folder for the files; created if it does not exist
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Format of the points
    #[arg(long, value_enum, default_value_t = Format::Pcd)]
    format: Format,
    /// Start of the first sweep, seconds (default: the start of the ego's trajectory)
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, value_parser = finite)]
    time: Option<f64>,
    /// Number of sweeps, one after the other
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    sweeps: u32,
    /// Frame of the points: of the sensor at each firing (raw), at the start or at the end of the
    /// sweep, of the vehicle at its end (ego), or of the world (default: end; ego for av2)
    #[arg(long, value_name = "FRAME", value_parser = PointFrame::NAMES)]
    frame: Option<String>,
    /// Place of the sensor on the vehicle, meters forward, left and up of the center of its box
    /// (default: that of the scene, otherwise 0,0,1.1)
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = place)]
    mount: Option<DVec3>,
    /// Direction of the sensor on the vehicle, degrees to the left (default: that of the scene,
    /// otherwise 0)
    #[arg(long, value_name = "DEGREES", allow_negative_numbers = true, value_parser = finite)]
    mount_yaw: Option<f64>,
    /// Range that a return reports (default: the sensor's own): of the splat at which half of the
    /// beam is gone, the mean by weight, of the splat that takes most, or two: of the strongest and
    /// of the last group of splats
    #[arg(long, value_name = "MODE", value_parser = ReturnMode::NAMED.map(|(name, _)| name))]
    returns: Option<String>,
    /// Share of a beam that splats have to take for a return
    #[arg(long, value_name = "SHARE", allow_negative_numbers = true, default_value_t = 0.5, value_parser = share)]
    opacity_min: f32,
    /// Standard deviation that is added to splats across the beams, radians: what the images that
    /// the scene was trained on have. sqrt(0.3) pixels over their focal length (default: that of
    /// the scene, otherwise 0.0005)
    #[arg(long, value_name = "RADIANS", allow_negative_numbers = true, value_parser = dilation)]
    dilation: Option<f64>,
    /// Seed of the noise of ranges, for sensors that have some
    #[arg(
        long,
        value_name = "SEED",
        allow_negative_numbers = true,
        default_value_t = 0
    )]
    seed: u64,
    /// Compare ranges with those of this scan (.bin of KITTI, .pcd.bin of nuScenes, .npy, .npz)
    /// instead, beam by beam: a table, and NAME_compared.json and .png in the folder. Beams of the
    /// sensor that have no point in the scan are traced too: a return of them is wrong. Where the
    /// file does not tell its pose, it is that of the scene's first LiDAR at SECONDS
    #[arg(long, value_name = "FILE[@SECONDS]", conflicts_with_all = ["sweeps", "frame", "mount", "mount_yaw", "previews", "seed"])]
    compare: Option<ScanFile>,
    /// Write previews of each sweep too: from above, as an image of ranges, and over the images of
    /// the scene's cameras
    #[arg(long)]
    previews: bool,
    #[command(flatten)]
    background: BackgroundArguments,
    #[command(flatten)]
    force: Force,
    #[command(flatten)]
    device: DeviceArguments,
}

/// Format of the points.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    /// x, y, z, intensity from 0 to 1, float32 (.bin)
    Kitti,
    /// x to the right, y forward, z, intensity from 0 to 255, ring from the lowest, float32
    /// (.pcd.bin)
    Nuscenes,
    /// Argoverse 2, 16-bit floats (.feather)
    Av2,
    /// Point Cloud Library, binary (.pcd)
    Pcd,
    /// Binary PLY (.ply)
    Ply,
    /// NumPy structured array (.npy)
    Npy,
    /// All sweeps in one file, ROS 2 PointCloud2 (.mcap)
    Mcap,
}

impl Format {
    /// The format of one file per sweep.
    fn of_sweeps(self) -> Option<PointFormat> {
        match self {
            Self::Kitti => Some(PointFormat::Kitti),
            Self::Nuscenes => Some(PointFormat::NuScenes),
            Self::Av2 => Some(PointFormat::Argoverse2),
            Self::Pcd => Some(PointFormat::Pcd),
            Self::Ply => Some(PointFormat::Ply),
            Self::Npy => Some(PointFormat::Npy),
            Self::Mcap => None,
        }
    }
}

fn place(text: &str) -> Result<DVec3, String> {
    three_numbers(text, 1e6)
        .map(DVec3::from_array)
        .ok_or_else(|| format!("expected X,Y,Z, found {text:?}"))
}

fn share(text: &str) -> Result<f32, String> {
    let parsed = finite(text)
        .ok()
        .filter(|share| (0.0..=1.0).contains(share));
    let parsed = parsed.ok_or_else(|| format!("expected 0 to 1, found {text:?}"))?;
    Ok(parsed as f32)
}

fn dilation(text: &str) -> Result<f64, String> {
    let parsed = finite(text)
        .ok()
        .filter(|angle| (1e-6..=0.1).contains(angle));
    parsed.ok_or_else(|| format!("expected 0.000001 to 0.1, found {text:?}"))
}

pub fn run(arguments: &Arguments) -> Result<()> {
    arguments.force.outputs(&[]).folder(&arguments.out)?;
    check_sensor(arguments)?;
    let reading = progress::spinner(format!("reading {}", arguments.scene.display()));
    let loaded = open_scene(&arguments.scene, arguments.time.unwrap_or(0.0))?;
    reading.finish_and_clear();
    let start_s = arguments.time.unwrap_or(loaded.ego.start_s());
    let gpu = arguments.device.open()?;
    let mut stored = RenderOptions::default();
    arguments.background.apply_to(&mut stored);
    let renderer = Renderer::new(&gpu, stored);
    let session = Session::on(&gpu, &stored.into());
    let mut world = World::new(&session.add_scene(&loaded)?);
    world.set_time(start_s);
    let rules = loaded.splat_scene.rules;
    let options = LidarOptions {
        rules: Rules {
            lidar_dilation_rad: arguments.dilation.unwrap_or(rules.lidar_dilation_rad),
            ..rules
        },
        ..LidarOptions::default()
    };
    fs::create_dir_all(&arguments.out)
        .with_context(|| format!("{} cannot be made", arguments.out.display()))?;
    let mut lidars = LidarRenderer::new(&gpu, options);
    if let Some(file) = &arguments.compare {
        world.lend(|splats| compare(file, arguments, &loaded, splats, &mut lidars))?;
        return check_validation(&gpu);
    }
    let mounted = mounted(arguments, &loaded.rig)?;
    let model = &mounted.model;
    let asked = arguments.returns.as_deref().and_then(ReturnMode::by_name);
    let mode = asked.unwrap_or(model.returns);
    let mut writer = SweepWriter::new(arguments, &mounted.name, mode, start_s)?;
    let mut previews = arguments
        .previews
        .then(|| previews::Previews::new(renderer, world.clone(), &loaded));
    let mut gpu_ms = Vec::new();
    let bar = progress::bar("sweeps", arguments.sweeps as usize);
    for index in 0..arguments.sweeps {
        let time_s = start_s + f64::from(index) * model.sweep_s;
        let start = loaded.ego.at(time_s);
        let end = loaded.ego.at(time_s + model.sweep_s);
        let motion = Motion::between(&start, &end, model.sweep_s);
        let lidar = mounted.sweep_from(&start, &motion);
        world.set_time(time_s);
        let traced = world.lend(|splats| lidars.trace(splats, &lidar, mode))?;
        let sweep = traced.returns(&ReturnOptions {
            mode,
            opacity_min: arguments.opacity_min,
            seed: arguments.seed.wrapping_add(u64::from(index)),
        });
        writer.add(index, &sweep, instances(&loaded, &sweep, time_s))?;
        gpu_ms.push(traced.gpu_time_ns as f64 * 1e-6);
        if let Some(previews) = &mut previews {
            for path in previews.write(&writer.stem(index), &sweep, time_s)? {
                print(&format!("{}\n", path.display()))?;
            }
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    gpu_ms.sort_by(f64::total_cmp);
    let median_ms = gpu_ms.get(gpu_ms.len() / 2).copied().unwrap_or(0.0);
    // Only for information.
    let _ = writeln!(
        std::io::stderr(),
        "{median_ms:.2} ms on the device per sweep (median of {})",
        gpu_ms.len()
    );
    writer.finish()?;
    check_validation(&gpu)
}

/// Compares the scan in `file` with the same beams through `splats`.
fn compare(
    file: &ScanFile,
    arguments: &Arguments,
    loaded: &LoadedScene,
    splats: FrameSplats<'_>,
    lidars: &mut LidarRenderer,
) -> Result<()> {
    let (scan, pose) = file.read(loaded)?;
    let mut comparison = ScanComparison::new(lidars, splats, &scan, pose)?;
    if arguments.sensor.is_some() || loaded.rig.lidars().next().is_some() {
        let sensor = mounted(arguments, &loaded.rig)?;
        let given = (sensor.model.as_ref(), &scan);
        comparison = comparison.with_empty_beams(lidars, splats, given, pose)?;
    }
    let path = |ending: &str| {
        arguments
            .out
            .join(format!("{}_compared.{ending}", file.name()))
    };
    write_atomically(&path("json"), |file| {
        writeln!(file, "{:#}", comparison.to_json())
    })?;
    write_image(&path("png"), &comparison.image(), ImageFileFormat::Png)?;
    print(&comparison.to_text())?;
    print(&format!(
        "{}\n{}\n",
        path("json").display(),
        path("png").display()
    ))
}

/// Refuses a LiDAR that nothing knows before the scene is loaded. Those in a package are known only
/// then.
fn check_sensor(arguments: &Arguments) -> Result<()> {
    let Some(sensor) = &arguments.sensor else {
        return Ok(());
    };
    if lidar_names().contains(&sensor.as_str()) || Path::new(sensor).exists() {
        return Ok(());
    }
    let own: Vec<String> = match SceneFile::read(&arguments.scene) {
        Ok(scene) => scene.lidars.into_iter().map(|lidar| lidar.name).collect(),
        Err(_) if is_scene_file(&arguments.scene) => return Ok(()),
        Err(_) => vec![],
    };
    let is_package = arguments
        .scene
        .extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("usdz"));
    ensure!(
        is_package || own.contains(sensor),
        "--sensor {sensor}: no LiDAR of the scene ({}), no model ({}) and no file has this name",
        if own.is_empty() {
            "it has none".to_owned()
        } else {
            own.join(", ")
        },
        lidar_names().join(", ")
    );
    Ok(())
}

/// The LiDAR that is asked for, on the vehicle. Its name names files.
fn mounted(arguments: &Arguments, rig: &Rig) -> Result<RigLidar> {
    let of_rig = || rig.lidars().map(|lidar| lidar.name.clone());
    let wanted = arguments.sensor.clone().or_else(|| of_rig().next());
    let wanted = wanted.with_context(|| {
        format!(
            "{} has no LiDAR: name a model with --sensor, one of {} or a file",
            arguments.scene.display(),
            lidar_names().join(", ")
        )
    })?;
    let mut lidars = chosen_lidars(rig, false, &[wanted])?;
    let mut lidar = lidars.remove(0);
    if !of_rig().any(|name| name == lidar.name) {
        lidar.name.clone_from(&lidar.model.name);
    }
    let plain = |letter: char| letter.is_ascii_alphanumeric() || "-_.".contains(letter);
    let name = &lidar.name;
    ensure!(
        !name.is_empty() && !name.starts_with('.') && name.chars().all(plain),
        "the sensor's name {name:?} cannot name a file: use letters, digits, '-' and '_'"
    );
    let pose = &mut lidar.rig_from_lidar;
    pose.translation = arguments.mount.unwrap_or(pose.translation);
    if let Some(yaw_deg) = arguments.mount_yaw {
        pose.rotation = DQuat::from_rotation_z(yaw_deg.to_radians());
    }
    Ok(lidar)
}

/// Agents with returns in a sweep that begins at `time_s`, by instance: name, class, and whether
/// they move.
fn instances(loaded: &LoadedScene, sweep: &LidarSweep, time_s: f64) -> serde_json::Value {
    let found: BTreeSet<u16> = sweep.returns.iter().map(|found| found.instance).collect();
    let moving: HashSet<u16> = loaded
        .agents
        .iter()
        .filter(|agent| !agent.trajectory.motion_at(time_s).is_rest())
        .map(|agent| agent.instance)
        .collect();
    let entry = |instance: &u16| {
        let label = loaded
            .agent_labels
            .get(usize::from(*instance).checked_sub(1)?)?;
        let of_agent = json!({
            "name": label.name,
            "class": label.class,
            "moving": moving.contains(instance),
        });
        Some((instance.to_string(), of_agent))
    };
    found.iter().filter_map(entry).collect()
}

/// Destination of sweeps.
struct SweepWriter<'a> {
    out: &'a Path,
    name: &'a str,
    format: Format,
    mode: ReturnMode,
    frame: &'a str,
    start_s: f64,
    mcap: Option<McapSweeps>,
}

impl<'a> SweepWriter<'a> {
    fn new(
        arguments: &'a Arguments,
        name: &'a str,
        mode: ReturnMode,
        start_s: f64,
    ) -> Result<Self> {
        let frame = arguments.frame.as_deref();
        let frame = frame.unwrap_or(match arguments.format {
            Format::Av2 => "ego",
            _ => "end",
        });
        let is_mcap = arguments.format == Format::Mcap;
        let mcap = is_mcap.then(|| McapSweeps::new(&format!("/lidar/{name}"), frame));
        Ok(Self {
            out: &arguments.out,
            name,
            format: arguments.format,
            mode,
            frame,
            start_s,
            mcap: mcap.transpose()?,
        })
    }

    /// Path of the files of a sweep, without extension.
    fn stem(&self, index: u32) -> PathBuf {
        self.out.join(format!("{}_{index:06}", self.name))
    }

    fn add(&mut self, index: u32, sweep: &LidarSweep, instances: serde_json::Value) -> Result<()> {
        let model = &sweep.lidar.model;
        let frame = PointFrame::by_name(self.frame, model.sweep_s)
            .context("the frame is one of the list")?;
        let points = sweep.points(frame);
        let time_s = self.start_s + f64::from(index) * model.sweep_s;
        let comments = [
            format!(
                "sensor {}, sweep from {time_s:.6} s to {:.6} s",
                model.name,
                time_s + model.sweep_s
            ),
            format!("frame {}, returns {}", self.frame, self.mode.name()),
            "intensity is the luma of the splats' colors: uncalibrated".to_owned(),
        ];
        let summary = json!({
            "sensor": model.name,
            "start_s": time_s,
            "end_s": time_s + model.sweep_s,
            "frame": self.frame,
            "returns": self.mode.name(),
            "intensity": "uncalibrated",
            "beams": sweep.beams.len(),
            "points": points.len(),
            "instances": instances,
        });
        let described = self.stem(index).with_added_extension("json");
        let text = format!("{summary:#}\n");
        write_atomically(&described, |file| file.write_all(text.as_bytes()))?;
        if let Some(mcap) = &mut self.mcap {
            mcap.add((time_s.max(0.0) * 1e9).round() as u64, &points)?;
        }
        if let Some(format) = self.format.of_sweeps() {
            let path = self.stem(index).with_added_extension(format.extension());
            write_points(&path, format, &points, model.rings(), &comments)?;
            print(&format!("{}\n", path.display()))?;
        }
        Ok(())
    }

    fn finish(self) -> Result<()> {
        if let Some(mcap) = self.mcap {
            let bytes = mcap.finish()?;
            let path = self.out.join(format!("{}.mcap", self.name));
            write_atomically(&path, |file| file.write_all(&bytes))?;
            print(&format!("{}\n", path.display()))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_out_of_range_are_refused() {
        assert_eq!(place("1,-2,0.5").unwrap(), DVec3::new(1.0, -2.0, 0.5));
        assert!(place("1,2").unwrap_err().contains("X,Y,Z"));
        assert!(share("1.5").unwrap_err().contains("0 to 1"));
        assert!(dilation("0").unwrap_err().contains("0.1"));
    }
}
