//! ROS 2 messages in an MCAP file, for Foxglove, RViz and `ros2 bag`.

mod drive;

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use anyhow::{Context, Result};
use decouplegs::episode::Moments;
use decouplegs::scene::episode::Episode;
use decouplegs::scene::lens::Lens;
use decouplegs::scene::lidar::PointFrame;
use decouplegs::scene::{Intrinsics, Rig, RoadUser};
use decouplegs_cli::png_bytes;
use decouplegs_recording::point_cloud::point_cloud2;
use decouplegs_recording::ros::{
    CAMERA_INFO, COMPRESSED_IMAGE, CameraModel, MARKER_ARRAY, Marker, McapLog, POINT_CLOUD2,
    TF_MESSAGE, Topic, Transform, camera_info, compressed_image, marker_array, tf_message,
};

use self::drive::DriveTopics;
use super::DataSet;
use super::sensed::{LabeledAgent, LabeledImage, Sensed};

/// Name of the file in the folder.
const FILE: &str = "episode.mcap";
/// Frames of the world and of the ego, whose origin is the middle of its box.
const MAP: &str = "map";
const BASE: &str = "base_link";
/// Time of the first step. ROS takes time 0 for "no time".
const START_NS: u64 = 1_000_000_000;

/// Time of a message from seconds since the start of the episode.
fn time_ns(time_s: f64) -> u64 {
    START_NS + (time_s.max(0.0) * 1e9).round() as u64
}

/// Topics of a camera.
struct CameraTopics {
    frame: String,
    image: Topic,
    info: Topic,
}

/// Log so far.
pub struct Messages {
    log: McapLog<BufWriter<File>>,
    transforms: Topic,
    boxes: Topic,
    drive: DriveTopics,
    cameras: Vec<CameraTopics>,
    lidar: Option<(String, Topic)>,
    images: usize,
    sweeps: usize,
}

impl Messages {
    /// Begins the file with the topics of `episode`, whose worlds are `moments`, and of `rig`.
    pub fn new(folder: &Path, episode: &Episode, moments: &Moments, rig: &Rig) -> Result<Self> {
        let path = folder.join(FILE);
        let file =
            File::create(&path).with_context(|| format!("{} cannot be made", path.display()))?;
        let mut log = McapLog::new(BufWriter::new(file))?;
        let transforms = log.topic("/tf", TF_MESSAGE, false);
        let fixed = log.topic("/tf_static", TF_MESSAGE, true);
        let boxes = log.topic("/objects", MARKER_ARRAY, false);
        let mut cameras = Vec::new();
        let mut mounts = Vec::new();
        for camera in rig.cameras() {
            let frame = format!("camera/{}", camera.name);
            mounts.push(Transform {
                parent: BASE.into(),
                child: frame.clone(),
                pose: camera.rig_from_camera,
            });
            let topic = |part: &str| format!("/camera/{}/{part}", camera.name);
            cameras.push(CameraTopics {
                frame,
                image: log.topic(&topic("image/compressed"), COMPRESSED_IMAGE, false),
                info: log.topic(&topic("camera_info"), CAMERA_INFO, false),
            });
        }
        let lidar = rig.lidars().next().map(|lidar| {
            let frame = format!("lidar/{}", lidar.name);
            mounts.push(Transform {
                parent: BASE.into(),
                child: frame.clone(),
                pose: lidar.rig_from_lidar,
            });
            let topic = format!("/lidar/{}/points", lidar.name);
            (frame, log.topic(&topic, POINT_CLOUD2, false))
        });
        log.add(fixed, START_NS, &tf_message(START_NS, &mounts))?;
        let drive = DriveTopics::new(&mut log, episode, moments);
        Ok(Self {
            log,
            transforms,
            boxes,
            drive,
            cameras,
            lidar,
            images: 0,
            sweeps: 0,
        })
    }

