//! Images of the ego's cameras.

use std::sync::Arc;

use decouplegs_scene::episode::{DrawnBy, ReadingRecord};
use decouplegs_scene::{Invalid, Rig, RigCamera};
use decouplegs_session::{BatchRenderer, HostImages, SessionError, SessionScene, World, WorldView};
use rayon::prelude::*;
use xxhash_rust::xxh3::xxh3_128;

use super::simulation::Simulation;
use crate::planner::{Cameras, Reading};

/// Renderer of what the ego's cameras see in an episode.
pub struct ObservationRenderer {
    renderer: BatchRenderer,
    world: World,
    rig: Rig,
    every: u32,
    images: HostImages,
}

/// Cameras of `rig` that `cameras` selects, at `size_px` if given.
///
/// # Errors
/// Returns an error if there is none to choose from.
pub fn chosen(rig: &Rig, cameras: Cameras, size_px: Option<[u32; 2]>) -> Result<Rig, Invalid> {
    let first = || {
        rig.cameras()
            .find(|camera| camera.name == "front")
            .or(rig.cameras().next())
    };
    let mut chosen: Vec<RigCamera> = match cameras {
        Cameras::None => Vec::new(),
        Cameras::Front => first().cloned().into_iter().collect(),
        Cameras::All => rig.cameras().cloned().collect(),
    };
    if cameras != Cameras::None && chosen.is_empty() {
        return Err("the planner wants images, and the scene has no cameras: add a [[rig]] to the scene file".into());
    }
    if let Some([width_px, height_px]) = size_px {
        for camera in &mut chosen {
            camera.intrinsics = camera.intrinsics.resized(width_px, height_px);
        }
    }
    Ok(Rig::from_iter(chosen))
}

impl ObservationRenderer {
    /// The cameras of `rig` in `scene`, drawn by `renderer` at every `every`th step.
    #[must_use]
    pub fn new(renderer: BatchRenderer, scene: &Arc<SessionScene>, rig: Rig, every: u32) -> Self {
        Self {
            renderer,
            world: World::empty(scene),
            rig,
            every: every.max(1),
            images: HostImages::default(),
        }
    }

    /// The cameras.
    #[must_use]
    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    /// Converts into the renderer, for another episode.
    #[must_use]
    pub fn into_renderer(self) -> BatchRenderer {
        self.renderer
    }

    /// Record of the renderer for a log.
    #[must_use]
    pub fn drawn_by(&self) -> Option<DrawnBy> {
        let first = self.rig.cameras().next()?;
        Some(DrawnBy {
            device: self.renderer.gpu().info().to_string(),
            width_px: first.intrinsics.width_px,
            height_px: first.intrinsics.height_px,
            every: self.every,
        })
    }

    /// Draws `simulation` if `step` is one that is drawn. Images of earlier steps are gone either
    /// way.
    ///
    /// # Errors
    /// Returns an error if the device was lost or has not the memory, or the scene has not the
    /// agents' assets.
    pub fn draw(&mut self, simulation: &mut Simulation, step: u32) -> Result<(), SessionError> {
        self.images.clear();
        if self.rig.sensors.is_empty() || !step.is_multiple_of(self.every) {
            return Ok(());
        }
        let (ego, motion) = simulation.show(&mut self.world)?;
        let view = WorldView {
            world: &self.world,
            cameras: &self.rig.moving_at(&ego, &motion),
        };
        self.renderer.draw(&[view], &mut self.images)?;
        Ok(())
    }

    /// Readings of the last observation.
    #[must_use]
    pub fn readings(&self) -> Vec<Reading<'_>> {
        self.drawn()
            .map(|(camera, rgba)| Reading::image(camera, rgba))
            .collect()
    }

    /// Hashes of the readings of the last observation.
    #[must_use]
    pub fn hashes(&self) -> Vec<ReadingRecord> {
        let drawn: Vec<_> = self.drawn().collect();
        let hash = |(camera, rgba): (&RigCamera, &[u8])| ReadingRecord {
            sensor: camera.name.clone(),
            hash: hash_of(rgba),
        };
        drawn.into_par_iter().map(hash).collect()
    }

    /// Cameras and their images; none at a step that is not drawn.
    fn drawn(&self) -> impl Iterator<Item = (&RigCamera, &[u8])> {
        let drawn = if self.images.views() > 0 {
            self.rig.sensors.len()
        } else {
            0
        };
        let cameras = self.rig.cameras().enumerate().take(drawn);
        cameras.map(|(index, camera)| (camera, self.images.rgba(0, index)))
    }
}

/// Bytes that one thread hashes.
const HASHED_BYTES: usize = 1 << 20;

/// The hash of [`ReadingRecord`]: of the hashes of its pieces, which are found side by side.
fn hash_of(rgba: &[u8]) -> u128 {
    let pieces: Vec<[u8; 16]> = rgba
        .par_chunks(HASHED_BYTES)
        .map(|piece| xxh3_128(piece).to_le_bytes())
        .collect();
    xxh3_128(pieces.as_flattened())
}
