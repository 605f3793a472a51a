//! Frame in flight: buffers that the host writes before it, buffers that the host reads after it,
//! and its agents.

use std::time::{Duration, Instant};

use decouplegs_gpu::{Buffer, Gpu, MemoryKind, Recorder, Ticket};
use decouplegs_scene::GroundShadow;

use crate::RenderError;
use crate::agents::{AgentList, Scene};
use crate::capacity::Capacity;
use crate::kernels::FrameVariant;
use crate::keys::KeyDecision;
use crate::layout::{CAMERAS_MAX, CameraRecord, LensRecord, RequiredCounts, ShadowRecord, View};
use crate::output::{OutputBuffers, Outputs};
use crate::post_processing::{PhotometryRecord, ProcessedView};
use crate::relit::RelitCodebooks;
use crate::resident::GpuScene;
use crate::staged_agents::StagedAgents;
use crate::stages::{AgentBuffers, AgentCounts, FrameData, PURPOSE, ShadowBuffers};
use crate::taken::SharedShelf;

/// A frame that was submitted and not yet finished.
pub(crate) struct Pending {
    pub world: GpuScene,
    pub variant: FrameVariant,
    pub keys: KeyDecision,
    /// The persistent key buffer that it was submitted with.
    pub kept_keys: Buffer<u32>,
    pub frame: Ticket,
    /// The agents' part, where there is one.
    pub update: Option<Ticket>,
    pub capacity: Capacity,
    pub since: Instant,
    /// Time at which all of it was submitted.
    pub submitted: Instant,
    pub record_time: Duration,
}

/// The buffers of one frame in flight.
pub(crate) struct FrameInFlight {
    staged_cameras: Buffer<CameraRecord>,
    staged_lenses: Buffer<LensRecord>,
    pub staged_key_sets: Buffer<u32>,
    pub staged_photometry: Buffer<PhotometryRecord>,
    agents: StagedAgents,
    pub relit: RelitCodebooks,
    staged_shadows: Buffer<ShadowRecord>,
    pub shadows: ShadowBuffers,
    /// Shadows and clusters that there is room for.
    shadow_room: (usize, usize),
    /// Shadows of the frame.
    pub shadow_count: usize,
    pub images: OutputBuffers,
    no_images: OutputBuffers,
    /// Pixels and splats that the images are made for.
    room: (usize, usize),
    pub found_required: Buffer<RequiredCounts>,
    pub view: Option<View>,
    /// Cameras of the view as post-processing sees them; none without it.
    pub processed: Vec<ProcessedView>,
    pub list: Option<AgentList>,
    pub pending: Option<Pending>,
    /// The frame that was finished last, whose images are those above.
    pub done: Option<Ticket>,
}

impl FrameInFlight {
    /// Buffers for no agents and no pixels yet.
    pub fn new(gpu: &Gpu, outputs: &Outputs) -> Result<Self, RenderError> {
        let no_images = OutputBuffers::new(gpu, 0, 0, outputs)?;
        Ok(Self {
            staged_cameras: gpu.buffer(
                "staged_cameras",
                PURPOSE,
                CAMERAS_MAX,
                MemoryKind::Upload,
            )?,
            staged_lenses: gpu.buffer("staged_lenses", PURPOSE, CAMERAS_MAX, MemoryKind::Upload)?,
            staged_key_sets: gpu.buffer(
                "staged_key_sets",
                PURPOSE,
                CAMERAS_MAX,
                MemoryKind::Upload,
            )?,
            staged_photometry: gpu.buffer(
                "staged_photometry",
                PURPOSE,
                CAMERAS_MAX,
                MemoryKind::Upload,
            )?,
            agents: StagedAgents::new(gpu)?,
            relit: RelitCodebooks::new(gpu)?,
            staged_shadows: gpu.buffer("staged_shadows", PURPOSE, 0, MemoryKind::Upload)?,
            shadows: ShadowBuffers::new(gpu, 0, 0)?,
            shadow_room: (0, 0),
            shadow_count: 0,
            images: no_images.clone(),
            no_images,
            room: (0, 0),
            found_required: gpu.buffer("found_required", PURPOSE, 1, MemoryKind::Readback)?,
            view: None,
            processed: Vec::new(),
            list: None,
            pending: None,
            done: None,
        })
    }

