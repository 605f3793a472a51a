//! Drives a mode through the scene: how long its frames take, what memory they hold, and its images
//! at the sampled moments.

use anyhow::Result;
use decouplegs::gpu::{Gpu, GpuError};
use decouplegs::render::layout::{CLUSTER_SPLATS, ClusterRecord, NodeRecord};
use decouplegs::render::{
    ColorFormat, Image, Outputs, Plane, RenderError, RenderOptions, Renderer, ResidentSplats,
    SHAPE_WORDS,
};
use decouplegs::scene::{Camera, CodedCloud, DetailLevels, SplatScene};
use decouplegs::{Session, SessionError, World};

use super::drive_schedule::DriveSchedule;
use super::fidelity::Fidelity;
use super::figures::{Measured, Outcome, stage_times};
use super::mode::{Agents, Mode};
use super::prune;
use super::workload::Workload;

/// Moments of the ego's way from which the importance of splats is measured for pruning.
const PRUNE_MOMENTS: u32 = 8;

/// Setup for measuring modes.
pub struct TestRig<'a> {
    pub gpu: &'a Gpu,
    pub workload: Workload,
    pub schedule: &'a DriveSchedule,
    pub memory_limit_bytes: Option<u64>,
    /// Importance of each splat of the cloud with the given number of agents.
    importance: Option<(usize, Vec<f64>)>,
}

/// Background and agents on the device.
enum Resident {
    Copies(Box<ResidentSplats>),
    Coded(World),
}

impl Resident {
    fn submit(
        &mut self,
        renderer: &mut Renderer,
        time_s: f64,
        cameras: &[Camera],
    ) -> Result<(), RenderError> {
        match self {
            Self::Copies(splat_scene) => renderer.submit(&**splat_scene, cameras),
            Self::Coded(world) => {
                world.set_time(time_s);
                world.lend(|splats| renderer.submit(splats, cameras))
            }
        }
    }
}

impl<'a> TestRig<'a> {
    pub fn new(
        gpu: &'a Gpu,
        workload: Workload,
        schedule: &'a DriveSchedule,
        memory_limit_bytes: Option<u64>,
    ) -> Self {
        Self {
            gpu,
            workload,
            schedule,
            memory_limit_bytes,
            importance: None,
        }
    }

    /// Measures the first `count` agents in `mode`. The images at the sampled moments are compared
    /// with `vanilla` if given.
    pub fn measure(
        &mut self,
        mode: &Mode,
        count: usize,
        vanilla: Option<&[Image]>,
    ) -> Result<(Outcome, Vec<Image>)> {
        match self.try_measure(mode, count, vanilla) {
            Ok(found) => Ok(found),
            Err(error) => match refusal(&error) {
                Some(outcome) => Ok((outcome, Vec::new())),
                None => Err(error),
            },
        }
    }

    /// The images that others are compared with, with instances; `None` where the device has not
    /// the memory for them.
    pub fn vanilla_images(&mut self, count: usize) -> Result<Option<Vec<Image>>> {
        let outputs = Outputs {
            planes: [Plane::Instance].into(),
            ..Outputs::default()
        };
        let options = RenderOptions {
            outputs,
            frames_in_flight: 1,
            keep_keys: false,
            ..self.defaults()
        };
        match self.images_of_copies(options, count, None) {
            Ok(images) => Ok(Some(images)),
            Err(error) if refusal(&error).is_some() => Ok(None),
            Err(error) => Err(error),
        }
    }

    fn defaults(&self) -> RenderOptions {
        RenderOptions {
            rules: self.workload.background().splat_scene.rules,
            ..RenderOptions::default()
        }
    }

