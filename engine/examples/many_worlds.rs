//! Many worlds over one background: each has agents of its own, all are drawn in one call, and images per second are counted.
//!
//! `cargo run --release --example many_worlds -- street/scene.toml [WORLDS] [WIDTHxHEIGHT] [SECONDS]`

use std::error::Error;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use decouplegs::scene::Camera;
use decouplegs::session::{HostPictures, Session, SessionOptions, SessionScene, World, WorldView};

/// The first camera of the rig at `size_px`, where the ego of world `world` is at `time_s`: each drives somewhere else.
fn camera(scene: &SessionScene, size_px: [u32; 2], world: usize, time_s: f64) -> Result<Vec<Camera>, Box<dyn Error>> {
    let mut rig = scene.rig().clone();
    rig.cameras.truncate(1);
    let front = rig.cameras.first_mut().ok_or("the scene has no rig: add a [[rig]] to the scene file")?;
    front.intrinsics = front.intrinsics.resized(size_px[0], size_px[1]);
    Ok(rig.at(&scene.ego().at(time_s + 0.37 * world as f64)))
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let path = PathBuf::from(arguments.first().ok_or("usage: many_worlds SCENE.toml [WORLDS] [WIDTHxHEIGHT] [SECONDS]")?);
    let worlds: usize = arguments.get(1).map_or(Ok(64), |text| text.parse())?;
    let (width, height) = arguments.get(2).map_or("512x320", String::as_str).split_once('x').ok_or("a size is WIDTHxHEIGHT")?;
    let size_px = [width.parse()?, height.parse()?];
    let length = Duration::from_secs_f64(arguments.get(3).map_or(Ok(10.0), |text| text.parse())?);

    let session = Session::open(&SessionOptions::default())?;
    let scene = session.open_scene(&path)?;
    println!("{}: {} splats of background, once", session.gpu().info(), scene.background_splats());
    let mut worlds = vec![World::new(&scene); worlds];
    for to_host in [false, true] {
        let (mut viewer, mut pictures) = (session.viewer(), HostPictures::default());
        let (mut times_ms, mut gpu_ms) = (Vec::new(), Vec::new());
        let start = Instant::now();
        for step in 0.. {
            let time_s = 0.1 * f64::from(step);
            let cameras = (0..worlds.len()).map(|world| camera(&scene, size_px, world, time_s)).collect::<Result<Vec<_>, _>>()?;
            for (index, world) in worlds.iter_mut().enumerate() {
                world.set_time(time_s + 0.61 * index as f64);
            }
            let views: Vec<WorldView<'_>> =
                worlds.iter().zip(&cameras).map(|(world, cameras)| WorldView { world, cameras }).collect();
            let since = Instant::now();
            let frames = if to_host { viewer.draw(&views, &mut pictures)? } else { viewer.draw_on_device(&views)?.1 };
            times_ms.push(1e3 * since.elapsed().as_secs_f64());
            gpu_ms.push(frames.iter().map(|frame| 1e3 * frame.gpu_time.as_secs_f64()).sum::<f64>());
            if start.elapsed() > length {
                break;
            }
        }
        // The first calls build kernels and find out how large buffers have to be.
        let settled = times_ms.len().min(20);
        let [mut wall, mut gpu] =
            [times_ms.split_off(settled.min(times_ms.len() - 1)), gpu_ms.split_off(settled.min(gpu_ms.len() - 1))];
        wall.sort_by(f64::total_cmp);
        gpu.sort_by(f64::total_cmp);
        let at = |sorted: &[f64], share: f64| sorted[((sorted.len() - 1) as f64 * share) as usize];
        println!(
            "{} worlds, {width}x{height}, pictures {}: median {:.2} ms, p99 {:.2} ms ({:.2} ms on the device), {:.0} images/s over {} calls",
            worlds.len(),
            if to_host { "on the host" } else { "on the device" },
            at(&wall, 0.5),
            at(&wall, 0.99),
            at(&gpu, 0.5),
            1e3 * worlds.len() as f64 * wall.len() as f64 / wall.iter().sum::<f64>(),
            wall.len(),
        );
    }
    for (purpose, bytes) in session.gpu().memory().bytes_by_purpose {
        println!("{purpose}: {:.1} MB", bytes as f64 / 1e6);
    }
    Ok(())
}
