//! Draws the roads of a map as splats and writes them with a scene file whose camera stands on a
//! lane, fit for `decouplegs render`: `cargo run --release --example draw_roads
//! -- MAP SPLATS PROBE|none EV OUT LANE AT_M`.

use std::error::Error;
use std::path::Path;
use std::time::Instant;

use decouplegs::asset::{SceneFile, inria_ply, read_map, read_probe};
use decouplegs::scene::{Intrinsics, LaneKind, Pose, Rig, RigCamera, Trajectory};
use decouplegs::synth::roads::{self, RoadsOptions};
use glam::DVec3;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [map, splats, probe, exposure_ev, out, lane, at_m] = arguments.as_slice() else {
        return Err("expected MAP SPLATS PROBE|none EV OUT LANE AT_M".into());
    };
    let map = read_map(Path::new(map))?;
    let probe = (probe != "none")
        .then(|| read_probe(Path::new(probe)))
        .transpose()?;
    let options = RoadsOptions::new(splats.parse()?, probe, exposure_ev.parse()?);
    let start = Instant::now();
    let drawn = roads::generate(&map, &options);
    println!(
        "{} splats in {:.2} s",
        drawn.background.len(),
        start.elapsed().as_secs_f64()
    );
    let out = Path::new(out);
    std::fs::create_dir_all(out)?;
    inria_ply::write(&out.join("roads.ply"), &drawn.background)?;

    let driving: Vec<_> = map
        .lanes
        .iter()
        .filter(|lane| lane.kind == LaneKind::Driving)
        .collect();
    let lane = driving[lane.parse::<usize>()? % driving.len()];
    let (mut left_m, mut at) = (at_m.parse::<f64>()?, 0);
    while at + 2 < lane.centerline.len()
        && left_m > lane.centerline[at].distance(lane.centerline[at + 1])
    {
        left_m -= lane.centerline[at].distance(lane.centerline[at + 1]);
        at += 1;
    }
    let ahead = lane.centerline[at + 1] - lane.centerline[at];
    let stands = lane.centerline[at] + ahead.normalize() * left_m + DVec3::Z * 0.75;
    println!(
        "{} driving lanes; on lane {} of {} points",
        driving.len(),
        lane.id,
        lane.centerline.len()
    );
    let camera = |name: &str, eye: DVec3, look: DVec3| RigCamera {
        name: name.into(),
        intrinsics: Intrinsics::centered([960, 540], 760.0),
        rig_from_camera: Pose {
            translation: eye,
            ..Pose::look_at(DVec3::ZERO, look, DVec3::Z).expect("no vertical look")
        },
    };
    let rig = Rig::from_iter([
        camera(
            "front",
            DVec3::new(1.5, 0.0, 0.8),
            DVec3::new(1.0, 0.0, -0.04),
        ),
        camera(
            "above",
            DVec3::new(-30.0, 0.0, 40.0),
            DVec3::new(1.0, 0.0, -0.9),
        ),
    ]);
    let ego = Some(Trajectory::standing(Pose::from_yaw(
        ahead.y.atan2(ahead.x),
        stands,
    )));
    let scene = SceneFile {
        origin: drawn.origin,
        sky: drawn.sky,
        rig,
        ego,
        ..SceneFile::of_background("roads.ply")
    };
    scene.write(&out.join("scene.toml"))?;
    Ok(())
}
