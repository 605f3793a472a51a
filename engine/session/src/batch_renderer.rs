//! Draws worlds.

use std::collections::VecDeque;

use decouplegs_gpu::Gpu;
use decouplegs_render::{
    ColorFormat, FrameAgents, FrameSplats, FrameStatistics, Image, ImageBytes, LidarOptions,
    LidarRenderer, LidarView, RenderOptions, Renderer, TakenImages, TracedSweep,
};
use decouplegs_scene::lidar::ReturnMode;
use decouplegs_scene::{Camera, Lidar, Rules};

use super::batch::{Batch, batches};
use super::{RigSweep, Scene, SessionError, SessionOptions, World};
use crate::AgentInstance;

/// A world, and the cameras that look at it.
#[derive(Clone, Copy)]
pub struct WorldView<'a> {
    /// World to render.
    pub world: &'a World,
    /// Cameras; at least one.
    pub cameras: &'a [Camera],
}

/// Draws worlds of one session. Its buffers are kept from frame to frame, so one batch renderer for
/// one use is fastest.
pub struct BatchRenderer {
    gpu: Gpu,
    options: RenderOptions,
    /// Rules of all scenes; `None`: each scene's own.
    rules: Option<Rules>,
    bakes_light_on_demand: bool,
    /// One for each set of rules that was drawn by: kernels are specialized by them.
    renderers: Vec<Renderer>,
    /// Renderers of LiDAR sweeps, one for each set of rules.
    lidars: Vec<LidarRenderer>,
    /// Number of frames of each submission, oldest first.
    submissions: VecDeque<usize>,
    /// The frames of all submissions that are not finished, oldest first.
    frames: VecDeque<QueuedFrame>,
    /// Number of the first `frames` that are on the device.
    in_flight: usize,
}

/// A frame, and the index of the renderer that draws it.
struct QueuedFrame {
    renderer: usize,
    batch: Batch,
}

/// Images on the host, four bytes per pixel: red, green, blue, alpha. Kept from frame to frame,
/// their memory is used again.
#[derive(Default)]
pub struct HostImages {
    frames: Vec<ImageBytes>,
    /// Frame and index in it of each camera, by view.
    image_indices: Vec<Vec<(usize, usize)>>,
}

impl HostImages {
    /// Images of view `view`.
    #[must_use]
    pub fn cameras(&self, view: usize) -> usize {
        self.image_indices[view].len()
    }

    /// Views that were drawn.
    #[must_use]
    pub fn views(&self) -> usize {
        self.image_indices.len()
    }

    /// Forgets the images and keeps their memory.
    pub fn clear(&mut self) {
        self.image_indices.clear();
    }

    /// Width and height of a camera's image, pixels.
    #[must_use]
    pub fn size_px(&self, view: usize, camera: usize) -> [u32; 2] {
        let (frame, index) = self.image_indices[view][camera];
        self.frames[frame].size_px(index)
    }

    /// The image of camera `camera` of view `view`, row by row from the top.
    #[must_use]
    pub fn rgba(&self, view: usize, camera: usize) -> &[u8] {
        let (frame, index) = self.image_indices[view][camera];
        self.frames[frame].rgba(index)
    }
}

impl BatchRenderer {
    pub(super) fn new(gpu: &Gpu, options: &SessionOptions) -> Self {
        Self {
            gpu: gpu.clone(),
            options: options.render,
            rules: options.rules,
            bakes_light_on_demand: options.bakes_light_on_demand,
            renderers: Vec::new(),
            lidars: Vec::new(),
            submissions: VecDeque::new(),
            frames: VecDeque::new(),
            in_flight: 0,
        }
    }

    /// Settings of its renderers, but for the rules.
    #[must_use]
    pub fn options(&self) -> &RenderOptions {
        &self.options
    }

    /// The device.
    #[must_use]
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// Index of the renderer for `scene`, made at the first use of its rules.
    fn renderer_of(&mut self, scene: &Scene) -> usize {
        let rules = self.rules.unwrap_or(scene.rules());
        self.renderers
            .iter()
            .position(|renderer| renderer.options().rules == rules)
            .unwrap_or_else(|| {
                self.renderers.push(Renderer::new(
                    &self.gpu,
                    RenderOptions {
                        rules,
                        ..self.options
                    },
                ));
                self.renderers.len() - 1
            })
    }