    /// Removes its images, with the size that they were made for; none remain.
    pub fn give_images(&mut self) -> ((usize, usize), OutputBuffers) {
        let room = std::mem::take(&mut self.room);
        (
            room,
            std::mem::replace(&mut self.images, self.no_images.clone()),
        )
    }

    /// Pixels that its images are made for.
    pub fn pixels(&self) -> usize {
        self.room.0
    }

    /// The assets of its agents.
    pub fn pool(&self) -> Option<&crate::asset_pool::PoolBuffers> {
        self.list.as_ref().map(|list| &list.pool)
    }

    /// Takes the views and agents of the next frame, and the shadows of `scene`. The frame before
    /// in this slot must be done.
    pub fn set(
        &mut self,
        gpu: &Gpu,
        (outputs, shelf): (&Outputs, &SharedShelf),
        view: View,
        scene: &Scene<'_>,
        list: Option<AgentList>,
    ) -> Result<(), RenderError> {
        self.view = None;
        let splats = scene.world.splats;
        let room = (view.pixels, splats * usize::from(outputs.contributions));
        if self.room != room {
            // The old ones go first: both would not always fit.
            self.give_images();
            self.images = match shelf.find(room) {
                Some(waiting) => waiting,
                None => OutputBuffers::new(gpu, view.pixels, splats, outputs)?,
            };
            self.room = room;
        }
        self.staged_cameras.write_host(0, &view.cameras);
        self.staged_lenses.write_host(0, &view.lenses);
        self.set_shadows(gpu, scene)?;
        let mut list = list;
        if let Some(list) = &mut list {
            self.agents.fit(gpu, list.counts)?;
            let wanted: Vec<_> = list
                .relights
                .iter()
                .map(|&(_, asset, relight)| (asset, relight))
                .collect();
            for (&(agent, ..), first) in list.relights.iter().zip(self.relit.set(gpu, &wanted)?) {
                list.records[agent].first_color = first;
            }
            self.agents.write(list);
        }
        self.list = list;
        self.view = Some(view);
        Ok(())
    }

    fn set_shadows(&mut self, gpu: &Gpu, scene: &Scene<'_>) -> Result<(), RenderError> {
        let (world, shadows, cameras) = (scene.world, scene.shadows, scene.shadow_cameras);
        let (room, clusters) = (self.shadow_room, world.cluster_count());
        if shadows.len() > room.0 || clusters > room.1 {
            let wanted = if shadows.len() > room.0 {
                shadows.len() + shadows.len() / 4
            } else {
                room.0
            };
            self.staged_shadows =
                gpu.buffer("staged_shadows", PURPOSE, wanted, MemoryKind::Upload)?;
            self.shadows = ShadowBuffers::new(gpu, wanted, clusters)?;
            self.shadow_room = (wanted, clusters);
        }
        let record = |(index, shadow): (usize, &GroundShadow)| ShadowRecord {
            cameras: cameras.map_or(u32::MAX, |cameras| cameras[index]),
            ..ShadowRecord::new(shadow, world.origin)
        };
        let records: Vec<ShadowRecord> = shadows.iter().enumerate().map(record).collect();
        self.staged_shadows.write_host(0, &records);
        self.shadow_count = shadows.len();
        Ok(())
    }

    /// Records the copy of what the host wrote of shadows.
    pub fn copy_shadows(&self, recorder: &mut Recorder) {
        recorder.copy(
            &self.staged_shadows,
            0,
            &self.shadows.shadows,
            0,
            self.shadow_count,
        );
    }

    /// Buffers of its agents.
    pub fn agents(&self) -> &AgentBuffers {
        &self.agents.buffers
    }

    /// Buffers that the host wrote of the view.
    pub fn staged(&self) -> FrameData<'_> {
        FrameData {
            cameras: &self.staged_cameras,
            lenses: &self.staged_lenses,
            key_sets: &self.staged_key_sets,
        }
    }

    /// Lenses of the view; 0 where all cameras are pinholes.
    pub fn lens_count(&self) -> usize {
        self.view.as_ref().map_or(0, |view| view.lenses.len())
    }

    /// Records the copy of what the host wrote of agents.
    pub fn copy_agents(&self, recorder: &mut Recorder, counts: AgentCounts) {
        self.agents.copy(recorder, counts);
        let lenses = &self.agents.buffers.lenses;
        recorder.copy(&self.staged_lenses, 0, lenses, 0, self.lens_count());
    }
}
