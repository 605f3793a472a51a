//! Many clients at once, some of them rude: those that are not get their images.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use decouplegs::scene::Pose;
use decouplegs_alpasim::wire::sensorsim::sensorsim_service_client::SensorsimServiceClient;
use decouplegs_alpasim::wire::sensorsim::{ImageFormat, RgbRenderRequest};
use futures_util::future::join_all;
use glam::DVec3;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tonic::Code;
use tonic::transport::{Channel, Endpoint};

use crate::asking::{cameras, client, options, request, serve};
use crate::lasting::p99;
use crate::scenes::street;

/// Requests that a rude client has open at a time.
const FLOOD: usize = 32;

/// Shortest crowd whose waits are judged, seconds: shorter ones say little.
const LONG_CROWD_S: u64 = 30;

/// Time that a server waits at its end for connections that are left (`Limits::grace`).
const GRACE: Duration = Duration::from_secs(30);

/// Longest time for one step of a client or of the server: a crowd that waits for longer hangs.
const STEP_MAX: Duration = Duration::from_secs(60);

/// The result of `step`, which must end in time: `name` says which one did not.
async fn in_time<T>(name: &str, step: impl Future<Output = T>) -> T {
    let done = tokio::time::timeout(STEP_MAX, step).await;
    done.unwrap_or_else(|_| panic!("{name} did not end in {STEP_MAX:?}"))
}

/// The request of a client for a small image of a scene.
async fn small(client: &mut SensorsimServiceClient<Channel>, scene: &str) -> RgbRenderRequest {
    let rig = cameras(client, scene).await;
    let here = Pose::from_yaw(0.0, DVec3::Z);
    request(scene, &rig[0], &here, ImageFormat::Jpeg)
}

