//! Photometric calibrations of a scene's cameras in the images that are served.

use decouplegs::asset::SceneFile;
use decouplegs::scene::{Photometry, Pose};
use decouplegs_alpasim::wire::sensorsim::ImageFormat;
use glam::DVec3;

use crate::asking::{cameras, client, options, png, request, serve};
use crate::scenes::street;

#[tokio::test(flavor = "multi_thread")]
async fn images_have_the_calibration_of_the_camera_of_their_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = street(folder.path());
    let mut scene = SceneFile::read(&path).unwrap();
    let plain = serve(&options(vec![path.clone()])).await;
    let mut asked = client(&plain).await;
    let rig = cameras(&mut asked, "street").await;
    // Red by half, and some blue.
    let matrix = [
        [0.5, 0.0, 0.0, 0.0],
        [0.0, 1.0, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.1],
    ];
    let calibrated = scene
        .rig
        .cameras_mut()
        .find(|camera| camera.name == rig[0].logical_id);
    calibrated.unwrap().intrinsics.photometry = Photometry {
        matrix,
        ..Photometry::IDENTITY
    };
    let other = path.with_file_name("calibrated.toml");
    scene.write(&other).unwrap();
    let running = serve(&options(vec![other])).await;
    let mut client = client(&running).await;
    let level = Pose::from_yaw(0.0, DVec3::new(0.0, 0.0, 0.8));
    for (index, camera) in rig.iter().take(2).enumerate() {
        let mut drawn = Vec::new();
        for (client, scene) in [(&mut asked, "street"), (&mut client, "calibrated")] {
            let request = request(scene, camera, &level, ImageFormat::Png);
            let image = client.render_rgb(request).await.unwrap().into_inner();
            drawn.push(png(&image.image_bytes).1);
        }
        let channels = drawn[0].len() / (160 * 100);
        for (place, (before, after)) in drawn[0].iter().zip(&drawn[1]).enumerate() {
            let before = f64::from(*before) / 255.0;
            let expected = match (index, place % channels) {
                (0, 0) => 0.5 * before,
                (0, 2) => (before + 0.1).min(1.0),
                _ => before,
            };
            let off = (255.0 * expected - f64::from(*after)).abs();
            assert!(off <= 1.01, "camera {index}, {place}: {off}");
        }
    }
    running.stop().await.unwrap();
    plain.stop().await.unwrap();
}
