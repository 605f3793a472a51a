//! Ground heights under any point, from the background's splats.
//!
//! A height is the mean `sum(alpha z) / sum(alpha)` over the splats in a vertical column, made
//! robust in four ways.
//!
//! - A splat is not its mean. Its share of a column is its Gaussian integrated over the column, and
//!   its height there is that of the part inside: the mean of z given the position
//!   ([`surfel`](self)). A large flat splat counts where its center is not.
//! - A surface is thin, leaves and walls are thick: the share falls with the height that a splat
//!   spans at one position.
//! - Heights in a column gather around surfaces (a deck, the road below it, a canopy). Each is
//!   found as a mode of its own, so that nothing above or below is ever mixed into a mean.
//! - The mean is the middle of a plane fitted to the heights around it: a plain mean leans to the
//!   side on which more splats happen to lie, which on a slope is a bias.
//!
//! Surfaces are found at the nodes of a grid, a tile of nodes at a time and only when a tile is
//! first asked for; a query joins the planes of the four nodes around it.
//!
//! Splats of a capture may be too few and too scattered for all that. [`Ground::guided`] measures
//! it, and then takes heights from what is known better ([`guide`](GroundGuides)).

mod guide;
mod layers;
mod quality;
mod surfel;
mod tiles;
mod way;

use decouplegs_scene::SplatCloud;
use glam::{DVec2, DVec3};
use rayon::prelude::*;

use layers::Layer;
use surfel::SurfelGrid;
use tiles::Tiles;

use guide::Guide;
pub use guide::{GroundGuides, GroundSource, RecordedWay, Survey};
pub use quality::GroundQuality;

/// Options of the height search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundOptions {
    /// Standard deviation of a column's horizontal weight, meters. Wider columns average more noise
    /// away, and more of the road's shape: the crown of a road of 2 % is lost by 0.8 times 2 % of
    /// it.
    pub column_sigma_m: f64,
    /// Largest distance of a surface from the height that was expected, meters: less than half of
    /// what is between two decks.
    pub band_m: f64,
    /// A surface that covers less of its column, as a mean of alpha, is not one.
    pub support_min: f64,
    /// Support that the lowest surface needs where no height is expected: less is debris below the
    /// road.
    pub support_unasked: f64,
}

impl Default for GroundOptions {
    fn default() -> Self {
        Self {
            column_sigma_m: 0.15,
            band_m: 1.0,
            support_min: 0.05,
            support_unasked: 0.15,
        }
    }
}

/// A height of the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundHeight {
    /// World coordinates, meters.
    pub z_m: f64,
    /// Mean over the column of the alpha that covers it, layers of splats added up: about 1 and
    /// more where the surface is closed.
    pub support: f64,
    /// Standard deviation of the splats' heights about the surface, meters.
    pub spread_m: f64,
    /// Source of the height.
    pub source: GroundSource,
}

/// The ground of a background, to be asked for heights. Queries may come from many threads.
pub struct Ground {
    splats: SplatGround,
    guide: Option<Box<Guide>>,
}

/// Heights from splats alone.
struct SplatGround {
    origin: DVec3,
    options: GroundOptions,
    surfels: SurfelGrid,
    tiles: Tiles,
}

/// Weight of nearness to the expected height against cover: at a third of the band as much as half
/// the cover, so that the underside of a deck is not taken for the deck.
const NEARNESS: f64 = 3.0;
/// Cover of a closed surface; of two that are closed, neither is better for having more.
const CLOSED: f64 = 1.0;
/// Debris below a surface covers less than this share of it.
const DEBRIS_SHARE: f64 = 0.4;
/// Largest depth of debris below its surface, meters: less than there is between decks.
const DEBRIS_DEPTH_M: f64 = 1.5;
/// Neighboring nodes hold the same surface where their planes meet within this, meters: a kerb more
/// than that is another one.
const SAME_SURFACE_M: f64 = 0.25;

impl Ground {
    /// The ground of `cloud`, whose means are relative to `origin`. Splats that cannot be drawn are
    /// passed over; splats of moving objects should not be in it.
    #[must_use]
    pub fn new(cloud: &SplatCloud, origin: DVec3, options: &GroundOptions) -> Self {
        Self {
            splats: SplatGround::new(cloud, origin, options),
            guide: None,
        }
    }

    /// This ground of `cloud` with `guides`, by order of trust: a survey, and then splats, if they
    /// are a road where the guides lead; if not, the map, the recorded way, and splats last.
    /// Without a way and lanes the splats are not examined.
    #[must_use]
    pub fn guided(mut self, cloud: &SplatCloud, guides: GroundGuides<'_>) -> Self {
        self.guide = Guide::new(&self.splats, cloud, guides).map(Box::new);
        self
    }

