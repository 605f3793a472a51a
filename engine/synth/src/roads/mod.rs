//! Places that are only a map, as splats: asphalt with its markings, the land about it with houses,
//! and the sky of a light probe.
//!
//! Everything is laid out relative to the middle of the map, and in the light of the probe: a face
//! that looks up shows its albedo times what the probe brings to it. The same map and options give
//! the same bits.

mod canvas;
mod dome;
mod houses;
mod illumination;
mod land;
mod objects;
mod paint;
mod pavement;
mod relief;
mod strip_index;
mod strips;
#[cfg(test)]
mod tests;

use decouplegs_scene::{LaneMap, Obstacle, SplatCloud, sh};
use glam::{DVec3, Vec3};

use canvas::Canvas;
use decouplegs_scene::light::Probe;
use illumination::Illumination;
use relief::Relief;
use strip_index::StripIndex;
use strips::{Strip, strips};

/// Options of the synthesis of a map's roads.
#[derive(Clone, Debug)]
pub struct RoadsOptions {
    /// Splats, all in all. A kilometer of road with two lanes looks sharp from about 100,000 on.
    pub splats: usize,
    /// The light, lat-long. None: an overcast sky.
    pub probe: Option<Probe>,
    /// Stops by which the probe's light is made brighter, below zero darker.
    pub exposure_ev: f64,
    /// Degree of the spherical harmonics; values above 3 count as 3. Roads mirror the sky in bands
    /// 1 and 2.
    pub sh_degree: u8,
    /// Houses and the wear of surfaces follow from it.
    pub seed: u64,
    /// Points of the way that cameras take, world coordinates in meters: splats are the smaller the
    /// nearer to it. Empty: roads are alike everywhere.
    pub way_m: Vec<DVec3>,
    /// Obstacles that are drawn as boxes a meter high, world coordinates.
    pub objects: Vec<Obstacle>,
}

impl Default for RoadsOptions {
    /// 200,000 splats of degree 2 under an overcast sky, alike everywhere.
    fn default() -> Self {
        Self {
            splats: 200_000,
            probe: None,
            exposure_ev: 0.0,
            sh_degree: 2,
            seed: 1,
            way_m: Vec::new(),
            objects: Vec::new(),
        }
    }
}

impl RoadsOptions {
    /// `splats` in the light of `probe`, the rest by default.
    #[must_use]
    pub fn new(splats: usize, probe: Option<Probe>, exposure_ev: f64) -> Self {
        Self {
            splats,
            probe,
            exposure_ev,
            ..Self::default()
        }
    }
}

/// The roads of a map as a background.
#[derive(Clone, Debug)]
pub struct RoadsScene {
    /// Exactly as many splats as asked for, relative to [`RoadsScene::origin`].
    pub background: SplatCloud,
    /// World coordinates of the point that splats are relative to: the middle of the map's lanes.
    pub origin: DVec3,
    /// Seen where splats let light through: the sky above the horizon, display-referred RGB.
    pub sky: [f32; 3],
    /// Boxes of the houses, world coordinates, those of [`obstacles`], then the objects that were
    /// asked for.
    pub obstacles: Vec<Obstacle>,
}

/// Least share of the splats that the sky has.
const DOME_SHARE: f64 = 0.08;

/// Largest spacing of splats on roads that is tried, meters. What does not fit at this spacing is
/// left out.
const SPACING_M_MAX: f32 = 12.0;

/// Number of spacings that are tried, and the share of the requested count that is enough. The sky
/// takes what is left.
const TRIES: usize = 8;
const FITTED: f32 = 0.93;

/// The roads of `map`. Lanes farther than 50 km from the first are left out.
#[must_use]
pub fn generate(map: &LaneMap, options: &RoadsOptions) -> RoadsScene {
    let (strips, origin) = strips(map);
    let way: Vec<Vec3> = options
        .way_m
        .iter()
        .map(|point| (*point - origin).as_vec3())
        .collect();
    let place = Drawn::new(strips, origin, way, options);
    let target = (options.splats as f64 * (1.0 - DOME_SHARE)) as usize;
    let mut canvas = place.fitted(target);
    let dome_splats = options.splats - canvas.len();
    dome::dome(
        &mut canvas,
        dome_splats,
        place.relief.radius_m() + dome::BEYOND_M,
        &place.light,
        place.relief.mean_z_m(),
    );
    let sh_degree = options.sh_degree.min(sh::DEGREE_MAX);
    RoadsScene {
        background: canvas.into_cloud(sh_degree, &place.light),
        origin,
        sky: place.light.horizon(),
        obstacles: boxes(&place.houses, origin)
            .into_iter()
            .chain(options.objects.iter().copied())
            .collect(),
    }
}

