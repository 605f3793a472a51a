//! KITTI object detection (Geiger, Lenz and Urtasun, "Are we ready for autonomous driving?", 2012;
//! its development kit's readme): one camera, with the LiDAR's points.

use std::fmt::Write as _;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use decouplegs::asset::write_atomically;
use decouplegs::drive::polyline::wrapped;
use decouplegs::scene::bounding_box::AgentBox;
use decouplegs::scene::lidar::PointFrame;
use decouplegs::scene::{Camera, Pose, Rig, RoadUser};
use decouplegs_recording::point_cloud::{PointFormat, write_points};
use glam::DVec3;

use super::sensed::{Labeled, LabeledAgent, Sensed};
use super::{DataSet, write_png};

/// Folders of the data set.
pub struct Folders {
    folder: PathBuf,
    steps: usize,
    labels: usize,
}

impl Folders {
    pub fn new(folder: &Path, rig: &Rig) -> Result<Self> {
        let cameras: Vec<&str> = rig.cameras().map(|camera| camera.name.as_str()).collect();
        let [_] = cameras[..] else {
            bail!(
                "a KITTI data set has one camera: name it with --cameras, one of {}",
                cameras.join(", ")
            );
        };
        for camera in rig.cameras() {
            ensure!(
                camera.intrinsics.lens.is_pinhole(),
                "camera {:?} has a lens, and KITTI's files know pinholes alone",
                camera.name
            );
        }
        for name in ["image_2", "label_2", "calib", "velodyne"] {
            let made = fs::create_dir(folder.join(name));
            made.with_context(|| format!("{} cannot be made", folder.join(name).display()))?;
        }
        Ok(Self {
            folder: folder.to_owned(),
            steps: 0,
            labels: 0,
        })
    }

    fn text(&self, folder: &str, step: u32, ending: &str, text: &str) -> Result<()> {
        let path = self.folder.join(folder).join(format!("{step:06}.{ending}"));
        Ok(write_atomically(&path, |file| {
            file.write_all(text.as_bytes())
        })?)
    }
}

impl DataSet for Folders {
    fn add(&mut self, sensed: &Sensed) -> Result<()> {
        let image = &sensed.images[0];
        let step = sensed.step;
        let path = self.folder.join(format!("image_2/{step:06}.png"));
        write_png(&path, image)?;
        let mut lines = String::new();
        for (agent, labeled) in sensed.agents.iter().zip(&image.boxes) {
            // What is wholly hidden has no label.
            if let Some(labeled) = labeled.filter(|labeled| labeled.visible.is_some()) {
                lines += &label(agent, &labeled);
                self.labels += 1;
            }
        }
        self.text("label_2", step, "txt", &lines)?;
        let lidar = sensed.sweep.as_ref().map(|sweep| {
            let end_s = sweep.lidar.model.sweep_s;
            sweep.lidar.pose_at(end_s)
        });
        let text = calibration(&image.camera, lidar.as_ref(), &sensed.ego);
        self.text("calib", step, "txt", &text)?;
        if let Some(sweep) = &sensed.sweep {
            let path = self.folder.join(format!("velodyne/{step:06}.bin"));
            let points = sweep.points(PointFrame::End);
            write_points(
                &path,
                PointFormat::Kitti,
                &points,
                sweep.lidar.model.rings(),
                &[],
            )?;
        }
        self.steps += 1;
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<String> {
        Ok(format!("{} images, {} labels", self.steps, self.labels))
    }
}

/// Line of `label_2`: type, truncated, occluded, alpha, 2D box, height, width, length, middle of
/// the floor in the camera's frame, rotation about the camera's y axis.
fn label(agent: &LabeledAgent, labeled: &Labeled) -> String {
    let kind = match agent.kind {
        RoadUser::Car => "Car",
        RoadUser::Truck => "Truck",
        RoadUser::Bus => "Misc",
        RoadUser::Cyclist => "Cyclist",
        RoadUser::Pedestrian => "Pedestrian",
    };
    let box_3d = &labeled.amodal.camera_from_box;
    let [length_m, width_m, height_m] = agent.dims_m;
    let floor = box_3d.transform(DVec3::new(0.0, 0.0, -0.5 * height_m));
    let ahead = box_3d.rotation * DVec3::X;
    let rotation_y = -f64::atan2(ahead.z, ahead.x);
    let alpha = wrapped(rotation_y - f64::atan2(floor.x, floor.z));
    let AgentBox {
        amodal, in_image, ..
    } = &labeled.amodal;
    let truncated = 1.0 - in_image.area_px() / amodal.area_px().max(1e-9);
    let occluded = match labeled.visible_fraction() {
        share if share >= 0.8 => 0,
        share if share >= 0.4 => 1,
        _ => 2,
    };
    format!(
        "{kind} {:.2} {occluded} {alpha:.4} {:.2} {:.2} {:.2} {:.2} {height_m:.3} {width_m:.3} {length_m:.3} {:.4} {:.4} {:.4} {rotation_y:.4}\n",
        truncated.clamp(0.0, 1.0),
        in_image.min_px.x,
        in_image.min_px.y,
        in_image.max_px.x,
        in_image.max_px.y,
        floor.x,
        floor.y,
        floor.z,
    )
}

/// File of `calib`: KITTI counts pixels from the middle of the first, we from its corner.
fn calibration(camera: &Camera, lidar: Option<&Pose>, ego: &Pose) -> String {
    let k = &camera.intrinsics;
    let p = format!(
        "{:.6e} 0 {:.6e} 0 0 {:.6e} {:.6e} 0 0 0 1 0",
        k.fx_px,
        k.cx_px - 0.5,
        k.fy_px,
        k.cy_px - 0.5
    );
    let camera_from = |pose: &Pose| rows(&camera.world_from_camera.inverse().then(pose));
    let lidar_from_ego = lidar.map_or(Pose::IDENTITY, |lidar| lidar.inverse().then(ego));
    let mut text = String::new();
    for index in 0..4 {
        let _ = writeln!(text, "P{index}: {p}");
    }
    let _ = writeln!(text, "R0_rect: 1 0 0 0 1 0 0 0 1");
    let _ = writeln!(
        text,
        "Tr_velo_to_cam: {}",
        camera_from(lidar.unwrap_or(ego))
    );
    let _ = writeln!(text, "Tr_imu_to_velo: {}", rows(&lidar_from_ego));
    text
}

/// Rotation and translation, three rows of four numbers.
fn rows(pose: &Pose) -> String {
    let columns = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| pose.rotation * axis);
    let row = |axis: usize| {
        let [x, y, z] = columns.map(|column| column[axis]);
        format!("{x:.9e} {y:.9e} {z:.9e} {:.9e}", pose.translation[axis])
    };
    [row(0), row(1), row(2)].join(" ")
}