/// `asked` with four times the pixels.
fn large(asked: &RgbRenderRequest) -> RgbRenderRequest {
    RgbRenderRequest {
        resolution_w: 2 * asked.resolution_w,
        resolution_h: 2 * asked.resolution_h,
        ..asked.clone()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_with_one_request_is_not_refused_beside_one_with_many() {
    let folder = tempfile::tempdir().unwrap();
    let mut options = options(vec![street(folder.path())]);
    options.limits.requests = 2;
    let running = serve(&options).await;
    let mut polite = client(&running).await;
    let asked = small(&mut polite, "street").await;
    let mut rude = client(&running).await;
    let heavy = large(&large(&asked));
    rude.render_rgb(heavy.clone()).await.unwrap();
    let flood = tokio::spawn(join_all((0..FLOOD).map(|_| {
        let (mut rude, heavy) = (rude.clone(), heavy.clone());
        async move { rude.render_rgb(heavy).await.map_err(|status| status.code()) }
    })));
    // Its places are taken once it waits for others.
    tokio::time::sleep(Duration::from_millis(200)).await;
    for _ in 0..5 {
        polite.render_rgb(asked.clone()).await.unwrap();
    }
    let flood = flood.await.unwrap();
    assert!(flood.iter().any(Result::is_ok), "some of many are answered");
    for refused in flood.iter().filter_map(|answer| answer.as_ref().err()) {
        assert_eq!(*refused, Code::ResourceExhausted);
    }
    running.stop().await.unwrap();
}

/// The scene of `from`, once more in `folder` under another id.
fn copied(from: &Path, folder: &Path, id: &str) -> PathBuf {
    let (from, into) = (from.parent().unwrap(), folder.join(id));
    std::fs::create_dir(&into).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        std::fs::copy(&path, into.join(path.file_name().unwrap())).unwrap();
    }
    into.join("scene.toml")
}

/// Half of the clients ask for one image after the other, as simulators do; the others flood,
/// cancel, connect again and again, or send garbage. None of the first is refused anything. In a
/// crowd of half a minute or more (`DECOUPLEGS_CROWD_S`, of 100 clients and 10 scenes) the 99th
/// percentile of their waits is at most twice what it is without the others.
#[tokio::test(flavor = "multi_thread")]
async fn rude_clients_do_not_hold_up_the_others() {
    let seconds = std::env::var("DECOUPLEGS_CROWD_S").map_or(2, |text| {
        text.parse()
            .expect("DECOUPLEGS_CROWD_S is a number of seconds")
    });
    let (half, scenes) = match seconds < LONG_CROWD_S {
        true => (5, 3),
        false => (50, 10),
    };
    let folder = tempfile::tempdir().unwrap();
    let first = street(folder.path());
    let ids: Vec<String> = (0..scenes).map(|number| format!("scene{number}")).collect();
    let files = ids.iter().map(|id| copied(&first, folder.path(), id));
    let mut options = options(files.collect());
    options.limits.cache_size = scenes as u32;
    let running = serve(&options).await;
    let address = running.address;
    // Scenes are read, and kernels are made, before the first wait counts.
    for id in &ids {
        let mut first = client(&running).await;
        let asked = small(&mut first, id).await;
        first.render_rgb(asked.clone()).await.unwrap();
        first.render_rgb(large(&asked)).await.unwrap();
    }
    let time = Duration::from_secs(seconds);
    let crowd = |end: Instant| {
        let ids = &ids;
        async move {
            let polite =
                (0..half).map(|n| tokio::spawn(polite(address, ids[n % scenes].clone(), end)));
            let waits = join_all(polite.collect::<Vec<_>>()).await;
            waits
                .into_iter()
                .flat_map(Result::unwrap)
                .collect::<Vec<_>>()
        }
    };
    let alone = crowd(Instant::now() + time).await;
    let end = Instant::now() + time;
    let rude = (0..half).map(|n| tokio::spawn(rude(address, ids[n % scenes].clone(), n, end)));
    let rude: Vec<_> = rude.collect();
    let beside = crowd(end).await;
    let answered: usize = join_all(rude).await.into_iter().map(Result::unwrap).sum();
    let figures = [&alone, &beside].map(|waits| (waits.len(), p99(waits.clone())));
    println!(
        "{half} polite clients alone: {} images, p99 {:?}; beside {half} rude ones, which got {answered}: {} images, p99 {:?}",
        figures[0].0, figures[0].1, figures[1].0, figures[1].1
    );
    assert!(figures.iter().all(|(images, _)| *images >= half));
    assert!(
        seconds < LONG_CROWD_S || figures[1].1 <= 2 * figures[0].1,
        "rude clients hold up the others"
    );
    // All clients are gone: nothing that has begun is waited for.
    let since = Instant::now();
    running.stop().await.unwrap();
    assert!(since.elapsed() < GRACE, "a connection is left");
}

async fn connected(address: SocketAddr) -> SensorsimServiceClient<Channel> {
    let endpoint = Endpoint::from_shared(format!("http://{address}")).unwrap();
    SensorsimServiceClient::new(endpoint.connect().await.unwrap())
}

/// Waits of a client that asks for one image after the other until `end`.
async fn polite(address: SocketAddr, scene: String, end: Instant) -> Vec<Duration> {
    let mut client = connected(address).await;
    let asked = small(&mut client, &scene).await;
    let mut waits = Vec::new();
    while Instant::now() < end || waits.is_empty() {
        let since = Instant::now();
        let answer = in_time("a polite request", client.render_rgb(asked.clone())).await;
        answer.unwrap();
        waits.push(since.elapsed());
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    waits
}

/// The images of a client of the kind `number` that thinks of itself alone, until `end`.
async fn rude(address: SocketAddr, scene: String, number: usize, end: Instant) -> usize {
    let mut client = connected(address).await;
    let asked = small(&mut client, &scene).await;
    let mut images = 0;
    while Instant::now() < end {
        match number % 4 {
            // Many at a time, and large ones.
            0 => {
                let flood = (0..FLOOD).map(|_| {
                    let (mut client, asked) = (client.clone(), large(&asked));
                    async move { client.render_rgb(asked).await.is_ok() }
                });
                images += in_time("a flood", join_all(flood))
                    .await
                    .into_iter()
                    .filter(|&is_ok| is_ok)
                    .count();
            }
            // Asked for and given up.
            1 => {
                let soon = Duration::from_millis(5);
                let _ = tokio::time::timeout(soon, client.render_rgb(large(&asked))).await;
            }
            // A connection for each request, half of which make no sense.
            2 => {
                let mut again = in_time("another connection", connected(address)).await;
                let answer = in_time("a first request", again.render_rgb(asked.clone())).await;
                images += usize::from(answer.is_ok());
                let unknown = RgbRenderRequest {
                    scene_id: "no such scene".into(),
                    ..asked.clone()
                };
                let refused = in_time("a refusal", again.render_rgb(unknown)).await;
                refused.unwrap_err();
            }
            // No HTTP/2 at all.
            _ => {
                let garbage = async {
                    let mut stream = tokio::net::TcpStream::connect(address).await.unwrap();
                    // The server may close it before all of it is sent.
                    let _ = stream.write_all(&[b'x'; 5000]).await;
                    let _ = stream.read(&mut [0; 100]).await;
                };
                in_time("a connection without HTTP/2", garbage).await;
            }
        }
    }
    images
}
