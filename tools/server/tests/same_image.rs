//! An image from the server is the image of a session in this process, byte for byte.

use decouplegs::open_movable_scene;
use decouplegs::scene::{Camera, Motion, Pose};
use decouplegs::session::{HostImages, Session, SessionOptions, World, WorldView};
use decouplegs_alpasim::wire::sensorsim::ImageFormat;
use glam::DVec3;

use crate::asking::{cameras, client, object, options, png, pose, request, serve};
use crate::scenes::street;

#[tokio::test(flavor = "multi_thread")]
async fn the_server_and_a_session_render_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let path = street(folder.path());
    let session = Session::open(&SessionOptions::default()).expect("a device");
    let scene = session
        .add_scene(&open_movable_scene(&path).unwrap().0)
        .unwrap();
    let mut world = World::new(&scene);
    let name = world.agents()[0].name.clone();
    let ahead = Pose::from_yaw(0.25, DVec3::new(14.0, 1.5, 0.75));
    world
        .set_agents([(name.clone(), world.agents()[0].placed)])
        .unwrap();
    world.move_to(&name, ahead).unwrap();

    let running = serve(&options(vec![path])).await;
    let mut client = client(&running).await;
    let rig = cameras(&mut client, "street").await;
    let mut images = Vec::new();
    for (camera, own) in rig.iter().zip(scene.rig().cameras()).take(2) {
        let mut asked = request("street", camera, &Pose::IDENTITY, ImageFormat::Png);
        asked.resolution_h = 90;
        asked.dynamic_objects = vec![object(&name, &ahead, &ahead)];
        let served = client.render_rgb(asked.clone()).await.unwrap().into_inner();

        let sent = asked.sensor_pose.unwrap();
        let start = pose(&sent.start_pose.unwrap());
        let drawn_from = Camera {
            name: own.name.clone(),
            intrinsics: own.intrinsics,
            world_from_camera: start.interpolate(&pose(&sent.end_pose.unwrap()), 0.5),
            motion: Motion::REST,
        };
        let view = WorldView {
            world: &world,
            cameras: &[drawn_from],
        };
        let mut drawn = HostImages::default();
        session
            .batch_renderer()
            .draw(&[view], &mut drawn)
            .expect("a small scene fits");
        let rgb: Vec<u8> = drawn
            .rgba(0, 0)
            .chunks_exact(4)
            .flat_map(|pixel| [pixel[0], pixel[1], pixel[2]])
            .collect();
        let (size_px, bytes) = png(&served.image_bytes);
        assert_eq!(size_px, drawn.size_px(0, 0));
        assert!(bytes == rgb, "camera {}", own.name);
        images.push(bytes);
    }
    assert!(images[0] != images[1], "two cameras see different images");
    running.stop().await.unwrap();
}
