//! Kept lists: records and sorted lists of the background that hold from frame to frame.
//!
//! While cameras stand, all that a frame finds of the background is what the frame before found:
//! records, depth keys and lists. They are kept, and only agents are projected, binned and sorted;
//! their lists are merged with those of the background. Coarse tiles without agents that the image
//! shows already are not blended again. A frame of cameras that moved is what it was without kept
//! lists.

use std::sync::atomic::{AtomicU64, Ordering};

use decouplegs_gpu::{Gpu, MemoryReport};
use decouplegs_scene::Fog;

use crate::capacity::Capacity;
use crate::layout::{CameraRecord, LensRecord};
use crate::stages::{MergeBuffers, ProjectVariant};

/// Source of the lists of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub enum ListSource {
    /// Background and agents sorted together.
    Sorted,
    /// Background sorted by itself, and kept; agents merged.
    Found,
    /// Kept lists of the background; agents merged.
    Kept,
}

/// Contents of a frame that records, lists and pixels of a background without agents depend on,
/// beside the options of the renderer.
#[derive(Clone)]
pub(crate) struct Standing {
    pub background_id: u64,
    pub sky: [f32; 3],
    pub fog: Option<Fog>,
    pub cameras: Vec<CameraRecord>,
    pub lenses: Vec<LensRecord>,
    pub background: ProjectVariant,
    pub post_processed: bool,
}

impl Standing {
    /// True if both are the same, bit by bit.
    fn equals(&self, other: &Self) -> bool {
        fn bytes<T: bytemuck::Pod>(records: &[T]) -> &[u8] {
            bytemuck::cast_slice(records)
        }
        self.background_id == other.background_id
            && bytes(&self.sky) == bytes(&other.sky)
            && self.fog == other.fog
            && bytes(&self.cameras) == bytes(&other.cameras)
            && bytes(&self.lenses) == bytes(&other.lenses)
            && self.background == other.background
            && self.post_processed == other.post_processed
    }
}

/// Tells lists apart that were kept one after the other.
static NEXT_ID: AtomicU64 = AtomicU64::new(1);

/// Lists of the background that are kept.
pub(crate) struct Kept {
    /// Different for all lists that are ever kept.
    pub id: u64,
    pub buffers: MergeBuffers,
}

/// The kept lists of a frame's buffers.
#[derive(Default)]
pub(crate) struct KeptLists {
    /// Contents of the frame before.
    before: Option<Standing>,
    kept: Option<Kept>,
    /// Frames since the lists were found.
    frames: u32,
    /// True if there is no memory for what stands now.
    refused: bool,
}

/// Frames between two looks at the memory that is left.
const FRAMES_PER_LOOK: u32 = 32;

impl KeptLists {
    /// Decides for a frame that shows `standing`, in `bins` coarse tiles and with room for
    /// `capacity`. Lists that it decides to find are taken as found: a frame that was not
    /// submitted must call [`Self::forget`].
    pub fn decide(
        &mut self,
        gpu: &Gpu,
        standing: Option<&Standing>,
        capacity: &Capacity,
        bins: u32,
    ) -> ListSource {
        let stands = match (&self.before, standing) {
            (Some(before), Some(standing)) => before.equals(standing),
            _ => false,
        };
        if !stands {
            *self = Self {
                before: standing.cloned(),
                ..Self::default()
            };
            return ListSource::Sorted;
        }
        if self.refused {
            return ListSource::Sorted;
        }
        self.frames += 1;
        if self.kept.is_some() {
            let looks = self.frames.is_multiple_of(FRAMES_PER_LOOK);
            if !(looks && is_short(&gpu.memory(), 0)) {
                return ListSource::Kept;
            }
            self.kept = None;
        } else if !is_short(&gpu.memory(), MergeBuffers::bytes(capacity, bins))
            && let Ok(buffers) = MergeBuffers::new(gpu, capacity, bins)
        {
            let id = NEXT_ID.fetch_add(1, Ordering::Relaxed);
            self.kept = Some(Kept { id, buffers });
            return ListSource::Found;
        }
        self.refused = true;
        ListSource::Sorted
    }

    /// Copy without lists, for other buffers: what stands can be found again at once.
    pub fn without_lists(self) -> Self {
        Self { kept: None, ..self }
    }

    /// Forgets what is kept, and that something stood.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// The lists that the frame found or uses; `None` where it sorts all.
    pub fn kept(&self) -> Option<&Kept> {
        self.kept.as_ref()
    }
}

/// True if less than a twentieth of the memory is left once `wanted_bytes` more are taken. False
/// where the driver does not tell.
fn is_short(report: &MemoryReport, wanted_bytes: u64) -> bool {
    match (report.budget_bytes, report.driver_usage_bytes) {
        (Some(budget), Some(used)) => used.saturating_add(wanted_bytes) > budget / 20 * 19,
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_short_when_a_twentieth_is_left() {
        let report = |budget_bytes, driver_usage_bytes| MemoryReport {
            budget_bytes,
            driver_usage_bytes,
            ..MemoryReport::default()
        };
        assert!(!is_short(&report(Some(100), Some(90)), 5));
        assert!(is_short(&report(Some(100), Some(90)), 6));
        assert!(is_short(&report(Some(100), Some(96)), 0));
        assert!(is_short(&report(Some(100), Some(0)), u64::MAX));
        assert!(!is_short(&report(None, None), u64::MAX));
    }
}