    /// Options of the height search.
    #[must_use]
    pub fn options(&self) -> &GroundOptions {
        &self.splats.options
    }

    /// Figures of how well splats show the road where the guides lead. `None` without guides.
    #[must_use]
    pub fn quality(&self) -> Option<&GroundQuality> {
        self.guide.as_ref()?.quality()
    }

    /// The height at `xy_m`, world coordinates: of the best covered surface within the band around
    /// `expected_z_m`, or, where nothing is expected, of the lowest well-covered one. `None` where
    /// there is none.
    #[must_use]
    pub fn height_at(&self, xy_m: DVec2, expected_z_m: Option<f64>) -> Option<GroundHeight> {
        let Some(guide) = &self.guide else {
            return self.splats.height_at(xy_m, expected_z_m);
        };
        guide.height_at(&self.splats, xy_m, expected_z_m)
    }

    /// [`Ground::height_at`] for many positions, on all threads.
    #[must_use]
    pub fn heights_at(&self, queries: &[(DVec2, Option<f64>)]) -> Vec<Option<GroundHeight>> {
        queries
            .par_iter()
            .with_min_len(256)
            .map(|&(xy_m, expected_z_m)| self.height_at(xy_m, expected_z_m))
            .collect()
    }
}

impl SplatGround {
    fn new(cloud: &SplatCloud, origin: DVec3, options: &GroundOptions) -> Self {
        let surfels = SurfelGrid::new(cloud, options.column_sigma_m);
        let tiles = Tiles::under(&surfels);
        Self {
            origin,
            options: *options,
            surfels,
            tiles,
        }
    }

    /// [`Ground::height_at`] without guides.
    fn height_at(&self, xy_m: DVec2, expected_z_m: Option<f64>) -> Option<GroundHeight> {
        let local = xy_m - self.origin.truncate();
        let expected = expected_z_m.map(|z_m| z_m - self.origin.z);
        let corners = self.tiles.around(local, |node| {
            layers::at_node(&self.surfels, node, self.options.support_min)
        })?;
        let mut by_weight = [0, 1, 2, 3];
        by_weight.sort_by(|&a, &b| corners[b].weight.total_cmp(&corners[a].weight));
        let chosen = by_weight.iter().find_map(|&at| {
            let corner = &corners[at];
            Some(
                self.choose(corner.layers, corner.offset, expected)?
                    .height_at(corner.offset),
            )
        })?;
        let (mut weights, mut z, mut support, mut spread) = (0.0, 0.0, 0.0, 0.0);
        for corner in &corners {
            let distance = |layer: &&Layer| (layer.height_at(corner.offset) - chosen).abs();
            let nearest = corner
                .layers
                .iter()
                .min_by(|a, b| distance(a).total_cmp(&distance(b)));
            if let Some(layer) = nearest.filter(|layer| distance(layer) <= SAME_SURFACE_M) {
                weights += corner.weight;
                z += corner.weight * layer.height_at(corner.offset);
                support += corner.weight * f64::from(layer.support);
                spread += corner.weight * f64::from(layer.spread);
            }
        }
        let share = 1.0 / weights;
        let found = GroundHeight {
            z_m: z * share + self.origin.z,
            support: support * share,
            spread_m: spread * share,
            source: GroundSource::Splats,
        };
        found.z_m.is_finite().then_some(found)
    }

    fn choose<'a>(
        &self,
        layers: &'a [Layer],
        offset: DVec2,
        expected: Option<f64>,
    ) -> Option<&'a Layer> {
        let Some(expected) = expected else {
            return layers.iter().find(|layer| self.is_ground(layer, layers));
        };
        let score = |layer: &Layer| {
            let off = (layer.height_at(offset) - expected) / self.options.band_m;
            (off.abs() <= 1.0)
                .then(|| f64::from(layer.support).min(CLOSED) / (1.0 + (NEARNESS * off).powi(2)))
        };
        let scored = layers
            .iter()
            .filter_map(|layer| Some((score(layer)?, layer)));
        scored
            .max_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, layer)| layer)
    }

    /// True if `layer` covers its column well, and is not debris below another of `layers`.
    fn is_ground(&self, layer: &Layer, layers: &[Layer]) -> bool {
        let above =
            |other: &&Layer| other.z > layer.z && f64::from(other.z - layer.z) < DEBRIS_DEPTH_M;
        let strongest = layers
            .iter()
            .filter(above)
            .map(|other| f64::from(other.support))
            .fold(0.0, f64::max);
        let support = f64::from(layer.support);
        support >= self.options.support_unasked && support >= DEBRIS_SHARE * strongest
    }
}
