//! nuScenes v1.0 (Caesar et al., "nuScenes: A multimodal dataset for autonomous driving", 2020; the
//! schema of its devkit): thirteen tables and a file for each reading.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use decouplegs::asset::write_atomically;
use decouplegs::episode::reading_hash;
use decouplegs::scene::episode::Episode;
use decouplegs::scene::lidar::PointFrame;
use decouplegs::scene::{Pose, Rig, RoadUser};
use decouplegs_cli::png_bytes;
use decouplegs_recording::point_cloud::{PointFormat, write_points};
use glam::{DQuat, DVec3};
use serde_json::{Value, json};

use super::sensed::{LabeledAgent, Sensed};
use super::{DataSet, write_png};

/// Version that a devkit is asked for: the name of the folder of the tables.
const VERSION: &str = "v1.0-decouplegs";
/// Time of the start of every episode, microseconds since 1970: 2026-01-01.
const START_US: i64 = 1_767_225_600_000_000;
/// A road user that moves slower stands, meters per second.
const STANDS_MPS: f64 = 0.2;
/// Interval between keyframes, seconds. Readings between them are sweeps, without annotations.
const KEYFRAME_S: f64 = 0.5;
/// File that stands for a map: devkits want one to exist.
const MAP: &str = "maps/none.png";

/// Tables so far.
pub struct Tables {
    folder: PathBuf,
    episode: String,
    /// Height of the middle of the ego's box above its floor, meters.
    half_height_m: f64,
    tables: BTreeMap<&'static str, Vec<Value>>,
    /// Rows of the sensors' last readings, and of the agents' last annotations.
    last: BTreeMap<String, (&'static str, usize)>,
    /// Annotations of each agent.
    tracks: BTreeMap<String, Vec<String>>,
    samples: Vec<String>,
    /// Time of the last keyframe, seconds.
    keyframe_s: Option<f64>,
    /// Rows of readings since then: their sample comes later.
    pending: Vec<usize>,
    /// Counts of readings and of poses until then.
    settled: [usize; 2],
}

impl Tables {
    pub fn new(folder: &Path, episode: &Episode, rig: &Rig) -> Result<Self> {
        let scenario = &episode.head.scenario;
        let mut tables = Self {
            folder: folder.to_owned(),
            episode: scenario.name.clone(),
            half_height_m: 0.5 * scenario.ego.size.height_m,
            tables: BTreeMap::new(),
            last: BTreeMap::new(),
            tracks: BTreeMap::new(),
            samples: Vec::new(),
            keyframe_s: None,
            pending: Vec::new(),
            settled: [0, 0],
        };
        for name in [VERSION, "maps"] {
            tables.make(name)?;
        }
        let map = png_bytes::encode(&[0, 0, 0, 255], [1, 1]).map_err(anyhow::Error::msg)?;
        write_atomically(&folder.join(MAP), |file| file.write_all(&map))?;
        let log = tables.token("log", "");
        tables.row(
            "log",
            json!({
                "token": log, "logfile": scenario.name, "vehicle": "decouplegs",
                "date_captured": "2026-01-01", "location": "simulation",
            }),
        );
        let map = tables.token("map", "");
        tables.row(
            "map",
            json!({
                "token": map, "log_tokens": [log], "category": "semantic_prior", "filename": MAP,
            }),
        );
        for (level, share) in [(1, "0-40"), (2, "40-60"), (3, "60-80"), (4, "80-100")] {
            tables.row(
                "visibility",
                json!({
                    "token": level.to_string(), "level": format!("v{share}"),
                    "description": format!("visibility of the whole object is between {share} %"),
                }),
            );
        }
        for kind in RoadUser::ALL {
            let token = tables.token("category", kind.name());
            tables.row(
                "category",
                json!({
                    "token": token, "name": category(kind), "description": kind.name(),
                }),
            );
        }
        for name in ATTRIBUTES {
            let token = tables.token("attribute", name);
            tables.row(
                "attribute",
                json!({"token": token, "name": name, "description": name}),
            );
        }
        let half_m = tables.half_height_m;
        for camera in rig.cameras() {
            let k = &camera.intrinsics;
            // nuScenes counts pixels from the middle of the first, we from its corner.
            let matrix = json!([
                [k.fx_px, 0.0, k.cx_px - 0.5],
                [0.0, k.fy_px, k.cy_px - 0.5],
                [0.0, 0.0, 1.0],
            ]);
            let pose = on_floor(&camera.rig_from_camera, half_m);
            tables.sensor(&channel_of_camera(&camera.name), "camera", &pose, &matrix)?;
        }
        for lidar in rig.lidars() {
            let turned = Pose::new(turn_of_lidar(), DVec3::ZERO);
            let pose = on_floor(&lidar.rig_from_lidar.then(&turned), half_m);
            tables.sensor(LIDAR, "lidar", &pose, &json!([]))?;
        }
        Ok(tables)
    }

