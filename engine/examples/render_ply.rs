//! One splat file, one image: opens the splats, puts a camera where it sees them all, and writes a
//! PNG.
//!
//! `cargo run --example render_ply -- garden.ply garden.png`

use std::error::Error;
use std::path::{Path, PathBuf};

use decouplegs::{HostImages, Session, SessionOptions, World, WorldView};

/// Draws the splat file `splats` to the PNG file `out`.
pub fn draw(splats: &Path, out: &Path) -> Result<(), Box<dyn Error>> {
    let session = Session::open(&SessionOptions::default())?;
    let scene = session.open_scene(splats)?;
    let camera = scene.frame([1280, 720], None, None).ok_or_else(|| {
        format!(
            "{}: expected splats that can be seen, in a file without cameras; the example rig draws scenes",
            splats.display()
        )
    })?;
    let (world, mut images) = (World::new(&scene), HostImages::default());
    let view = WorldView {
        world: &world,
        cameras: &[camera],
    };
    session.batch_renderer().draw(&[view], &mut images)?;
    images.save_png(0, 0, out)?;
    println!("{}: 1280x720 pixels", out.display());
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let (Some(splats), Some(out)) = (arguments.next(), arguments.next()) else {
        return Err(
            "usage: render_ply SPLATS IMAGE.png: a splat file, and the image to write".into(),
        );
    };
    draw(&splats, &out)
}
