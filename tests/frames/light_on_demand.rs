//! Light that is baked wherever agents come, and images that do not depend on it.

use decouplegs::scene::Pose;
use decouplegs::session::{Session, SessionOptions, World, WorldView};
use glam::DVec3;

use super::editing::{Site, cameras, options};
use crate::device::Validated;

/// Light that is baked where an agent came before changes later images, unless it is not baked on
/// demand.
#[test]
fn without_light_on_demand_no_image_depends_on_those_before() {
    let gpu = Validated::open();
    let site = Site::new();
    let loaded = site.loaded();
    let views = cameras(&loaded);
    let ahead = loaded.ego.at(0.0).translation;
    let pose = |x_m: f64| Pose::from_yaw(0.3, ahead + DVec3::new(x_m, 1.5, 0.8));
    // Images at the last of `positions`, after those before.
    let drawn = |bakes_light_on_demand: bool, positions: &[f64]| {
        let options = SessionOptions {
            render: options(),
            bakes_light_on_demand,
            ..SessionOptions::default()
        };
        let session = Session::on(&gpu, &options);
        let scene = session.add_scene(&loaded).unwrap();
        let (mut renderer, mut world) = (session.batch_renderer(), World::new(&scene));
        let mut images = Vec::new();
        for x_m in positions {
            world.move_to("ahead", pose(*x_m)).unwrap();
            let view = WorldView {
                world: &world,
                cameras: &views,
            };
            images = renderer.draw_images(&[view]).unwrap().0;
        }
        images
    };
    let alone = drawn(false, &[9.0]);
    assert!(alone == drawn(false, &[9.4, 8.7, 9.0]), "exact light");
    assert!(
        alone != drawn(true, &[9.0]),
        "baked light is interpolated, which shows"
    );
}
