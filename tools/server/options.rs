//! Options of the server: its address, its scenes, and its limits.

use std::net::{IpAddr, ToSocketAddrs};
use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Parser, ValueEnum};
use decouplegs::gpu::DeviceChoice;
use decouplegs::render::{ColorFormat, Outputs, RenderOptions, Storage};
use decouplegs_cli::device::DevicesArguments;

/// Pixels of one image by default: room for cameras of 3848x2168, of which NuRec's scenes are.
const IMAGE_PIXELS: u64 = 4096 * 2304;

/// Options of the server.
#[derive(Args, Clone, Debug)]
pub struct ServerOptions {
    /// Scenes: scene files (.toml) or splat files. A scene's id is the name of the folder of
    /// scene.toml, or of any other file without its ending
    #[arg(value_name = "SCENE")]
    pub scenes: Vec<PathBuf>,
    /// More scenes, found by a pattern such as '/data/**/scene.toml'
    #[arg(long, value_name = "GLOB")]
    pub artifact_glob: Vec<String>,
    /// Address to listen on, or a name of this machine such as localhost. Other machines reach it
    /// only if this is not the loopback
    #[arg(long, value_name = "ADDRESS", value_parser = address, default_value = "127.0.0.1")]
    pub host: IpAddr,
    /// Port to listen on; 0 takes a free one and prints it on standard output
    #[arg(
        long,
        value_name = "PORT",
        allow_negative_numbers = true,
        default_value_t = 8080
    )]
    pub port: u16,
    /// Port of the Prometheus metrics, on the same address; none without it
    #[arg(long, value_name = "PORT", allow_negative_numbers = true)]
    pub metrics_port: Option<u16>,
    /// Device to render on: an index, a part of its name or its UUID, as `decouplegs devices` lists
    /// them
    #[arg(long, value_name = "DEVICE", default_value = "auto")]
    pub device: DeviceChoice,
    /// Devices that scenes are spread over
    #[command(flatten)]
    pub devices: DevicesArguments,
    /// Storage of the scenes' splats on the device: exact, 152 bytes per splat of degree 3, or
    /// compact, 120 bytes with an error of less than one step of an 8-bit image
    #[arg(long, value_name = "STORAGE", value_parser = storage, default_value = "exact")]
    pub storage: Storage,
    /// Render backgrounds with fewer splats where they lie at most this many pixels apart (default:
    /// always the finest, which is exact)
    #[arg(long, value_name = "PIXELS", allow_negative_numbers = true, value_parser = pixels)]
    pub background_pitch: Option<f64>,
    /// Origin of the clients' rig, in the scenes' vehicle frame (meters, x forward, y left, z up),
    /// instead of the origin that a package was made with, and of the center of the box for scene
    /// files. Simulators put it on the ground below the rear axle
    #[arg(long, value_name = "X,Y,Z", value_parser = meters, allow_hyphen_values = true)]
    pub rig_origin: Option<[f64; 3]>,
    /// Folder of ego masks, which images show that ask for them: RIG/CAMERA.png with alpha
    #[arg(long, value_name = "DIR")]
    pub egocar_hood_dir: Option<PathBuf>,
    /// Load all scenes into the cache at the start instead of at their first request
    // The other name is the one that CARLA's NuRec example gives the NuRec renderer.
    #[arg(long, alias = "test-scenes-are-valid")]
    pub preload: bool,
    /// Limits of the server
    #[command(flatten)]
    pub limits: Limits,
    /// Certificate chain (PEM) for TLS
    #[arg(long, value_name = "FILE", requires = "tls_key")]
    pub tls_cert: Option<PathBuf>,
    /// Private key (PEM) for TLS
    #[arg(long, value_name = "FILE", requires = "tls_cert")]
    pub tls_key: Option<PathBuf>,
    /// File with a token that clients must send, as `authorization: Bearer TOKEN`
    #[arg(long, value_name = "FILE")]
    pub token_file: Option<PathBuf>,
    /// Form of the log on standard error
    #[arg(long, value_name = "FORM", value_enum, default_value = "text")]
    pub log: LogForm,
    /// Least level of the events in the log; the environment variable RUST_LOG overrides it
    #[arg(
        long,
        value_name = "LEVEL",
        value_enum,
        ignore_case = true,
        default_value = "info"
    )]
    pub log_level: LogLevel,
    /// Flags of another renderer
    #[command(flatten)]
    pub of_nurec: NurecFlags,
}

