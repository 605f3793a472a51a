//! Readings of the ego's sensors.

use std::sync::Arc;
use std::time::Duration;

use decouplegs_asset::{AssetError, read_lidar};
use decouplegs_scene::episode::{DrawnBy, ReadingRecord};
use decouplegs_scene::lidar::{ROOF_M, ReturnOptions};
use decouplegs_scene::{
    Camera, Invalid, LidarSweep, Motion, Pose, Rig, RigCamera, RigLidar, random,
};
use decouplegs_session::{
    BatchRenderer, HostImages, RigSweep, Scene, SessionError, TracedSweep, World, WorldView,
    hash_bytes,
};
use rayon::prelude::*;

use super::simulation::Simulation;
use crate::planner::{Cameras, Reading};

/// Renderer of what the ego's sensors observe in an episode.
pub struct ObservationRenderer {
    renderer: BatchRenderer,
    world: World,
    rig: Rig,
    f_theta: bool,
    every: u32,
    images: HostImages,
    /// Hashes of the last images, where these stayed on the device.
    hashed: Vec<u128>,
    /// The last sweep of each LiDAR; none at a step that is not drawn.
    sweeps: Vec<LidarSweep>,
    /// States of the beams of these sweeps. Their memory is used again.
    traced: Vec<TracedSweep>,
    /// Time of the device for the last images.
    device_time: Duration,
}

/// Cameras of `rig` that `cameras` selects, at `size_px` if given.
///
/// # Errors
/// Returns an error if there is none to choose from, or none with a requested name.
pub fn chosen(rig: &Rig, cameras: &Cameras, size_px: Option<[u32; 2]>) -> Result<Rig, Invalid> {
    let first = || {
        rig.cameras()
            .find(|camera| camera.name == "front")
            .or(rig.cameras().next())
    };
    let mut chosen: Vec<RigCamera> = match cameras {
        Cameras::None => Vec::new(),
        Cameras::Front => first().cloned().into_iter().collect(),
        Cameras::Named(names) => {
            let named = |name: &String| camera_named(rig, name).cloned();
            names.iter().map(named).collect::<Result<_, _>>()?
        }
        Cameras::All => rig.cameras().cloned().collect(),
    };
    if *cameras != Cameras::None && chosen.is_empty() {
        return Err("the planner wants images, and the scene has no cameras: add a [[rig]] to the scene file".into());
    }
    if let Some([width_px, height_px]) = size_px {
        for camera in &mut chosen {
            camera.intrinsics = camera.intrinsics.resized(width_px, height_px);
        }
    }
    Ok(Rig::from_iter(chosen))
}

/// The camera of `rig` called `name`.
///
/// # Errors
/// A sentence with the names of the cameras that there are.
pub fn camera_named<'a>(rig: &'a Rig, name: &str) -> Result<&'a RigCamera, Invalid> {
    let mut cameras = rig.cameras();
    cameras.find(|camera| camera.name == name).ok_or_else(|| {
        let names: Vec<&str> = rig.cameras().map(|camera| camera.name.as_str()).collect();
        let found = match names.as_slice() {
            [] => "no camera".to_owned(),
            names => names.join(", "),
        };
        Invalid::new(format!("the scene has no camera {name:?}; it has {found}"))
    })
}

/// The LiDARs called `names`: those of `rig`, otherwise models by name or file, on the roof of the
/// ego. All of `rig` with `all`, and these first.
///
/// # Errors
/// [`AssetError`] where `rig` has no such LiDAR and there is no such model.
pub fn chosen_lidars(rig: &Rig, all: bool, names: &[String]) -> Result<Vec<RigLidar>, AssetError> {
    let mut chosen: Vec<RigLidar> = match all {
        true => rig.lidars().cloned().collect(),
        false => Vec::new(),
    };
    for name in names {
        if chosen.iter().any(|lidar| lidar.name == *name) {
            continue;
        }
        let of_rig = rig.lidars().find(|lidar| lidar.name == *name);
        chosen.push(match of_rig {
            Some(lidar) => lidar.clone(),
            None => RigLidar {
                name: name.clone(),
                model: Arc::new(read_lidar(name.as_ref())?),
                rig_from_lidar: Pose {
                    translation: ROOF_M,
                    ..Pose::IDENTITY
                },
            },
        });
    }
    Ok(chosen)
}

