//! Draws frames: their public interface.

use std::collections::VecDeque;
use std::time::Instant;

use decouplegs_gpu::{Gpu, QueueRole, Recorder, Ticket};
use decouplegs_scene::{Camera, DepthOrder, DetailLevels, SplatScene};

use crate::agents::relit::Relights;
use crate::agents::{AgentList, FrameSplats};
use crate::asset_pool::AssetPool;
use crate::capacity::Capacity;
use crate::frame::{FrameInput, record_agents, record_frame};
use crate::frame_buffers::{FrameBuffers, FrameShape};
use crate::image_hash::ImageHasher;
use crate::images::taken::SharedImagePool;
use crate::kept_lists::{KeptLists, ListSource};
use crate::kernels::{FrameVariant, Kernels};
use crate::keys::{KeyDecision, PersistentKeys};
use crate::layout::{View, near_m};
use crate::options::{FrameStatistics, RenderOptions};
use crate::output::OutputBuffers;
use crate::post_processing::{PhotometryRecord, RayTables};
use crate::resident_splats::ResidentSplats;
use crate::slot::FrameInFlight;
use crate::stages::{AgentVariant, CameraVariant, ProjectVariant, RecordContents};
use crate::submitted::{FrameContents, ShownFrame, SubmittedFrame};
use crate::{Plane, RenderError};

/// Splats an index can name with room for a camera beside it.
const SPLATS_MAX: usize = 1 << 27;

/// Frames that may outgrow their buffers in a row: each list can grow once, and once more for what
/// it hid.
const ATTEMPTS_MAX: u32 = 6;

/// Draws frames on one device with one set of options. Buffers are kept from frame to frame and
/// grow as needed.
pub struct Renderer {
    gpu: Gpu,
    options: RenderOptions,
    kernels: Kernels,
    capacity: Option<Capacity>,
    frame: Option<FrameBuffers>,
    slots: Vec<FrameInFlight>,
    /// The oldest first.
    in_flight: VecDeque<SubmittedFrame>,
    shown: Option<ShownFrame>,
    /// `None` before the first frame.
    keys: Option<PersistentKeys>,
    image_pool: SharedImagePool,
    /// Kernel and buffers of hashes, once some were asked for.
    pub(crate) hasher: Option<ImageHasher>,
    ray_tables: RayTables,
}

impl Renderer {
    /// A renderer on `gpu`. Kernels are built when the first frame of a kind is drawn.
    #[must_use]
    pub fn new(gpu: &Gpu, options: RenderOptions) -> Self {
        Self {
            gpu: gpu.clone(),
            options,
            kernels: Kernels::new(&options, gpu.info().kind),
            capacity: None,
            frame: None,
            slots: Vec::new(),
            in_flight: VecDeque::new(),
            shown: None,
            keys: None,
            image_pool: SharedImagePool::default(),
            hasher: None,
            ray_tables: RayTables::default(),
        }
    }

    /// The device it draws on.
    #[must_use]
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// Options of the renderer.
    #[must_use]
    pub fn options(&self) -> &RenderOptions {
        &self.options
    }

    /// Times the stages of frames that are submitted from here on, or no longer times them
    /// ([`RenderOptions::stage_times`]).
    pub fn time_stages(&mut self, timed: bool) {
        self.options.stage_times = timed;
    }

    /// Starts with room for exactly `capacity` instead of a guess: for callers that know their
    /// scene, and for tests of growth.
    #[must_use]
    pub fn with_capacity(mut self, capacity: Capacity) -> Self {
        self.capacity = Some(capacity);
        self
    }

