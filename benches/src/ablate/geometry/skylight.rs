//! Light from an environment at surface samples: the part that the body does not block, and the
//! reflection of the ground.

use std::f64::consts::PI;

use decouplegs::scene::light::Probe;
use glam::{DVec2, DVec3, IVec2};
use rayon::prelude::*;

use super::body::Body;

/// Columns of the environment: light comes from the middle of each pixel.
const COLUMNS: usize = 64;

/// Side of the cells whose ground is lit alike, meters.
const CELL_M: f64 = 0.5;

/// Cells along each side of the ground that a body can darken.
const CELLS: i32 = 16;

/// Linear RGB radiance per pixel of an environment of [`COLUMNS`] columns.
pub type Environment = Vec<[f64; 3]>;

/// Share of what a source sends: its index, and the cosine times the steradians over pi.
type Share = (u32, f64);

/// Sources that a point sees.
#[derive(Clone, Debug, Default)]
struct Seen {
    /// Pixels of the environment.
    sky: Vec<Share>,
    /// Cells of the ground; the last one is the open ground around them.
    ground: Vec<Share>,
}

/// A body on a matt ground: what each of its surfels, and each cell of the ground, sees.
pub struct BodyOnGround {
    surfels: Vec<Seen>,
    cells: Vec<Seen>,
}

/// Directions of the pixels of an environment, and their steradians.
pub fn directions() -> Vec<(DVec3, f64)> {
    let grid = Probe::from_fn("grid", COLUMNS, |_| [1.0; 3]);
    grid.rays()
        .map(|(direction, steradians, _)| (direction, steradians))
        .collect()
}

/// `probe` on [`COLUMNS`] columns, turned left by `quarters` of a turn.
pub fn environment(probe: &Probe, quarters: usize) -> Environment {
    let probe = probe.downsampled(COLUMNS);
    assert_eq!(probe.width(), COLUMNS, "{} is too narrow", probe.name);
    // Columns count to the right, azimuths to the left.
    let pixel = |position: usize| {
        let (row, column) = (position / COLUMNS, position % COLUMNS);
        let from = (column + quarters * COLUMNS / 4) % COLUMNS;
        probe.pixels()[row * COLUMNS + from].map(f64::from)
    };
    (0..probe.pixels().len()).map(pixel).collect()
}

fn add(sum: &mut [f64; 3], share: f64, light: [f64; 3]) {
    (0..3).for_each(|channel| sum[channel] += share * light[channel]);
}

impl Seen {
    fn sky(&self, environment: &Environment) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for &(pixel, share) in &self.sky {
            add(&mut sum, share, environment[pixel as usize]);
        }
        sum
    }
}

impl BodyOnGround {
    pub fn new(body: &Body) -> Self {
        let directions = directions();
        let seen_from = |position: DVec3, normal: DVec3| {
            let mut seen = Seen::default();
            for (pixel, &(direction, steradians)) in directions.iter().enumerate() {
                let share = normal.dot(direction) * steradians / PI;
                if share <= 0.0 || !body.solid.open(position, direction) {
                    continue;
                }
                if direction.z > 0.0 {
                    seen.sky.push((pixel as u32, share));
                } else {
                    let hit_m = position.z.max(0.0) / -direction.z;
                    let hit = position + hit_m * direction;
                    seen.ground.push((cell_at(hit.truncate()), share));
                }
            }
            seen
        };
        let surfels = body.surfels.par_iter();
        let cell = |index: i32| {
            let at = IVec2::new(index % CELLS, index / CELLS).as_dvec2() + 0.5 * DVec2::ONE;
            let at = CELL_M * (at - 0.5 * f64::from(CELLS));
            seen_from(at.extend(1e-3), DVec3::Z)
        };
        Self {
            surfels: surfels
                .map(|surfel| seen_from(surfel.position, surfel.normal))
                .collect(),
            cells: (0..CELLS * CELLS).into_par_iter().map(cell).collect(),
        }
    }

    /// E / pi on each surfel under `environment`, over a ground of the albedo `albedo`.
    pub fn lit(&self, environment: &Environment, albedo: f64) -> Vec<[f64; 3]> {
        let mut ground: Vec<[f64; 3]> = self
            .cells
            .iter()
            .map(|cell| cell.sky(environment).map(|light| albedo * light))
            .collect();
        ground.push(on_open_ground(environment).map(|light| albedo * light));
        let lit = |seen: &Seen| {
            let mut sum = seen.sky(environment);
            for &(cell, share) in &seen.ground {
                add(&mut sum, share, ground[cell as usize]);
            }
            sum
        };
        self.surfels.iter().map(lit).collect()
    }

    /// E / pi on each surfel under white light from everywhere, the ground included.
    pub fn in_white_light(&self) -> Vec<f64> {
        let shares = |shares: &[Share]| shares.iter().map(|(_, share)| share).sum::<f64>();
        self.surfels
            .iter()
            .map(|seen| shares(&seen.sky) + shares(&seen.ground))
            .collect()
    }
}

/// E / pi on ground that nothing darkens.
pub fn on_open_ground(environment: &Environment) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for (light, (direction, steradians)) in environment.iter().zip(directions()) {
        add(&mut sum, direction.z.max(0.0) * steradians / PI, *light);
    }
    sum
}

fn cell_at(at: DVec2) -> u32 {
    let cell = (at / CELL_M + 0.5 * f64::from(CELLS)).floor();
    let inside = |position: f64| (0.0..f64::from(CELLS)).contains(&position);
    if inside(cell.x) && inside(cell.y) {
        cell.y as u32 * CELLS as u32 + cell.x as u32
    } else {
        (CELLS * CELLS) as u32
    }
}
