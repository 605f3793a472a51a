//! A server whose scenes are spread over devices: the first one of the machine, opened twice.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use decouplegs::gpu::{DeviceChoice, DeviceSet};
use decouplegs::scene::Pose;
use decouplegs_alpasim::wire::common::Empty;
use decouplegs_alpasim::wire::sensorsim::sensorsim_service_client::SensorsimServiceClient;
use decouplegs_alpasim::wire::sensorsim::{
    BatchRgbRenderReturnItem, ImageFormat, RgbRenderRequest,
};
use decouplegs_server::options::ServerOptions;
use glam::DVec3;
use tonic::Code;
use tonic::transport::Channel;

use crate::asking::{batch, cameras, client, options, request, serve};
use crate::scenes::street_of;

const SCENES: [&str; 3] = ["north", "south", "west"];

/// Three streets of different sizes.
fn streets(folder: &Path) -> Vec<PathBuf> {
    let street = |(index, name): (usize, &&str)| {
        let made = street_of(folder, 2000 + 1500 * index);
        let place = folder.join(name);
        std::fs::rename(made.parent().unwrap(), &place).unwrap();
        place.join("scene.toml")
    };
    SCENES.iter().enumerate().map(street).collect()
}

/// `scenes` on a device that is opened twice, with these faults.
fn on_two(scenes: Vec<PathBuf>, drills: &[&str]) -> ServerOptions {
    let mut options = options(scenes);
    let device = match options.device.clone() {
        DeviceChoice::Automatic => DeviceChoice::Index(0),
        device => device,
    };
    options.devices.devices = Some(DeviceSet::Each(vec![device.clone(), device]));
    options.devices.drill = drills.iter().map(|drill| drill.parse().unwrap()).collect();
    options
}

/// A request of one image of `scene` with the vehicle `x_m` from its origin.
async fn at(
    client: &mut SensorsimServiceClient<Channel>,
    scene: &str,
    x_m: f64,
) -> RgbRenderRequest {
    let rig = cameras(client, scene).await;
    let pose = Pose::from_yaw(0.0, DVec3::new(x_m, 0.0, 1.0));
    request(scene, &rig[0], &pose, ImageFormat::Png)
}

/// Images of all scenes, two of each.
async fn images(client: &mut SensorsimServiceClient<Channel>) -> Vec<Vec<u8>> {
    let mut images = Vec::new();
    for x_m in [0.0, 3.0] {
        for scene in SCENES {
            let asked = at(client, scene, x_m).await;
            let answer = client.render_rgb(asked).await;
            images.push(answer.unwrap().into_inner().image_bytes.to_vec());
        }
    }
    images
}

#[tokio::test(flavor = "multi_thread")]
async fn scenes_on_two_devices_are_drawn_as_on_one() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = streets(folder.path());
    let one = serve(&options(scenes.clone())).await;
    let truth = images(&mut client(&one).await).await;
    one.stop().await.unwrap();
    let two = serve(&on_two(scenes, &[])).await;
    assert!(images(&mut client(&two).await).await == truth);
    let drawn = two.images_by_device();
    assert!(drawn.iter().all(|images| *images > 0), "{drawn:?}");
    assert_eq!(drawn.iter().sum::<u64>(), 6);
    two.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn scenes_of_a_device_that_is_lost_or_full_are_drawn_by_the_other() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = streets(folder.path());
    let one = serve(&options(scenes.clone())).await;
    let truth = images(&mut client(&one).await).await;
    one.stop().await.unwrap();
    // Of a device that is lost while it loads, in the middle of what it draws, or full.
    for drill in ["0:lost:3", "0:lost:45", "1:lost:0", "0:full:0", "1:full:0"] {
        let running = serve(&on_two(scenes.clone(), &[drill])).await;
        let mut clients = tokio::task::JoinSet::new();
        for _ in 0..2 {
            let mut client = client(&running).await;
            clients.spawn(async move { images(&mut client).await });
        }
        while let Some(drawn) = clients.join_next().await {
            assert!(drawn.unwrap() == truth, "{drill}: no request is lost");
        }
        running.stop().await.unwrap();
    }
}