/// Flags that AlpaSim gives the NuRec renderer and its physics service (`services.renderer.command`
/// and `services.physics.command` of `src/wizard/configs/base_config.yaml` at 3032e0c), or CARLA's
/// example the renderer (`PythonAPI/examples/nvidia/nurec/nurec_render_service.py` at cbf5435), and
/// that say nothing to this server: taken, so that it starts in their place, and named in a
/// warning.
#[derive(Args, Clone, Debug, Default)]
pub struct NurecFlags {
    #[arg(long, hide = true, value_name = "DIR")]
    download_cache_dir: Option<PathBuf>,
    #[arg(long, hide = true, value_name = "N", allow_negative_numbers = true)]
    max_backends_per_scene: Option<u32>,
    // Threads of its gRPC server, of which AlpaSim's default is 4: too few to encode large images.
    #[arg(long, hide = true, value_name = "N", allow_negative_numbers = true)]
    max_workers: Option<u32>,
    #[arg(long, hide = true)]
    enable_nrend: bool,
    #[arg(long, hide = true)]
    no_enable_nrend: bool,
    #[arg(long, hide = true)]
    enable_editing_actors: bool,
    #[arg(long, hide = true)]
    enable_timing: bool,
    #[arg(long, hide = true)]
    enable_harmonizer: bool,
    #[arg(long, hide = true, value_name = "NAME")]
    renderer: Option<String>,
    #[arg(long, hide = true, value_name = "BOOL")]
    use_ground_mesh: Option<String>,
    #[arg(long, hide = true, value_name = "BOOL")]
    visualize: Option<String>,
}

impl NurecFlags {
    /// Names of the flags that were given.
    #[must_use]
    pub fn given(&self) -> Vec<&'static str> {
        let all = [
            ("--download-cache-dir", self.download_cache_dir.is_some()),
            (
                "--max-backends-per-scene",
                self.max_backends_per_scene.is_some(),
            ),
            ("--max-workers", self.max_workers.is_some()),
            ("--enable-nrend", self.enable_nrend),
            ("--no-enable-nrend", self.no_enable_nrend),
            ("--enable-editing-actors", self.enable_editing_actors),
            ("--enable-timing", self.enable_timing),
            ("--enable-harmonizer", self.enable_harmonizer),
            ("--renderer", self.renderer.is_some()),
            ("--use-ground-mesh", self.use_ground_mesh.is_some()),
            ("--visualize", self.visualize.is_some()),
        ];
        all.into_iter()
            .filter_map(|(name, is_given)| is_given.then_some(name))
            .collect()
    }
}

impl ServerOptions {
    /// Options of the renderers, images in bytes.
    #[must_use]
    pub fn render(&self) -> RenderOptions {
        RenderOptions {
            outputs: Outputs {
                color: ColorFormat::U8,
                ..Outputs::default()
            },
            storage: self.storage,
            background_pitch_px: self.background_pitch,
            ..RenderOptions::default()
        }
    }

    /// The defaults for `scenes`, on a free port of the loopback.
    #[must_use]
    pub fn on_a_free_port(scenes: Vec<PathBuf>) -> Self {
        let mut options = Defaults::parse_from(["decouplegs-server", "--port", "0"]).options;
        options.scenes = scenes;
        options
    }
}

/// The address that `text` is, or that this machine knows for the name.
fn address(text: &str) -> Result<IpAddr, String> {
    if let Ok(address) = text.parse() {
        return Ok(address);
    }
    let found: Vec<IpAddr> = (text, 0)
        .to_socket_addrs()
        .map_err(|error| {
            format!("expected an address such as 127.0.0.1, or a name that has one: {error}")
        })?
        .map(|socket| socket.ip())
        .collect();
    // Clients that are given the name try IPv4 too, not all of them IPv6.
    let preferred = found.iter().find(|address| address.is_ipv4());
    preferred
        .or(found.first())
        .copied()
        .ok_or_else(|| "no address has this name".to_owned())
}

fn storage(text: &str) -> Result<Storage, String> {
    Storage::by_name(text).ok_or_else(|| format!("expected exact or compact, found {text:?}"))
}

