//! `decouplegs import`: a scene to drive in, from a recording and splats that were trained on it.

mod kitti;
mod lanes;
mod ncore;
mod nuscenes;
mod posed_images;
mod recording;
mod scans;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::ValueEnum;
use decouplegs::asset::cameras::transforms;
use decouplegs::asset::maps::lane_json;
use decouplegs::asset::ncore::NcoreSequence;
use decouplegs::asset::scene_file::path_from;
use decouplegs::asset::tracks::write_poses;
use decouplegs::asset::{
    SceneFile, SceneRecording, SceneSky, SeenFrom, SkyKind, inria_ply, read_placed_splats,
    write_atomically, write_ground, write_obstacles,
};
use decouplegs::drive::{Ground, GroundGuides, GroundOptions, Survey};
use decouplegs::scene::{Pose, SplatCloud, Trajectory, VehicleSize};
use glam::{DMat3, DQuat, DVec3};
use std::io::Write as _;

use self::recording::Recording;
use self::scans::Surveyed;
use crate::arguments::{print, warn};
use crate::progress;

/// Form of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Form {
    /// A drive of KITTI's raw data, synced and rectified
    Kitti,
    /// A scene of nuScenes: the folder with maps, samples, sweeps and v1.0-mini, or that of the
    /// tables
    Nuscenes,
    /// transforms.json of nerfstudio or instant-ngp, or its folder
    Nerfstudio,
    /// Folder with a COLMAP model
    Colmap,
    /// Sequence of NVIDIA NCore, version 4: its JSON file, or the folder that it lies in
    Ncore,
}

/// Make a scene to drive in from a recording and the splats that were trained on its images: the
/// rig, the way of the vehicle, views, lanes along the way and labeled boxes
///
/// The new folder holds scene.toml, cameras.json, lanes.json and, where boxes are labeled,
/// tracks.csv; with --hold-out, held_out.txt. Where a KITTI drive has scans, ground.ply and
/// obstacles.json are made of them. A sky of Instant NuRec beside the splats (X.sky.npz) is named
/// in the scene. The splats stay where they are, unless --level turns them.
#[derive(clap::Args)]
pub struct Arguments {
    /// Form of the recording
    form: Form,
    /// Recording: a folder, or a file of cameras
    recording: PathBuf,
    /// Splats that were trained on the recording (.ply, .spz, ...), in its coordinates
    #[arg(long, value_name = "FILE")]
    splats: PathBuf,
    /// Folder of the new scene; it must not exist, or be empty
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Cameras that the splats were trained with, in place of the poses of a KITTI drive: a
    /// transforms.json whose names hold frame and camera, such as 000004_2.png
    #[arg(long, value_name = "FILE")]
    poses: Option<PathBuf>,
    /// Box of the vehicle that recorded, meters [default: those of KITTI's and nuScenes' cars,
    /// else 4.5,1.8,1.5]
    #[arg(long, value_name = "LENGTH,WIDTH,HEIGHT", value_parser = triple)]
    vehicle: Option<[f64; 3]>,
    /// Middle of the vehicle's box from the origin of the recorded poses, meters forward, left and
    /// up: from the IMU of a KITTI drive, from the rear axle on the ground of nuScenes and NCore,
    /// else from the front camera [default: 1.23,-0.32,-0.17 for KITTI, 1.386,0,0.781 for nuScenes,
    /// 1.35,0 and half of the height for NCore, else -0.3,0,-0.75]
    #[arg(long, value_name = "X,Y,Z", value_parser = triple, allow_hyphen_values = true)]
    middle: Option<[f64; 3]>,
    /// Scene of nuScenes: its name, or its place in the table counted from 0 [default: the only
    /// one]
    #[arg(long, value_name = "NAME|NUMBER")]
    scene: Option<String>,
    /// Place of the splats' origin in the coordinates of the recording, meters: for splats in a
    /// local frame with the same axes [default: 0,0,0]
    #[arg(long, value_name = "X,Y,Z", value_parser = triple, allow_hyphen_values = true)]
    origin: Option<[f64; 3]>,
    /// Name every N-th image of each camera of an NCore sequence, or every N-th keyframe of
    /// nuScenes, in held_out.txt, to hold out of training
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..))]
    hold_out: Option<u32>,
    /// Images per second of a recording without times
    #[arg(long, value_name = "HZ", allow_negative_numbers = true, default_value_t = 10.0, value_parser = rate)]
    rate: f64,
    /// Write the images of an NCore sequence into the folder images, as they were encoded;
    /// images.csv names their cameras and times
    #[arg(long)]
    images: bool,
    /// Turn the scene until its z axis is up, with its splats, which are written as background.ply
    #[arg(long)]
    level: bool,
}