/// Four images of `scene` in one request.
async fn four(client: &mut SensorsimServiceClient<Channel>, scene: &str) -> Vec<Vec<u8>> {
    let mut asked = Vec::new();
    for number in 0..4 {
        let request = at(client, scene, f64::from(number)).await;
        asked.push((format!("camera{number}"), request));
    }
    let answer = client.batch_render_rgb(batch(asked)).await;
    let items = answer.unwrap().into_inner().items.into_iter();
    let image = |item: BatchRgbRenderReturnItem| {
        assert!(item.success, "{}", item.error_message);
        item.result.unwrap().image_bytes.to_vec()
    };
    items.map(image).collect()
}

/// Waits until the one scene of the server is on `devices` devices.
async fn until_on(client: &mut SensorsimServiceClient<Channel>, devices: u64) {
    let since = Instant::now();
    loop {
        let loaded = client.get_loaded_scenes(Empty {}).await.unwrap();
        let scenes = loaded.into_inner().scenes;
        assert!(scenes.len() < 2, "a scene is listed twice: {scenes:?}");
        if (scenes.iter()).any(|scene| scene.loaded_instance_count == devices) {
            return;
        }
        assert!(since.elapsed() < Duration::from_secs(120), "{scenes:?}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn cameras_of_one_request_are_divided_between_copies_of_the_scene() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = vec![streets(folder.path()).remove(0)];
    let one = serve(&options(scenes.clone())).await;
    let truth = four(&mut client(&one).await, "north").await;
    one.stop().await.unwrap();
    assert!(truth.iter().skip(1).all(|image| *image != truth[0]));
    // Without copies the second device draws nothing of it.
    for (copies, of_each) in [(1, [4, 0]), (2, [2, 2])] {
        let mut options = on_two(scenes.clone(), &[]);
        (options.limits.copies, options.preload) = (copies, true);
        let two = serve(&options).await;
        let mut client = client(&two).await;
        until_on(&mut client, copies.into()).await;
        assert!(four(&mut client, "north").await == truth, "{copies}");
        assert_eq!(two.images_by_device(), of_each);
        two.stop().await.unwrap();
    }
    // A device that is lost leaves its part to the other.
    let mut options = on_two(scenes, &["1:lost:60"]);
    options.limits.copies = 2;
    let two = serve(&options).await;
    let mut client = client(&two).await;
    for _ in 0..30 {
        assert!(four(&mut client, "north").await == truth);
    }
    two.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_that_loses_two_devices_does_not_lose_the_third() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = streets(folder.path());
    let mut options = on_two(scenes, &["0:lost:0", "1:lost:0"]);
    let Some(DeviceSet::Each(devices)) = &mut options.devices.devices else {
        unreachable!("two devices were named")
    };
    devices.push(devices[0].clone());
    let running = serve(&options).await;
    let mut client = client(&running).await;
    let asked = at(&mut client, "north", 0.0).await;
    let status = client.render_rgb(asked.clone()).await.unwrap_err();
    assert_eq!(status.code(), Code::Unavailable, "{status}");
    client.render_rgb(asked).await.unwrap();
    assert_eq!(running.images_by_device(), [0, 0, 1]);
    running.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_ends_when_no_device_is_left() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = streets(folder.path());
    let running = serve(&on_two(scenes, &["0:lost:0", "1:lost:0"])).await;
    let mut client = client(&running).await;
    let asked = at(&mut client, "north", 0.0).await;
    let status = client.render_rgb(asked).await.unwrap_err();
    assert_eq!(status.code(), Code::Unavailable, "{status}");
    let end = running.until(std::future::pending()).await.unwrap_err();
    assert!(
        format!("{end:#}").contains("nothing can be drawn"),
        "{end:#}"
    );
}