    fn make(&self, name: &str) -> Result<()> {
        let folder = self.folder.join(name);
        fs::create_dir_all(&folder).with_context(|| format!("{} cannot be made", folder.display()))
    }

    /// Token of a row: the same in every export of the episode.
    fn token(&self, table: &str, key: &str) -> String {
        let text = format!("{}/{table}/{key}", self.episode);
        format!("{:032x}", reading_hash(text.as_bytes()))
    }

    fn row(&mut self, table: &'static str, row: Value) -> usize {
        let rows = self.tables.entry(table).or_default();
        rows.push(row);
        rows.len() - 1
    }

    fn sensor(&mut self, channel: &str, modality: &str, pose: &Pose, matrix: &Value) -> Result<()> {
        self.make(&format!("samples/{channel}"))?;
        let sensor = self.token("sensor", channel);
        self.row(
            "sensor",
            json!({"token": sensor, "channel": channel, "modality": modality}),
        );
        let calibrated = self.token("calibrated_sensor", channel);
        self.row("calibrated_sensor", json!({
            "token": calibrated, "sensor_token": sensor, "translation": pose.translation.to_array(),
            "rotation": wxyz(pose.rotation), "camera_intrinsic": matrix,
        }));
        Ok(())
    }

    /// Adds a row that is linked with the row before of the same thing, by `prev` and `next`.
    fn linked(&mut self, table: &'static str, thing: &str, mut row: Value) -> String {
        let token = row["token"].as_str().unwrap_or_default().to_owned();
        let key = format!("{table}/{thing}");
        (row["prev"], row["next"]) = ("".into(), "".into());
        if let Some(&(_, before)) = self.last.get(&key) {
            let rows = self.tables.entry(table).or_default();
            row["prev"] = rows[before]["token"].clone();
            rows[before]["next"] = token.clone().into();
        }
        let place = self.row(table, row);
        self.last.insert(key, (table, place));
        token
    }

    /// Adds the row of a reading, of a keyframe if there is a `sample`. Returns the name of its
    /// file.
    fn reading(
        &mut self,
        sensed: &Sensed,
        sample: Option<&str>,
        channel: &str,
        size_px: [u32; 2],
        format: &str,
    ) -> Result<String> {
        let folder = match sample {
            Some(_) => "samples",
            None => "sweeps",
        };
        self.make(&format!("{folder}/{channel}"))?;
        let file = format!(
            "{folder}/{channel}/{}_{:04}.{format}",
            self.episode, sensed.step
        );
        let token = self.token("sample_data", &format!("{channel}/{}", sensed.step));
        let [width_px, height_px] = size_px;
        let kind = if format == "png" { "png" } else { "pcd" };
        let row = json!({
            "token": token, "sample_token": sample,
            "ego_pose_token": self.token("ego_pose", &sensed.step.to_string()),
            "calibrated_sensor_token": self.token("calibrated_sensor", channel),
            "timestamp": timestamp(sensed), "fileformat": kind, "is_key_frame": sample.is_some(),
            "height": height_px, "width": width_px, "filename": file,
        });
        self.linked("sample_data", channel, row);
        if sample.is_none() {
            self.pending.push(self.tables["sample_data"].len() - 1);
        }
        Ok(file)
    }