fn triple(text: &str) -> Result<[f64; 3], String> {
    let numbers: Option<Vec<f64>> = text
        .split(',')
        .map(|part| part.trim().parse().ok().filter(|x: &f64| x.is_finite()))
        .collect();
    let bad = || format!("expected three numbers such as 4.5,1.8,1.5, found {text:?}");
    numbers.ok_or_else(bad)?.try_into().map_err(|_| bad())
}

fn rate(text: &str) -> Result<f64, String> {
    let rate: Option<f64> = text.parse().ok();
    rate.filter(|rate| (0.01..=1000.0).contains(rate))
        .ok_or_else(|| format!("expected 0.01 to 1000 images per second, found {text:?}"))
}

/// A scene that is tilted by more is worth a word, degrees.
const TILT_DEG_MAX: f64 = 1.0;
/// Poses that are farther from where they should be above the ground are worth a word, meters.
const HEIGHT_OFF_M_MAX: f64 = 0.15;
/// Points of splats that are labeled road, where they are turned.
const GROUND: &str = "ground.ply";
/// Places along the way at which the ground is asked for.
const PLACES: usize = 200;

pub fn run(arguments: &Arguments) -> Result<()> {
    let out = &arguments.out;
    if let Ok(mut entries) = std::fs::read_dir(out) {
        ensure!(
            entries.next().is_none(),
            "{} is not empty: nothing that exists is replaced; name another folder with --out",
            out.display()
        );
    }
    let (mut recording, sequence) = recording_of(arguments)?;
    let reading = progress::spinner(format!("reading {}", arguments.splats.display()));
    let placed = read_placed_splats(&arguments.splats)?;
    let road_m: Vec<DVec3> = placed.road_points_m();
    let (mut splats, mut origin) = (placed.cloud, placed.origin);
    reading.finish_and_clear();
    // In f64: coordinates of a city have no millimeters in f32.
    let offset_m = arguments.origin.map_or(DVec3::ZERO, DVec3::from_array);
    origin += offset_m;
    let tilt_deg = recording
        .level_from_world
        .angle_between(DQuat::IDENTITY)
        .to_degrees();
    let turned = match arguments.level {
        true => recording.level_from_world,
        false => DQuat::IDENTITY,
    };
    if arguments.level {
        let level = Pose::new(recording.level_from_world, DVec3::ZERO);
        splats = splats.placed(&level, true);
        origin = level.transform(origin);
        recording.turn(&level);
    }
    let surveyed = scans::survey(&recording)?;
    if let Some(middle_m) = surveyed.as_ref().and_then(|surveyed| surveyed.middle_m) {
        recording.ego_height_m = middle_m;
    }
    std::fs::create_dir_all(out).with_context(|| format!("{} cannot be made", out.display()))?;
    let background = if arguments.level {
        let file = PathBuf::from("background.ply");
        inria_ply::write(&out.join(&file), &splats)?;
        // The file has no labels.
        if !road_m.is_empty() {
            let road_m: Vec<DVec3> = road_m.iter().map(|point| turned * *point).collect();
            write_ground(&out.join(GROUND), &road_m)?;
        }
        file
    } else {
        path_from(out, &arguments.splats)
            .with_context(|| format!("{} cannot be named", arguments.splats.display()))?
    };
    let ego_height_m = recording.ego_height_m;
    let scene = SceneFile {
        // A file that was not written anew has its own origin.
        origin: if arguments.level { origin } else { offset_m },
        rig: recording.rig.clone(),
        lidars: recording.lidars.clone(),
        ego: Some(recording.ego.clone()),
        ego_height_m: Some(ego_height_m),
        recording: SceneRecording {
            ground: (surveyed.is_some() || arguments.level && !road_m.is_empty())
                .then(|| GROUND.into()),
            obstacles: surveyed.as_ref().map(|_| "obstacles.json".into()),
            seen_from: Some(SeenFrom::Cameras("cameras.json".into())),
            vehicle_size: Some(recording.vehicle),
        },
        sky_map: sky_beside(&arguments.splats, out, turned)?,
        ..SceneFile::of_background(background)
    };
    write_files(out, &recording, surveyed.as_ref(), scene.origin)?;
    if let Some(sequence) = &sequence {
        sequence.notes.iter().for_each(|sentence| warn(sentence));
        if arguments.images {
            ncore::write_images(sequence, out)?;
        }
    }
    let lanes = lanes::along(&recording.ego, ego_height_m);
    if let Some(lanes) = &lanes {
        lane_json::write(&out.join("lanes.json"), lanes)?;
    }
    // Last: when it is there, all that it names is.
    scene.write(&out.join("scene.toml"))?;
    let looking = progress::spinner("measuring the ground".into());
    let check = checked(&splats, origin, &recording, surveyed.as_ref());
    looking.finish_and_clear();
    for sentence in &check.warnings {
        warn(sentence);
    }
    if tilt_deg > TILT_DEG_MAX && !arguments.level {
        warn(&format!(
            "the world is tilted by {tilt_deg:.1} degrees against the vertical: --level turns it, with its splats"
        ));
    }
    let lines = report(&recording, &scene, &check, surveyed.as_ref());
    print(&closed(lines, lanes.is_some(), out))
}

