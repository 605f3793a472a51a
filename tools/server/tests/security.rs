//! Access control, metrics, and the server's shutdown.

use std::fs;
use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};
use std::time::Duration;

use decouplegs::scene::Pose;
use decouplegs_alpasim::wire::common::Empty;
use decouplegs_alpasim::wire::sensorsim::ImageFormat;
use decouplegs_alpasim::wire::sensorsim::sensorsim_service_client::SensorsimServiceClient;
use decouplegs_server::names::{PHYSICS_ALSO, SENSORSIM, SENSORSIM_ALSO};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tonic::transport::{Certificate, ClientTlsConfig, Endpoint};
use tonic::{Code, Request};
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_client::HealthClient;

use crate::asking::{batch, cameras, channel, client, options, request, serve};
use crate::scenes::street;

#[tokio::test(flavor = "multi_thread")]
async fn a_token_is_asked_for_and_health_is_not_secret() {
    let folder = tempfile::tempdir().unwrap();
    let mut options = options(vec![street(folder.path())]);
    let token_file = folder.path().join("token");
    fs::write(&token_file, "open sesame\n").unwrap();
    options.token_file = Some(token_file.clone());
    assert!(
        decouplegs_server::running::start(&options).await.is_err(),
        "a token with a space cannot be sent"
    );
    fs::write(&token_file, "open-sesame\n").unwrap();
    let running = serve(&options).await;
    let mut client = client(&running).await;
    for sent in [
        None,
        Some("Bearer open-sesamE"),
        Some("Bearer "),
        Some("open-sesame"),
        Some("Basic open-sesame"),
    ] {
        let mut asked = Request::new(Empty {});
        if let Some(sent) = sent {
            asked
                .metadata_mut()
                .insert("authorization", sent.parse().unwrap());
        }
        assert_eq!(
            client.get_version(asked).await.unwrap_err().code(),
            Code::Unauthenticated,
            "{sent:?}"
        );
    }
    let mut asked = Request::new(Empty {});
    asked
        .metadata_mut()
        .insert("authorization", "Bearer open-sesame".parse().unwrap());
    client.get_version(asked).await.unwrap();
    let mut health = HealthClient::new(channel(&running).await);
    for service in ["", SENSORSIM, SENSORSIM_ALSO[0], PHYSICS_ALSO[1]] {
        let asked = HealthCheckRequest {
            service: service.into(),
        };
        assert_eq!(
            health.check(asked).await.unwrap().into_inner().status,
            1,
            "{service:?} is serving"
        );
    }
    let unknown = health
        .check(HealthCheckRequest {
            service: "lidar".into(),
        })
        .await;
    assert_eq!(unknown.unwrap_err().code(), Code::NotFound);
    running.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn tls_is_spoken_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let made = rcgen::generate_simple_self_signed(vec!["localhost".to_owned()]).unwrap();
    let (certificate, key) = (
        folder.path().join("cert.pem"),
        folder.path().join("key.pem"),
    );
    fs::write(&certificate, made.cert.pem()).unwrap();
    fs::write(&key, made.signing_key.serialize_pem()).unwrap();
    let mut options = options(vec![street(folder.path())]);
    (options.tls_cert, options.tls_key) = (Some(certificate), Some(key));
    options.limits.handshake = 2.0;
    let running = serve(&options).await;
    let port = running.address.port();
    let plain = Endpoint::from_shared(format!("http://127.0.0.1:{port}")).unwrap();
    if let Ok(channel) = plain.timeout(Duration::from_secs(10)).connect().await {
        SensorsimServiceClient::new(channel)
            .get_version(Empty {})
            .await
            .expect_err("plain text is not answered");
    }
    let trusted = ClientTlsConfig::new()
        .ca_certificate(Certificate::from_pem(made.cert.pem()))
        .domain_name("localhost");
    let endpoint = Endpoint::from_shared(format!("https://127.0.0.1:{port}"))
        .unwrap()
        .tls_config(trusted)
        .unwrap();
    let mut client = SensorsimServiceClient::new(endpoint.connect().await.unwrap());
    client.get_version(Empty {}).await.unwrap();
    let stranger = Endpoint::from_shared(format!("https://127.0.0.1:{port}")).unwrap();
    let stranger = stranger
        .tls_config(ClientTlsConfig::new().domain_name("localhost"))
        .unwrap();
    assert!(
        stranger.connect().await.is_err(),
        "who does not trust the certificate does not speak"
    );
    running.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn metrics_tell_what_was_asked() {
    let folder = tempfile::tempdir().unwrap();
    let mut options = options(vec![street(folder.path())]);
    options.metrics_port = Some(0);
    let running = serve(&options).await;
    let mut client = client(&running).await;
    let rig = cameras(&mut client, "street").await;
    let asked = request("street", &rig[0], &Pose::IDENTITY, ImageFormat::Png);
    client
        .batch_render_rgb(batch([
            ("a".to_owned(), asked.clone()),
            ("b".to_owned(), asked),
        ]))
        .await
        .unwrap();
    client
        .render_rgb(decouplegs_alpasim::wire::sensorsim::RgbRenderRequest::default())
        .await
        .unwrap_err();
    let address = running.metrics_address.unwrap();
    let read = async |path: &str| {
        let mut stream = TcpStream::connect(address).await.unwrap();
        stream
            .write_all(format!("GET {path} HTTP/1.1\r\nhost: x\r\n\r\n").as_bytes())
            .await
            .unwrap();
        let mut text = String::new();
        stream.read_to_string(&mut text).await.unwrap();
        text
    };
    let page = read("/metrics").await;
    for line in [
        "decouplegs_requests_total{method=\"batch_render_rgb\",status=\"Ok\"} 1",
        "decouplegs_requests_total{method=\"render_rgb\",status=\"InvalidArgument\"} 1",
        "decouplegs_request_seconds_count{method=\"batch_render_rgb\"} 1",
        "decouplegs_images_total 2",
        "decouplegs_submissions_total 1",
        "decouplegs_queue_depth 0",
        "decouplegs_scenes_cached 1",
        "decouplegs_connections 1",
    ] {
        assert!(
            page.lines().any(|written| written == line),
            "{line} is not in\n{page}"
        );
    }
    let bytes = page
        .lines()
        .find_map(|line| line.strip_prefix("decouplegs_scene_cache_bytes "))
        .unwrap();
    assert!(bytes.parse::<u64>().unwrap() > 4000 * 48, "{bytes}");
    assert!(read("/").await.starts_with("HTTP/1.1 404"));
    running.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn what_has_begun_is_finished_when_the_server_is_told_to_stop() {
    let folder = tempfile::tempdir().unwrap();
    let scene = street(folder.path());
    let mut program = Command::new(env!("CARGO_BIN_EXE_decouplegs-server"))
        .args([
            "serve-grpc",
            "--host",
            "127.0.0.1",
            "--port",
            "0",
            "--cache-size",
            "2",
            "--encoders",
            "2",
            "--log",
            "json",
        ])
        .arg("--artifact-glob")
        .arg(folder.path().join("*/scene.toml"))
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    assert!(scene.exists());
    let mut said = String::new();
    BufReader::new(program.stdout.take().unwrap())
        .read_line(&mut said)
        .unwrap();
    let address = said
        .trim()
        .strip_prefix("listening on ")
        .expect("it says where it listens")
        .to_owned();
    let channel = Endpoint::from_shared(format!("http://{address}"))
        .unwrap()
        .connect()
        .await
        .unwrap();
    let mut client = SensorsimServiceClient::new(channel);
    let rig = cameras(&mut client, "street").await;
    // The first image takes a while: the scene is read and kernels are built.
    let asked = request(
        "street",
        &rig[0],
        &Pose::from_yaw(0.0, glam::DVec3::Z),
        ImageFormat::Png,
    );
    let mut asking = client.clone();
    let begun = tokio::spawn(async move { asking.render_rgb(asked).await });
    tokio::time::sleep(Duration::from_millis(150)).await;
    let id = rustix::process::Pid::from_child(&program);
    rustix::process::kill_process(id, rustix::process::Signal::TERM).unwrap();
    assert!(
        !begun
            .await
            .unwrap()
            .expect("what has begun is finished")
            .into_inner()
            .image_bytes
            .is_empty()
    );
    let status = tokio::task::spawn_blocking(move || program.wait())
        .await
        .unwrap()
        .unwrap();
    assert_eq!(status.code(), Some(0));
    client
        .get_version(Empty {})
        .await
        .expect_err("nobody is there");
}

#[test]
fn a_command_line_that_makes_no_sense_exits_with_two_and_a_failure_with_one() {
    let run = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_decouplegs-server"))
            .args(arguments)
            .output()
            .unwrap();
        (
            output.status.code(),
            String::from_utf8_lossy(&output.stderr).into_owned(),
        )
    };
    assert_eq!(run(&["serve", "--port", "70000", "a.toml"]).0, Some(2));
    assert_eq!(run(&["serve", "a.toml", "--tls-cert", "x.pem"]).0, Some(2));
    let (code, said) = run(&["serve", "/nowhere/scene.toml"]);
    assert!(
        code == Some(1) && said.contains("/nowhere/scene.toml"),
        "{said}"
    );
    let (code, said) = run(&["serve"]);
    assert!(code == Some(1) && said.contains("no scenes"), "{said}");
}
