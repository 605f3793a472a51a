//! Images of the ego's cameras.

use decouplegs_render::{ColorFormat, ImageBytes, Outputs, RenderError, RenderOptions, Renderer};
use decouplegs_scene::episode::{DrawnBy, ImageRecord};
use decouplegs_scene::{Rig, RigCamera, Rules};
use rayon::prelude::*;
use xxhash_rust::xxh3::xxh3_128;

use super::simulation::Simulation;
use crate::planner::{Cameras, Frame};
use decouplegs_session::LiveScene;

/// Cameras that look at an episode.
pub struct ObservationRenderer<'a> {
    live: &'a LiveScene,
    renderer: Renderer,
    rig: Rig,
    every: u32,
    images: ImageBytes,
    /// True if the images of a rendered frame are still on the device.
    unread: bool,
}

/// From step to step the ego drives meters, and other houses fill the images.
const SPARE: f64 = 0.5;

/// Options of a renderer for episodes: `rules`, and 8-bit images.
#[must_use]
pub fn render_options(rules: Rules) -> RenderOptions {
    let outputs = Outputs {
        color: ColorFormat::U8,
        ..Outputs::default()
    };
    RenderOptions {
        rules,
        outputs,
        spare: SPARE,
        ..RenderOptions::default()
    }
}

/// Cameras of `rig` that `cameras` selects, at `size_px` if given.
///
/// # Errors
/// Returns an error if there is none to choose from.
pub fn chosen(rig: &Rig, cameras: Cameras, size_px: Option<[u32; 2]>) -> Result<Rig, String> {
    let first = || {
        rig.cameras
            .iter()
            .find(|camera| camera.name == "front")
            .or(rig.cameras.first())
    };
    let mut chosen: Vec<RigCamera> = match cameras {
        Cameras::None => Vec::new(),
        Cameras::Front => first().cloned().into_iter().collect(),
        Cameras::All => rig.cameras.clone(),
    };
    if cameras != Cameras::None && chosen.is_empty() {
        return Err("the planner wants images, and the scene has no cameras: add a [[rig]] to the scene file".into());
    }
    if let Some([width_px, height_px]) = size_px {
        for camera in &mut chosen {
            camera.intrinsics = camera.intrinsics.resized(width_px, height_px);
        }
    }
    Ok(Rig { cameras: chosen })
}

impl<'a> ObservationRenderer<'a> {
    /// The cameras of `rig` in `live`, drawn by `renderer` at every `every`th step.
    #[must_use]
    pub fn new(live: &'a LiveScene, renderer: Renderer, rig: Rig, every: u32) -> Self {
        Self {
            live,
            renderer,
            rig,
            every: every.max(1),
            images: ImageBytes::default(),
            unread: false,
        }
    }

    /// The cameras.
    #[must_use]
    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    /// The renderer, for other eyes.
    #[must_use]
    pub fn into_renderer(self) -> Renderer {
        self.renderer
    }

    /// Record of the renderer for a log.
    #[must_use]
    pub fn drawn_by(&self) -> Option<DrawnBy> {
        let first = self.rig.cameras.first()?;
        Some(DrawnBy {
            device: self.renderer.gpu().info().to_string(),
            width_px: first.intrinsics.width_px,
            height_px: first.intrinsics.height_px,
            every: self.every,
        })
    }

    /// Draws `simulation` if `step` is one that is drawn; what was seen before is gone either way.
    ///
    /// # Errors
    /// Returns an error if the device was lost or has not the memory.
    pub fn look(&mut self, simulation: &mut Simulation, step: u32) -> Result<bool, RenderError> {
        if self.rig.cameras.is_empty() || !step.is_multiple_of(self.every) {
            self.images.clear();
            return Ok(false);
        }
        let (ego, placed) = simulation.placed();
        let moment = self.live.placed(&placed);
        self.renderer
            .render(self.live.with(&moment), &self.rig.at(&ego))?;
        self.unread = true;
        Ok(true)
    }

    /// Fetches what was drawn.
    ///
    /// # Errors
    /// Returns an error if the device was lost or has not the memory.
    pub fn read(&mut self) -> Result<(), RenderError> {
        if std::mem::take(&mut self.unread) {
            self.renderer.read_bytes(&mut self.images)
        } else {
            Ok(())
        }
    }

    /// Images of the last observation.
    #[must_use]
    pub fn frames(&self) -> Vec<Frame<'_>> {
        (0..self.images.len())
            .map(|index| Frame {
                camera: &self.rig.cameras[index],
                rgba: self.images.rgba(index),
            })
            .collect()
    }

    /// The bits of what was seen last.
    #[must_use]
    pub fn hashes(&self) -> Vec<ImageRecord> {
        let hash = |index: usize| ImageRecord {
            camera: self.rig.cameras[index].name.clone(),
            hash: hash_of(self.images.rgba(index)),
        };
        (0..self.images.len()).into_par_iter().map(hash).collect()
    }
}

/// Bytes that one thread hashes.
const HASHED_BYTES: usize = 1 << 20;

/// The hash of [`ImageRecord`]: of the hashes of its pieces, which are found side by side.
fn hash_of(rgba: &[u8]) -> u128 {
    let pieces: Vec<[u8; 16]> = rgba
        .par_chunks(HASHED_BYTES)
        .map(|piece| xxh3_128(piece).to_le_bytes())
        .collect();
    xxh3_128(pieces.as_flattened())
}
