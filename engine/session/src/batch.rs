//! Batching of cameras and worlds into frames.

use std::ops::Range;
use std::sync::Arc;

use decouplegs_render::layout::CAMERAS_MAX;
use decouplegs_render::{Agent, Scene};
use decouplegs_scene::{Camera, ContactShadow};

use super::batch_renderer::WorldView;
use super::{SessionError, SessionScene};
use crate::{AgentInstance, LiveScene};

/// Some cameras of one view.
pub(super) struct Part {
    pub view: usize,
    pub cameras: Range<usize>,
}

/// Contents of one frame: cameras over one background.
pub(super) struct Batch {
    pub scene: Arc<SessionScene>,
    pub parts: Vec<Part>,
}

/// The frames that draw `views`, in order: of one scene each, with no more cameras than a frame can
/// have, nor more pixels than `pixels_max` unless it is one camera.
pub(super) fn batches(
    views: &[WorldView<'_>],
    pixels_max: u64,
) -> Result<Vec<Batch>, SessionError> {
    let mut batches: Vec<Batch> = Vec::new();
    let (mut cameras, mut pixels) = (0, 0);
    for (
        view,
        WorldView {
            world,
            cameras: wanted,
        },
    ) in views.iter().enumerate()
    {
        if wanted.is_empty() {
            return Err(SessionError::NoCameras);
        }
        for (index, camera) in wanted.iter().enumerate() {
            let own = camera.intrinsics.pixels();
            let fits = cameras < CAMERAS_MAX && pixels + own <= pixels_max;
            match batches
                .last_mut()
                .filter(|batch| fits && Arc::ptr_eq(&batch.scene, world.scene()))
            {
                Some(batch) => match batch.parts.last_mut().filter(|part| part.view == view) {
                    Some(part) => part.cameras.end = index + 1,
                    None => batch.parts.push(Part {
                        view,
                        cameras: index..index + 1,
                    }),
                },
                None => {
                    (cameras, pixels) = (0, 0);
                    let parts = vec![Part {
                        view,
                        cameras: index..index + 1,
                    }];
                    batches.push(Batch {
                        scene: world.scene().clone(),
                        parts,
                    });
                }
            }
            (cameras, pixels) = (cameras + 1, pixels + own);
        }
    }
    Ok(batches)
}

/// The agents of a batch, each seen by the cameras of its world.
pub(super) struct AgentBatch {
    agents: Vec<Agent>,
    shadows: Vec<ContactShadow>,
    shadow_cameras: Option<Vec<u32>>,
}

impl Batch {
    /// Cameras, in the order of the frame's images.
    pub fn cameras(&self, views: &[WorldView<'_>]) -> Vec<Camera> {
        self.parts
            .iter()
            .flat_map(|part| {
                views[part.view].cameras[part.cameras.clone()]
                    .iter()
                    .cloned()
            })
            .collect()
    }

    /// Agents, in the light of the scene.
    pub fn cast(&self, live: &LiveScene, views: &[WorldView<'_>]) -> AgentBatch {
        let mut cast = AgentBatch {
            agents: Vec::new(),
            shadows: Vec::new(),
            shadow_cameras: None,
        };
        let mut shadow_cameras = Vec::new();
        let mut first = 0;
        for part in &self.parts {
            let own = ((1u64 << part.cameras.len()) - 1) << first;
            first += part.cameras.len();
            let placed: Vec<AgentInstance> = views[part.view]
                .world
                .agents()
                .iter()
                .map(|agent| agent.placed)
                .collect();
            let moment = live.placed(&placed);
            cast.agents
                .extend(moment.agents.into_iter().map(|agent| Agent {
                    cameras: own as u32,
                    ..agent
                }));
            shadow_cameras.extend(std::iter::repeat_n(own as u32, moment.shadows.len()));
            cast.shadows.extend(moment.shadows);
        }
        // One world needs no masks, and kernels without them are the faster ones.
        cast.shadow_cameras =
            (self.parts.len() > 1 && !shadow_cameras.is_empty()).then_some(shadow_cameras);
        cast
    }
}

impl AgentBatch {
    /// The background of `live` with these agents.
    pub fn over<'a>(&'a self, live: &'a LiveScene) -> Scene<'a> {
        Scene {
            shadows: &self.shadows,
            shadow_cameras: self.shadow_cameras.as_deref(),
            ..Scene::with_agents(&live.world, &live.pool, &self.agents)
        }
    }
}