    /// Adds the sample of `sensed` if it is a keyframe. It is also that of the readings since the
    /// keyframe before: they point to the sample that follows them.
    fn keyframe(&mut self, sensed: &Sensed) -> Option<String> {
        let since_s = self.keyframe_s.map(|before_s| sensed.time_s - before_s);
        if since_s.is_some_and(|since_s| since_s < KEYFRAME_S - 1e-6) {
            return None;
        }
        let row = json!({
            "token": self.token("sample", &sensed.step.to_string()), "timestamp": timestamp(sensed),
            "scene_token": self.token("scene", ""),
        });
        let sample = self.linked("sample", "", row);
        let readings = self.tables.entry("sample_data").or_default();
        for row in self.pending.drain(..) {
            readings[row]["sample_token"] = sample.clone().into();
        }
        self.keyframe_s = Some(sensed.time_s);
        self.samples.push(sample.clone());
        Some(sample)
    }

    /// Takes back the readings after the last keyframe, which no sample follows.
    fn take_back_pending(&mut self) -> Result<()> {
        let [readings, poses] = self.settled;
        self.tables.entry("ego_pose").or_default().truncate(poses);
        let rows = self.tables.entry("sample_data").or_default();
        for taken in rows.split_off(readings) {
            for row in rows.iter_mut().filter(|row| row["next"] == taken["token"]) {
                row["next"] = "".into();
            }
            let file = self
                .folder
                .join(taken["filename"].as_str().unwrap_or_default());
            fs::remove_file(&file).with_context(|| format!("{} is in the way", file.display()))?;
        }
        Ok(())
    }