fn pixels(text: &str) -> Result<f64, String> {
    let parsed = text.parse::<f64>().ok();
    parsed
        .filter(|pixels| pixels.is_finite() && *pixels >= 0.0)
        .ok_or_else(|| format!("expected pixels, 0 or more, found {text:?}"))
}

/// Options as a command line of their own.
#[derive(Parser)]
struct Defaults {
    #[command(flatten)]
    options: ServerOptions,
}

/// Form of the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum LogForm {
    /// Lines for people
    Text,
    /// One JSON object per line
    Json,
}

/// Least level of the events in the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum LogLevel {
    /// Each step of the server
    Debug,
    /// Starts, ends, and what became of scenes
    Info,
    /// Things that a person should look at
    #[value(alias = "warning")]
    Warn,
    /// Failures
    #[value(alias = "critical")]
    Error,
}

impl LogLevel {
    /// The level as `RUST_LOG` calls it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Debug => "debug",
            Self::Info => "info",
            Self::Warn => "warn",
            Self::Error => "error",
        }
    }
}

/// Limits of the server.
#[derive(Args, Clone, Debug)]
pub struct Limits {
    /// Largest message that is sent, bytes
    #[arg(long, value_name = "BYTES", allow_negative_numbers = true, default_value_t = 64 << 20, value_parser = message_bytes)]
    pub message_bytes: usize,
    /// Largest message that is received, bytes; requests are far smaller than images
    #[arg(long, value_name = "BYTES", allow_negative_numbers = true, default_value_t = 16 << 20, value_parser = message_bytes)]
    pub request_bytes: usize,
    /// Concurrent requests beside one of each connection; further ones wait for a second and are
    /// then refused with RESOURCE_EXHAUSTED
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=65_536))]
    pub requests: u32,
    /// Concurrent connections; further ones are closed
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=65_536))]
    pub connections: u32,
    /// Concurrent connections from one address; further ones are closed
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 128, value_parser = clap::value_parser!(u32).range(1..=65_536))]
    pub address_connections: u32,
    /// Time without a request after which a connection is closed, seconds. Clients connect again by
    /// themselves
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, default_value_t = 60.0, value_parser = seconds)]
    pub idle: f64,
    /// Pixels of one image
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = IMAGE_PIXELS)]
    pub image_pixels: u64,
    /// Pixels of all images of one request
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 8 * IMAGE_PIXELS)]
    pub pixels: u64,
    /// Cameras of one request
    #[arg(
        long,
        value_name = "N",
        allow_negative_numbers = true,
        default_value_t = 16
    )]
    pub cameras: usize,
    /// Objects per camera of a request
    #[arg(
        long,
        value_name = "N",
        allow_negative_numbers = true,
        default_value_t = 4096
    )]
    pub objects: usize,
    /// Time limit of a request, seconds
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, default_value_t = 300.0, value_parser = seconds)]
    pub deadline: f64,
    /// Time limit for the first bytes of a connection, seconds
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, default_value_t = 10.0, value_parser = seconds)]
    pub handshake: f64,
    /// Longest time that requests may take to finish after SIGTERM or SIGINT, seconds. Then
    /// connections are closed and the server exits, as soon as the frame that is being drawn is
    /// done
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, default_value_t = 30.0, value_parser = seconds)]
    pub grace: f64,
    /// Number of scenes that are kept on each device
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub cache_size: u32,
    /// Devices that may have the same scene. Then each request for it goes to the one with the
    /// fewest, and the cameras of one request are divided between them. A further copy is made only
    /// where no other scene has to go
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=64))]
    pub copies: u32,
    /// Memory of each device that scenes in the cache may take, bytes
    #[arg(long, value_name = "BYTES", allow_negative_numbers = true, default_value_t = 32 << 30)]
    pub cache_bytes: u64,
    /// Threads that encode images; 0: as many as there are processors
    #[arg(
        long,
        value_name = "N",
        allow_negative_numbers = true,
        default_value_t = 0
    )]
    pub encoders: usize,
}

impl Limits {
    /// [`Limits::deadline`].
    #[must_use]
    pub fn deadline(&self) -> Duration {
        Duration::from_secs_f64(self.deadline)
    }

    /// [`Limits::handshake`].
    #[must_use]
    pub fn handshake(&self) -> Duration {
        Duration::from_secs_f64(self.handshake)
    }

    /// [`Limits::idle`].
    #[must_use]
    pub fn idle(&self) -> Duration {
        Duration::from_secs_f64(self.idle)
    }

