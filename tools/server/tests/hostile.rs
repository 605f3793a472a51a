//! Clients that mean harm, or do not know better: each is told so, and the server goes on.

use std::time::{Duration, Instant};

use bytes::{Buf, BufMut, Bytes};
use decouplegs::scene::Pose;
use decouplegs_alpasim::wire::common::{Quat, Vec3};
use decouplegs_alpasim::wire::sensorsim::sensorsim_service_client::SensorsimServiceClient;
use decouplegs_alpasim::wire::sensorsim::{
    CameraSpec, DynamicObject, ImageFormat, RgbRenderRequest,
};
use decouplegs_server::running::Running;
use prost::Message;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tonic::client::Grpc;
use tonic::codec::{Codec, DecodeBuf, Decoder, EncodeBuf, Encoder};
use tonic::transport::Channel;
use tonic::{Code, Request, Status};

use crate::asking::{batch, cameras, channel, client, object, options, pair, png, request, serve};
use crate::scenes::street;

/// Sends bytes as they are, and takes any.
#[derive(Clone, Default)]
struct Raw;

impl Codec for Raw {
    type Encode = Bytes;
    type Decode = Bytes;
    type Encoder = Self;
    type Decoder = Self;

    fn encoder(&mut self) -> Self {
        Self
    }

    fn decoder(&mut self) -> Self {
        Self
    }
}

impl Encoder for Raw {
    type Item = Bytes;
    type Error = Status;

    fn encode(&mut self, item: Bytes, buffer: &mut EncodeBuf<'_>) -> Result<(), Status> {
        buffer.put(item);
        Ok(())
    }
}

impl Decoder for Raw {
    type Item = Bytes;
    type Error = Status;

    fn decode(&mut self, buffer: &mut DecodeBuf<'_>) -> Result<Option<Bytes>, Status> {
        Ok(Some(buffer.copy_to_bytes(buffer.remaining())))
    }
}

const PATH: &str = "/nre.grpc.protos.sensorsim.SensorsimService/";

/// The status of `method`, sent `bytes` as its message.
async fn refused(channel: &Channel, method: &str, bytes: impl Into<Bytes>) -> Status {
    let mut grpc = Grpc::new(channel.clone()).max_encoding_message_size(1 << 30);
    grpc.ready().await.expect("the server is there");
    let path = format!("{PATH}{method}").parse().unwrap();
    grpc.unary(Request::new(bytes.into()), path, Raw)
        .await
        .expect_err("it is refused")
}

/// Memory of this process, server and clients, bytes.
fn memory_bytes() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
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

/// A good image, to be spoilt.
async fn good(client: &mut SensorsimServiceClient<Channel>) -> RgbRenderRequest {
    let rig = cameras(client, "street").await;
    request(
        "street",
        &rig[0],
        &Pose::from_yaw(0.0, glam::DVec3::Z),
        ImageFormat::Png,
    )
}

