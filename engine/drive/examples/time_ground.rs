//! Prints how many heights a second the ground answers: `cargo run --release -p decouplegs-drive
//! --example time_ground`.
#![forbid(unsafe_code)]

#[path = "../tests/drive/roads.rs"]
mod roads;

use std::time::Instant;

use decouplegs_drive::{Ground, GroundOptions};
use glam::{DVec2, DVec3};
use roads::{ROAD, RoadOptions, cluttered, positions};

fn main() {
    let options = RoadOptions {
        length_m: 400.0,
        width_m: 20.0,
        ..ROAD
    };
    let height = |at: DVec2| 0.06 * at.x + 0.03 * at.y;
    let cloud = cluttered(&options, &height, 1);
    let started = Instant::now();
    let ground = Ground::new(&cloud, DVec3::ZERO, &GroundOptions::default());
    println!(
        "{} splats over {} m x {} m, index in {:.0?}",
        cloud.len(),
        options.length_m,
        options.width_m,
        started.elapsed()
    );
    let queries: Vec<_> = positions(&options, 1_000_000, 2)
        .into_iter()
        .map(|at| (at, Some(height(at))))
        .collect();
    for (what, threads) in [
        ("every tile found first", 2),
        ("two threads", 2),
        ("one thread", 1),
    ] {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads can be started");
        let started = Instant::now();
        let heights = pool.install(|| ground.heights_at(&queries));
        let seconds = started.elapsed().as_secs_f64();
        let mut errors: Vec<f64> = heights
            .iter()
            .zip(&queries)
            .filter_map(|(h, q)| Some((h.as_ref()?.z_m - height(q.0)).abs()))
            .collect();
        errors.sort_by(f64::total_cmp);
        let p95 = errors[errors.len() * 95 / 100];
        let rate = queries.len() as f64 / seconds / 1e6;
        println!(
            "{what}: {rate:.2} M queries/s; {} answered, p95 {:.1} mm",
            errors.len(),
            1e3 * p95
        );
    }
}
