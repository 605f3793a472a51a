//! Options and statistics of frames.

use std::time::{Duration, Instant};

use decouplegs_gpu::{GpuError, StageTime, Ticket};
use decouplegs_scene::Rules;
use decouplegs_shaders::constants;

use crate::capacity::Capacity;
use crate::kept_lists::ListSource;
use crate::keys::KeySource;
use crate::layout::RequiredCounts;
use crate::output::Outputs;
use crate::storage::Storage;

/// Options of a renderer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderOptions {
    /// The definition of an image.
    pub rules: Rules,
    /// Requested outputs.
    pub outputs: Outputs,
    /// Time over which [`crate::Plane::FlowForward`] and [`crate::Plane::FlowBackward`] are
    /// displacements, seconds.
    pub flow_interval_s: f64,
    /// Highest degree of spherical harmonics that is evaluated, whatever the world stores.
    pub sh_degree_max: u8,
    /// Storage of the splats of worlds that this renderer uploads. A world that another renderer
    /// uploaded is drawn as it is stored.
    pub storage: Storage,
    /// Length of the segments in which lists of coarse tiles are blended, side by side, pairs. By
    /// default the longest that a workgroup of the blend lists at once, 992.
    /// Shorter segments balance better and take more memory: 768 bytes of partial result per
    /// segment and fine tile that it draws in. Above 2^24 lists are not cut; a software device cuts
    /// them at 10,000.
    pub segment_pairs: u32,
    /// True keeps depth keys of the background per view direction, false computes them in every
    /// frame. Images are the same.
    pub keep_keys: bool,
    /// True keeps records and lists of the background while all cameras of the renderer stand: from
    /// the third frame on only agents are projected and sorted, and coarse tiles without agents
    /// that the image shows already are not blended again. Shadows on the background, and
    /// [`Outputs::contributions`], rule it out. It takes 12 bytes of memory per pair, while cameras
    /// stand. Images are the same.
    pub keep_lists: bool,
    /// Agents are drawn at the coarsest level of detail whose splats are at most this far apart in
    /// the image. `None`: always at the finest, which is exact.
    pub level_pitch_px: Option<f64>,
    /// The background is drawn at levels of detail whose splats lay at most this far apart in the
    /// image before they were merged, in its middle; worlds are uploaded with levels of detail
    /// then, which take a third more memory. `None`: always at the finest, which is exact.
    pub background_pitch_px: Option<f64>,
    /// Frames that may be submitted before the first of them is finished, at least 1. Each has
    /// images of its own.
    pub frames_in_flight: usize,
    /// Frames whose images may be taken ([`crate::Renderer::take_images`]) and not yet dropped.
    pub taken_max: usize,
    /// Buffers that were too small grow to what was needed and this share of it more. Cameras that
    /// leap outgrow a small one again and again, and each time a frame is drawn twice.
    pub spare: f64,
    /// True if the agents' part of a frame runs on the queue for updates, beside the frame before;
    /// otherwise it runs in line.
    pub overlap: bool,
    /// True if stages are timed ([`FrameStatistics::stages`]). Stages that are timed do not
    /// overlap, so frames may take longer.
    pub stage_times: bool,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self {
            rules: Rules::DEFAULT,
            outputs: Outputs::default(),
            flow_interval_s: 0.1,
            sh_degree_max: 3,
            storage: Storage::Exact,
            segment_pairs: constants::BATCH,
            keep_keys: true,
            keep_lists: false,
            level_pitch_px: None,
            background_pitch_px: None,
            frames_in_flight: 2,
            taken_max: 16,
            spare: 1.0 / 16.0,
            overlap: true,
            stage_times: false,
        }
    }
}

/// Timing of a frame on one queue.
#[derive(Clone, Debug)]
pub struct QueueTrace {
    /// `main` or `update`; the same queue on devices with one.
    pub queue: &'static str,
    /// Start, nanoseconds of the device's clock, which the queues share
    /// ([`decouplegs_gpu::Gpu::clock`]).
    pub begin_ns: u64,
    /// Duration, nanoseconds.
    pub total_ns: u64,
    /// Stages, with times from the queue's start.
    pub stages: Vec<StageTime>,
}

impl QueueTrace {
    pub(crate) fn from_ticket(queue: &'static str, ticket: &Ticket) -> Result<Self, GpuError> {
        let (begin_ns, total_ns, stages) = (
            ticket.begin_ns()?,
            ticket.gpu_time_ns()?,
            ticket.stage_times()?,
        );
        Ok(Self {
            queue,
            begin_ns,
            total_ns,
            stages,
        })
    }
}

/// Statistics of a finished frame.
#[derive(Clone, Debug)]
pub struct FrameStatistics {
    /// Required counts of each list.
    pub required: RequiredCounts,
    /// Capacity of each list.
    pub capacity: Capacity,
    /// Number of attempts after a list outgrew its buffer.
    pub redrawn: u32,
    /// Source of the depth keys of each view's background.
    pub keys: Vec<KeySource>,
    /// Source of the lists of coarse tiles.
    pub lists: ListSource,
    /// Agents that some camera could see, and their splats at the levels of detail that were drawn.
    pub agents: usize,
    /// Splats of those agents.
    pub agent_splats: usize,
    /// Codebooks that were relit for this frame: those of agents whose light changed since their
    /// slot was last drawn.
    pub relit: usize,
    /// GPU time from the first command to the last, without the agents' part where that ran on its
    /// own queue.
    pub gpu_time: Duration,
    /// GPU time by stage, in order; empty unless [`RenderOptions::stage_times`].
    pub stages: Vec<StageTime>,
    /// GPU time of the agents' part where it was submitted by itself.
    pub update_time: Option<Duration>,
    /// Timing on each queue.
    pub queues: Vec<QueueTrace>,
    /// Times at which the frame was handed over, and at which all of it was submitted.
    pub submitted: (Instant, Instant),
    /// Times at which the host began to wait for it, and at which it was done.
    pub awaited: (Instant, Instant),
    /// Wall clock from the submission to the finished image, redrawing included.
    pub wall_time: Duration,
    /// Host time to record and submit the last drawing.
    pub record_time: Duration,
    /// True if the frame had the commands of an earlier one, which were submitted again and not
    /// recorded again.
    pub repeated: bool,
}