    fn annotate(&mut self, sensed: &Sensed, sample: &str, index: usize) {
        let agent = &sensed.agents[index];
        let seen = sensed.images.iter().filter_map(|image| image.boxes[index]);
        let (visible, alone) = seen.fold((0, 0), |(visible, alone), seen| {
            let pixels = seen.visible.map_or(0, |visible| visible.pixels);
            (
                visible + pixels.min(seen.pixels_alone),
                alone + seen.pixels_alone,
            )
        });
        let points = sensed.points_on(agent);
        // Far from all sensors.
        if alone == 0 && points == 0 {
            return;
        }
        let share = f64::from(visible) / f64::from(alone.max(1));
        let level = [0.4, 0.6, 0.8]
            .iter()
            .filter(|least| share >= **least)
            .count()
            + 1;
        let token = self.token(
            "sample_annotation",
            &format!("{}/{}", agent.name, sensed.step),
        );
        let [length_m, width_m, height_m] = agent.dims_m;
        let row = json!({
            "token": token, "sample_token": sample,
            "instance_token": self.token("instance", &agent.name),
            "visibility_token": level.to_string(),
            "attribute_tokens": [self.token("attribute", attribute(agent))],
            "translation": agent.pose.translation.to_array(),
            "size": [width_m, length_m, height_m],
            "rotation": wxyz(agent.pose.rotation),
            "num_lidar_pts": points, "num_radar_pts": 0,
        });
        self.linked("sample_annotation", &agent.name, row);
        let track = self.tracks.entry(agent.name.clone()).or_default();
        if track.is_empty() {
            let category = self.token("category", agent.kind.name());
            let instance = self.token("instance", &agent.name);
            self.row(
                "instance",
                json!({"token": instance, "category_token": category, "name": agent.name}),
            );
        }
        self.tracks
            .entry(agent.name.clone())
            .or_default()
            .push(token);
    }
}

impl DataSet for Tables {
    fn add(&mut self, sensed: &Sensed) -> Result<()> {
        let step = sensed.step.to_string();
        let ego = sensed.ego.then(&Pose::new(
            DQuat::IDENTITY,
            DVec3::new(0.0, 0.0, -self.half_height_m),
        ));
        let token = self.token("ego_pose", &step);
        self.row(
            "ego_pose",
            json!({
                "token": token, "timestamp": timestamp(sensed),
                "translation": ego.translation.to_array(), "rotation": wxyz(ego.rotation),
            }),
        );
        let sample = self.keyframe(sensed);
        for image in &sensed.images {
            let k = &image.camera.intrinsics;
            let channel = channel_of_camera(&image.camera.name);
            let size_px = [k.width_px, k.height_px];
            let file = self.reading(sensed, sample.as_deref(), &channel, size_px, "png")?;
            write_png(&self.folder.join(file), image)?;
        }
        if let Some(sweep) = &sensed.sweep {
            let file = self.reading(sensed, sample.as_deref(), LIDAR, [0, 0], "pcd.bin")?;
            let points = sweep.points(PointFrame::End);
            let rings = sweep.lidar.model.rings();
            write_points(
                &self.folder.join(file),
                PointFormat::NuScenes,
                &points,
                rings,
                &[],
            )?;
        }
        let Some(sample) = sample else {
            return Ok(());
        };
        for index in 0..sensed.agents.len() {
            self.annotate(sensed, &sample, index);
        }
        self.settled =
            ["sample_data", "ego_pose"].map(|table| self.tables.get(table).map_or(0, Vec::len));
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<String> {
        self.take_back_pending()?;
        let (token, log) = (self.token("scene", ""), self.token("log", ""));
        let ends =
            [self.samples.first(), self.samples.last()].map(|end| end.cloned().unwrap_or_default());
        let row = json!({
            "token": token, "log_token": log, "nbr_samples": self.samples.len(),
            "first_sample_token": ends[0], "last_sample_token": ends[1],
            "name": self.episode, "description": "episode of DecoupleGS",
        });
        self.row("scene", row);
        for row in self.tables.entry("instance").or_default() {
            let name = row["name"].as_str().unwrap_or_default();
            let track = &self.tracks[name];
            let (first, last) = (track[0].clone(), track[track.len() - 1].clone());
            row["nbr_annotations"] = track.len().into();
            (row["first_annotation_token"], row["last_annotation_token"]) =
                (first.into(), last.into());
        }
        for table in TABLES {
            let rows = self.tables.entry(table).or_default();
            let text = serde_json::to_string_pretty(rows)?;
            let path = self.folder.join(VERSION).join(format!("{table}.json"));
            write_atomically(&path, |file| file.write_all(text.as_bytes()))?;
        }
        let count = |table: &str| self.tables.get(table).map_or(0, Vec::len);
        Ok(format!(
            "nuScenes tables {VERSION}, {} samples, {} readings, {} annotations",
            count("sample"),
            count("sample_data"),
            count("sample_annotation")
        ))
    }
}

const TABLES: [&str; 13] = [
    "attribute",
    "calibrated_sensor",
    "category",
    "ego_pose",
    "instance",
    "log",
    "map",
    "sample",
    "sample_annotation",
    "sample_data",
    "scene",
    "sensor",
    "visibility",
];
const ATTRIBUTES: [&str; 5] = [
    "vehicle.moving",
    "vehicle.stopped",
    "cycle.with_rider",
    "pedestrian.moving",
    "pedestrian.standing",
];
const LIDAR: &str = "LIDAR_TOP";

fn channel_of_camera(name: &str) -> String {
    format!("CAM_{}", name.to_uppercase())
}

fn category(kind: RoadUser) -> &'static str {
    match kind {
        RoadUser::Car => "vehicle.car",
        RoadUser::Truck => "vehicle.truck",
        RoadUser::Bus => "vehicle.bus.rigid",
        RoadUser::Cyclist => "vehicle.bicycle",
        RoadUser::Pedestrian => "human.pedestrian.adult",
    }
}

fn attribute(agent: &LabeledAgent) -> &'static str {
    let moves = agent.motion.velocity_mps.length() >= STANDS_MPS;
    match (agent.kind, moves) {
        (RoadUser::Cyclist, _) => "cycle.with_rider",
        (RoadUser::Pedestrian, true) => "pedestrian.moving",
        (RoadUser::Pedestrian, false) => "pedestrian.standing",
        (_, true) => "vehicle.moving",
        (_, false) => "vehicle.stopped",
    }
}

/// Pose relative to the point on the floor below the middle of the ego's box, from one relative to
/// that middle.
fn on_floor(rig_from_sensor: &Pose, half_height_m: f64) -> Pose {
    let up_m = DVec3::new(0.0, 0.0, half_height_m);
    Pose::new(rig_from_sensor.rotation, rig_from_sensor.translation + up_m)
}

/// Turn of nuScenes' LiDAR, whose x axis is to the right and y forward, to ours.
fn turn_of_lidar() -> DQuat {
    DQuat::from_rotation_z(-std::f64::consts::FRAC_PI_2)
}

fn timestamp(sensed: &Sensed) -> i64 {
    START_US + (1e6 * sensed.time_s).round() as i64
}

fn wxyz(q: DQuat) -> [f64; 4] {
    [q.w, q.x, q.y, q.z]
}
