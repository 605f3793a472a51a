//! Draws the rig of a scene by one device, and by several at once: the time of a step, and whether
//! the bytes are the same.
//!
//! `cargo run --release --example rig_devices -- street/scene.toml 0,1 200 pandar128 hdl32e`

use std::error::Error;
use std::path::Path;
use std::time::Instant;

use decouplegs::episode::chosen_lidars;
use decouplegs::gpu::{DeviceOptions, DeviceSet, Gpu};
use decouplegs::render::layout::BeamState;
use decouplegs::scene::lidar::ReturnMode;
use decouplegs::scene::{Rig, Trajectory};
use decouplegs::session::{RigRenderer, RigSweep, Session, SessionOptions, World};

/// Steps that are not timed: kernels are built and buffers grow.
const WARM_UP: u32 = 20;
/// Time between steps, seconds.
const STEP_S: f64 = 0.1;

/// Images of a step, and the states of the beams of its sweeps.
type Drawn = (Vec<Vec<u8>>, Vec<Vec<BeamState>>);

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [path, devices, steps, lidars @ ..] = arguments.as_slice() else {
        return Err("usage: rig_devices SCENE.toml all|DEVICE,... STEPS [LIDAR...]".into());
    };
    let (path, steps) = (Path::new(path), steps.parse()?);
    let gpus = Gpu::open_all(&devices.parse::<DeviceSet>()?, |_| DeviceOptions::default())?;
    // Light where the scene says: what a device has drawn before changes nothing.
    let options = SessionOptions {
        bakes_light_on_demand: false,
        ..SessionOptions::default()
    };
    let mut truth = None;
    for count in 1..=gpus.len() {
        let on = |gpu: &Gpu| Session::on(gpu, &options);
        let sessions: Vec<Session> = gpus[..count].iter().map(on).collect();
        let mut renderer = RigRenderer::open(&sessions, path)?;
        let scene = renderer.scene().clone();
        let mut rig = scene.rig().clone();
        let lidars = chosen_lidars(&rig, false, lidars)?;
        rig.sensors
            .extend(lidars.into_iter().map(decouplegs::scene::Sensor::Lidar));
        let (times_ms, last) = steps_of(&mut renderer, &rig, scene.ego(), steps)?;
        let at = |share: f64| times_ms[((times_ms.len() - 1) as f64 * share).round() as usize];
        println!(
            "{count} devices: p50 {:.2} ms, p99 {:.2} ms a step of {} cameras and {} sweeps; cameras on devices {:?}",
            at(0.5),
            at(0.99),
            rig.cameras().count(),
            rig.lidars().count(),
            renderer.devices_of_cameras().collect::<Vec<_>>()
        );
        match &truth {
            None => truth = Some(last),
            Some(truth) if *truth == last => println!("  the same bytes as by one"),
            Some(_) => return Err("the bytes are not those of one device".into()),
        }
    }
    Ok(())
}

/// Times of all steps but the first, sorted, milliseconds; and what the last one drew: images, and
/// states of beams.
fn steps_of(
    renderer: &mut RigRenderer,
    rig: &Rig,
    ego: &Trajectory,
    steps: u32,
) -> Result<(Vec<f64>, Drawn), Box<dyn Error>> {
    let scene = renderer.scene().clone();
    let (mut world, mut times_ms) = (World::new(&scene), Vec::new());
    let mut last = (Vec::new(), Vec::new());
    for step in 0..WARM_UP + steps {
        let time_s = STEP_S * f64::from(step);
        world.set_time(time_s);
        let (pose, motion) = (ego.at(time_s), ego.motion_at(time_s));
        let cameras = rig.moving_at(&pose, &motion);
        let sweep = |lidar: decouplegs::scene::Lidar| RigSweep {
            world_s: lidar.model.sweep_s,
            mode: ReturnMode::Median,
            lidar,
        };
        let sweeps: Vec<RigSweep> = rig
            .sweeps_until(&pose, &motion)
            .into_iter()
            .map(sweep)
            .collect();
        let since = Instant::now();
        renderer.draw(&world, &cameras, &sweeps)?;
        if step >= WARM_UP {
            times_ms.push(1e3 * since.elapsed().as_secs_f64());
        }
        if step + 1 == WARM_UP + steps {
            let images = (0..cameras.len()).map(|camera| renderer.rgba(camera).to_vec());
            let states = (0..sweeps.len()).map(|sweep| {
                let states = renderer.sweep(sweep).states.iter();
                states.copied().collect()
            });
            last = (images.collect(), states.collect());
        }
    }
    times_ms.sort_by(f64::total_cmp);
    if times_ms.is_empty() {
        return Err("give at least one step".into());
    }
    Ok((times_ms, last))
}