/// Writes the files of a recording: its views, labels, and what the scene names. The ground is
/// written about `origin`.
fn write_files(
    out: &Path,
    recording: &Recording,
    surveyed: Option<&Surveyed>,
    origin: DVec3,
) -> Result<()> {
    for file in &recording.files {
        write_atomically(&out.join(&file.path), |to| to.write_all(&file.content))?;
    }
    let cameras = transforms(&recording.views)?;
    write_atomically(&out.join("cameras.json"), |file| {
        writeln!(file, "{cameras:#}")
    })?;
    if let Some(surveyed) = surveyed {
        let about: Vec<DVec3> = surveyed.ground_m.iter().map(|at| *at - origin).collect();
        write_ground(&out.join(GROUND), &about)?;
        write_obstacles(&out.join("obstacles.json"), &surveyed.obstacles)?;
    }
    if !recording.held_out.is_empty() {
        write_atomically(&out.join("held_out.txt"), |file| {
            writeln!(file, "{}", recording.held_out.join("\n"))
        })?;
    }
    if !recording.tracks.is_empty() {
        write_poses(&out.join("tracks.csv"), &recording.tracks)?;
    }
    Ok(())
}

/// The recording, and the sequence that it is, where it is one of NCore.
fn recording_of(arguments: &Arguments) -> Result<(Recording, Option<NcoreSequence>)> {
    let vehicle = arguments.vehicle.map(VehicleSize::from_array);
    let middle_m = arguments.middle.map(DVec3::from_array);
    let path = &arguments.recording;
    ensure!(
        arguments.poses.is_none() || arguments.form == Form::Kitti,
        "--poses belongs to a KITTI drive: other recordings have their own"
    );
    ensure!(
        !arguments.images || arguments.form == Form::Ncore,
        "--images belongs to an NCore sequence: the images of other recordings are files already"
    );
    ensure!(
        arguments.scene.is_none() || arguments.form == Form::Nuscenes,
        "--scene belongs to nuScenes"
    );
    ensure!(
        arguments.hold_out.is_none() || matches!(arguments.form, Form::Nuscenes | Form::Ncore),
        "--hold-out belongs to nuScenes and NCore"
    );
    let hold_out = arguments.hold_out.map(|every| every as usize);
    let recording = match arguments.form {
        Form::Ncore => {
            let (recording, sequence) = ncore::read(path, vehicle, middle_m, hold_out)?;
            return Ok((recording, Some(sequence)));
        }
        Form::Kitti => kitti::read(path, arguments.poses.as_deref(), vehicle, middle_m)?,
        Form::Nuscenes => nuscenes::read(
            path,
            arguments.scene.as_deref(),
            vehicle,
            middle_m,
            hold_out,
        )?,
        Form::Nerfstudio | Form::Colmap => {
            let file = match arguments.form {
                Form::Nerfstudio if path.is_dir() => path.join("transforms.json"),
                _ => path.clone(),
            };
            posed_images::read(&file, vehicle, middle_m, arguments.rate)?
        }
    };
    Ok((recording, None))
}

