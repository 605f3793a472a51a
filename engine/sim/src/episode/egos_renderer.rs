//! Readings of the sensors of several egos, drawn as views of one world.

use std::sync::Arc;
use std::time::Duration;

use decouplegs_scene::episode::{DrawnBy, ReadingRecord};
use decouplegs_scene::{Camera, LidarSweep, Motion, Pose, Rig, random};
use decouplegs_session::{
    BatchRenderer, HostImages, Scene, SessionError, TracedSweep, World, WorldView,
};
use rayon::prelude::*;

use super::observation_renderer::{drawn_by, record_image, record_sweep, sweeps_of};
use super::simulation::Simulation;
use crate::planner::Reading;

/// Renderer of what the sensors of all egos observe in an episode. One frame shows the cameras of
/// all of them: what they have in common is prepared once.
pub struct EgosRenderer {
    renderer: BatchRenderer,
    world: World,
    every: u32,
    egos: Vec<Seat>,
    images: HostImages,
    /// States of the beams of the last sweeps. Their memory is used again.
    traced: Vec<TracedSweep>,
    device_time: Duration,
}

/// Sensors of an ego, and its last readings.
struct Seat {
    rig: Rig,
    /// View of its cameras among those of the last frame; `None` where none was drawn.
    view: Option<usize>,
    /// The last sweep of each LiDAR; none at a step that is not drawn.
    sweeps: Vec<LidarSweep>,
}

/// An ego at a step that is drawn.
struct Seen {
    ego: usize,
    pose: Pose,
    motion: Motion,
    /// World without the body of the ego.
    world: World,
}

impl EgosRenderer {
    /// The sensors of `rigs`, those of the egos in the order of the scenario, in `scene`, drawn by
    /// `renderer` at every `every`th step.
    #[must_use]
    pub fn new(renderer: BatchRenderer, scene: &Arc<Scene>, rigs: Vec<Rig>, every: u32) -> Self {
        let seat = |rig: Rig| Seat {
            rig,
            view: None,
            sweeps: Vec::new(),
        };
        Self {
            renderer,
            world: World::empty(scene),
            every: every.max(1),
            egos: rigs.into_iter().map(seat).collect(),
            images: HostImages::default(),
            traced: Vec::new(),
            device_time: Duration::ZERO,
        }
    }

    /// The sensors of ego `ego`, from 0.
    ///
    /// # Panics
    /// Panics if there is no such ego.
    #[must_use]
    pub fn rig(&self, ego: usize) -> &Rig {
        &self.egos[ego].rig
    }

    /// Record of the renderer of ego `ego` for a log.
    ///
    /// # Panics
    /// Panics if there is no such ego.
    #[must_use]
    pub fn drawn_by(&self, ego: usize) -> Option<DrawnBy> {
        drawn_by(self.rig(ego), &self.renderer, self.every)
    }

    /// Time of the device for the images of the last observation.
    #[must_use]
    pub fn device_time(&self) -> Duration {
        self.device_time
    }

    /// Draws `simulation` as the egos that drive see it, if `step` is one that is drawn, and traces
    /// the sweeps that end then. Readings of earlier steps are gone either way.
    ///
    /// # Errors
    /// Returns an error if the device was lost or has not the memory, or the scene has not the
    /// agents' assets.
    pub fn draw(&mut self, simulation: &Simulation, step: u32) -> Result<(), SessionError> {
        self.images.clear();
        self.device_time = Duration::ZERO;
        for seat in &mut self.egos {
            seat.view = None;
            seat.sweeps.clear();
        }
        if !step.is_multiple_of(self.every) {
            return Ok(());
        }
        let seen = self.seen(simulation)?;
        let cameras: Vec<Vec<Camera>> = seen
            .iter()
            .map(|seen| self.egos[seen.ego].rig.moving_at(&seen.pose, &seen.motion))
            .collect();
        let views = seen.iter().zip(&cameras);
        let views = views.filter(|(_, cameras)| !cameras.is_empty());
        let views: Vec<(usize, WorldView)> = views
            .map(|(seen, cameras)| {
                (
                    seen.ego,
                    WorldView {
                        world: &seen.world,
                        cameras,
                    },
                )
            })
            .collect();
        for (view, (ego, _)) in views.iter().enumerate() {
            self.egos[*ego].view = Some(view);
        }
        let views: Vec<WorldView> = views.into_iter().map(|(_, view)| view).collect();
        // The device draws the images while the host prepares the first sweep.
        if !views.is_empty() {
            self.renderer.submit(&views)?;
        }
        let seed = random::mix(simulation.scenario().seed ^ u64::from(step));
        let traced = seen.iter().try_for_each(|seen| self.trace(seen, seed));
        if !views.is_empty() {
            let frames = self.renderer.finish(&mut self.images)?;
            self.device_time = frames.iter().map(|frame| frame.gpu_time).sum();
        }
        traced
    }

    /// Egos that drive and have sensors, with what they see.
    fn seen(&mut self, simulation: &Simulation) -> Result<Vec<Seen>, SessionError> {
        simulation.show_all(&mut self.world)?;
        let egos = 0..self.egos.len();
        let egos = egos.filter(|&ego| {
            let has_ended = simulation.view(ego).end().is_some();
            !has_ended && !self.egos[ego].rig.sensors.is_empty()
        });
        let egos: Vec<usize> = egos.collect();
        let bodies = egos.iter().filter_map(|&ego| simulation.ego_instance(ego));
        let worlds = self.world.without_each(&bodies.collect::<Vec<u16>>());
        let seen = egos.into_iter().zip(worlds).map(|(ego, world)| {
            let (pose, motion) = simulation.view(ego).pose();
            Seen {
                ego,
                pose,
                motion,
                world,
            }
        });
        Ok(seen.collect())
    }

    fn trace(&mut self, seen: &Seen, seed: u64) -> Result<(), SessionError> {
        let seat = &mut self.egos[seen.ego];
        let (sweeps, options) = sweeps_of(&seat.rig, (&seen.pose, &seen.motion), seed);
        self.renderer
            .trace_all(&seen.world, &sweeps, &mut self.traced)?;
        let returns = self.traced.iter().zip(&options);
        seat.sweeps = returns
            .map(|(traced, options)| traced.returns(options))
            .collect();
        Ok(())
    }

    /// Readings of ego `ego` at the last observation.
    ///
    /// # Panics
    /// Panics if there is no such ego.
    #[must_use]
    pub fn readings(&self, ego: usize) -> Vec<Reading<'_>> {
        let seat = &self.egos[ego];
        let drawn = seat.view.iter().flat_map(|&view| {
            let cameras = seat.rig.cameras().enumerate();
            cameras.map(move |(index, camera)| (camera, self.images.rgba(view, index)))
        });
        let images = drawn.map(|(camera, rgba)| Reading::image(camera, rgba));
        images
            .chain(seat.sweeps.iter().map(Reading::Sweep))
            .collect()
    }

    /// Hashes of these readings.
    ///
    /// # Panics
    /// Panics if there is no such ego.
    #[must_use]
    pub fn hashes(&self, ego: usize) -> Vec<ReadingRecord> {
        let readings = self.readings(ego);
        let hash = |reading: &Reading| match reading {
            Reading::Image(frame) => record_image(frame.camera, frame.rgba),
            Reading::Sweep(sweep) => record_sweep(sweep),
        };
        readings.par_iter().map(hash).collect()
    }
}