impl ObservationRenderer {
    /// The sensors of `rig` in `scene`, drawn by `renderer` at every `every`th step.
    #[must_use]
    pub fn new(renderer: BatchRenderer, scene: &Arc<Scene>, rig: Rig, every: u32) -> Self {
        Self {
            renderer,
            world: World::empty(scene),
            rig,
            f_theta: false,
            every: every.max(1),
            images: HostImages::default(),
            hashed: Vec::new(),
            sweeps: Vec::new(),
            traced: Vec::new(),
            device_time: Duration::ZERO,
        }
    }

    /// Replaces the cameras by [`decouplegs_scene::Intrinsics::through_f_theta`].
    ///
    /// # Errors
    /// A sentence naming a camera that no such lens can replace.
    pub fn through_f_theta(mut self) -> Result<Self, Invalid> {
        for camera in self.rig.cameras_mut() {
            let fitted = camera.intrinsics.through_f_theta();
            camera.intrinsics = fitted.ok_or_else(|| {
                Invalid::new(format!(
                    "camera {:?} sees no ray at the edge of its image: no f-theta lens shows the same",
                    camera.name
                ))
            })?;
        }
        self.f_theta = true;
        Ok(self)
    }

    /// The sensors.
    #[must_use]
    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    /// The sensors of `rig` in `scene`, for another episode, in the memory of this one: images in
    /// new memory take several times as long to copy.
    #[must_use]
    pub fn restarted(self, scene: &Arc<Scene>, rig: Rig, every: u32) -> Self {
        Self {
            images: self.images,
            traced: self.traced,
            ..Self::new(self.renderer, scene, rig, every)
        }
    }

    /// Record of the renderer for a log.
    #[must_use]
    pub fn drawn_by(&self) -> Option<DrawnBy> {
        let drawn_by = drawn_by(&self.rig, &self.renderer, self.every);
        drawn_by.map(|record| DrawnBy {
            f_theta: self.f_theta,
            ..record
        })
    }

    /// Submits the images of `simulation`, without sweeps, if `step` is one that is drawn; true if
    /// it is. Readings of earlier steps stay until [`Self::finish`].
    ///
    /// # Errors
    /// Returns the errors of [`Self::draw`].
    pub(super) fn submit(
        &mut self,
        simulation: &Simulation,
        step: u32,
    ) -> Result<bool, SessionError> {
        if self.rig.cameras().next().is_none() || !step.is_multiple_of(self.every) {
            return Ok(false);
        }
        let (ego, motion) = simulation.view(0).show(&mut self.world)?;
        let cameras = self.rig.moving_at(&ego, &motion);
        self.submit_cameras(&cameras)?;
        Ok(true)
    }

    fn submit_cameras(&mut self, cameras: &[Camera]) -> Result<(), SessionError> {
        let world = &self.world;
        self.renderer.submit(&[WorldView { world, cameras }])
    }

    fn forget_readings(&mut self) {
        self.images.clear();
        self.hashed.clear();
        self.sweeps.clear();
        self.device_time = Duration::ZERO;
    }

    /// Brings the images that were submitted first to the host, if the step `is_drawn`, or their
    /// hashes alone unless they are used (`is_watched`). Readings of earlier steps are gone either
    /// way.
    ///
    /// # Errors
    /// Returns an error if the device was lost or has not the memory.
    pub(super) fn finish(&mut self, is_drawn: bool, is_watched: bool) -> Result<(), SessionError> {
        self.forget_readings();
        if !is_drawn {
            return Ok(());
        }
        let frames = if is_watched {
            self.renderer.finish(&mut self.images)?
        } else {
            let (hashes, frames) = self.renderer.finish_hashes()?;
            self.hashed = hashes.into_iter().flatten().collect();
            frames
        };
        self.device_time = frames.iter().map(|frame| frame.gpu_time).sum();
        Ok(())
    }

    /// Draws `simulation` if `step` is one that is drawn, and traces the sweeps that end then.
    /// Readings of earlier steps are gone either way.
    ///
    /// # Errors
    /// Returns an error if the device was lost or has not the memory, or the scene has not the
    /// agents' assets.
    pub fn draw(&mut self, simulation: &Simulation, step: u32) -> Result<(), SessionError> {
        self.forget_readings();
        if self.rig.sensors.is_empty() || !step.is_multiple_of(self.every) {
            return Ok(());
        }
        let (ego, motion) = simulation.view(0).show(&mut self.world)?;
        let cameras = self.rig.moving_at(&ego, &motion);
        let seed = random::mix(simulation.scenario().seed ^ u64::from(step));
        let (sweeps, options) = sweeps_of(&self.rig, (&ego, &motion), seed);
        // The device draws the images while the host prepares the first sweep.
        if !cameras.is_empty() {
            self.submit_cameras(&cameras)?;
        }
        let traced = (self.renderer).trace_all(&self.world, &sweeps, &mut self.traced);
        if !cameras.is_empty() {
            let frames = self.renderer.finish(&mut self.images)?;
            self.device_time = frames.iter().map(|frame| frame.gpu_time).sum();
        }
        traced?;
        let returns = self.traced.iter().zip(&options);
        self.sweeps = returns
            .map(|(traced, options)| traced.returns(options))
            .collect();
        Ok(())
    }