    /// Copies `splat_scene` to the device, its splats in the order given.
    ///
    /// # Errors
    /// Returns an error if it has too many splats, or the device not the memory.
    pub fn upload(&self, splat_scene: &SplatScene) -> Result<ResidentSplats, RenderError> {
        let splats = match self.options.background_pitch_px {
            None => splat_scene.splats.len(),
            Some(_) => DetailLevels::splats_at_most(splat_scene.splats.len()),
        };
        if splats > SPLATS_MAX {
            return Err(RenderError::TooManySplats {
                splats,
                max: SPLATS_MAX,
            });
        }
        match self.options.background_pitch_px {
            None => ResidentSplats::upload(&self.gpu, splat_scene, self.options.storage),
            Some(_) => {
                ResidentSplats::upload_with_levels(&self.gpu, splat_scene, self.options.storage)
            }
        }
    }

    /// Draws `splats` for all `cameras` in one submission and waits for the images.
    ///
    /// They stay on the device until the next call; [`Renderer::read_images`] fetches them. Frames
    /// submitted before are finished first, and what they took is dropped.
    ///
    /// # Errors
    /// Returns an error if a camera or an agent cannot make an image, the device has not the memory
    /// or was lost.
    pub fn render<'a>(
        &mut self,
        splats: impl Into<FrameSplats<'a>>,
        cameras: &[Camera],
    ) -> Result<FrameStatistics, RenderError> {
        while !self.in_flight.is_empty() {
            self.finish()?;
        }
        self.submit(splats, cameras)?;
        self.finish()
    }

    /// Submits the frame that shows `splats` to all `cameras`, and returns without waiting for it.
    /// Frames are finished in the order submitted, by [`Renderer::finish`].
    ///
    /// # Errors
    /// Returns the errors of [`Renderer::render`], and one when [`RenderOptions::frames_in_flight`]
    /// frames are in flight already.
    pub fn submit<'a>(
        &mut self,
        splats: impl Into<FrameSplats<'a>>,
        cameras: &[Camera],
    ) -> Result<(), RenderError> {
        let (splats, since) = (splats.into(), Instant::now());
        let mut contents = self.prepare(&splats, cameras)?;
        let mut keys = match &self.keys {
            Some(keys) => keys.clone(),
            None => PersistentKeys::new(&self.gpu)?,
        };
        let decision = if self.options.keep_keys {
            keys.decide(
                &self.gpu,
                splats.background,
                &contents.view,
                &self.options.rules,
            )?
        } else {
            keys.all_computed(cameras.len())
        };
        let index = self.free_slot(contents.view.pixels)?;
        let slot = &mut self.slots[index];
        let images = (&self.options.outputs, &self.image_pool);
        slot.load(&self.gpu, images, &splats, &mut contents)?;
        slot.staged_key_sets.write_host(0, &decision.sets);
        let added = splats.pool.and_then(AssetPool::last_upload);
        let update = self.submit_agents(index, &contents, added)?;
        let record_start = Instant::now();
        let (frame, capacity, lists) =
            match self.submit_frame(index, &contents, &decision, update.as_ref()) {
                Ok(submitted) => submitted,
                Err(error) => {
                    // The next frame writes what the agents' part reads.
                    update.map_or(Ok(()), |update| update.wait())?;
                    return Err(error);
                }
            };
        let submitted = Instant::now();
        if contents.agents.is_some() {
            self.slots[index].relit.commit(&mut contents.relights);
        }
        self.keys = Some(keys);
        self.in_flight.push_back(SubmittedFrame {
            slot: index,
            contents,
            keys: decision,
            lists,
            frame,
            update,
            capacity,
            since,
            submitted,
            record_time: submitted - record_start,
        });
        Ok(())
    }

    /// Contents of the frame that draws `splats` for `cameras`, without colors of relit agents.
    fn prepare(
        &mut self,
        splats: &FrameSplats<'_>,
        cameras: &[Camera],
    ) -> Result<FrameContents, RenderError> {
        let options = self.options;
        splats.check_motions(cameras, self.flow_interval_s())?;
        let view = View::new(
            cameras,
            splats.background.origin,
            self.distance_max_m(splats, cameras)?,
        )
        .map_err(RenderError::View)?;
        let near_m = near_m(&options.rules);
        let agents = AgentList::new(splats, cameras, &view, near_m, options.level_pitch_px)?;
        let (mut processed, mut photometry) = (Vec::new(), Vec::new());
        if splats.background.is_post_processed(cameras) {
            let sky = splats.background.sky_map.as_ref();
            processed = self.ray_tables.seen_by(&self.gpu, sky, cameras)?;
            let calibrations = cameras
                .iter()
                .map(|camera| splats.background.photometry_of(camera));
            photometry.extend(calibrations.map(|own| PhotometryRecord::new(&own)));
        }
        let mut contents = FrameContents {
            background: splats.background.clone(),
            variant: self.variant(splats, &view, agents.as_ref(), !processed.is_empty()),
            view,
            agents,
            relights: Relights::default(),
            shadow_count: splats.agents.shadows.len(),
            processed,
            photometry,
            standing: None,
        };
        if options.keep_lists && !options.outputs.contributions {
            contents.standing = contents.find_standing();
        }
        Ok(contents)
    }

    /// Specialization of the frame that shows `splats` to the cameras of `view`.
    fn variant(
        &self,
        splats: &FrameSplats<'_>,
        view: &View,
        list: Option<&AgentList>,
        post_processed: bool,
    ) -> FrameVariant {
        let options = &self.options;
        let labels = RecordContents::for_outputs(&options.outputs).labels;
        FrameVariant {
            background: ProjectVariant {
                sh_degree: splats.background.sh_degree.min(options.sh_degree_max),
                labels,
                instances: splats.background.has_instances
                    && options.outputs.planes.contains(Plane::Instance),
                splat_ids: options.outputs.contributions,
                shadows: !splats.agents.shadows.is_empty(),
                shadows_by_camera: !splats.agents.shadow_cameras.is_empty(),
                cameras: CameraVariant::for_cameras(&view.cameras, &view.lenses),
                planes: options.outputs.planes,
                fog: splats.background.fog.is_some(),
                storage: splats.background.storage,
            },
            post_processed,
            // That of all assets, in view or not: building kernels in the middle of a drive
            // would stall it.
            agents: splats
                .pool
                .and_then(AssetPool::sh_degree)
                .map(|degree| AgentVariant {
                    sh_degree: degree.min(options.sh_degree_max),
                    labels,
                    relit: splats.agents.relights(),
                    shaded: splats.agents.shades(),
                    cameras: CameraVariant::for_cameras(
                        list.map_or(&[], |list| &list.cameras),
                        &view.lenses,
                    ),
                    planes: options.outputs.planes,
                    fog: splats.background.fog.is_some(),
                }),
        }
    }

    /// Interval of optical flow, seconds; 0 where none is asked for.
    fn flow_interval_s(&self) -> f64 {
        let planes = self.options.outputs.planes;
        match planes.contains(Plane::FlowForward) || planes.contains(Plane::FlowBackward) {
            true => self.options.flow_interval_s,
            false => 0.0,
        }
    }

    /// Waits for the oldest frame in flight, whose images can be read then.
    ///
    /// # Errors
    /// Returns an error if there is none, the device has not the memory for what the frame needed,
    /// or was lost.
    pub fn finish(&mut self) -> Result<FrameStatistics, RenderError> {
        let mut submitted = self
            .in_flight
            .pop_front()
            .ok_or(RenderError::NothingInFlight)?;
        let awaited = Instant::now();
        for redrawn in 0..ATTEMPTS_MAX {
            submitted.frame.wait()?;
            let slot = &self.slots[submitted.slot];
            let required = slot.found_required.read_host()[0];
            // Another frame may have grown the buffers since.
            let capacity = self.capacity.unwrap_or(submitted.capacity);
            if submitted.capacity.holds(&required) {
                self.capacity = Some(capacity.grown_ahead_of(&required, self.options.spare));
                let statistics = submitted.statistics(required, redrawn, awaited)?;
                self.shown = Some(ShownFrame {
                    slot: submitted.slot,
                    view: submitted.contents.view,
                    frame: submitted.frame,
                });
                return Ok(statistics);
            }
            self.capacity = Some(capacity.grown_to(&required, self.options.spare));
            let record_start = Instant::now();
            // Frames submitted since may have taken the place of the keys that this one was to use.
            submitted.keys = submitted.keys.without_kept_keys();
            slot.staged_key_sets.write_host(0, &submitted.keys.sets);
            // Nor is what they keep the lists of this one, or in its images.
            submitted.contents.standing = None;
            (submitted.frame, submitted.capacity, submitted.lists) = self.submit_frame(
                submitted.slot,
                &submitted.contents,
                &submitted.keys,
                submitted.update.as_ref(),
            )?;
            submitted.record_time = record_start.elapsed();
        }
        let required = self.slots[submitted.slot].found_required.read_host();
        Err(RenderError::Unsettled {
            attempts: ATTEMPTS_MAX,
            required: format!("{required:?}"),
        })
    }

    /// The frame that was finished last, until its place is taken.
    pub(crate) fn shown(&self) -> Option<&ShownFrame> {
        self.shown.as_ref()
    }

    /// View and images of the frame that was finished last.
    pub(crate) fn shown_images(&self) -> Option<(&View, &OutputBuffers)> {
        let shown = self.shown.as_ref()?;
        Some((&shown.view, &self.slots[shown.slot].images))
    }

    /// The frame that was finished last.
    pub(crate) fn shown_frame(&self) -> Option<&Ticket> {
        Some(&self.shown.as_ref()?.frame)
    }

    /// Removes the frame that was finished last, with its images and the size that they were made
    /// for.
    pub(crate) fn take_shown(&mut self) -> Option<(ShownFrame, (usize, usize), OutputBuffers)> {
        let shown = self.shown.take()?;
        let (room, images) = self.slots[shown.slot].give_images();
        Some((shown, room, images))
    }

    /// True if some frame is in flight.
    #[must_use]
    pub fn is_busy(&self) -> bool {
        !self.in_flight.is_empty()
    }

    /// Images that wait for a frame.
    pub(crate) fn image_pool(&self) -> &SharedImagePool {
        &self.image_pool
    }

    /// A slot that no frame in flight has, one with room for just `pixels` if there is one: frames
    /// of two sizes that take turns then make no buffers.
    fn free_slot(&mut self, pixels: usize) -> Result<usize, RenderError> {
        let max = self.options.frames_in_flight.max(1);
        if self.in_flight.len() >= max {
            return Err(RenderError::TooManyInFlight { max });
        }
        // Not the one whose images may be read, as long as there is another.
        let shown = self.shown.as_ref().map(|shown| shown.slot);
        let free = |slot: &usize| self.in_flight.iter().all(|frame| frame.slot != *slot);
        let slot = (0..self.slots.len())
            .filter(free)
            .min_by_key(|slot| (self.slots[*slot].pixels() != pixels, shown == Some(*slot)));
        match slot {
            // One slot is enough for those who wait for every frame.
            Some(slot)
                if shown != Some(slot) || self.in_flight.is_empty() || self.slots.len() >= max =>
            {
                self.shown = self.shown.take().filter(|shown| shown.slot != slot);
                Ok(slot)
            }
            _ => {
                self.slots
                    .push(FrameInFlight::new(&self.gpu, &self.options.outputs)?);
                Ok(self.slots.len() - 1)
            }
        }
    }

    /// No depth is larger, meters.
    fn distance_max_m(
        &self,
        splats: &FrameSplats<'_>,
        cameras: &[Camera],
    ) -> Result<f64, RenderError> {
        let distance_max_m = splats.distance_max_m()?;
        // Distances count from the camera, depths from the origin.
        Ok(if self.options.rules.order == DepthOrder::Radial {
            let from_origin = |camera: &Camera| {
                (camera.world_from_camera.translation - splats.background.origin).length()
            };
            cameras.iter().map(from_origin).fold(0.0, f64::max) + distance_max_m
        } else {
            distance_max_m
        })
    }

    /// Submits the agents' part of the frame in `slot` by itself, behind `added`; nothing where it
    /// is to run in line.
    fn submit_agents(
        &mut self,
        slot: usize,
        contents: &FrameContents,
        added: Option<&Ticket>,
    ) -> Result<Option<Ticket>, RenderError> {
        let has_work = contents.agents.is_some() || contents.shadow_count > 0;
        if !self.options.overlap || !has_work {
            return Ok(None);
        }
        let mut recorder = self.recorder(QueueRole::Update);
        let stages = self.kernels.stages(&self.gpu, contents.variant)?;
        record_agents(&mut recorder, stages, &self.slots[slot], contents);
        let behind: Vec<&Ticket> = added.into_iter().collect();
        Ok(Some(self.gpu.submit(recorder, &behind)?))
    }

    /// Submits the frame in `slot`; returns what room it was given, and where its lists are from.
    fn submit_frame(
        &mut self,
        slot: usize,
        contents: &FrameContents,
        keys: &KeyDecision,
        update: Option<&Ticket>,
    ) -> Result<(Ticket, Capacity, ListSource), RenderError> {
        let mut recorder = self.recorder(QueueRole::Main);
        let shape = self.shape(contents);
        let frame = match self.frame.take() {
            Some(frame) if frame.room().covers(&shape) => frame,
            old => {
                // The old ones go first: both would not always fit.
                let (room, kept_lists) = match old {
                    Some(old) => (old.room().with(&shape), old.kept_lists.without_lists()),
                    None => (shape, KeptLists::default()),
                };
                let mut made = FrameBuffers::new(&self.gpu, room, &self.options)?;
                made.kept_lists = kept_lists;
                self.capacity = Some(shape.capacity);
                made
            }
        };
        let frame = self.frame.insert(frame);
        frame.shape = shape;
        let stages = self.kernels.stages(&self.gpu, contents.variant)?;
        if update.is_none() {
            record_agents(&mut recorder, stages, &self.slots[slot], contents);
        }
        let standing = contents.standing.as_ref();
        let lists = (frame.kept_lists).decide(&self.gpu, standing, &shape.capacity, shape.bins);
        let kept = frame.kept_lists.kept().map(|kept| kept.id);
        // What is blended into a buffer that frames share is blended whole.
        let skips = contents.processed.is_empty();
        let skipped_bins = if skips { shape.bins } else { 0 };
        let prepared = self.slots[slot].draw_from(&self.gpu, kept, skipped_bins);
        let submitted = prepared.and_then(|()| {
            let input = FrameInput {
                contents,
                keys,
                lists,
                options: &self.options,
            };
            record_frame(&mut recorder, stages, frame, &self.slots[slot], input);
            let behind: Vec<&Ticket> = update.into_iter().collect();
            self.gpu.submit(recorder, &behind)
        });
        if submitted.is_err() {
            frame.kept_lists.forget();
        }
        Ok((submitted?, shape.capacity, lists))
    }

    fn recorder(&self, role: QueueRole) -> Recorder {
        let recorder = self.gpu.record(role);
        match self.options.stage_times {
            true => recorder.time_stages(),
            false => recorder,
        }
    }

    /// Sizes of the buffers for a frame, as far as they are known.
    fn shape(&self, contents: &FrameContents) -> FrameShape {
        let view = &contents.view;
        FrameShape {
            capacity: self
                .capacity
                .unwrap_or_else(|| Capacity::guess(contents.splats(), view.cameras.len())),
            cameras: view.cameras.len(),
            clusters: contents.background.cluster_count(),
            bins: view.bins,
            blended_pixels: match contents.processed.is_empty() {
                true => 0,
                false => view.pixels,
            },
        }
    }
}
