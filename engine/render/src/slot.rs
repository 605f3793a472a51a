//! Frame in flight: buffers that the host writes before it, and buffers that the host reads after
//! it.

use decouplegs_gpu::{Buffer, Gpu, GpuError, MemoryKind, Recorder};
use decouplegs_scene::GroundShadow;

use crate::RenderError;
use crate::agents::FrameSplats;
use crate::agents::relit::RelitCodebooks;
use crate::agents::staged_agents::StagedAgents;
use crate::images::taken::SharedImagePool;
use crate::layout::{CAMERAS_MAX, CameraRecord, LensRecord, RequiredCounts, ShadowRecord};
use crate::output::{OutputBuffers, Outputs};
use crate::post_processing::PhotometryRecord;
use crate::stages::{AgentBuffers, AgentCounts, DrawnAlone, FrameData, PURPOSE, ShadowBuffers};
use crate::submitted::FrameContents;

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
    pub images: OutputBuffers,
    no_images: OutputBuffers,
    /// Pixels and splats that the images are made for.
    room: (usize, usize),
    pub found_required: Buffer<RequiredCounts>,
    drawn_alone: Buffer<u32>,
    /// The kept lists that the images were drawn from last, as [`crate::kept_lists::Kept::id`]
    /// tells; `None` where others may have drawn into them since.
    drawn_from: Option<u64>,
    drawn_holds: bool,
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
            images: no_images.clone(),
            no_images,
            room: (0, 0),
            found_required: gpu.buffer("found_required", PURPOSE, 1, MemoryKind::Readback)?,
            drawn_alone: gpu.buffer("drawn_alone", PURPOSE, 0, MemoryKind::Device)?,
            drawn_from: None,
            drawn_holds: false,
        })
    }

    /// Removes its images, with the size that they were made for; none remain.
    pub fn give_images(&mut self) -> ((usize, usize), OutputBuffers) {
        let room = std::mem::take(&mut self.room);
        self.drawn_from = None;
        (
            room,
            std::mem::replace(&mut self.images, self.no_images.clone()),
        )
    }

    /// Prepares for a frame that is drawn from the kept lists `kept`, if there are some, and leaves
    /// out coarse tiles of `bins` that its images show already; 0 where none is left out. The frame
    /// before in this slot must be done.
    pub fn draw_from(&mut self, gpu: &Gpu, kept: Option<u64>, bins: u32) -> Result<(), GpuError> {
        let from = kept.filter(|_| bins > 0);
        self.drawn_holds = from.is_some() && self.drawn_from == from;
        self.drawn_from = from;
        if kept.is_some() && self.drawn_alone.len() != bins as usize {
            self.drawn_alone =
                gpu.buffer("drawn_alone", PURPOSE, bins as usize, MemoryKind::Device)?;
        }
        Ok(())
    }

    /// Coarse tiles that its images show already, or [`Self::draw_from`] says that none count.
    pub fn drawn_alone(&self) -> DrawnAlone<'_> {
        DrawnAlone {
            tiles: &self.drawn_alone,
            holds: self.drawn_holds,
        }
    }

    /// Pixels that its images are made for.
    pub fn pixels(&self) -> usize {
        self.room.0
    }

    /// Writes what a frame shows, with the shadows of `splats`. The frame before in this slot must
    /// be done.
    pub fn load(
        &mut self,
        gpu: &Gpu,
        (outputs, pool): (&Outputs, &SharedImagePool),
        splats: &FrameSplats<'_>,
        contents: &mut FrameContents,
    ) -> Result<(), RenderError> {
        let view = &contents.view;
        let count = splats.background.splats;
        let room = (view.pixels, count * usize::from(outputs.contributions));
        if self.room != room {
            // The old ones go first: both would not always fit.
            self.give_images();
            self.images = match pool.find(room) {
                Some(waiting) => waiting,
                None => OutputBuffers::new(gpu, view.pixels, count, outputs)?,
            };
            self.room = room;
        }
        self.staged_cameras.write_host(0, &view.cameras);
        self.staged_lenses.write_host(0, &view.lenses);
        self.staged_photometry.write_host(0, &contents.photometry);
        self.load_shadows(gpu, splats)?;
        if let Some(list) = &mut contents.agents {
            self.agents.fit(gpu, list.counts)?;
            let wanted: Vec<_> = list
                .relights
                .iter()
                .map(|&(_, asset, relight)| (asset, relight))
                .collect();
            contents.relights = self.relit.plan(gpu, &wanted)?;
            for (&(agent, ..), first) in list.relights.iter().zip(&contents.relights.offsets) {
                list.records[agent].first_color = *first;
            }
            self.agents.write(list);
        }
        Ok(())
    }

    fn load_shadows(&mut self, gpu: &Gpu, splats: &FrameSplats<'_>) -> Result<(), RenderError> {
        let (background, shadows) = (splats.background, &splats.agents.shadows);
        let cameras = &splats.agents.shadow_cameras;
        let (room, clusters) = (self.shadow_room, background.cluster_count());
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
            cameras: cameras.get(index).copied().unwrap_or(u32::MAX),
            ..ShadowRecord::new(shadow, background.origin)
        };
        let records: Vec<ShadowRecord> = shadows.iter().enumerate().map(record).collect();
        self.staged_shadows.write_host(0, &records);
        Ok(())
    }

    /// Records the copy of what the host wrote of `count` shadows.
    pub fn copy_shadows(&self, recorder: &mut Recorder, count: usize) {
        recorder.copy(&self.staged_shadows, 0, &self.shadows.shadows, 0, count);
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

    /// Records the copy of what the host wrote of agents and of `lenses` lenses.
    pub fn copy_agents(&self, recorder: &mut Recorder, counts: AgentCounts, lenses: usize) {
        self.agents.copy(recorder, counts);
        let to = &self.agents.buffers.lenses;
        recorder.copy(&self.staged_lenses, 0, to, 0, lenses);
    }
}
