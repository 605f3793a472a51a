//! Draws worlds: the public face of the frame.

use std::collections::VecDeque;
use std::time::Instant;

use decouplegs_gpu::{Buffer, Gpu, QueueRole, Recorder, Ticket};
use decouplegs_scene::{Camera, DepthOrder, DetailLevels, World};

use crate::agents::{AgentList, Scene};
use crate::capacity::Capacity;
use crate::frame::{FrameInput, record_agents, record_frame};
use crate::frame_buffers::{FrameBuffers, FrameShape};
use crate::kernels::{FrameVariant, Kernels};
use crate::keys::{KeyDecision, PersistentKeys};
use crate::layout::{View, near_m};
use crate::options::{FrameStatistics, RenderOptions};
use crate::post_processing::{PhotometryRecord, RayTables};
use crate::resident::GpuScene;
use crate::slot::{FrameInFlight, Pending};
use crate::stages::{AgentCounts, AgentVariant, CameraVariant, ProjectVariant, RecordContents};
use crate::taken::SharedShelf;
use crate::{Attribute, Plane, RenderError};

/// Splats an index can name with room for a camera beside it.
const SPLATS_MAX: usize = 1 << 27;

/// Frames that may outgrow their buffers in a row: each list can grow once, and once more for what
/// it hid.
const ATTEMPTS_MAX: u32 = 6;

/// Draws worlds on one device with one set of options. Buffers are kept from frame to frame and
/// grow as needed.
pub struct Renderer {
    gpu: Gpu,
    options: RenderOptions,
    kernels: Kernels,
    capacity: Option<Capacity>,
    frame: Option<FrameBuffers>,
    slots: Vec<FrameInFlight>,
    /// Slots of the frames in flight, the oldest first.
    in_flight: VecDeque<usize>,
    /// The slot of the frame that was finished last.
    shown: Option<usize>,
    keys: Option<PersistentKeys>,
    shelf: SharedShelf,
    ray_tables: RayTables,
}

impl Renderer {
    /// A renderer on `gpu`. Kernels are built when the first world of a kind is drawn.
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
            shelf: SharedShelf::default(),
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

    /// Copies `world` to the device, its splats in the order given.
    ///
    /// # Errors
    /// Returns an error if it has too many splats, or the device not the memory.
    pub fn upload(&self, world: &World) -> Result<GpuScene, RenderError> {
        let splats = match self.options.background_pitch_px {
            None => world.splats.len(),
            Some(_) => DetailLevels::splats_at_most(world.splats.len()),
        };
        if splats > SPLATS_MAX {
            return Err(RenderError::TooManySplats {
                splats,
                max: SPLATS_MAX,
            });
        }
        match self.options.background_pitch_px {
            None => GpuScene::upload(&self.gpu, world, self.options.storage),
            Some(_) => GpuScene::upload_with_levels(&self.gpu, world, self.options.storage),
        }
    }

