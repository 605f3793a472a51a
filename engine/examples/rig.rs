//! Opens a scene, drives its agents along for a second, and writes what the rig saw last.
//!
//! `cargo run --example rig -- street/scene.toml out`

use std::error::Error;
use std::path::PathBuf;

use decouplegs::session::{HostImages, Session, SessionOptions, World, WorldView};

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let (Some(path), Some(out)) = (arguments.next(), arguments.next()) else {
        return Err(
            "usage: rig SCENE.toml OUT: a scene file with a rig, and a folder for the images"
                .into(),
        );
    };
    let session = Session::open(&SessionOptions::default())?;
    let scene = session.open_scene(&path)?;
    println!(
        "{}: {} splats, {} agents",
        session.gpu().info(),
        scene.background_splats(),
        scene.agents().len()
    );

    let (mut renderer, mut world, mut images) = (
        session.batch_renderer(),
        World::new(&scene),
        HostImages::default(),
    );
    let mut cameras = Vec::new();
    for step in 0..10 {
        let time_s = 0.1 * f64::from(step);
        world.set_time(time_s);
        cameras = scene.rig().driving(scene.ego(), time_s);
        let frames = renderer.draw(
            &[WorldView {
                world: &world,
                cameras: &cameras,
            }],
            &mut images,
        )?;
        let [gpu, wall] =
            [frames[0].gpu_time, frames[0].wall_time].map(|time| 1e3 * time.as_secs_f64());
        println!(
            "{time_s:.1} s: {} agents in view, {gpu:.2} ms on the device, {wall:.2} ms in all",
            frames[0].agents
        );
    }

    std::fs::create_dir_all(&out)?;
    for (index, camera) in cameras.iter().enumerate() {
        let [width, height] = images.size_px(0, index);
        let path = out.join(format!("{}.png", camera.name));
        let image = image::RgbaImage::from_raw(width, height, images.rgba(0, index).to_vec())
            .ok_or("an image is too short")?;
        image.save(&path)?;
        println!("{}", path.display());
    }
    for (purpose, bytes) in session.gpu().memory().bytes_by_purpose {
        println!("{purpose}: {:.1} MB", bytes as f64 / 1e6);
    }
    Ok(())
}
