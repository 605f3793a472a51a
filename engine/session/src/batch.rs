//! Batching of cameras and worlds into frames.

use std::collections::VecDeque;
use std::sync::Arc;

use decouplegs_render::FrameAgents;
use decouplegs_render::layout::CAMERAS_MAX;
use decouplegs_scene::Camera;
use glam::DVec3;

use super::batch_renderer::WorldView;
use super::world::SharedAgents;
use super::{Scene, SessionError, World};
use crate::AgentInstance;

/// Some cameras of one view, with the agents that they see.
struct Part {
    view: usize,
    cameras: usize,
    agents: Vec<AgentInstance>,
    /// Agents of the world that the view is a part of, if it is.
    shared: Option<SharedAgents>,
}

impl Part {
    /// True if both views are of one world.
    fn is_of_world_of(&self, other: &Self) -> bool {
        match (&self.shared, &other.shared) {
            (Some(own), Some(other)) => Arc::ptr_eq(&own.all, &other.all),
            _ => false,
        }
    }
}

/// Contents of one frame: cameras over one background. It owns all it needs, so that a frame can
/// wait for its turn after the caller's worlds have moved on.
pub(super) struct Batch {
    pub scene: Arc<Scene>,
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

impl Batch {
    fn add(&mut self, view: usize, world: &World, camera: &Camera) {
        self.cameras.push(camera.clone());
        match self.parts.last_mut().filter(|part| part.view == view) {
            Some(part) => part.cameras += 1,
            None => self.parts.push(Part {
                view,
                cameras: 1,
                agents: world.present_agents().collect(),
                shared: world.shared().cloned(),
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
    pub fn frame_agents(&self) -> FrameAgents {
        let mut all = FrameAgents::default();
        let mut first = 0;
        for parts in self.parts.chunk_by(Part::is_of_world_of) {
            for run in runs(parts, &mut first) {
                all.add_for_cameras(self.scene.lit(&run.agents), run.cameras);
            }
        }
        // One world needs no masks, and kernels without them are the faster ones.
        if self.parts.len() == 1 {
            all.shadow_cameras.clear();
        }
        all
    }
}

/// Agents one after the other that the same cameras see.
struct Run {
    agents: Vec<AgentInstance>,
    /// A bit for each camera.
    cameras: u32,
}

/// Agents of views of one world, in their order. The bit of the first camera is `first`, which
/// becomes that of the camera after the last.
fn runs(parts: &[Part], first: &mut usize) -> Vec<Run> {
    let mut mask = |part: &Part| {
        let own = ((1u64 << part.cameras) - 1) << *first;
        *first += part.cameras;
        own as u32
    };
    let masks: Vec<u32> = parts.iter().map(&mut mask).collect();
    let (Some(shared), true) = (&parts[0].shared, parts.len() > 1) else {
        return vec![Run {
            agents: parts[0].agents.clone(),
            cameras: masks[0],
        }];
    };
    let sees = |part: &Part, agent: &AgentInstance| {
        let without = part.shared.as_ref().map(|shared| shared.without);
        without != Some(agent.instance)
    };
    let cameras_of = |agent: &AgentInstance| {
        let seeing = parts.iter().zip(&masks);
        let seeing = seeing.filter(|(part, _)| sees(part, agent));
        seeing.fold(0, |all, (_, mask)| all | mask)
    };
    let same = |a: &AgentInstance, b: &AgentInstance| cameras_of(a) == cameras_of(b);
    let all = shared.all.chunk_by(same).map(|agents| Run {
        cameras: cameras_of(&agents[0]),
        agents: agents.to_vec(),
    });
    all.filter(|run| run.cameras != 0).collect()
}