/// Boxes of the houses that [`generate`] draws beside the roads of `map` with `seed`, for sites
/// that are not drawn.
#[must_use]
pub fn obstacles(map: &LaneMap, seed: u64) -> Vec<Obstacle> {
    let (strips, origin) = strips(map);
    let index = StripIndex::new(strips);
    let relief = Relief::new(&index);
    boxes(&houses::houses(&index, &relief, seed), origin)
}

fn boxes(houses: &[houses::House], origin: DVec3) -> Vec<Obstacle> {
    houses.iter().map(|house| house.obstacle(origin)).collect()
}

/// Elements that are the same for every spacing.
struct Drawn {
    index: StripIndex,
    relief: Relief,
    light: Illumination,
    way: Vec<Vec3>,
    houses: Vec<houses::House>,
    objects: Vec<objects::Object>,
    seed: u64,
}

impl Drawn {
    fn new(strips: Vec<Strip>, origin: DVec3, way: Vec<Vec3>, options: &RoadsOptions) -> Self {
        let index = StripIndex::new(strips);
        let relief = Relief::new(&index);
        let houses = houses::houses(&index, &relief, options.seed);
        let objects = objects::objects(&options.objects, origin, &relief);
        let light = Illumination::new(options.probe.as_ref(), options.exposure_ev);
        // Noise adds to its seed, which must leave room.
        let seed = (options.seed ^ (options.seed >> 32)) & 0xffff_ffff;
        Self {
            index,
            relief,
            light,
            way,
            houses,
            objects,
            seed,
        }
    }

    /// Everything except the sky, at the spacing whose count is closest below `target` splats, and
    /// never above.
    fn fitted(&self, target: usize) -> Canvas {
        // Coarse first: the count there is soon known, and tells where to go.
        let mut spacing_m = 2.0;
        let mut best = Canvas::new(0);
        for _ in 0..TRIES {
            // Twice the target tells how far off the spacing is; more is never kept.
            let canvas = self.at_spacing(spacing_m, target.saturating_mul(2));
            let share = canvas.len() as f32 / target.max(1) as f32;
            if canvas.len() <= target && canvas.len() > best.len() {
                best = canvas;
                if share > FITTED {
                    break;
                }
            }
            if share > 1.0 && spacing_m >= SPACING_M_MAX {
                break;
            }
            // Counts fall with the square of the spacing, but where one splat a cell is the least
            // there is.
            spacing_m =
                (spacing_m * (share * 1.03).sqrt().clamp(0.1, 2.0)).clamp(0.01, SPACING_M_MAX);
        }
        if best.len() == 0 {
            self.at_spacing(SPACING_M_MAX, target)
        } else {
            best
        }
    }

    /// Everything except the sky, at most `splats_max`.
    fn at_spacing(&self, spacing_m: f32, splats_max: usize) -> Canvas {
        let mut canvas = Canvas::new(splats_max);
        pavement::pavement(&mut canvas, self, spacing_m);
        land::land(&mut canvas, self, spacing_m);
        houses::walls(&mut canvas, self, spacing_m);
        objects::draw(&mut canvas, self);
        canvas
    }

    /// Factor on spacings at a place: 1 where cameras pass, and everywhere without a way.
    fn coarseness(&self, position: Vec3) -> f32 {
        /// Distance from the way at which spacings have doubled, meters.
        const DOUBLED_AT_M: f32 = 14.0;
        let to_leg_m = |leg: &[Vec3]| {
            let (along, offset) = ((leg[1] - leg[0]).truncate(), (position - leg[0]).truncate());
            let share = (offset.dot(along) / along.length_squared().max(1e-6)).clamp(0.0, 1.0);
            (offset - along * share).length()
        };
        let nearest_m = match self.way.as_slice() {
            [] => 0.0,
            [only] => only.truncate().distance(position.truncate()),
            way => way.windows(2).map(to_leg_m).fold(f32::MAX, f32::min),
        };
        1.0 + nearest_m / DOUBLED_AT_M
    }
}
