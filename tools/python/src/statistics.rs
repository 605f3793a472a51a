//! Statistics of frames.

use std::collections::BTreeMap;
use std::time::Duration;

use decouplegs::render::FrameStatistics;
use pyo3::prelude::*;

/// Statistics of one frame.
#[pyclass(frozen, get_all, module = "decouplegs")]
#[derive(Clone)]
pub struct Statistics {
    /// Time on the device, without the agents' part where that ran beside the frame before.
    gpu_ms: f64,
    /// Time of the agents' part, where it was submitted by itself.
    update_ms: Option<f64>,
    /// Time from the submission to the finished images.
    wall_ms: f64,
    /// Time of the host to record and submit.
    record_ms: f64,
    /// Time on the device by stage; empty unless the session has `stage_times=True`.
    stages_ms: BTreeMap<String, f64>,
    /// Cameras that were drawn.
    cameras: usize,
    /// Agents that some camera could see.
    agents: usize,
    /// Splats of those agents.
    agent_splats: usize,
    /// Number of repeated draws, because a list outgrew its buffer.
    redrawn: u32,
}

fn ms(time: Duration) -> f64 {
    1e3 * time.as_secs_f64()
}

impl Statistics {
    pub fn from_frame(frame: &FrameStatistics) -> Self {
        let mut stages_ms = BTreeMap::new();
        for stage in frame.queues.iter().flat_map(|queue| &queue.stages) {
            *stages_ms.entry(stage.name.to_owned()).or_default() += stage.duration_ns as f64 / 1e6;
        }
        Self {
            gpu_ms: ms(frame.gpu_time),
            update_ms: frame.update_time.map(ms),
            wall_ms: ms(frame.wall_time),
            record_ms: ms(frame.record_time),
            stages_ms,
            cameras: frame.keys.len(),
            agents: frame.agents,
            agent_splats: frame.agent_splats,
            redrawn: frame.redrawn,
        }
    }
}

#[pymethods]
impl Statistics {
    fn __repr__(&self) -> String {
        format!(
            "Statistics({} cameras, {} agents, {:.3} ms on the device)",
            self.cameras, self.agents, self.gpu_ms
        )
    }
}
