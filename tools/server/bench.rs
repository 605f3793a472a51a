//! `decouplegs-server bench`: a server in this process, asked over the loopback as a simulator's
//! runtime asks it.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, ensure};
use clap::{Args, ValueEnum};
use decouplegs::asset::{SceneFile, write_atomically};
use decouplegs::gpu::DeviceChoice;
use decouplegs::scene::{Pose, Trajectory};
use decouplegs_cli::device::DevicesArguments;
use decouplegs_cli::outputs::Force;
use glam::DVec3;
use serde_json::json;
use std::io::Write;
use tonic::transport::{Channel, Endpoint};

use crate::options::ServerOptions;
use crate::running;
use crate::scene_registry::id_of;
use decouplegs_alpasim::poses::{message_of, pose_of};
use decouplegs_alpasim::wire::common::Empty;
use decouplegs_alpasim::wire::sensorsim::available_cameras_return::AvailableCamera;
use decouplegs_alpasim::wire::sensorsim::sensorsim_service_client::SensorsimServiceClient;
use decouplegs_alpasim::wire::sensorsim::{
    AvailableCamerasRequest, AvailableTrajectoriesRequest, BatchRgbRenderRequest,
    BatchRgbRenderRequestItem, DynamicObject, ImageFormat, PosePair, RgbRenderRequest,
};

/// Time for which a shutter is open, microseconds.
const SHUTTER_US: u64 = 20_000;
/// Number of first requests of a client that are left out of the figures, or half of them if they
/// are few: buffers still grow.
const WARM_UP: usize = 20;

/// Bytes that the server may send ahead of what is read.
const WINDOW_BYTES: u32 = 64 << 20;

/// Workload and duration.
#[derive(Args, Clone, Debug)]
pub struct BenchOptions {
    /// Scene file. May be repeated: each client drives through one of them in turn
    #[arg(long, value_name = "SCENE.toml", required = true)]
    pub scene: Vec<PathBuf>,
    /// Cameras of each request, the first of the rig
    #[arg(
        long,
        value_name = "N",
        allow_negative_numbers = true,
        default_value_t = 2
    )]
    pub cameras: usize,
    /// Size of the images; that of the rig without it
    #[arg(long, value_name = "WxH", allow_hyphen_values = true, value_parser = size, default_value = "512x320")]
    pub size: [u32; 2],
    /// Image file format
    #[arg(long, value_enum, default_value = "jpeg")]
    pub format: FormatName,
    /// Quality of JPEG, 1 to 100
    #[arg(long, value_name = "QUALITY", default_value_t = 95.0)]
    pub quality: f32,
    /// Duration of the requests, also called --soak
    #[arg(
        long,
        visible_alias = "soak",
        value_name = "SECONDS",
        default_value_t = 10.0
    )]
    pub seconds: f64,
    /// Number of concurrent rollouts
    #[arg(
        long,
        value_name = "N",
        allow_negative_numbers = true,
        default_value_t = 1
    )]
    pub clients: usize,
    /// Time step of the scene between requests, seconds
    #[arg(
        long,
        value_name = "SECONDS",
        allow_negative_numbers = true,
        default_value_t = 0.1
    )]
    pub step: f64,
    /// Device to render on: an index, a part of its name or its UUID
    #[arg(long, value_name = "DEVICE", default_value = "auto")]
    pub device: DeviceChoice,
    /// Devices that scenes are spread over
    #[command(flatten)]
    pub devices: DevicesArguments,
    /// Devices that may have the same scene
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=64))]
    pub copies: u32,
    /// Write the figures to a file
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Permission to replace files
    #[command(flatten)]
    pub force: Force,
}

/// Longest time until all copies of a scene are on their devices.
const COPIES_MAX: Duration = Duration::from_secs(120);

/// Image file format.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum FormatName {
    /// PNG
    Png,
    /// JPEG
    Jpeg,
    /// Uncompressed planes of bytes
    Planar,
}

/// Runs the bench in a program that started at `started`.
///
/// # Errors
/// Returns an error if the server does not start, or a request fails.
pub fn run(options: &BenchOptions, started: Instant) -> Result<()> {
    ensure!(
        options.clients > 0 && options.cameras > 0,
        "--clients and --cameras are at least 1"
    );
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .context("no threads")?;
    runtime.block_on(measure(options, started))
}