    /// Submits the frames that draw `views`, and returns without waiting for them. One frame draws
    /// up to 32 cameras of worlds over the same scene that follow one another. As many frames are
    /// on the device at a time as [`decouplegs_render::RenderOptions::frames_in_flight`] allows;
    /// later ones follow while [`BatchRenderer::finish`] collects images. The worlds may move on at
    /// once. It may be called again before `finish`: submissions are finished in their order.
    ///
    /// # Errors
    /// Returns an error if a camera or agent cannot make an image, a view has no camera or shows a
    /// world of another session, or the device has not the memory or was lost. All submissions are
    /// dropped then.
    pub fn submit(&mut self, views: &[WorldView<'_>]) -> Result<(), SessionError> {
        let queued = self.queue(views).and_then(|()| self.submit_queued());
        self.dropping_all_on_error(queued)
    }

    /// Waits for the oldest submission and brings its images to the host, four bytes per pixel.
    /// Returns the statistics of each frame.
    ///
    /// # Errors
    /// Returns an error if nothing was submitted, images are floats, or the device has not the
    /// memory or was lost. All submissions are dropped then.
    pub fn finish(
        &mut self,
        images: &mut HostImages,
    ) -> Result<Vec<FrameStatistics>, SessionError> {
        images.image_indices.clear();
        if self.options.outputs.color != ColorFormat::U8 {
            return self.dropping_all_on_error(Err(SessionError::NotBytes));
        }
        let HostImages {
            frames,
            image_indices,
        } = images;
        self.finish_frames(|renderer, number, batch| {
            if frames.len() <= number {
                frames.push(ImageBytes::default());
            }
            renderer.read_bytes(&mut frames[number])?;
            for (index, view) in batch.views().enumerate() {
                of_view(image_indices, view).push((number, index));
            }
            Ok(())
        })
    }

    /// Waits for the oldest submission and hashes its images, which stay on the device:
    /// `[view][camera]`, as [`decouplegs_render::hash_bytes`] hashes what [`BatchRenderer::finish`]
    /// brings.
    ///
    /// # Errors
    /// Returns the errors of [`BatchRenderer::finish`].
    pub fn finish_hashes(
        &mut self,
    ) -> Result<(Vec<Vec<u128>>, Vec<FrameStatistics>), SessionError> {
        if self.options.outputs.color != ColorFormat::U8 {
            return self.dropping_all_on_error(Err(SessionError::NotBytes));
        }
        let mut hashes: Vec<Vec<u128>> = Vec::new();
        let statistics = self.finish_frames(|renderer, _, batch| {
            for (view, hash) in batch.views().zip(renderer.hash_images()?) {
                of_view(&mut hashes, view).push(hash);
            }
            Ok(())
        })?;
        Ok((hashes, statistics))
    }

    /// [`BatchRenderer::finish`], in floats, with depth and instances where the session's outputs
    /// have them: `[view][camera]`.
    ///
    /// # Errors
    /// Returns the errors of [`BatchRenderer::finish`], but for images in floats.
    pub fn finish_images(
        &mut self,
    ) -> Result<(Vec<Vec<Image>>, Vec<FrameStatistics>), SessionError> {
        let mut images: Vec<Vec<Image>> = Vec::new();
        let statistics = self.finish_frames(|renderer, _, batch| {
            for (view, image) in batch.views().zip(renderer.read_images()?) {
                of_view(&mut images, view).push(image);
            }
            Ok(())
        })?;
        Ok((images, statistics))
    }

    /// Waits for the oldest submission and leaves its images on the device, one buffer per frame:
    /// cameras in the order of the views. They stay as they are until they are dropped, and with
    /// [`decouplegs_render::Outputs::exported`] another API may read them there.
    ///
    /// # Errors
    /// Returns the errors of [`BatchRenderer::finish_images`], and one if too many images are held
    /// already.
    pub fn finish_on_device(
        &mut self,
    ) -> Result<(Vec<TakenImages>, Vec<FrameStatistics>), SessionError> {
        let mut taken = Vec::new();
        let statistics = self.finish_frames(|renderer, _, _| {
            taken.extend(renderer.take_images()?);
            Ok(())
        })?;
        Ok((taken, statistics))
    }

    /// Draws `views` and brings the images to the host: [`BatchRenderer::submit`] and
    /// [`BatchRenderer::finish`].
    ///
    /// # Errors
    /// Returns the errors of both, and [`SessionError::Unfinished`].
    pub fn draw(
        &mut self,
        views: &[WorldView<'_>],
        images: &mut HostImages,
    ) -> Result<Vec<FrameStatistics>, SessionError> {
        self.check_finished()?;
        self.submit(views)?;
        self.finish(images)
    }

    /// Draws `views`: [`BatchRenderer::submit`] and [`BatchRenderer::finish_images`].
    ///
    /// # Errors
    /// Returns the errors of both, and [`SessionError::Unfinished`].
    pub fn draw_images(
        &mut self,
        views: &[WorldView<'_>],
    ) -> Result<(Vec<Vec<Image>>, Vec<FrameStatistics>), SessionError> {
        self.check_finished()?;
        self.submit(views)?;
        self.finish_images()
    }

    /// Draws `views`: [`BatchRenderer::submit`] and [`BatchRenderer::finish_on_device`].
    ///
    /// # Errors
    /// Returns the errors of both, and [`SessionError::Unfinished`].
    pub fn draw_on_device(
        &mut self,
        views: &[WorldView<'_>],
    ) -> Result<(Vec<TakenImages>, Vec<FrameStatistics>), SessionError> {
        self.check_finished()?;
        self.submit(views)?;
        self.finish_on_device()
    }

    /// Traces one sweep of `lidar` through `world` and waits for it. The agents are where `world`
    /// has them `world_s` after the start of the sweep; before and after that they go on with their
    /// motion. Returns by `mode` can be made of it; with [`ReturnMode::Dual`], by every mode.
    ///
    /// # Errors
    /// Returns an error if `world` is of another session, the model, a pose or a motion makes no
    /// sense, or the device has not the memory or was lost.
    pub fn trace(
        &mut self,
        world: &World,
        lidar: &Lidar,
        world_s: f64,
        mode: ReturnMode,
    ) -> Result<TracedSweep, SessionError> {
        let sweep = RigSweep {
            lidar: lidar.clone(),
            world_s,
            mode,
        };
        let mut traced = Vec::new();
        self.trace_all(world, &[sweep], &mut traced)?;
        Ok(traced.pop().expect("a sweep was asked for"))
    }

    /// Traces sweeps through `world`, as [`BatchRenderer::trace`] does, and waits for all of them.
    /// The device traces one while the host prepares the next, behind the images that were
    /// submitted before. `traced` becomes the sweeps in their order; memory that it holds is used
    /// again.
    ///
    /// # Errors
    /// Returns the errors of [`BatchRenderer::trace`]; `traced` is empty then. Submissions stay.
    pub fn trace_all(
        &mut self,
        world: &World,
        sweeps: &[RigSweep],
        traced: &mut Vec<TracedSweep>,
    ) -> Result<(), SessionError> {
        if !world.scene().is_on(&self.gpu) {
            traced.clear();
            return Err(SessionError::OtherSession { view: 0 });
        }
        let at_start = |agent: AgentInstance, world_s: f64| AgentInstance {
            pose: match agent.motion.is_rest() {
                true => agent.pose,
                false => agent.pose.moved(&agent.motion, -world_s),
            },
            ..agent
        };
        let scene = world.scene();
        let agents_of = |sweep: &RigSweep| {
            let placed = world.present_agents();
            let placed: Vec<_> = placed.map(|agent| at_start(agent, sweep.world_s)).collect();
            scene.unlit(&placed)
        };
        let agents: Vec<FrameAgents> = sweeps.iter().map(agents_of).collect();
        let resources = scene.resources();
        let views = sweeps.iter().zip(&agents).map(|(sweep, agents)| LidarView {
            splats: FrameSplats::with_agents(scene.background(), &resources.pool, agents),
            lidar: &sweep.lidar,
            mode: sweep.mode,
        });
        let views: Vec<LidarView> = views.collect();
        let rules = self.rules.unwrap_or(scene.rules());
        let mut built = self.lidars.iter();
        let index = built.position(|renderer| renderer.options().rules == rules);
        let index = index.unwrap_or_else(|| {
            let options = LidarOptions {
                rules,
                ..LidarOptions::default()
            };
            self.lidars.push(LidarRenderer::new(&self.gpu, options));
            self.lidars.len() - 1
        });
        Ok(self.lidars[index].trace_all(&views, traced)?)
    }

    fn check_finished(&self) -> Result<(), SessionError> {
        match self.submissions.len() {
            0 => Ok(()),
            submissions => Err(SessionError::Unfinished { submissions }),
        }
    }

    /// Appends the frames of `views` to the queue as one submission.
    fn queue(&mut self, views: &[WorldView<'_>]) -> Result<(), SessionError> {
        let is_foreign = |view: &WorldView| !view.world.scene().is_on(&self.gpu);
        if let Some(view) = views.iter().position(is_foreign) {
            return Err(SessionError::OtherSession { view });
        }
        let post_processed = views
            .iter()
            .any(|view| view.world.scene().is_post_processed(view.cameras));
        let batches = batches(views, self.pixels_max(post_processed))?;
        self.submissions.push_back(batches.len());
        for batch in batches {
            let renderer = self.renderer_of(&batch.scene);
            self.frames.push_back(QueuedFrame { renderer, batch });
        }
        Ok(())
    }

    /// Submits queued frames, oldest first, until as many are in flight as may be.
    fn submit_queued(&mut self) -> Result<(), SessionError> {
        while self.in_flight < self.options.frames_in_flight.max(1)
            && let Some(QueuedFrame { renderer, batch }) = self.frames.get(self.in_flight)
        {
            if self.bakes_light_on_demand {
                batch.scene.ready_light(&batch.agent_positions());
            }
            let renderer = &mut self.renderers[*renderer];
            let draw = |splats: FrameSplats<'_>| renderer.submit(splats, &batch.cameras);
            batch.scene.lend(&batch.frame_agents(), draw)?;
            self.in_flight += 1;
        }
        Ok(())
    }

    /// Finishes the frames of the oldest submission, and calls `done` with the number of each.
    fn finish_frames(
        &mut self,
        mut done: impl FnMut(&mut Renderer, usize, &Batch) -> Result<(), SessionError>,
    ) -> Result<Vec<FrameStatistics>, SessionError> {
        let frames = self
            .submissions
            .pop_front()
            .ok_or(SessionError::NothingSubmitted)?;
        let mut statistics = Vec::with_capacity(frames);
        // A renderer finishes its frames in the order of their submission, which is the queue's.
        let finished = (0..frames).try_for_each(|number| {
            self.submit_queued()?;
            let QueuedFrame { renderer, batch } = self
                .frames
                .pop_front()
                .expect("each submission has its frames");
            self.in_flight -= 1;
            let renderer = &mut self.renderers[renderer];
            statistics.push(renderer.finish()?);
            done(renderer, number, &batch)
        });
        // The device goes on with the next submission while the caller looks at these images.
        let finished = finished.and_then(|()| self.submit_queued());
        self.dropping_all_on_error(finished.map(|()| statistics))
    }

    /// Drops all submissions if `result` is an error: which frames are in flight is unknown then.
    fn dropping_all_on_error<T>(
        &mut self,
        result: Result<T, SessionError>,
    ) -> Result<T, SessionError> {
        if result.is_err() {
            self.submissions.clear();
            self.frames.clear();
            self.in_flight = 0;
            for renderer in &mut self.renderers {
                // Their errors add nothing; the loop ends when none is in flight.
                while renderer.is_busy() {
                    let _ = renderer.finish();
                }
            }
        }
        result
    }

    /// Pixels that one buffer of images can hold, and one of all planes. What is post-processed is
    /// blended as f32, and so are medians.
    fn pixels_max(&self, post_processed: bool) -> u64 {
        let outputs = self.options.outputs;
        let has_medians = outputs.planes.has_medians();
        let color_bytes = match outputs.color {
            ColorFormat::U8 if !post_processed && !has_medians => 4,
            _ => 16,
        };
        let plane_bytes = 4 * outputs.planes.words() as u64;
        self.gpu.limits().storage_buffer_bytes_max / color_bytes.max(plane_bytes)
    }
}

/// The entries of view `view`; the views up to it are added if they are missing.
fn of_view<T>(views: &mut Vec<Vec<T>>, view: usize) -> &mut Vec<T> {
    views.resize_with(views.len().max(view + 1), Vec::new);
    &mut views[view]
}
