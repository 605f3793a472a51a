//! A server that has to last: broken scenes, names without end, idle connections, an end that
//! comes, and hours of all of it.

use std::fs::{self, File};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use decouplegs::scene::Pose;
use decouplegs_alpasim::wire::common::Empty;
use decouplegs_alpasim::wire::sensorsim::sensorsim_service_client::SensorsimServiceClient;
use decouplegs_alpasim::wire::sensorsim::{AvailableCamerasRequest, ImageFormat, RgbRenderRequest};
use decouplegs_server::running::Running;
use glam::DVec3;
use tonic::Code;
use tonic::transport::{Channel, Endpoint};
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_client::HealthClient;

use crate::asking::{cameras, channel, client, object, options, png, request, serve};
use crate::scenes::street;

/// A good request for an image of the street.
async fn good(client: &mut SensorsimServiceClient<Channel>) -> RgbRenderRequest {
    let rig = cameras(client, "street").await;
    request(
        "street",
        &rig[0],
        &Pose::from_yaw(0.0, DVec3::Z),
        ImageFormat::Png,
    )
}

/// Resident memory of a process, bytes.
fn resident_bytes(process: &str) -> u64 {
    let status = fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmRSS:"))
        .unwrap();
    line.trim()
        .strip_suffix(" kB")
        .unwrap()
        .trim()
        .parse::<u64>()
        .unwrap()
        << 10
}

async fn is_healthy(channel: Channel) -> bool {
    let asked = HealthCheckRequest {
        service: String::new(),
    };
    HealthClient::new(channel)
        .check(asked)
        .await
        .is_ok_and(|health| health.into_inner().status == 1)
}

/// Scenes in `folder` that cannot be served: a background that is no splat file, and one that
/// blocks its readers.
fn broken_scenes(folder: &Path) -> Vec<std::path::PathBuf> {
    let fifo = folder.join("fifo.ply");
    assert!(
        Command::new("mkfifo")
            .arg(&fifo)
            .status()
            .unwrap()
            .success()
    );
    fs::write(folder.join("cut.pt"), b"PK\x03\x04 and nothing behind it").unwrap();
    let scene = |name: &str, background: &str| {
        let place = folder.join(name);
        fs::create_dir_all(&place).unwrap();
        let path = place.join("scene.toml");
        fs::write(&path, format!("version = 1\nbackground = {background:?}\n")).unwrap();
        path
    };
    vec![
        scene("cut", "../cut.pt"),
        scene("blocked", "../fifo.ply"),
        scene("endless", "/dev/zero"),
    ]
}