    /// Draws `scene` for all `cameras` in one submission and waits for the images.
    ///
    /// They stay on the device until the next call; [`Renderer::read_images`] fetches them. Frames
    /// submitted before are finished first, and what they took is dropped.
    ///
    /// # Errors
    /// Returns an error if a camera or an agent cannot make an image, the device has not the memory
    /// or was lost.
    pub fn render<'a>(
        &mut self,
        scene: impl Into<Scene<'a>>,
        cameras: &[Camera],
    ) -> Result<FrameStatistics, RenderError> {
        while !self.in_flight.is_empty() {
            self.finish()?;
        }
        self.submit(scene, cameras)?;
        self.finish()
    }

    /// Submits the frame that shows `scene` to all `cameras`, and returns without waiting for it.
    /// Frames are finished in the order submitted, by [`Renderer::finish`].
    ///
    /// # Errors
    /// Those of [`Renderer::render`], and when [`RenderOptions::frames_in_flight`] frames are in
    /// flight already.
    pub fn submit<'a>(
        &mut self,
        scene: impl Into<Scene<'a>>,
        cameras: &[Camera],
    ) -> Result<(), RenderError> {
        let submitted = self.try_submit(scene.into(), cameras);
        if submitted.is_err() {
            // Keys that this frame was to find may never be found.
            self.keys = None;
            self.slots.iter_mut().for_each(|slot| slot.relit.forget());
        }
        submitted
    }

    fn try_submit(&mut self, scene: Scene<'_>, cameras: &[Camera]) -> Result<(), RenderError> {
        let since = Instant::now();
        let options = self.options;
        scene.check_motions(cameras, self.flow_interval_s())?;
        let view = View::new(cameras, scene.world.origin, self.reach_m(&scene, cameras)?)
            .map_err(RenderError::View)?;
        let slot = self.free_slot(view.pixels)?;
        let list = AgentList::new(
            &scene,
            cameras,
            &view,
            near_m(&options.rules),
            options.level_pitch_px,
        )?;
        let keys = match &mut self.keys {
            Some(keys) => keys,
            None => self.keys.insert(PersistentKeys::new(&self.gpu)?),
        };
        let decision = if options.keep_keys {
            keys.decide(&self.gpu, scene.world, &view, &options.rules)?
        } else {
            KeyDecision::computed(view.cameras.len())
        };
        let kept_keys = keys.keys().clone();
        let (mut processed, mut photometry) = (Vec::new(), Vec::new());
        if scene.world.is_post_processed(cameras) {
            let sky = scene.world.sky_map.as_ref();
            processed = self.ray_tables.seen_by(&self.gpu, sky, cameras)?;
            let calibrations = cameras
                .iter()
                .map(|camera| scene.world.photometry_of(camera));
            photometry.extend(calibrations.map(|own| PhotometryRecord::new(&own)));
        }
        let variant = self.variant(&scene, &view, list.as_ref(), !processed.is_empty());
        let added = scene
            .agents
            .and_then(|(pool, _)| pool.last_upload().cloned());
        self.slots[slot].set(
            &self.gpu,
            (&options.outputs, &self.shelf),
            view,
            &scene,
            list,
        )?;
        self.slots[slot].processed = processed;
        self.slots[slot]
            .staged_photometry
            .write_host(0, &photometry);
        self.slots[slot]
            .staged_key_sets
            .write_host(0, &decision.sets);
        let update = self.submit_agents(slot, scene.world, variant, added.as_ref())?;
        let record_start = Instant::now();
        let (frame, capacity) = self.submit_frame(
            slot,
            scene.world,
            variant,
            (&decision, &kept_keys),
            update.as_ref(),
        )?;
        let (world, record_time) = (scene.world.clone(), record_start.elapsed());
        let submitted = Instant::now();
        let pending = Pending {
            world,
            variant,
            keys: decision,
            kept_keys,
            frame,
            update,
            capacity,
            since,
            submitted,
            record_time,
        };
        self.slots[slot].pending = Some(pending);
        self.in_flight.push_back(slot);
        Ok(())
    }

    /// Specialization of the frame that shows `scene` to the cameras of `view`.
    fn variant(
        &self,
        scene: &Scene<'_>,
        view: &View,
        list: Option<&AgentList>,
        post_processed: bool,
    ) -> FrameVariant {
        let options = &self.options;
        let labels = RecordContents::of(&options.outputs).labels;
        FrameVariant {
            background: ProjectVariant {
                sh_degree: scene.world.sh_degree.min(options.sh_degree_max),
                labels,
                instances: scene.world.has_instances
                    && options.outputs.planes.contains(Plane::Instance),
                splat_ids: options.outputs.contributions,
                shadows: !scene.shadows.is_empty(),
                shadows_by_camera: scene.shadow_cameras.is_some(),
                cameras: CameraVariant::of(&view.cameras, &view.lenses),
                attribute: Attribute::None,
                fog: scene.world.fog.is_some(),
                storage: scene.world.storage,
            },
            post_processed,
            // That of all assets, in view or not: building kernels in the middle of a drive
            // would stall it.
            agents: scene
                .agents
                .and_then(|(pool, _)| pool.sh_degree())
                .map(|degree| AgentVariant {
                    sh_degree: degree.min(options.sh_degree_max),
                    labels,
                    relit: scene.relights(),
                    cameras: CameraVariant::of(
                        list.map_or(&[], |list| &list.cameras),
                        &view.lenses,
                    ),
                    attribute: Attribute::None,
                    fog: scene.world.fog.is_some(),
                }),
        }
    }

    /// Interval of optical flow, seconds; 0 where none is asked for.
    fn flow_interval_s(&self) -> f64 {
        let mut planes = self.options.outputs.planes.geometry();
        match planes.any(|plane| plane.attribute() == Attribute::Flow) {
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
        let slot = self
            .in_flight
            .pop_front()
            .ok_or(RenderError::NothingInFlight)?;
        let Some(mut pending) = self.slots[slot].pending.take() else {
            return Err(RenderError::NothingInFlight);
        };
        let awaited = Instant::now();
        for redrawn in 0..ATTEMPTS_MAX {
            pending.frame.wait()?;
            let required = self.slots[slot].found_required.read_host()[0];
            // Another frame may have grown the buffers since.
            let capacity = self.capacity.unwrap_or(pending.capacity);
            if pending.capacity.holds(&required) {
                self.capacity = Some(capacity.grown_ahead_of(&required, self.options.spare));
                self.shown = Some(slot);
                self.slots[slot].done = Some(pending.frame.clone());
                let statistics =
                    self.slots[slot].statistics(&pending, required, redrawn, awaited)?;
                return Ok(statistics);
            }
            self.capacity = Some(capacity.grown_to(&required, self.options.spare));
            let record_start = Instant::now();
            // Frames submitted since may have taken the place of the keys that this one was to use.
            pending.keys = KeyDecision::computed(pending.keys.sources.len());
            self.slots[slot]
                .staged_key_sets
                .write_host(0, &pending.keys.sets);
            let Pending {
                world,
                variant,
                keys,
                kept_keys,
                update,
                ..
            } = &pending;
            let (frame, capacity) =
                self.submit_frame(slot, world, *variant, (keys, kept_keys), update.as_ref())?;
            (pending.frame, pending.capacity, pending.record_time) =
                (frame, capacity, record_start.elapsed());
        }
        let required = format!("{:?}", self.slots[slot].found_required.read_host());
        Err(RenderError::Unsettled {
            attempts: ATTEMPTS_MAX,
            required,
        })
    }

    /// The place of the frame that was finished last.
    pub(crate) fn shown_slot(&self) -> Option<&FrameInFlight> {
        self.shown.and_then(|shown| self.slots.get(shown))
    }

    /// True if some frame is in flight.
    #[must_use]
    pub fn is_busy(&self) -> bool {
        !self.in_flight.is_empty()
    }

    pub(crate) fn shown_slot_mut(&mut self) -> Option<&mut FrameInFlight> {
        self.shown.and_then(|shown| self.slots.get_mut(shown))
    }

    /// The frame that was finished last has no images any more.
    pub(crate) fn show_nothing(&mut self) {
        self.shown = None;
    }

    /// Images that wait for a frame.
    pub(crate) fn shelf(&self) -> &SharedShelf {
        &self.shelf
    }

    /// A slot that no frame in flight has, one with room for just `pixels` if there is one: frames
    /// of two sizes that take turns then make no buffers.
    fn free_slot(&mut self, pixels: usize) -> Result<usize, RenderError> {
        let max = self.options.frames_in_flight.max(1);
        if self.in_flight.len() >= max {
            return Err(RenderError::TooManyInFlight { max });
        }
        // Not the one whose images may be read, as long as there is another.
        let free = |slot: &usize| !self.in_flight.contains(slot);
        let slot = (0..self.slots.len()).filter(free).min_by_key(|slot| {
            (
                self.slots[*slot].pixels() != pixels,
                self.shown == Some(*slot),
            )
        });
        match slot {
            // One place is enough for those who wait for every frame.
            Some(slot)
                if self.shown != Some(slot)
                    || self.in_flight.is_empty()
                    || self.slots.len() >= max =>
            {
                self.shown = self.shown.filter(|shown| *shown != slot);
                Ok(slot)
            }
            _ => {
                self.slots
                    .push(FrameInFlight::new(&self.gpu, &self.options.outputs)?);
                Ok(self.slots.len() - 1)
            }
        }
    }

    /// No depth of the scene is larger, meters.
    fn reach_m(&self, scene: &Scene<'_>, cameras: &[Camera]) -> Result<f64, RenderError> {
        let reach_m = scene.reach_m()?;
        // Distances count from the camera, depths from the origin.
        Ok(if self.options.rules.order == DepthOrder::Radial {
            let from_origin = |camera: &Camera| {
                (camera.world_from_camera.translation - scene.world.origin).length()
            };
            cameras.iter().map(from_origin).fold(0.0, f64::max) + reach_m
        } else {
            reach_m
        })
    }

    /// Submits the agents' part of the frame in `slot` by itself, behind `added`; nothing where it
    /// is to run in line.
    fn submit_agents(
        &mut self,
        slot: usize,
        world: &GpuScene,
        variant: FrameVariant,
        added: Option<&Ticket>,
    ) -> Result<Option<Ticket>, RenderError> {
        let counts = self.agent_counts(slot);
        if !self.options.overlap || (counts.is_none() && self.slots[slot].shadow_count == 0) {
            return Ok(None);
        }
        let mut recorder = self.recorder(QueueRole::Update);
        let stages = self.kernels.of(&self.gpu, variant)?;
        record_agents(&mut recorder, &stages, &self.slots[slot], world, counts);
        let behind: Vec<&Ticket> = added.into_iter().collect();
        Ok(Some(self.gpu.submit(recorder, &behind)?))
    }

    /// Submits the frame in `slot`; returns what room it was given.
    fn submit_frame(
        &mut self,
        slot: usize,
        world: &GpuScene,
        variant: FrameVariant,
        (keys, kept_keys): (&KeyDecision, &Buffer<u32>),
        update: Option<&Ticket>,
    ) -> Result<(Ticket, Capacity), RenderError> {
        let agents = self.agent_counts(slot);
        let frame_capacity = self.fit_buffers(slot, world)?;
        let Some(frame) = &self.frame else {
            unreachable!("fit_buffers made them")
        };
        let mut recorder = self.recorder(QueueRole::Main);
        let stages = self.kernels.of(&self.gpu, variant)?;
        if update.is_none() {
            record_agents(&mut recorder, &stages, &self.slots[slot], world, agents);
        }
        let input = FrameInput {
            world,
            keys,
            kept_keys,
            agents,
            options: &self.options,
        };
        record_frame(&mut recorder, &stages, frame, &self.slots[slot], input);
        let behind: Vec<&Ticket> = update.into_iter().collect();
        Ok((self.gpu.submit(recorder, &behind)?, frame_capacity))
    }

    fn recorder(&self, role: QueueRole) -> Recorder {
        let recorder = self.gpu.record(role);
        match self.options.stage_times {
            true => recorder.time_stages(),
            false => recorder,
        }
    }

    fn agent_counts(&self, slot: usize) -> Option<AgentCounts> {
        self.slots[slot].list.as_ref().map(|list| list.counts)
    }

    /// Makes the buffers what the frame in `slot` needs, as far as that is known.
    fn fit_buffers(&mut self, slot: usize, world: &GpuScene) -> Result<Capacity, RenderError> {
        let slot = &self.slots[slot];
        let Some(view) = &slot.view else {
            unreachable!("a slot is set before it is submitted")
        };
        let with_geometry = self.options.outputs.planes.geometry().next().is_some();
        let splats = world.splats + slot.list.as_ref().map_or(0, |list| list.splats);
        let shape = FrameShape {
            capacity: self
                .capacity
                .unwrap_or_else(|| Capacity::guess(splats, view.cameras.len())),
            cameras: view.cameras.len(),
            clusters: world.cluster_count(),
            bins: view.bins,
            blended_pixels: if slot.processed.is_empty() && !with_geometry {
                0
            } else {
                view.pixels
            },
        };
        match &mut self.frame {
            Some(frame) if frame.room().covers(&shape) => frame.shape = shape,
            frame => {
                // The old ones go first: both would not always fit.
                let room = frame.take().map_or(shape, |old| old.room().with(&shape));
                let mut made = FrameBuffers::new(&self.gpu, room, &self.options)?;
                made.shape = shape;
                *frame = Some(made);
                self.capacity = Some(shape.capacity);
            }
        }
        Ok(shape.capacity)
    }
}