    /// [`Limits::grace`].
    #[must_use]
    pub fn grace(&self) -> Duration {
        Duration::from_secs_f64(self.grace)
    }
}

fn seconds(text: &str) -> Result<f64, String> {
    let parsed = text
        .parse()
        .ok()
        .filter(|seconds| (0.001..=86_400.0).contains(seconds));
    parsed.ok_or_else(|| format!("expected seconds, 0.001 to 86400, found {text:?}"))
}

/// A size of messages that can hold a request.
fn message_bytes(text: &str) -> Result<usize, String> {
    let parsed = text
        .parse()
        .ok()
        .filter(|bytes| (1024..=2 << 30).contains(bytes));
    parsed.ok_or_else(|| format!("expected bytes, 1024 to 2147483648, found {text:?}"))
}

fn meters(text: &str) -> Result<[f64; 3], String> {
    let numbers: Vec<f64> = text
        .split(',')
        .filter_map(|number| number.trim().parse().ok())
        .collect();
    let parsed = numbers
        .try_into()
        .ok()
        .filter(|place: &[f64; 3]| place.iter().all(|meters| meters.is_finite()));
    parsed.ok_or_else(|| {
        format!("expected three numbers in meters, like -1.4,0,-0.75, found {text:?}")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(line: &[&str]) -> Result<ServerOptions, clap::Error> {
        let line = std::iter::once("decouplegs-server").chain(line.iter().copied());
        Defaults::try_parse_from(line).map(|defaults| defaults.options)
    }

    /// The command of `services.renderer` in AlpaSim's `src/wizard/configs/base_config.yaml:155` at
    /// 3032e0c, its references resolved, behind the name of the program.
    #[test]
    fn the_command_lines_of_alpasim_are_taken() {
        let options = parsed(&[
            "--port=6005",
            "--host=0.0.0.0",
            "--artifact-glob=/mnt/nre-data/sceneset/**/*.usdz",
            "--egocar-hood-dir=/mnt/ego-hoods",
            "--no-enable-nrend",
            "--download-cache-dir",
            "/cache/nre",
            "--cache-size=2",
            "--max-workers=4",
            "--enable-editing-actors",
        ])
        .unwrap();
        assert_eq!((options.port, options.limits.cache_size), (6005, 2));
        assert_eq!(options.artifact_glob, ["/mnt/nre-data/sceneset/**/*.usdz"]);
        assert_eq!(
            options.egocar_hood_dir.as_deref(),
            Some(std::path::Path::new("/mnt/ego-hoods"))
        );
        let ignored = [
            "--download-cache-dir",
            "--max-workers",
            "--no-enable-nrend",
            "--enable-editing-actors",
        ];
        assert_eq!(options.of_nurec.given(), ignored);
        assert!(parsed(&["scene.toml"]).unwrap().of_nurec.given().is_empty());
        // `services.physics.command` of the same file, line 193.
        let options = parsed(&[
            "--host=0.0.0.0",
            "--port=6006",
            "--artifact-glob=/mnt/nre-data/./**/*.usdz",
            "--use-ground-mesh=true",
            "--cache-size=16",
            "--log-level=WARNING",
        ])
        .unwrap();
        assert_eq!(options.log_level, LogLevel::Warn);
        assert_eq!(options.of_nurec.given(), ["--use-ground-mesh"]);
        assert!(parsed(&["--egocar-hood"]).is_err(), "a typing error is one");
    }

    /// The command of `NuRecRenderService.start` in CARLA's example, with all that it may add.
    #[test]
    fn the_command_line_of_carla_is_taken() {
        let options = parsed(&[
            "--artifact-glob",
            "/maps/scene.usdz",
            "--port=46435",
            "--host=localhost",
            "--test-scenes-are-valid",
            "--enable-editing-actors",
            "--renderer=gsplat",
            "--enable-harmonizer",
        ])
        .unwrap();
        assert!(options.host.is_loopback() && options.preload);
        assert_eq!(
            options.of_nurec.given(),
            [
                "--enable-editing-actors",
                "--enable-harmonizer",
                "--renderer"
            ]
        );
        let refused = parsed(&["--host=no.such.host.invalid"]).unwrap_err();
        let sentence = refused.to_string();
        assert!(
            sentence.contains("expected an address such as 127.0.0.1"),
            "{sentence}"
        );
    }
}