#[tokio::test(flavor = "multi_thread")]
async fn scenes_that_cannot_be_read_leave_the_others_and_the_health_alone() {
    let folder = tempfile::tempdir().unwrap();
    let mut scenes = broken_scenes(folder.path());
    scenes.push(street(folder.path()));
    let running = serve(&options(scenes)).await;
    let mut client = client(&running).await;
    let good = good(&mut client).await;
    for name in ["cut", "blocked", "endless", "cut"] {
        let asked = RgbRenderRequest {
            scene_id: name.into(),
            ..good.clone()
        };
        let status = client.render_rgb(asked).await.unwrap_err();
        assert_eq!(status.code(), Code::FailedPrecondition, "{name}: {status}");
    }
    assert_eq!(
        png(&client
            .render_rgb(good)
            .await
            .unwrap()
            .into_inner()
            .image_bytes)
        .0,
        [160, 100]
    );
    assert!(is_healthy(channel(&running).await).await);
    running.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn names_without_end_are_refused_and_not_kept() {
    let folder = tempfile::tempdir().unwrap();
    let running = serve(&options(vec![street(folder.path())])).await;
    let mut client = client(&running).await;
    let good = good(&mut client).await;
    client.render_rgb(good.clone()).await.unwrap();
    let before = resident_bytes("self");
    let here = Pose::IDENTITY;
    for _ in 0..20 {
        let long = "\u{1}".repeat(15 << 20);
        let crowded = RgbRenderRequest {
            dynamic_objects: vec![object(&long, &here, &here)],
            ..good.clone()
        };
        let elsewhere = RgbRenderRequest {
            scene_id: long.clone(),
            ..good.clone()
        };
        for asked in [crowded, elsewhere] {
            let status = client.render_rgb(asked).await.unwrap_err();
            assert_eq!(status.code(), Code::InvalidArgument, "{:?}", status.code());
            assert!(
                status.message().contains("256") && status.message().len() < 200,
                "{}",
                status.message()
            );
        }
        let asked = AvailableCamerasRequest { scene_id: long };
        assert_eq!(
            client
                .get_available_cameras(asked)
                .await
                .unwrap_err()
                .code(),
            Code::InvalidArgument
        );
    }
    let grown = resident_bytes("self").saturating_sub(before);
    assert!(grown < 300 << 20, "memory grew by {grown} bytes");
    // One of 256 control characters is told in a few.
    let asked = RgbRenderRequest {
        scene_id: "\u{1}".repeat(256),
        ..good
    };
    let status = client.render_rgb(asked).await.unwrap_err();
    assert!(
        status.code() == Code::NotFound && status.message().len() < 1000,
        "{status}"
    );
    running.stop().await.unwrap();
}

/// A channel of its own, connected.
async fn connect(running: &Running) -> Option<Channel> {
    Endpoint::from_shared(format!("http://{}", running.address))
        .unwrap()
        .connect()
        .await
        .ok()
}

#[tokio::test(flavor = "multi_thread")]
async fn idle_connections_end_and_health_is_served_beside_a_crowd() {
    let folder = tempfile::tempdir().unwrap();
    let mut options = options(vec![street(folder.path())]);
    (options.limits.connections, options.limits.idle) = (3, 2.0);
    let running = serve(&options).await;
    let mut crowd = Vec::new();
    for _ in 0..3 {
        crowd.push(connect(&running).await.unwrap());
    }
    let crowded = SensorsimServiceClient::new(connect(&running).await.unwrap())
        .get_version(Empty {})
        .await;
    assert_eq!(crowded.unwrap_err().code(), Code::ResourceExhausted);
    assert!(
        is_healthy(connect(&running).await.unwrap()).await,
        "health has places of its own"
    );
    tokio::time::sleep(Duration::from_secs(3)).await;
    SensorsimServiceClient::new(connect(&running).await.unwrap())
        .get_version(Empty {})
        .await
        .expect("the idle ones have ended");
    // A connection with a request now and then stays.
    let mut busy = SensorsimServiceClient::new(connect(&running).await.unwrap());
    for _ in 0..4 {
        tokio::time::sleep(Duration::from_millis(900)).await;
        busy.get_version(Empty {}).await.unwrap();
    }
    drop(crowd);
    running.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn one_address_does_not_take_all_connections() {
    let folder = tempfile::tempdir().unwrap();
    let mut options = options(vec![street(folder.path())]);
    options.limits.address_connections = 2;
    let running = serve(&options).await;
    let mut own = Vec::new();
    for _ in 0..2 {
        own.push(connect(&running).await.unwrap());
    }
    let third = connect(&running).await;
    let refused = match third {
        None => true,
        Some(channel) => SensorsimServiceClient::new(channel)
            .get_version(Empty {})
            .await
            .is_err(),
    };
    assert!(
        refused,
        "the third connection of an address that may have two"
    );
    SensorsimServiceClient::new(own.remove(0))
        .get_version(Empty {})
        .await
        .unwrap();
    running.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn the_end_comes_when_grace_is_over() {
    let folder = tempfile::tempdir().unwrap();
    let mut options = options(vec![street(folder.path())]);
    options.limits.grace = 0.5;
    let running = serve(&options).await;
    let mut client = client(&running).await;
    let mut large = good(&mut client).await;
    client.render_rgb(large.clone()).await.unwrap();
    (large.resolution_w, large.resolution_h) = (1920, 1200);
    let asking: Vec<_> = (0..40)
        .map(|_| {
            let (mut client, large) = (client.clone(), large.clone());
            tokio::spawn(async move { client.render_rgb(large).await.map(|_| ()) })
        })
        .collect();
    tokio::time::sleep(Duration::from_millis(500)).await;
    let since = Instant::now();
    running.stop().await.unwrap();
    assert!(
        since.elapsed() < Duration::from_secs(15),
        "it took {:.1} s",
        since.elapsed().as_secs_f64()
    );
    let mut cut = 0;
    for asked in asking {
        cut += usize::from(asked.await.unwrap().is_err());
    }
    assert!(cut > 0, "forty images take longer than the server had");
}

/// Shortest soak whose figures are judged by the bounds of a long one, seconds.
const LONG_SOAK_S: u64 = 60;

/// Runs the program for `DECOUPLEGS_SOAK_S` seconds (5 unless set) under good and bad requests: its
/// memory stays, its log stays small, and it is healthy to the end. In a soak of a minute or more
/// memory grows by at most 5 %, and the 99th percentile of a steady client's waits is at most twice
/// that of the same client alone.
#[tokio::test(flavor = "multi_thread")]
async fn a_soak_leaves_memory_log_and_health_as_they_were() {
    let seconds = std::env::var("DECOUPLEGS_SOAK_S").map_or(5, |text| {
        text.parse()
            .expect("DECOUPLEGS_SOAK_S is a number of seconds")
    });
    let folder = tempfile::tempdir().unwrap();
    let mut scenes = broken_scenes(folder.path());
    scenes.push(street(folder.path()));
    let log = folder.path().join("log");
    let started = Command::new(env!("CARGO_BIN_EXE_decouplegs-server"))
        .args(["serve-grpc", "--port", "0"])
        .args(&scenes)
        .stdout(Stdio::piped())
        .stderr(File::create(&log).unwrap())
        .spawn();
    let mut guard = Killed(started.unwrap());
    let program = &mut guard.0;
    let mut said = String::new();
    std::io::BufRead::read_line(
        &mut std::io::BufReader::new(program.stdout.take().unwrap()),
        &mut said,
    )
    .unwrap();
    let address = format!(
        "http://{}",
        said.trim()
            .strip_prefix("listening on ")
            .expect("it says where it listens")
    );
    let quiet = Duration::from_secs((seconds / 5).clamp(1, 30));
    let alone = p99(steady(address.clone(), Instant::now() + quiet).await);
    let end = Instant::now() + Duration::from_secs(seconds);
    let clients: Vec<_> = (0..4)
        .map(|number| tokio::spawn(soak(address.clone(), number, end)))
        .collect();
    let steady_client = tokio::spawn(steady(address.clone(), end));
    // A minute, or a fifth of a short soak, until caches are full.
    tokio::time::sleep(Duration::from_secs((seconds / 5).clamp(2, 60))).await;
    let process = program.id().to_string();
    let mut resident = Vec::new();
    while Instant::now() < end {
        resident.push(resident_bytes(&process));
        tokio::time::sleep(Duration::from_millis(500)).await;
    }
    let mut calls = 0;
    for client in clients {
        calls += client.await.unwrap();
    }
    let beside = p99(steady_client.await.unwrap());
    // One sample says little: messages of megabytes come and go.
    let window = resident.len().div_ceil(5);
    let warm = median(resident[..window].to_vec());
    let after = median(resident[resident.len() - window..].to_vec());
    let logged = fs::metadata(&log).unwrap().len();
    let channel = Endpoint::from_shared(address)
        .unwrap()
        .connect()
        .await
        .unwrap();
    assert!(is_healthy(channel).await);
    println!(
        "{seconds} s, {calls} calls: {warm} bytes resident when warm, {after} at the end; {logged} bytes of log; a steady client's p99 {alone:?} alone, {beside:?} beside the others"
    );
    let grown_max = match seconds < LONG_SOAK_S {
        true => warm / 10 + (16 << 20),
        false => warm / 20,
    };
    assert!(
        after < warm + grown_max,
        "memory grew from {warm} to {after} bytes"
    );
    assert!(
        seconds < LONG_SOAK_S || beside <= 2 * alone,
        "the p99 of a steady client grew from {alone:?} to {beside:?}"
    );
    assert!(logged < 5 << 20, "{logged} bytes of log");
    let id = rustix::process::Pid::from_child(program);
    rustix::process::kill_process(id, rustix::process::Signal::TERM).unwrap();
    assert_eq!(program.wait().unwrap().code(), Some(0));
}

/// A process that ends with the test, also where that fails.
struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn median(mut bytes: Vec<u64>) -> u64 {
    bytes.sort_unstable();
    bytes[bytes.len() / 2]
}

/// Waits of a client that asks for an image every 50 ms until `end`, as a simulator does; the first
/// ones, in which buffers grow, are left out.
async fn steady(address: String, end: Instant) -> Vec<Duration> {
    let channel = Endpoint::from_shared(address).unwrap();
    let channel = channel.connect().await.unwrap();
    let mut client = SensorsimServiceClient::new(channel);
    let good = good(&mut client).await;
    let mut waits = Vec::new();
    while Instant::now() < end {
        let since = Instant::now();
        client.render_rgb(good.clone()).await.unwrap();
        waits.push(since.elapsed());
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    waits.split_off(waits.len().min(10))
}

/// The 99th percentile of some waits; zero for none.
pub fn p99(mut waits: Vec<Duration>) -> Duration {
    waits.sort();
    let at = (waits.len() * 99).div_ceil(100).saturating_sub(1);
    waits.get(at).copied().unwrap_or_default()
}

/// Good and bad requests, some ten a second, until `end`; how many.
async fn soak(address: String, number: u64, end: Instant) -> u64 {
    let channel = Endpoint::from_shared(address)
        .unwrap()
        .connect()
        .await
        .unwrap();
    let mut client = SensorsimServiceClient::new(channel).max_encoding_message_size(64 << 20);
    let good = good(&mut client).await;
    let here = Pose::IDENTITY;
    let mut calls = 0;
    while Instant::now() < end {
        let mut asked = good.clone();
        let is_good = match (calls + number) % 8 {
            0 | 1 => true,
            2 => {
                asked.dynamic_objects =
                    vec![object(&format!("unknown {number} {calls}"), &here, &here)];
                true
            }
            3 => {
                asked.dynamic_objects = vec![object(
                    &"\u{1b}[31m\n".repeat(1 + 2000 * (calls as usize % 300)),
                    &here,
                    &here,
                )];
                calls % 300 == 0
            }
            4 => {
                asked.scene_id = "\u{7}".repeat(calls as usize % 5000);
                false
            }
            5 => {
                asked.scene_id = ["cut", "blocked", "endless"][calls as usize % 3].into();
                false
            }
            6 => {
                asked.sensor_pose.as_mut().unwrap().start_pose = None;
                false
            }
            _ => {
                (asked.resolution_w, asked.resolution_h) = (60_000, 60_000);
                false
            }
        };
        let answer = client.render_rgb(asked).await;
        assert_eq!(
            answer.is_ok(),
            is_good,
            "call {calls} of client {number}: {:?}",
            answer.map(|_| ())
        );
        calls += 1;
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    calls
}
