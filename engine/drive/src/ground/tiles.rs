//! Nodes in tiles, found when first asked for.

use std::collections::HashMap;
use std::sync::OnceLock;

use glam::DVec2;

use super::layers::Layer;
use super::surfel::SurfelGrid;

/// Distance between nodes, meters. A surface is a plane between four of them, so less than what
/// bends on a road.
const NODE_M: f64 = 0.25;
/// Squares of nodes along a side of a tile; one more node than that, so that a query needs one tile
/// only.
const TILE_NODES: i32 = 16;
const TILE_M: f64 = NODE_M * TILE_NODES as f64;

/// The tiles that hold any surface.
pub struct Tiles {
    tiles: HashMap<[i32; 2], OnceLock<Tile>>,
}

/// Surfaces over the nodes of a square.
struct Tile {
    /// First surface of each node, and one past the last.
    starts: Vec<u32>,
    layers: Vec<Layer>,
}

/// A node beside a query.
pub struct Corner<'a> {
    /// Surfaces over it, rising.
    pub layers: &'a [Layer],
    /// Offset from the node to the query, meters.
    pub offset: DVec2,
    /// Bilinear weight; the four add up to one.
    pub weight: f64,
}

impl Tiles {
    /// Grid of tiles under `surfels`, none computed yet.
    pub fn under(surfels: &SurfelGrid) -> Self {
        let mut tiles = HashMap::new();
        for (low, size) in surfels.reached() {
            let ([x0, y0], [x1, y1]) = (tile_of(low), tile_of(low + size));
            for x in x0..=x1 {
                for y in y0..=y1 {
                    tiles.entry([x, y]).or_insert_with(OnceLock::new);
                }
            }
        }
        Self { tiles }
    }

    /// The four nodes around `at`, the surfaces over a node being found by `find`; `None` where no
    /// splat is near.
    pub fn around(&self, at: DVec2, find: impl Fn(DVec2) -> Vec<Layer>) -> Option<[Corner<'_>; 4]> {
        let key = tile_of(at);
        let corner_m = DVec2::new(f64::from(key[0]), f64::from(key[1])) * TILE_M;
        let tile = self
            .tiles
            .get(&key)?
            .get_or_init(|| Tile::new(corner_m, find));
        let within = (at - corner_m) / NODE_M;
        let last = f64::from(TILE_NODES - 1);
        let cell = within.floor().clamp(DVec2::ZERO, DVec2::splat(last));
        let share = within - cell;
        Some(
            [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]].map(|step| {
                let step = DVec2::from_array(step);
                let node = cell + step;
                let index = (node.y as usize) * (TILE_NODES as usize + 1) + node.x as usize;
                let layers =
                    &tile.layers[tile.starts[index] as usize..tile.starts[index + 1] as usize];
                let along = |step: f64, share: f64| if step > 0.0 { share } else { 1.0 - share };
                Corner {
                    layers,
                    offset: (share - step) * NODE_M,
                    weight: along(step.x, share.x) * along(step.y, share.y),
                }
            }),
        )
    }
}

impl Tile {
    fn new(corner_m: DVec2, find: impl Fn(DVec2) -> Vec<Layer>) -> Self {
        let (mut starts, mut layers) = (vec![0], Vec::new());
        for y in 0..=TILE_NODES {
            for x in 0..=TILE_NODES {
                layers.extend(find(
                    corner_m + DVec2::new(f64::from(x), f64::from(y)) * NODE_M,
                ));
                starts.push(layers.len() as u32);
            }
        }
        Self { starts, layers }
    }
}

/// The tile that holds `at`; there is none at the ends of the plane.
fn tile_of(at: DVec2) -> [i32; 2] {
    crate::cells::cell_of(at, TILE_M).to_array()
}