/// Sky of Instant NuRec beside the splats at `path`, as a scene in `out` names it that is turned by
/// `turned`.
fn sky_beside(path: &Path, out: &Path, turned: DQuat) -> Result<Option<SceneSky>> {
    let sky = path.with_extension("sky.npz");
    if !sky.is_file() {
        return Ok(None);
    }
    let named = path_from(out, &sky);
    let named = named.with_context(|| format!("{} cannot be named", sky.display()))?;
    Ok(Some(SceneSky {
        world_from_sky: DMat3::from_quat(turned),
        ..SceneSky::new(named, SkyKind::Npz)
    }))
}

/// Answer of the splats about the way.
struct Check {
    /// Median height of the ego's poses above the ground of the splats, where they show one.
    height_m: Option<f64>,
    places: usize,
    warnings: Vec<String>,
}

/// Measures the way of `recording` against `splats`, whose means are relative to `origin`.
fn checked(
    splats: &SplatCloud,
    origin: DVec3,
    recording: &Recording,
    surveyed: Option<&Surveyed>,
) -> Check {
    let ground = Ground::new(splats, origin, &GroundOptions::default());
    let places = along(&recording.ego);
    let mut heights_m: Vec<f64> = places
        .iter()
        .filter_map(|at| {
            let below = ground.height_at(at.truncate(), Some(at.z - recording.ego_height_m))?;
            Some(at.z - below.z_m)
        })
        .collect();
    heights_m.sort_by(f64::total_cmp);
    let height_m = heights_m.get(heights_m.len() / 2).copied();
    let mut warnings = Vec::new();
    match height_m {
        Some(height_m) if (height_m - recording.ego_height_m).abs() > HEIGHT_OFF_M_MAX => {
            warnings.push(format!(
                "the middle of the vehicle is {height_m:.2} m above the ground of the splats, and {:.2} m were expected: \
                 the origin of the recorded poses may be another one ({}); give its place with --middle",
                recording.ego_height_m, recording.origin
            ));
        }
        Some(_) => {}
        None => warnings.push(
            "no ground was found below the way: are the splats in the coordinates of the recording? Those in a local frame need --origin".into(),
        ),
    }
    if recording.scans.is_some() && surveyed.is_none() {
        warnings.push("the scans show no ground below the way: are the poses and --middle those of the recording?".into());
    }
    let survey = surveyed.and_then(|surveyed| Survey::from_points(surveyed.ground_m.clone()));
    let guides = GroundGuides {
        survey: survey.as_ref(),
        ..GroundGuides::for_way(recording.ego.poses(), Some(recording.ego_height_m))
    };
    let guided = ground.guided(splats, guides);
    warnings.extend(guided.quality().and_then(|quality| quality.warning()));
    Check {
        height_m,
        places: heights_m.len(),
        warnings,
    }
}

