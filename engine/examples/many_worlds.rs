//! Many worlds over one background: each has agents of its own, all are drawn in one call, and
//! images per second are counted.
//!
//! `cargo run --release --example many_worlds -- street/scene.toml [WORLDS] [WIDTHxHEIGHT]
//! [SECONDS] [AGENTS] [PITCH] [BACKGROUND_PITCH]`
//!
//! Egos are spread over the way of the scene's ego. Each world has the first AGENTS agents of the
//! scene (default: all), where they are at another time in each. With PITCH, agents are drawn at a
//! level of detail whose splats are so many pixels apart at most (0: all of their splats), and with
//! BACKGROUND_PITCH the background. Images are counted twice: where each step waits for its images,
//! as a closed loop does, and where a step is submitted before the images of the one before are
//! finished, as two halves of the worlds can take turns.

use std::error::Error;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use decouplegs::scene::Camera;
use decouplegs::session::{HostImages, Scene, Session, SessionOptions, World, WorldView};

/// Workload of the benchmark: views and duration.
struct Course {
    worlds: usize,
    size_px: [u32; 2],
    length: Duration,
    agents: usize,
}

impl Course {
    /// Time of the ego of world `world` at step `step`: over its whole path, repeatedly.
    fn time_s(&self, scene: &Scene, world: usize, step: u32) -> f64 {
        let span_s = scene.ego().poses().last().map_or(0.0, |last| last.time_s);
        let time_s = 0.1 * f64::from(step) + span_s * world as f64 / self.worlds as f64;
        if span_s > 0.0 { time_s % span_s } else { 0.0 }
    }

    /// The rig's first camera on an ego.
    fn cameras(&self, scene: &Scene, time_s: f64) -> Result<Vec<Camera>, Box<dyn Error>> {
        let mut rig = scene.rig().clone();
        rig.sensors.truncate(1);
        let front = rig
            .cameras_mut()
            .next()
            .ok_or("the scene has no rig: add a [[rig]] to the scene file")?;
        front.intrinsics = front.intrinsics.resized(self.size_px[0], self.size_px[1]);
        Ok(rig.driving(scene.ego(), time_s))
    }

    fn run(
        &self,
        session: &Session,
        scene: &std::sync::Arc<Scene>,
        to_host: bool,
        is_ahead: bool,
    ) -> Result<(), Box<dyn Error>> {
        let mut worlds = vec![World::new(scene); self.worlds];
        for world in &mut worlds {
            for agent in scene.agents().iter().skip(self.agents) {
                world.remove(&agent.name)?;
            }
        }
        let (mut renderer, mut images) = (session.batch_renderer(), HostImages::default());
        let (mut times_ms, mut gpu_ms, mut seen) = (Vec::new(), Vec::new(), 0);
        let start = Instant::now();
        let mut since = start;
        for step in 0.. {
            let at = |world: usize| self.time_s(scene, world, step);
            let cameras = (0..self.worlds)
                .map(|world| self.cameras(scene, at(world)))
                .collect::<Result<Vec<_>, _>>()?;
            worlds
                .iter_mut()
                .enumerate()
                .for_each(|(index, world)| world.set_time(at(index)));
            let views: Vec<WorldView<'_>> = worlds
                .iter()
                .zip(&cameras)
                .map(|(world, cameras)| WorldView { world, cameras })
                .collect();
            // Who waits for images has moved the worlds before; who does not moves them meanwhile.
            if !is_ahead {
                since = Instant::now();
            }
            renderer.submit(&views)?;
            if is_ahead && step == 0 {
                continue;
            }
            let frames = if to_host {
                renderer.finish(&mut images)?
            } else {
                renderer.finish_on_device()?.1
            };
            times_ms.push(1e3 * since.elapsed().as_secs_f64());
            since = Instant::now();
            gpu_ms.push(
                frames
                    .iter()
                    .map(|frame| 1e3 * frame.gpu_time.as_secs_f64())
                    .sum::<f64>(),
            );
            seen += frames.iter().map(|frame| frame.agents).sum::<usize>();
            if start.elapsed() > self.length {
                break;
            }
        }
        let calls = times_ms.len();
        // The first calls build kernels and find out how large buffers have to be.
        let settled = 20.min(calls - 1);
        let [mut wall, mut gpu] = [times_ms.split_off(settled), gpu_ms.split_off(settled)];
        wall.sort_by(f64::total_cmp);
        gpu.sort_by(f64::total_cmp);
        let at = |sorted: &[f64], share: f64| sorted[((sorted.len() - 1) as f64 * share) as usize];
        println!(
            "{} worlds of {} agents ({:.1} in view a world), {}x{}, images on the {}, {}: median {:.2} ms, p99 {:.2} ms ({:.2} ms of it the \
             device's), {:.0} images/s over {} calls",
            self.worlds,
            self.agents.min(scene.agents().len()),
            seen as f64 / (calls * self.worlds) as f64,
            self.size_px[0],
            self.size_px[1],
            if to_host { "host" } else { "device" },
            if is_ahead {
                "a step ahead"
            } else {
                "each step waits"
            },
            at(&wall, 0.5),
            at(&wall, 0.99),
            at(&gpu, 0.5),
            1e3 * self.worlds as f64 * wall.len() as f64 / wall.iter().sum::<f64>(),
            wall.len(),
        );
        Ok(())
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let usage = "usage: many_worlds SCENE.toml [WORLDS] [WIDTHxHEIGHT] [SECONDS] [AGENTS] [PITCH] \
                 [BACKGROUND_PITCH]";
    let path = PathBuf::from(arguments.first().ok_or(usage)?);
    let (width, height) = arguments
        .get(2)
        .map_or("512x320", String::as_str)
        .split_once('x')
        .ok_or("a size is WIDTHxHEIGHT")?;
    let course = Course {
        worlds: arguments.get(1).map_or(Ok(64), |text| text.parse())?,
        size_px: [width.parse()?, height.parse()?],
        length: Duration::from_secs_f64(arguments.get(3).map_or(Ok(10.0), |text| text.parse())?),
        agents: arguments
            .get(4)
            .map_or(Ok(usize::MAX), |text| text.parse())?,
    };
    let mut options = SessionOptions::default();
    let pitch_px = |place: usize| arguments.get(place).map(|text| text.parse()).transpose();
    options.render.level_pitch_px = pitch_px(5)?.filter(|&pitch_px| pitch_px > 0.0);
    options.render.background_pitch_px = pitch_px(6)?;
    let session = Session::open(&options)?;
    let scene = session.open_scene(&path)?;
    println!(
        "{}: {} splats of background, once",
        session.gpu().info(),
        scene.background_splats()
    );
    for (to_host, is_ahead) in [(false, false), (true, false), (false, true), (true, true)] {
        course.run(&session, &scene, to_host, is_ahead)?;
    }
    for (purpose, bytes) in session.gpu().memory().bytes_by_purpose {
        println!("{purpose}: {:.1} MB", bytes as f64 / 1e6);
    }
    Ok(())
}