async fn assert_still_up(running: &Running) {
    let mut client = client(running).await;
    let asked = good(&mut client).await;
    assert_eq!(
        png(&client
            .render_rgb(asked)
            .await
            .unwrap()
            .into_inner()
            .image_bytes)
        .0,
        [160, 100]
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn what_makes_no_sense_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let running = serve(&options(vec![street(folder.path())])).await;
    let mut client = client(&running).await;
    let good = good(&mut client).await;
    let here = Pose::IDENTITY;
    type Spoil = fn(&mut RgbRenderRequest);
    let spoilt: [(&str, Code, Spoil); 15] = [
        ("scene_id", Code::InvalidArgument, |asked| {
            asked.scene_id.clear();
        }),
        ("scene_id", Code::NotFound, |asked| {
            asked.scene_id = "../../etc/passwd".into();
        }),
        ("sensor_pose is missing", Code::InvalidArgument, |asked| {
            asked.sensor_pose = None;
        }),
        ("sensor_pose.end_pose.vec", Code::InvalidArgument, |asked| {
            let end = asked
                .sensor_pose
                .as_mut()
                .unwrap()
                .end_pose
                .as_mut()
                .unwrap();
            end.vec = Some(Vec3 {
                x: f32::NAN,
                y: 0.0,
                z: 0.0,
            });
        }),
        (
            "sensor_pose.start_pose.vec",
            Code::InvalidArgument,
            |asked| {
                let start = asked
                    .sensor_pose
                    .as_mut()
                    .unwrap()
                    .start_pose
                    .as_mut()
                    .unwrap();
                start.vec = Some(Vec3 {
                    x: 0.0,
                    y: f32::NEG_INFINITY,
                    z: 0.0,
                });
            },
        ),
        (
            "sensor_pose.start_pose.quat",
            Code::InvalidArgument,
            |asked| {
                asked
                    .sensor_pose
                    .as_mut()
                    .unwrap()
                    .start_pose
                    .as_mut()
                    .unwrap()
                    .quat = Some(Quat::default());
            },
        ),
        ("frame_end_us", Code::InvalidArgument, |asked| {
            asked.frame_end_us = 0;
        }),
        ("image_format", Code::InvalidArgument, |asked| {
            asked.image_format = 0;
        }),
        ("image_format", Code::Unimplemented, |asked| {
            asked.image_format = ImageFormat::Jpeg2000.into();
        }),
        ("image_quality", Code::InvalidArgument, |asked| {
            (asked.image_format, asked.image_quality) = (ImageFormat::Jpeg.into(), f32::NAN);
        }),
        (
            "camera_intrinsics is missing",
            Code::InvalidArgument,
            |asked| asked.camera_intrinsics = None,
        ),
        (
            "camera_intrinsics.camera_param",
            Code::InvalidArgument,
            |asked| {
                asked.camera_intrinsics = Some(CameraSpec {
                    camera_param: None,
                    ..asked.camera_intrinsics.clone().unwrap()
                });
            },
        ),
        ("pixels", Code::ResourceExhausted, |asked| {
            (asked.resolution_h, asked.resolution_w) = (60_000, 60_000);
        }),
        ("resolution", Code::InvalidArgument, |asked| {
            asked.resolution_h = 0;
        }),
        ("ego_mask_id", Code::InvalidArgument, |asked| {
            asked.insert_ego_mask = true;
        }),
    ];
    for (name, code, spoil) in spoilt {
        let mut asked = good.clone();
        spoil(&mut asked);
        let status = client.render_rgb(asked).await.unwrap_err();
        assert!(
            status.code() == code && status.message().contains(name),
            "{name}: {status}"
        );
    }
    // Of objects, and of batches.
    let mut asked = good.clone();
    asked.dynamic_objects = vec![object("car", &here, &here), object("car", &here, &here)];
    assert!(
        client
            .render_rgb(asked.clone())
            .await
            .unwrap_err()
            .message()
            .contains("dynamic_objects[1].track_id")
    );
    asked.dynamic_objects = vec![DynamicObject {
        track_id: "car".into(),
        pose_pair: Some(pair(&here, &here)),
    }];
    asked.dynamic_objects[0]
        .pose_pair
        .as_mut()
        .unwrap()
        .end_pose = None;
    assert!(
        client
            .render_rgb(asked)
            .await
            .unwrap_err()
            .message()
            .contains("dynamic_objects[0].pose_pair.end_pose")
    );
    let twice = batch([
        ("front".to_owned(), good.clone()),
        ("front".to_owned(), good.clone()),
    ]);
    let status = client.batch_render_rgb(twice).await.unwrap_err();
    assert!(
        status.code() == Code::InvalidArgument && status.message().contains("items[1].camera_name"),
        "{status}"
    );
    let many = batch((0..100).map(|index| (index.to_string(), good.clone())));
    assert_eq!(
        client.batch_render_rgb(many).await.unwrap_err().code(),
        Code::ResourceExhausted
    );
    assert_still_up(&running).await;
    running.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn bytes_that_are_no_message_and_messages_that_are_too_large() {
    let folder = tempfile::tempdir().unwrap();
    let running = serve(&options(vec![street(folder.path())])).await;
    assert_still_up(&running).await;
    let (mut client, channel) = (client(&running).await, channel(&running).await);
    let good = good(&mut client).await;
    let before = memory_bytes();
    for garbage in [
        vec![0xff; 40],
        vec![0x0a, 0xff, 0xff, 0xff, 0xff, 0x0f],
        vec![0x42; 1000],
        vec![0x22; 3],
    ] {
        for method in [
            "render_rgb",
            "batch_render_rgb",
            "render_aggregated",
            "get_available_cameras",
        ] {
            let status = refused(&channel, method, garbage.clone()).await;
            assert_eq!(status.code(), Code::InvalidArgument, "{method}: {status}");
        }
    }
    let oversized = refused(&channel, "render_rgb", vec![0; 40 << 20]).await;
    assert!(
        matches!(oversized.code(), Code::OutOfRange | Code::ResourceExhausted),
        "{oversized}"
    );
    // Each object of two bytes would be a hundred times as large once it is a value.
    let bomb = [0x42, 0x00].repeat(4 << 20);
    assert_eq!(
        refused(&channel, "render_rgb", bomb).await.code(),
        Code::ResourceExhausted
    );
    let mut crowded = good.clone();
    let here = Pose::IDENTITY;
    crowded.dynamic_objects = (0..100_000)
        .map(|index| object(&format!("car {index}"), &here, &here))
        .collect();
    assert_eq!(
        refused(&channel, "render_rgb", crowded.encode_to_vec())
            .await
            .code(),
        Code::ResourceExhausted
    );
    let all = batch([("front".to_owned(), crowded)]);
    assert_eq!(
        refused(&channel, "batch_render_rgb", all.encode_to_vec())
            .await
            .code(),
        Code::ResourceExhausted
    );
    let grown = memory_bytes().saturating_sub(before);
    assert!(grown < 300 << 20, "memory grew by {grown} bytes");
    assert_still_up(&running).await;
    running.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn bodies_that_never_end_and_claims_that_are_never_kept() {
    let folder = tempfile::tempdir().unwrap();
    let mut options = options(vec![street(folder.path())]);
    options.limits.deadline = 2.0;
    options.limits.requests = 8;
    let running = serve(&options).await;
    let before = memory_bytes();
    let stream = TcpStream::connect(running.address).await.unwrap();
    let (mut sender, connection) = h2::client::handshake(stream).await.unwrap();
    tokio::spawn(connection);
    let mut open = Vec::new();
    for index in 0..20 {
        sender = sender.ready().await.unwrap();
        let uri = format!("http://{}{PATH}render_rgb", running.address);
        let head = http::Request::post(uri)
            .header("content-type", "application/grpc")
            .header("te", "trailers")
            .body(())
            .unwrap();
        let (response, mut body) = sender.send_request(head, false).unwrap();
        // A frame of four gigabytes, of a sixteen-megabyte message, or of nothing for ever.
        let claim: &[u8] = [
            &[0, 0xff, 0xff, 0xff, 0xff][..],
            &[0, 0, 0xff, 0xff, 0xff],
            &[0],
        ][index % 3];
        body.send_data(Bytes::copy_from_slice(claim), false)
            .unwrap();
        open.push((response, body));
    }
    let since = Instant::now();
    for (response, _body) in open {
        let response = response.await.expect("an answer");
        let code = response
            .headers()
            .get("grpc-status")
            .and_then(|code| code.to_str().ok())
            .expect("a status")
            .to_owned();
        assert!(
            ["3", "4", "8", "11", "13"].contains(&code.as_str()),
            "{code}"
        );
    }
    assert!(since.elapsed() < Duration::from_secs(60));
    let grown = memory_bytes().saturating_sub(before);
    assert!(grown < 300 << 20, "memory grew by {grown} bytes");
    running.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn thousands_of_connections_that_say_nothing() {
    let limit = rustix::process::getrlimit(rustix::process::Resource::Nofile);
    let raised = rustix::process::Rlimit {
        current: limit.maximum,
        ..limit
    };
    rustix::process::setrlimit(rustix::process::Resource::Nofile, raised).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let mut options = options(vec![street(folder.path())]);
    options.limits.connections = 64;
    options.limits.handshake = 2.0;
    let running = serve(&options).await;
    let mut silent = Vec::new();
    for _ in 0..1500 {
        silent.push(TcpStream::connect(running.address).await.unwrap());
    }
    // Those beyond the limit are closed at once, the others when they have said nothing for a
    // while.
    let since = Instant::now();
    let mut closed = 0;
    for stream in &mut silent {
        let (patience, mut said) = (Duration::from_secs(20), Vec::new());
        let read = tokio::time::timeout(patience, stream.read_to_end(&mut said))
            .await
            .expect("it is closed before long");
        // What the server says first is its settings, and it says nothing else.
        closed += usize::from(read.is_err() || said.len() < 256);
    }
    assert_eq!(closed, 1500);
    assert!(since.elapsed() < Duration::from_secs(60));
    // Others speak another language.
    for noise in [
        &b"GET / HTTP/1.1\r\nHost: x\r\n\r\n"[..],
        &[0x16, 3, 1, 2, 0],
        &[0xff; 4096],
    ] {
        let mut stream = TcpStream::connect(running.address).await.unwrap();
        stream.write_all(noise).await.unwrap();
        let mut said = Vec::new();
        // Reset, or closed: it ends.
        let _ = tokio::time::timeout(Duration::from_secs(20), stream.read_to_end(&mut said))
            .await
            .expect("it is closed");
    }
    drop(silent);
    assert_still_up(&running).await;
    running.stop().await.unwrap();
}
