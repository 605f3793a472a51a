//! Batching of cameras and worlds into frames.

use std::collections::VecDeque;
use std::sync::Arc;

use decouplegs_render::layout::CAMERAS_MAX;
use decouplegs_render::{Agent, Scene};
use decouplegs_scene::{Camera, GroundShadow};
use glam::DVec3;

use super::batch_renderer::WorldView;
use super::{SessionError, SessionScene, World};
use crate::{AgentInstance, LiveScene};

/// Some cameras of one view, with the agents that they see.
struct Part {
    view: usize,
    cameras: usize,
    agents: Vec<AgentInstance>,
}

/// Contents of one frame: cameras over one background. It owns all it needs, so that a frame can
/// wait for its turn after the caller's worlds have moved on.
pub(super) struct Batch {
    pub scene: Arc<SessionScene>,
    /// Cameras, in the order of the frame's images.
    pub cameras: Vec<Camera>,
    parts: Vec<Part>,
}

/// The frames that draw `views`, in order: of one scene each, with no more cameras than a frame can
/// have, nor more pixels than `pixels_max` unless it is one camera.
pub(super) fn batches(
    views: &[WorldView<'_>],
    pixels_max: u64,
) -> Result<VecDeque<Batch>, SessionError> {
    let mut batches: VecDeque<Batch> = VecDeque::new();
    let mut pixels = 0;
    for (view, WorldView { world, cameras }) in views.iter().enumerate() {
        if cameras.is_empty() {
            return Err(SessionError::NoCameras);
        }
        for camera in *cameras {
            let own = camera.intrinsics.pixels();
            let fits = |batch: &Batch| {
                batch.cameras.len() < CAMERAS_MAX
                    && pixels + own <= pixels_max
                    && Arc::ptr_eq(&batch.scene, world.scene())
            };
            if !batches.back().is_some_and(fits) {
                pixels = 0;
                batches.push_back(Batch {
                    scene: world.scene().clone(),
                    cameras: Vec::new(),
                    parts: Vec::new(),
                });
            }
            let batch = batches.back_mut().expect("one was there or was added");
            batch.add(view, world, camera);
            pixels += own;
        }
    }
    Ok(batches)
}

/// The agents of a batch, each seen by the cameras of its world.
pub(super) struct AgentBatch {
    agents: Vec<Agent>,
    shadows: Vec<GroundShadow>,
    shadow_cameras: Option<Vec<u32>>,
}

impl Batch {
    fn add(&mut self, view: usize, world: &World, camera: &Camera) {
        self.cameras.push(camera.clone());
        match self.parts.last_mut().filter(|part| part.view == view) {
            Some(part) => part.cameras += 1,
            None => self.parts.push(Part {
                view,
                cameras: 1,
                agents: world.present_agents().collect(),
            }),
        }
    }

    /// View of each camera, in the order of the frame's images.
    pub fn views(&self) -> impl Iterator<Item = usize> {
        self.parts
            .iter()
            .flat_map(|part| std::iter::repeat_n(part.view, part.cameras))
    }

    /// Positions of all agents, world coordinates.
    pub fn agent_positions(&self) -> Vec<DVec3> {
        let agents = self.parts.iter().flat_map(|part| &part.agents);
        agents.map(|agent| agent.pose.translation).collect()
    }

    /// Agents of all views as one list, lit, each with the mask of its cameras.
    pub fn lit_agents(&self, live: &LiveScene) -> AgentBatch {
        let mut batch = AgentBatch {
            agents: Vec::new(),
            shadows: Vec::new(),
            shadow_cameras: None,
        };
        let mut shadow_cameras = Vec::new();
        let mut first = 0;
        for part in &self.parts {
            let own = ((1u64 << part.cameras) - 1) << first;
            first += part.cameras;
            let moment = live.placed(&part.agents);
            batch
                .agents
                .extend(moment.agents.into_iter().map(|agent| Agent {
                    cameras: own as u32,
                    ..agent
                }));
            shadow_cameras.extend(std::iter::repeat_n(own as u32, moment.shadows.len()));
            batch.shadows.extend(moment.shadows);
        }
        // One world needs no masks, and kernels without them are the faster ones.
        batch.shadow_cameras =
            (self.parts.len() > 1 && !shadow_cameras.is_empty()).then_some(shadow_cameras);
        batch
    }
}

impl AgentBatch {
    /// The background of `live` with these agents.
    pub fn over<'a>(&'a self, live: &'a LiveScene) -> Scene<'a> {
        Scene {
            shadows: &self.shadows,
            shadow_cameras: self.shadow_cameras.as_deref(),
            ..Scene::with_agents(&live.gpu_scene, &live.pool, &self.agents)
        }
    }
}