async fn measure(options: &BenchOptions, started: Instant) -> Result<()> {
    let mut server = ServerOptions::on_a_free_port(options.scene.clone());
    server.device = options.device.clone();
    server.devices = options.devices.clone();
    server.limits.copies = options.copies;
    let running = running::start(&server).await?;
    let listening = started.elapsed();
    let endpoint = Endpoint::from_shared(format!("http://{}", running.address))?.tcp_nodelay(true);
    // Images come in one piece; a window smaller than one would be asked for again and again.
    let endpoint = endpoint
        .initial_stream_window_size(WINDOW_BYTES)
        .initial_connection_window_size(WINDOW_BYTES);
    // Every scene is on its device before the clients begin.
    for scene in &options.scene {
        let mut rollout = Rollout::begin(endpoint.connect().await?, scene, options).await?;
        rollout.ask(0).await?;
    }
    let first_image = started.elapsed();
    let copies = u64::from(options.copies).min(running.images_by_device().len() as u64);
    for scene in &options.scene {
        let rollout = Rollout::begin(endpoint.connect().await?, scene, options).await?;
        rollout.until_copied(copies).await?;
    }
    let memory_start = memory_bytes();
    let mut clients = tokio::task::JoinSet::new();
    let until = Instant::now() + Duration::from_secs_f64(options.seconds);
    for client in 0..options.clients {
        let scene = &options.scene[client % options.scene.len()];
        let mut rollout = Rollout::begin(endpoint.connect().await?, scene, options).await?;
        clients.spawn(async move {
            let mut times = Vec::new();
            while Instant::now() < until {
                times.push(rollout.ask(times.len() + 37 * client).await?);
            }
            Ok::<_, anyhow::Error>(times)
        });
    }
    let mut times = Vec::new();
    let asked_since = Instant::now();
    while let Some(done) = clients.join_next().await {
        let asked = done??;
        times.extend_from_slice(&asked[WARM_UP.min(asked.len() / 2)..]);
    }
    let asked_for = asked_since.elapsed();
    let (submissions, images_by_device) = (running.submissions(), running.images_by_device());
    running.stop().await?;
    ensure!(
        !times.is_empty(),
        "no request was answered: give more --seconds"
    );
    times.sort();
    let at =
        |share: f64| times[((times.len() - 1) as f64 * share).round() as usize].as_secs_f64() * 1e3;
    let requests = times.len();
    let scenes: Vec<String> = options
        .scene
        .iter()
        .map(|path| path.display().to_string())
        .collect();
    let figures = json!({
        "scene": scenes.join(", "),
        "cameras": options.cameras,
        "width_px": options.size[0],
        "height_px": options.size[1],
        "format": format!("{:?}", options.format).to_lowercase(),
        "clients": options.clients,
        "copies": options.copies,
        "requests": requests,
        "submissions": submissions,
        "images_by_device": images_by_device,
        "p50_ms": at(0.5),
        "p99_ms": at(0.99),
        "max_ms": at(1.0),
        "images_per_s": (requests * options.cameras) as f64 / asked_for.as_secs_f64(),
        "listening_after_s": listening.as_secs_f64(),
        "first_image_after_s": first_image.as_secs_f64(),
        "memory_start_bytes": memory_start,
        "memory_end_bytes": memory_bytes(),
    });
    if let Some(path) = &options.json {
        write_atomically(path, |file| writeln!(file, "{figures:#}"))?;
    }
    println!("{figures:#}");
    Ok(())
}

/// A client that drives through a scene.
struct Rollout {
    client: SensorsimServiceClient<Channel>,
    scene: String,
    cameras: Vec<AvailableCamera>,
    /// Trajectory of the ego: (time in us, pose), local frame.
    ego: Vec<(u64, Pose)>,
    agents: Vec<(String, Trajectory)>,
    origin: DVec3,
    options: BenchOptions,
}

impl Rollout {
    async fn begin(channel: Channel, path: &Path, options: &BenchOptions) -> Result<Self> {
        let file = SceneFile::read(path)?;
        let mut client = SensorsimServiceClient::new(channel).max_decoding_message_size(64 << 20);
        client.get_version(Empty {}).await?;
        let scene = id_of(path).context("the scene has no id")?;
        client.get_available_ego_masks(Empty {}).await?;
        let asked = AvailableCamerasRequest {
            scene_id: scene.clone(),
        };
        let mut cameras = client
            .get_available_cameras(asked)
            .await?
            .into_inner()
            .available_cameras;
        let count = cameras.len();
        ensure!(
            count >= options.cameras,
            "the rig has {count} cameras, asked for are {}",
            options.cameras
        );
        cameras.truncate(options.cameras);
        let asked = AvailableTrajectoriesRequest {
            scene_id: scene.clone(),
        };
        let ways = client
            .get_available_trajectories(asked)
            .await?
            .into_inner()
            .available_trajectories;
        let way = ways
            .into_iter()
            .next()
            .and_then(|way| way.trajectory)
            .context("the scene has no way of the ego")?;
        let timed = way
            .poses
            .iter()
            .map(|timed| Ok((timed.timestamp_us, pose_of(timed.pose.as_ref(), "ego")?)));
        let ego = timed.collect::<Result<Vec<_>, tonic::Status>>()?;
        let agents = file
            .agents
            .into_iter()
            .map(|agent| (agent.name, agent.trajectory))
            .collect();
        Ok(Self {
            client,
            scene,
            cameras,
            ego,
            agents,
            origin: file.origin,
            options: options.clone(),
        })
    }

