//! A frame from its submission to the reading of its images.

use std::time::{Duration, Instant};

use decouplegs_gpu::Ticket;

use crate::agents::AgentList;
use crate::agents::relit::Relights;
use crate::capacity::Capacity;
use crate::kept_lists::{ListSource, Standing};
use crate::kernels::FrameVariant;
use crate::keys::KeyDecision;
use crate::layout::View;
use crate::post_processing::{PhotometryRecord, ProcessedView};
use crate::resident_splats::ResidentSplats;
use crate::stages::AgentCounts;

/// Contents of a frame, as the host prepared them.
pub(crate) struct FrameContents {
    pub background: ResidentSplats,
    pub view: View,
    pub variant: FrameVariant,
    pub agents: Option<AgentList>,
    pub relights: Relights,
    pub shadow_count: usize,
    /// Cameras of the view as post-processing sees them; none without it.
    pub processed: Vec<ProcessedView>,
    /// One per camera, where images are post-processed.
    pub photometry: Vec<PhotometryRecord>,
    /// Contents that may stand from frame to frame; `None` where no lists are kept.
    pub standing: Option<Standing>,
}

impl FrameContents {
    /// Counts of the agents; zeros without agents.
    pub fn agent_counts(&self) -> AgentCounts {
        self.agents
            .as_ref()
            .map_or_else(AgentCounts::default, |list| list.counts)
    }

    /// Contents that may stand from frame to frame; `None` where shadows of agents lie on the
    /// background: they move.
    pub fn find_standing(&self) -> Option<Standing> {
        (self.shadow_count == 0).then(|| Standing {
            background_id: self.background.id,
            sky: self.background.sky,
            fog: self.background.fog,
            cameras: self.view.cameras.clone(),
            lenses: self.view.lenses.clone(),
            background: self.variant.background,
            post_processed: self.variant.post_processed,
        })
    }

    /// Splats of background and agents.
    pub fn splats(&self) -> usize {
        self.background.splats + self.agents.as_ref().map_or(0, |list| list.splats)
    }
}

/// A frame that was submitted and is not yet finished.
pub(crate) struct SubmittedFrame {
    /// Index of its slot.
    pub slot: usize,
    pub contents: FrameContents,
    pub keys: KeyDecision,
    pub lists: ListSource,
    pub frame: Ticket,
    /// The agents' part, where it was submitted by itself.
    pub update: Option<Ticket>,
    pub capacity: Capacity,
    pub since: Instant,
    /// Time at which all of it was submitted.
    pub submitted: Instant,
    pub record_time: Duration,
}

/// The frame that was finished last.
pub(crate) struct ShownFrame {
    /// Index of its slot, which has its images.
    pub slot: usize,
    pub view: View,
    pub frame: Ticket,
}
