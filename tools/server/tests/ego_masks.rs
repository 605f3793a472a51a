//! Ego masks: images that ask for one are covered by it, and others are what they were.

use decouplegs::scene::Pose;
use decouplegs_alpasim::wire::common::Empty;
use decouplegs_alpasim::wire::sensorsim::{EgoMaskId, ImageFormat};
use glam::DVec3;
use tonic::Code;

use crate::asking::{batch, cameras, client, options, png, request, serve};
use crate::scenes::street;

/// Color and alpha of the mask, right half only.
const HOOD: [u8; 4] = [40, 50, 60, 255];

#[tokio::test(flavor = "multi_thread")]
async fn images_that_ask_for_a_mask_are_covered_by_it() {
    let folder = tempfile::tempdir().unwrap();
    let masks = folder.path().join("masks/sedan");
    std::fs::create_dir_all(&masks).unwrap();
    let plain = serve(&options(vec![street(folder.path())])).await;
    let mut asked = client(&plain).await;
    let camera = cameras(&mut asked, "street").await.remove(0);
    // Larger than the image, which is 160 x 100.
    let file = std::fs::File::create(masks.join(format!("{}.png", camera.logical_id))).unwrap();
    let mut encoder = png::Encoder::new(file, 320, 200);
    encoder.set_color(png::ColorType::Rgba);
    let pixel = |pixel: usize| match pixel % 320 >= 160 {
        true => HOOD,
        false => [0; 4],
    };
    let rgba: Vec<[u8; 4]> = (0..320 * 200).map(pixel).collect();
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(rgba.as_flattened()).unwrap();
    writer.finish().unwrap();
    let mut own = options(vec![street(folder.path())]);
    own.egocar_hood_dir = Some(folder.path().join("masks"));
    let running = serve(&own).await;
    let mut client = client(&running).await;
    let listed = client.get_available_ego_masks(Empty {}).await.unwrap();
    let mut listed = listed.into_inner().ego_mask_metadata;
    let id = listed.remove(0).ego_mask_id.unwrap();
    assert_eq!(
        (
            id.rig_config_id.as_str(),
            &id.camera_logical_id,
            listed.len()
        ),
        ("sedan", &camera.logical_id, 0)
    );
    let level = Pose::from_yaw(0.0, DVec3::new(0.0, 0.0, 0.8));
    let bare = request("street", &camera, &level, ImageFormat::Png);
    let mut masked = bare.clone();
    (masked.insert_ego_mask, masked.ego_mask_id) = (true, Some(id));
    let image = |bytes: &[u8]| png(bytes).1;
    let expected = asked.render_rgb(bare.clone()).await.unwrap();
    let expected = image(&expected.into_inner().image_bytes);
    // One frame of both: each has its own mask.
    let pairs = [
        ("bare".to_owned(), bare),
        ("masked".to_owned(), masked.clone()),
    ];
    let both = client.batch_render_rgb(batch(pairs)).await.unwrap();
    let items = both.into_inner().items;
    let of = |index: usize| image(&items[index].result.as_ref().unwrap().image_bytes);
    assert_eq!(of(0), expected);
    let channels = expected.len() / (160 * 100);
    for (index, value) in of(1).iter().enumerate() {
        let (pixel, channel) = (index / channels, index % channels);
        match pixel % 160 >= 80 && channel < 3 {
            true => assert_eq!(*value, HOOD[channel], "{pixel}"),
            false => assert_eq!(*value, expected[index], "{pixel}"),
        }
    }
    for id in [None, Some(EgoMaskId::default())] {
        masked.ego_mask_id = id;
        let refused = client.render_rgb(masked.clone()).await.unwrap_err();
        assert_eq!(refused.code(), Code::InvalidArgument);
        assert!(refused.message().starts_with("ego_mask_id"), "{refused}");
    }
    running.stop().await.unwrap();
    plain.stop().await.unwrap();
}
