//! Results, and their JSON.

use std::collections::BTreeMap;

use decouplegs::gpu::MemoryReport;
use decouplegs::render::FrameStatistics;
use serde_json::{Value, json};

use super::drive_schedule::Driven;
use super::fidelity::Fidelity;
use super::mode::Mode;
use crate::spread::Spread;
use crate::stage_times::stage_times_ms;

/// Figures of one mode with one number of agents.
pub struct Point {
    pub mode: Mode,
    pub agents: usize,
    pub unique_assets: usize,
    pub outcome: Outcome,
}

pub enum Outcome {
    Measured(Box<Measured>),
    /// The mode needs more memory than it may have, or than there is.
    OutOfMemory {
        needed_bytes: u64,
        /// Source of the value.
        known: &'static str,
    },
    /// The device cannot draw it at all.
    Refused(String),
}

/// Times of the timed frames.
pub struct Measured {
    /// Frames that were drawn before them.
    pub warm_up_frames: usize,
    /// Wall clock from the end of a frame to the end of the next.
    pub step_ms: Spread,
    /// GPU time on the main queue.
    pub gpu_ms: Spread,
    /// GPU time of the agents' part, if it has a queue of its own.
    pub update_ms: Option<Spread>,
    /// Host time to record and submit.
    pub record_ms: Spread,
    /// Durations of the stages of both queues, milliseconds, in the order they run. Measured on
    /// frames drawn once more, as stages that are timed do not overlap.
    pub stages: Vec<(&'static str, Spread)>,
    /// Device memory in use while the last of the frames was shown.
    pub memory: MemoryReport,
    /// Predicted memory of the scene alone.
    pub predicted_scene_bytes: u64,
    /// Splats of the cloud that is no agent's own.
    pub world_splats: usize,
    /// Medians: agents in sight, their splats, visible splats, entries of coarse tiles.
    pub agents_drawn: f64,
    pub agent_splats: f64,
    pub records: f64,
    pub pairs: f64,
    pub cameras: usize,
    /// Frames that were drawn again because a list outgrew its buffer.
    pub redrawn: usize,
    /// Views by the source of their background's depth keys.
    pub keys: BTreeMap<String, usize>,
    /// Difference from vanilla; `None` for vanilla itself, or where nothing was compared.
    pub fidelity: Option<Fidelity>,
}

impl Point {
    pub fn measured(&self) -> Option<&Measured> {
        if let Outcome::Measured(measured) = &self.outcome {
            Some(measured)
        } else {
            None
        }
    }

    pub fn to_json(&self) -> Value {
        let mut point = match &self.outcome {
            Outcome::Measured(measured) => measured.to_json(),
            Outcome::OutOfMemory {
                needed_bytes,
                known,
            } => {
                json!({ "out_of_memory": { "needed_bytes": needed_bytes, "known": known } })
            }
            Outcome::Refused(reason) => json!({ "refused": reason }),
        };
        point["mode"] = json!(self.mode.name);
        point["agents"] = json!(self.agents);
        point["unique_assets"] = json!(self.unique_assets);
        point
    }
}

impl Measured {
    /// The figures of `driven`, which has at least one frame. Times of stages, fidelity and what
    /// the frames do not tell are left open.
    pub fn from_driven(driven: &Driven, memory: MemoryReport) -> Self {
        let frames = &driven.frames;
        let spread =
            |of: &dyn Fn(&FrameStatistics) -> f64| Spread::from_values(frames.iter().map(of));
        let median = |of: &dyn Fn(&FrameStatistics) -> f64| spread(of).median;
        let updates: Vec<f64> = frames
            .iter()
            .filter_map(|frame| Some(frame.update_time?.as_secs_f64() * 1e3))
            .collect();
        let mut keys = BTreeMap::<String, usize>::new();
        for source in frames.iter().flat_map(|frame| &frame.keys) {
            *keys
                .entry(format!("{source:?}").to_lowercase())
                .or_default() += 1;
        }
        Self {
            warm_up_frames: driven.warm_up_frames,
            step_ms: Spread::from_values(driven.steps_ms.iter().copied()),
            gpu_ms: spread(&|frame| frame.gpu_time.as_secs_f64() * 1e3),
            update_ms: (!updates.is_empty()).then(|| Spread::from_values(updates)),
            record_ms: spread(&|frame| frame.record_time.as_secs_f64() * 1e3),
            stages: Vec::new(),
            memory,
            predicted_scene_bytes: 0,
            world_splats: 0,
            agents_drawn: median(&|frame| frame.agents as f64),
            agent_splats: median(&|frame| frame.agent_splats as f64),
            records: median(&|frame| f64::from(frame.required.records)),
            pairs: median(&|frame| f64::from(frame.required.pairs)),
            cameras: frames[0].keys.len(),
            redrawn: frames.iter().filter(|frame| frame.redrawn > 0).count(),
            keys,
            fidelity: None,
        }
    }

    /// Frames of the whole rig per second, from the mean interval: frames in flight may end in
    /// pairs, so that a median says nothing of a rate.
    pub fn rig_steps_per_s(&self) -> f64 {
        1e3 / self.step_ms.mean
    }

    pub fn images_per_s(&self) -> f64 {
        self.rig_steps_per_s() * self.cameras as f64
    }

    /// Share of the views whose depth keys of the background were read, not computed.
    pub fn share_of_kept_keys(&self) -> f64 {
        let all: usize = self.keys.values().sum();
        *self.keys.get("kept").unwrap_or(&0) as f64 / all.max(1) as f64
    }

    fn to_json(&self) -> Value {
        let stages = self
            .stages
            .iter()
            .map(|(name, times)| json!({ "name": name, "gpu_ms": times.to_json() }));
        json!({
            "rig_steps_per_s": self.rig_steps_per_s(),
            "images_per_s": self.images_per_s(),
            "warm_up_frames": self.warm_up_frames,
            "step_wall_ms": self.step_ms.to_json(),
            "frame_gpu_ms": self.gpu_ms.to_json(),
            "update_gpu_ms": self.update_ms.map(Spread::to_json),
            "record_ms": self.record_ms.to_json(),
            "stages": stages.collect::<Vec<_>>(),
            "memory_bytes": {
                "total": self.memory.total_bytes,
                "by_purpose": self.memory.bytes_by_purpose,
                "driver_usage": self.memory.driver_usage_bytes,
                "driver_budget": self.memory.budget_bytes,
                "predicted_scene": self.predicted_scene_bytes,
            },
            "world_splats": self.world_splats,
            "agents_drawn": self.agents_drawn,
            "agent_splats": self.agent_splats,
            "records": self.records,
            "pairs": self.pairs,
            "frames_redrawn": self.redrawn,
            "keys": self.keys,
            "share_of_kept_keys": self.share_of_kept_keys(),
            "fidelity": self.fidelity.map(Fidelity::to_json),
        })
    }
}

/// Times of each stage of `frames`, whose stages were timed; those of the update queue first.
pub fn stage_times<'a>(frames: &'a [FrameStatistics]) -> Vec<(&'static str, Spread)> {
    let stages = |frame: &'a FrameStatistics| {
        let stages = frame.queues.iter().rev().flat_map(|queue| &queue.stages);
        stages.map(|stage| (stage.name, stage.duration_ns))
    };
    let times = stage_times_ms(frames, stages).into_iter();
    times
        .map(|(name, times)| (name, Spread::from_values(times)))
        .collect()
}