/// Places along a way.
fn along(way: &Trajectory) -> Vec<DVec3> {
    let span_s = way.end_s() - way.start_s();
    let at = |place: usize| {
        let share = place as f64 / (PLACES - 1) as f64;
        way.at(way.start_s() + share * span_s).translation
    };
    (0..PLACES).map(at).collect()
}

fn report(
    recording: &Recording,
    scene: &SceneFile,
    check: &Check,
    surveyed: Option<&Surveyed>,
) -> Vec<String> {
    let way: Vec<DVec3> = along(&recording.ego);
    let length_m: f64 = way.windows(2).map(|pair| pair[0].distance(pair[1])).sum();
    let span_s = recording.ego.end_s() - recording.ego.start_s();
    let cameras: Vec<&str> = scene
        .rig
        .cameras()
        .map(|camera| camera.name.as_str())
        .collect();
    let height = check
        .height_m
        .map_or("-".into(), |height_m| format!("{height_m:.2} m"));
    let [length, width, tall] = recording.vehicle.to_array();
    let mut lines = vec![
        format!("origin     {}", recording.origin),
        format!(
            "vehicle    {length:.2} x {width:.2} x {tall:.2} m; its middle {:.2} m above the road, {height} above the ground of the splats ({} of {PLACES} places)",
            recording.ego_height_m, check.places
        ),
        format!(
            "way        {} poses, {length_m:.1} m, {span_s:.1} s",
            recording.ego.poses().len()
        ),
        format!(
            "cameras    {}; {} views",
            cameras.join(", "),
            recording.views.len()
        ),
    ];
    if scene.origin != DVec3::ZERO {
        let [x, y, z] = scene.origin.to_array();
        lines.push(format!(
            "splats     around {x:.3}, {y:.3}, {z:.3} m, which are taken off in f64"
        ));
    }
    if !recording.held_out.is_empty() {
        lines.push(format!(
            "held out   {} views, in held_out.txt",
            recording.held_out.len()
        ));
    }
    if !recording.tracks.is_empty() {
        let ids: std::collections::HashSet<&str> =
            recording.tracks.iter().map(|row| row.id.as_str()).collect();
        lines.push(format!("tracks     {} labeled road users", ids.len()));
    }
    if let Some(surveyed) = surveyed {
        lines.push(format!(
            "scans      {}: ground at {} places, {} obstacles beside the way",
            surveyed.scans,
            surveyed.ground_m.len(),
            surveyed.obstacles.len()
        ));
    }
    lines
}

/// `lines`, and what was written and comes next.
fn closed(mut lines: Vec<String>, has_lanes: bool, out: &Path) -> String {
    lines.push(match has_lanes {
        true => "lanes      one along the way, as no map is there".into(),
        false => "lanes      none: the vehicle stood".into(),
    });
    let scene = out.join("scene.toml");
    lines.push(scene.display().to_string());
    if has_lanes {
        lines.push(format!(
            "next       decouplegs drive --scene {} --map {} --follow-recording --planner constant-velocity --out RUN",
            scene.display(),
            out.join("lanes.json").display()
        ));
    }
    lines.join("\n") + "\n"
}

/// A way of poses, or what is wrong with them.
fn way_of(poses: Vec<decouplegs::scene::TimedPose>) -> Result<Trajectory> {
    if poses.is_empty() {
        bail!("the recording has no poses");
    }
    Trajectory::new(poses).map_err(|reason| anyhow::anyhow!("the poses are no way: {reason}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_options_are_checked() {
        assert_eq!(triple("4.5, 1.8,1.5"), Ok([4.5, 1.8, 1.5]));
        for text in ["", "1,2", "1,2,3,4", "1,2,x", "1,2,inf"] {
            assert!(triple(text).is_err(), "{text}");
        }
        assert!(rate("0").is_err() && rate("10").is_ok() && rate("x").is_err());
    }
}