    fn try_measure(
        &mut self,
        mode: &Mode,
        count: usize,
        vanilla: Option<&[Image]>,
    ) -> Result<(Outcome, Vec<Image>)> {
        let kept = self.kept(mode, count)?;
        let rules = self.workload.background().splat_scene.rules;
        let (schedule, limit_bytes) = (self.schedule, self.memory_limit_bytes.unwrap_or(u64::MAX));
        let predicted_scene_bytes;
        let world_splats;
        let measured = {
            let options = mode.options(rules, ColorFormat::U8);
            let mut renderer = Renderer::new(self.gpu, options);
            let mut resident = match mode.agents {
                Agents::Copies { .. } => {
                    let splat_scene = SplatScene {
                        instance_from_splat: Vec::new(),
                        ..self.copies(count, schedule.middle_s(), kept.as_deref())
                    };
                    predicted_scene_bytes = world_bytes(&splat_scene, mode);
                    world_splats = splat_scene.splats.len();
                    if predicted_scene_bytes > limit_bytes {
                        return Ok((out_of_memory(predicted_scene_bytes, PREDICTED), Vec::new()));
                    }
                    Resident::Copies(Box::new(renderer.upload(&splat_scene)?))
                }
                Agents::Coded(coding) => {
                    let scene = self.workload.staged(count, coding);
                    predicted_scene_bytes = world_bytes(&scene.splat_scene, mode)
                        + scene.assets.iter().map(asset_bytes).sum::<u64>();
                    world_splats = scene.splat_scene.splats.len();
                    if predicted_scene_bytes > limit_bytes {
                        return Ok((out_of_memory(predicted_scene_bytes, PREDICTED), Vec::new()));
                    }
                    let session = Session::on(self.gpu, &options.into());
                    Resident::Coded(World::new(&session.add_scene(scene)?))
                }
            };
            let mut submit = |renderer: &mut Renderer, time_s: f64| {
                Ok(resident.submit(
                    renderer,
                    time_s,
                    &self.schedule.cameras(self.workload.background(), time_s),
                )?)
            };
            let driven = self.schedule.drive(&mut renderer, &mut submit)?;
            let memory = self.gpu.memory();
            let by_stage = self.schedule.drive_by_stage(&mut renderer, submit)?;
            Measured {
                stages: stage_times(&by_stage),
                ..Measured::from_driven(&driven, memory)
            }
        };
        if measured.memory.total_bytes > limit_bytes {
            return Ok((
                out_of_memory(measured.memory.total_bytes, COUNTED),
                Vec::new(),
            ));
        }
        let mut measured = Measured {
            predicted_scene_bytes,
            world_splats,
            ..measured
        };
        let mut images = Vec::new();
        if let Some(vanilla) = vanilla.filter(|vanilla| !vanilla.is_empty() && !mode.is_vanilla()) {
            images = self.images(mode, count, kept.as_deref())?;
            measured.fidelity = Some(Fidelity::between(&images, vanilla)?);
        }
        Ok((Outcome::Measured(Box::new(measured)), images))
    }

    /// The images of `mode` at the sampled moments, all cameras of one after those of the other.
    fn images(&mut self, mode: &Mode, count: usize, kept: Option<&[u32]>) -> Result<Vec<Image>> {
        let options = RenderOptions {
            frames_in_flight: 1,
            ..mode.options(self.defaults().rules, ColorFormat::F32)
        };
        let Agents::Coded(coding) = mode.agents else {
            return self.images_of_copies(options, count, kept);
        };
        let mut renderer = Renderer::new(self.gpu, options);
        let session = Session::on(self.gpu, &options.into());
        let scene = session.add_scene(self.workload.staged(count, coding))?;
        let mut resident = Resident::Coded(World::new(&scene));
        let mut images = Vec::new();
        for frame in self.schedule.sample_frames() {
            let time_s = self.schedule.time_s(frame);
            resident.submit(
                &mut renderer,
                time_s,
                &self.schedule.cameras(self.workload.background(), time_s),
            )?;
            renderer.finish()?;
            images.extend(renderer.read_images()?);
        }
        Ok(images)
    }

    fn images_of_copies(
        &self,
        options: RenderOptions,
        count: usize,
        kept: Option<&[u32]>,
    ) -> Result<Vec<Image>> {
        let mut renderer = Renderer::new(self.gpu, options);
        let mut images = Vec::new();
        for frame in self.schedule.sample_frames() {
            let time_s = self.schedule.time_s(frame);
            let splat_scene = renderer.upload(&self.copies(count, time_s, kept))?;
            renderer.render(
                &splat_scene,
                &self.schedule.cameras(self.workload.background(), time_s),
            )?;
            images.extend(renderer.read_images()?);
        }
        Ok(images)
    }

