//! The persistent key buffer: depth keys of the background along the directions that cameras look.
//!
//! The depth of a splat is f.p - f.c: along one direction f the keys f.p are the same wherever the
//! camera stands. They are computed once per direction, for all splats, and read by every frame
//! that looks the same way. Driving straight on computes none.

use decouplegs_gpu::{Buffer, Gpu, MemoryKind};
use decouplegs_scene::{DepthOrder, Rules};

use crate::RenderError;
use crate::layout::{CameraRecord, NO_KEY_SET, View};
use crate::resident_splats::ResidentSplats;
use crate::stages::{PURPOSE, WantedKeys};

/// Source of the depth keys of one view's background.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub enum KeySource {
    /// Computed for the splats that are seen.
    Computed,
    /// Computed for all splats, and kept.
    Found,
    /// Read from the persistent key buffer.
    Kept,
}

/// All that the keys of a static world depend on, to the last bit.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Direction {
    forward: [f32; 3],
    forward_low: [f32; 3],
    key_scale: f32,
}

impl Direction {
    fn from_camera(camera: &CameraRecord) -> Self {
        Self {
            forward: camera.row_z,
            forward_low: camera.row_z_low,
            key_scale: camera.key_scale,
        }
    }
}

/// Keys along one direction.
#[derive(Clone)]
struct KeySet {
    direction: Direction,
    last_used: u64,
}

/// Sources of the depth keys of a frame's views.
#[derive(Clone, Debug)]
pub(crate) struct KeyDecision {
    /// The set of each camera, or [`NO_KEY_SET`].
    pub sets: Vec<u32>,
    pub sources: Vec<KeySource>,
    /// Cameras whose keys are to be found, and the sets that they go to.
    pub find: Vec<WantedKeys>,
    /// Depth keys, `[set][splat]`.
    pub kept: Buffer<u32>,
}

impl KeyDecision {
    /// All keys computed; `kept` is bound and not read.
    fn computed(views: usize, kept: Buffer<u32>) -> Self {
        Self {
            sets: vec![NO_KEY_SET; views],
            sources: vec![KeySource::Computed; views],
            find: Vec::new(),
            kept,
        }
    }

    /// The same views with all keys computed.
    pub fn without_kept_keys(&self) -> Self {
        Self::computed(self.sources.len(), self.kept.clone())
    }
}

/// The persistent key buffer of one background. A frame changes a clone, which takes the place of
/// the original once the frame was submitted: what was to be found may never be.
#[derive(Clone)]
pub(crate) struct PersistentKeys {
    background_id: u64,
    keys: Buffer<u32>,
    sets: Vec<KeySet>,
    sets_max: usize,
    previous: Vec<Direction>,
    frame: u64,
}

impl PersistentKeys {
    /// None kept yet, with no memory taken.
    pub fn new(gpu: &Gpu) -> Result<Self, RenderError> {
        let keys = gpu.buffer("kept_keys", PURPOSE, 0, MemoryKind::Device)?;
        Ok(Self {
            background_id: 0,
            keys,
            sets: Vec::new(),
            sets_max: 0,
            previous: Vec::new(),
            frame: 0,
        })
    }

    /// Decides that all keys of `views` views are computed.
    pub fn all_computed(&self, views: usize) -> KeyDecision {
        KeyDecision::computed(views, self.keys.clone())
    }

    /// Decides for the views of the next frame. Keys that it decides to find are taken as found.
    pub fn decide(
        &mut self,
        gpu: &Gpu,
        background: &ResidentSplats,
        view: &View,
        rules: &Rules,
    ) -> Result<KeyDecision, RenderError> {
        let views = view.cameras.len();
        let bytes = (background.splats * views * 4) as u64;
        let possible = bytes > 0 && bytes <= gpu.limits().storage_buffer_bytes_max;
        if rules.order == DepthOrder::Radial || !possible {
            return Ok(self.all_computed(views));
        }
        self.frame += 1;
        self.fit(gpu, background, views)?;
        let directions: Vec<Direction> = view.cameras.iter().map(Direction::from_camera).collect();
        let mut decision = self.all_computed(views);
        for (camera, direction) in directions.iter().enumerate() {
            let (set, source) =
                if let Some(known) = self.sets.iter().position(|set| set.direction == *direction) {
                    (known, KeySource::Kept)
                } else if self.previous.get(camera) == Some(direction)
                    && let Some(free) = self.free_set(*direction, &directions)
                {
                    // A direction that did not change for a frame is worth it: its keys are paid
                    // for once and serve many frames.
                    decision.find.push(WantedKeys { camera, set: free });
                    (free, KeySource::Found)
                } else {
                    continue;
                };
            self.sets[set].last_used = self.frame;
            decision.sets[camera] = set as u32;
            decision.sources[camera] = source;
        }
        if !decision.find.is_empty() && self.keys.is_empty() {
            // Callers that draw a single image have no use for it.
            self.keys = gpu.buffer(
                "kept_keys",
                PURPOSE,
                background.splats * self.sets_max,
                MemoryKind::Device,
            )?;
        }
        self.previous = directions;
        decision.kept = self.keys.clone();
        Ok(decision)
    }

    /// Sets for as many views. What was kept of another world is forgotten.
    fn fit(
        &mut self,
        gpu: &Gpu,
        background: &ResidentSplats,
        views: usize,
    ) -> Result<(), RenderError> {
        if self.background_id != background.id || self.sets_max < views {
            self.sets.clear();
            self.previous.clear();
            self.keys = gpu.buffer("kept_keys", PURPOSE, 0, MemoryKind::Device)?;
            (self.background_id, self.sets_max) = (background.id, views);
        }
        Ok(())
    }

    /// The set for the keys along `direction`: a new one, or the one whose last use is longest ago,
    /// of those that no view of this frame looks along.
    fn free_set(&mut self, direction: Direction, wanted: &[Direction]) -> Option<usize> {
        let set = KeySet {
            direction,
            last_used: self.frame,
        };
        if self.sets.len() < self.sets_max {
            self.sets.push(set);
            return Some(self.sets.len() - 1);
        }
        let free = |&i: &usize| !wanted.contains(&self.sets[i].direction);
        let oldest = (0..self.sets.len())
            .filter(free)
            .min_by_key(|&i| self.sets[i].last_used)?;
        self.sets[oldest] = set;
        Some(oldest)
    }
}