    fn add_image(&mut self, camera: usize, time_ns: u64, image: &LabeledImage) -> Result<()> {
        let CameraTopics {
            frame,
            image: topic,
            info,
        } = &self.cameras[camera];
        let k = &image.camera.intrinsics;
        let png = png_bytes::encode(&image.rgba, [k.width_px, k.height_px]);
        let png = png.map_err(anyhow::Error::msg)?;
        self.log
            .add(*topic, time_ns, &compressed_image(time_ns, frame, &png))?;
        self.log
            .add(*info, time_ns, &camera_info(time_ns, frame, &model_of(k)))?;
        self.images += 1;
        Ok(())
    }
}

impl DataSet for Messages {
    fn add(&mut self, sensed: &Sensed) -> Result<()> {
        self.drive.add_until(&mut self.log, sensed.time_s)?;
        let time_ns = time_ns(sensed.time_s);
        let ego = Transform {
            parent: MAP.into(),
            child: BASE.into(),
            pose: sensed.ego,
        };
        self.log
            .add(self.transforms, time_ns, &tf_message(time_ns, &[ego]))?;
        let markers: Vec<Marker> = sensed.agents.iter().map(marker_of).collect();
        self.log
            .add(self.boxes, time_ns, &marker_array(time_ns, MAP, &markers))?;
        for (camera, image) in sensed.images.iter().enumerate() {
            self.add_image(camera, time_ns, image)?;
        }
        if let (Some(sweep), Some((frame, topic))) = (&sensed.sweep, &self.lidar) {
            let sweep_s = sweep.lidar.model.sweep_s;
            let end = PointFrame::by_name("end", sweep_s).context("the frame is known")?;
            let sweep_ns = (sweep_s * 1e9).round() as u64;
            let start_ns = time_ns.saturating_sub(sweep_ns);
            let message = point_cloud2(start_ns, frame, &sweep.points(end));
            self.log.add(*topic, time_ns, &message)?;
            self.sweeps += 1;
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<String> {
        self.drive.add_until(&mut self.log, f64::INFINITY)?;
        let file = self.log.finish()?;
        let file = file.into_inner().map_err(|error| error.into_error())?;
        file.sync_all()?;
        Ok(format!(
            "{FILE} with {} images and {} sweeps",
            self.images, self.sweeps
        ))
    }
}

/// Box of a road user, in a color per kind.
fn marker_of(agent: &LabeledAgent) -> Marker {
    let rgba = match agent.kind {
        RoadUser::Car => [0.2, 0.5, 0.9, 0.5],
        RoadUser::Truck | RoadUser::Bus => [0.5, 0.3, 0.8, 0.5],
        RoadUser::Cyclist => [0.2, 0.7, 0.4, 0.5],
        RoadUser::Pedestrian => [0.9, 0.5, 0.1, 0.5],
    };
    Marker {
        namespace: agent.kind.name().to_owned(),
        id: agent.instance.into(),
        pose: agent.pose,
        dims_m: agent.dims_m,
        rgba,
        text: agent.name.clone(),
    }
}

/// Calibration as ROS has it. ROS counts pixels from the middle of the first, we from its corner.
fn model_of(k: &Intrinsics) -> CameraModel {
    let (distortion, coefficients) = match &k.lens {
        Lens::Pinhole => ("plumb_bob", vec![0.0; 5]),
        Lens::OpenCv(lens) => {
            let [k1, k2, k3, k4, k5, k6] = lens.radial;
            let [p1, p2] = lens.tangential;
            ("rational_polynomial", vec![k1, k2, p1, p2, k3, k4, k5, k6])
        }
        Lens::Fisheye(lens) => ("equidistant", lens.radial.to_vec()),
        // ROS has no model of it.
        Lens::FTheta(_) => ("", Vec::new()),
    };
    CameraModel {
        size_px: [k.width_px, k.height_px],
        distortion,
        coefficients,
        focal_and_center_px: [k.fx_px, k.fy_px, k.cx_px - 0.5, k.cy_px - 0.5],
    }
}