    /// Waits until the scene is on `copies` devices.
    async fn until_copied(mut self, copies: u64) -> Result<()> {
        let since = Instant::now();
        loop {
            let loaded = self.client.get_loaded_scenes(Empty {}).await?.into_inner();
            let entry = loaded.scenes.iter().find(|one| one.scene_id == self.scene);
            let found = entry.map_or(0, |entry| entry.loaded_instance_count);
            if found >= copies {
                return Ok(());
            }
            ensure!(
                since.elapsed() < COPIES_MAX,
                "scene {:?} is on {found} devices, expected {copies}: have they the memory?",
                self.scene
            );
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }

    /// Asks for the images of one step; how long it took from the request to all bytes.
    async fn ask(&mut self, step: usize) -> Result<Duration> {
        let end_us = self.ego.last().map_or(0, |(time_us, _)| *time_us).max(1);
        let time_us = (step as f64 * self.options.step * 1e6) as u64 % end_us;
        let items = self
            .cameras
            .iter()
            .map(|camera| self.item(camera, time_us))
            .collect::<Result<Vec<_>>>()?;
        let request = BatchRgbRenderRequest { items };
        let since = Instant::now();
        let reply = self.client.batch_render_rgb(request).await?.into_inner();
        let took = since.elapsed();
        let failed = reply.items.iter().find(|item| !item.success);
        failed.map_or(Ok(()), |item| {
            Err(anyhow!("{}: {}", item.camera_name, item.error_message))
        })?;
        ensure!(
            reply.items.len() == self.cameras.len(),
            "{} images came back",
            reply.items.len()
        );
        Ok(took)
    }

    fn item(&self, camera: &AvailableCamera, time_us: u64) -> Result<BatchRgbRenderRequestItem> {
        let rig_from_camera = pose_of(camera.rig_to_camera.as_ref(), "rig_to_camera")?;
        let times_us = [time_us, time_us + SHUTTER_US];
        let pair = |pose_at: &dyn Fn(u64) -> Pose| {
            let [start_pose, end_pose] =
                times_us.map(|time_us| Some(message_of(&pose_at(time_us))));
            Some(PosePair {
                start_pose,
                end_pose,
            })
        };
        let object = |(name, way): &(String, Trajectory)| {
            let local = |time_us: u64| {
                let pose = way.at(time_us as f64 * 1e-6);
                Pose {
                    translation: pose.translation - self.origin,
                    ..pose
                }
            };
            DynamicObject {
                track_id: name.clone(),
                pose_pair: pair(&local),
            }
        };
        let format = match self.options.format {
            FormatName::Png => ImageFormat::Png,
            FormatName::Jpeg => ImageFormat::Jpeg,
            FormatName::Planar => ImageFormat::RgbUint8Planar,
        };
        let request = RgbRenderRequest {
            scene_id: self.scene.clone(),
            resolution_h: self.options.size[1],
            resolution_w: self.options.size[0],
            camera_intrinsics: camera.intrinsics.clone(),
            frame_start_us: times_us[0],
            frame_end_us: times_us[1],
            sensor_pose: pair(&|time_us| self.ego_at(time_us).then(&rig_from_camera)),
            dynamic_objects: self.agents.iter().map(object).collect(),
            image_format: format.into(),
            image_quality: self.options.quality,
            ..RgbRenderRequest::default()
        };
        Ok(BatchRgbRenderRequestItem {
            camera_name: camera.logical_id.clone(),
            request: Some(request),
        })
    }

    fn ego_at(&self, time_us: u64) -> Pose {
        let next = self.ego.partition_point(|(knot_us, _)| *knot_us <= time_us);
        match (
            next.checked_sub(1).and_then(|before| self.ego.get(before)),
            self.ego.get(next),
        ) {
            (Some((from_us, from)), Some((to_us, to))) => {
                from.interpolate(to, (time_us - from_us) as f64 / (to_us - from_us) as f64)
            }
            (Some((_, end)), None) | (None, Some((_, end))) => *end,
            (None, None) => Pose::IDENTITY,
        }
    }
}

/// Memory that this process has in use; zero where the operating system does not say.
fn memory_bytes() -> u64 {
    let status = std::fs::read_to_string(Path::new("/proc/self/status")).unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    line.and_then(|line| line.trim().strip_suffix(" kB")?.trim().parse::<u64>().ok())
        .map_or(0, |kib| kib << 10)
}

fn size(text: &str) -> Result<[u32; 2], String> {
    let parsed = text.split_once('x').and_then(|(width, height)| {
        let side = |text: &str| text.parse().ok().filter(|side| (1..=65_536).contains(side));
        Some([side(width)?, side(height)?])
    });
    parsed.ok_or_else(|| {
        format!("expected WIDTHxHEIGHT in pixels, 1x1 to 65536x65536, like 512x320, found {text:?}")
    })
}