    /// Time of the device for the images of the last observation, without their way to the host.
    #[must_use]
    pub fn device_time(&self) -> Duration {
        self.device_time
    }

    /// Readings of the last observation.
    #[must_use]
    pub fn readings(&self) -> Vec<Reading<'_>> {
        let images = self.drawn();
        let images = images.map(|(camera, rgba)| Reading::image(camera, rgba));
        images
            .chain(self.sweeps.iter().map(Reading::Sweep))
            .collect()
    }

    /// Hashes of the readings of the last observation.
    #[must_use]
    pub fn hashes(&self) -> Vec<ReadingRecord> {
        let drawn: Vec<_> = self.drawn().collect();
        let hash = |(camera, rgba): (&RigCamera, &[u8])| record_image(camera, rgba);
        let images = drawn.into_par_iter().map(hash);
        // Those that stayed on the device.
        let hashed = self.rig.cameras().zip(&self.hashed);
        let hashed = hashed.map(|(camera, hash)| ReadingRecord {
            sensor: camera.name.clone(),
            hash: *hash,
        });
        let hashed: Vec<ReadingRecord> = hashed.collect();
        let sweeps = self.sweeps.par_iter().map(record_sweep);
        images.chain(hashed).chain(sweeps).collect()
    }

    /// Cameras and their images; none at a step that is not drawn.
    fn drawn(&self) -> impl Iterator<Item = (&RigCamera, &[u8])> {
        let is_drawn = self.images.views() > 0;
        let cameras = self.rig.cameras().enumerate().filter(move |_| is_drawn);
        cameras.map(|(index, camera)| (camera, self.images.rgba(0, index)))
    }
}

/// Hash of a reading, as [`ReadingRecord`] has it.
#[must_use]
pub fn reading_hash(bytes: &[u8]) -> u128 {
    hash_bytes(bytes)
}

/// Record for a log of what draws the sensors of `rig`, through their own lenses; `None` where
/// there are none.
pub(super) fn drawn_by(rig: &Rig, renderer: &BatchRenderer, every: u32) -> Option<DrawnBy> {
    let first = rig.cameras().next();
    let size_px = first.map(|camera| camera.intrinsics);
    (!rig.sensors.is_empty()).then(|| DrawnBy {
        device: renderer.gpu().info().to_string(),
        width_px: size_px.map_or(0, |k| k.width_px),
        height_px: size_px.map_or(0, |k| k.height_px),
        every,
        f_theta: false,
    })
}

/// Sweeps of the LiDARs of `rig` that end at the pose and the motion of an ego, and the options of
/// their returns.
pub(super) fn sweeps_of(
    rig: &Rig,
    (pose, motion): (&Pose, &Motion),
    seed: u64,
) -> (Vec<RigSweep>, Vec<ReturnOptions>) {
    let lidars = rig.sweeps_until(pose, motion);
    let options = lidars.iter().zip(0..).map(|(lidar, index)| ReturnOptions {
        seed: seed.wrapping_add(index),
        ..ReturnOptions::for_model(&lidar.model)
    });
    let options: Vec<ReturnOptions> = options.collect();
    let sweeps = lidars.into_iter().zip(&options);
    let sweeps = sweeps.map(|(lidar, options)| RigSweep {
        world_s: lidar.model.sweep_s,
        mode: options.mode,
        lidar,
    });
    (sweeps.collect(), options)
}

/// Record of an image of `camera`.
pub(super) fn record_image(camera: &RigCamera, rgba: &[u8]) -> ReadingRecord {
    ReadingRecord {
        sensor: camera.name.clone(),
        hash: reading_hash(rgba),
    }
}

/// Record of a sweep.
pub(super) fn record_sweep(sweep: &LidarSweep) -> ReadingRecord {
    ReadingRecord {
        sensor: sweep.lidar.name.clone(),
        hash: reading_hash(&sweep.bytes()),
    }
}