    /// Background and copies of the agents where they are at `time_s`; of all their splats those at
    /// `kept`, if given.
    fn copies(&self, count: usize, time_s: f64, kept: Option<&[u32]>) -> SplatScene {
        let splat_scene = self.workload.copies(count, time_s);
        let Some(kept) = kept else { return splat_scene };
        let of = |&splat: &u32| splat_scene.instance_from_splat[splat as usize];
        let instance_from_splat = if splat_scene.instance_from_splat.is_empty() {
            Vec::new()
        } else {
            kept.iter().map(of).collect()
        };
        SplatScene {
            splats: splat_scene.splats.select(kept),
            instance_from_splat,
            ..splat_scene
        }
    }

    /// The splats that `mode` keeps of background and copies; `None` for all.
    fn kept(&mut self, mode: &Mode, count: usize) -> Result<Option<Vec<u32>>> {
        let Agents::Copies { keep } = mode.agents else {
            return Ok(None);
        };
        if keep >= 1.0 {
            return Ok(None);
        }
        if self
            .importance
            .as_ref()
            .is_none_or(|(known, _)| *known != count)
        {
            self.importance = Some((count, self.measured_importance(count)?));
        }
        Ok(self
            .importance
            .as_ref()
            .map(|(_, importance)| prune::kept(importance, keep)))
    }

    fn measured_importance(&self, count: usize) -> Result<Vec<f64>> {
        let renderer = Renderer::new(self.gpu, self.defaults());
        let mut weights = Vec::new();
        for time_s in self
            .schedule
            .way_moments_s(self.workload.background(), PRUNE_MOMENTS)
        {
            let splat_scene = renderer.upload(&self.copies(count, time_s, None))?;
            let found = renderer.contribution_weights(
                &splat_scene,
                &self
                    .schedule
                    .all_cameras(self.workload.background(), time_s),
            )?;
            weights.resize(found.len(), 0.0);
            weights
                .iter_mut()
                .zip(found)
                .for_each(|(sum, weight)| *sum += f64::from(weight));
        }
        Ok(prune::importance(
            &self.copies(count, self.schedule.start_s, None).splats,
            &weights,
        ))
    }
}

const PREDICTED: &str = "predicted before upload: its splats alone";
const COUNTED: &str = "counted after the last frame";
const DEVICE: &str = "refused by the device";

fn out_of_memory(needed_bytes: u64, known: &'static str) -> Outcome {
    Outcome::OutOfMemory {
        needed_bytes,
        known,
    }
}

/// Outcome of a mode that cannot be rendered; `None` if the whole run has failed.
fn refusal(error: &anyhow::Error) -> Option<Outcome> {
    let error = match error.downcast_ref() {
        Some(SessionError::Render(error)) => error,
        _ => error.downcast_ref::<RenderError>()?,
    };
    match error {
        RenderError::Gpu(GpuError::OutOfMemory {
            wanted_bytes,
            used_bytes,
            ..
        }) => Some(out_of_memory(used_bytes + wanted_bytes, DEVICE)),
        RenderError::Gpu(GpuError::BufferTooLarge { .. }) | RenderError::TooManySplats { .. } => {
            Some(Outcome::Refused(error.to_string()))
        }
        _ => None,
    }
}

/// Size of `splat_scene` on the device, without the allocator's rounding.
fn world_bytes(splat_scene: &SplatScene, mode: &Mode) -> u64 {
    let (splats, cluster_bytes) = match mode.background_pitch_px {
        None => (splat_scene.splats.len(), size_of::<ClusterRecord>()),
        Some(_) => (
            DetailLevels::splats_at_most(splat_scene.splats.len()),
            size_of::<ClusterRecord>() + size_of::<NodeRecord>(),
        ),
    };
    let ids = 2 * usize::from(!splat_scene.instance_from_splat.is_empty());
    let splat_bytes = mode.storage.splat_bytes(splat_scene.splats.sh_degree) + ids;
    (splats * splat_bytes + splats.div_ceil(CLUSTER_SPLATS) * cluster_bytes) as u64
}

/// Size of an asset on the device, without rounding.
fn asset_bytes(asset: &CodedCloud) -> u64 {
    // A color's DC term, and its bands.
    const COLOR_BYTES: usize = 12 + 4 * 24;
    let clusters: usize = asset
        .levels
        .iter()
        .map(|level| level.div_ceil(CLUSTER_SPLATS))
        .sum();
    let books =
        asset.shapes.len() * size_of::<[f32; SHAPE_WORDS]>() + asset.color_count() * COLOR_BYTES;
    (size_of_val(asset.splats.as_slice()) + books + clusters * size_of::<ClusterRecord>()) as u64
}
