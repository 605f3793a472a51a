//! Draws worlds.

use std::collections::VecDeque;

use decouplegs_gpu::Gpu;
use decouplegs_render::{
    ColorFormat, FrameStatistics, Image, ImageBytes, RenderOptions, Renderer, TakenImages,
};
use decouplegs_scene::{Camera, Rules};
use glam::DVec3;

use super::batch::{Batch, batches};
use super::{SessionError, SessionOptions, SessionScene, World};

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
    /// None: each scene's own.
    rules: Option<Rules>,
    /// One for each set of rules that was drawn by: kernels are specialized by them.
    renderers: Vec<Renderer>,
}

/// Images on the host, four bytes per pixel: red, green, blue, alpha. Kept from frame to frame,
/// their memory is used again.
#[derive(Default)]
pub struct HostImages {
    frames: Vec<ImageBytes>,
    /// Frame and place in it of each camera, by view.
    places: Vec<Vec<(usize, usize)>>,
}

impl HostImages {
    /// Images of view `view`.
    #[must_use]
    pub fn cameras(&self, view: usize) -> usize {
        self.places[view].len()
    }

    /// Views that were drawn.
    #[must_use]
    pub fn views(&self) -> usize {
        self.places.len()
    }

    /// Width and height of a camera's image, pixels.
    #[must_use]
    pub fn size_px(&self, view: usize, camera: usize) -> [u32; 2] {
        let (frame, place) = self.places[view][camera];
        self.frames[frame].size_px(place)
    }

    /// The image of camera `camera` of view `view`, row by row from the top.
    #[must_use]
    pub fn rgba(&self, view: usize, camera: usize) -> &[u8] {
        let (frame, place) = self.places[view][camera];
        self.frames[frame].rgba(place)
    }
}

impl BatchRenderer {
    pub(super) fn new(gpu: &Gpu, options: &SessionOptions) -> Self {
        Self {
            gpu: gpu.clone(),
            options: options.render,
            rules: options.rules,
            renderers: Vec::new(),
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
    fn renderer_of(&mut self, scene: &SessionScene) -> usize {
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

    /// Draws `views` and brings the images to the host. What each frame took is returned: one frame
    /// draws up to 32 cameras of worlds over the same scene that follow one another, and all frames
    /// are submitted before the first is waited for, as far as
    /// [`decouplegs_render::RenderOptions::frames_in_flight`] lets them.
    ///
    /// # Errors
    /// Returns an error if a camera or agent cannot make an image, the device has not the memory or
    /// was lost, or images are floats.
    pub fn draw(
        &mut self,
        views: &[WorldView<'_>],
        images: &mut HostImages,
    ) -> Result<Vec<FrameStatistics>, SessionError> {
        if self.options.outputs.color != ColorFormat::U8 {
            return Err(SessionError::NotBytes);
        }
        images.places = vec![Vec::new(); views.len()];
        let HostImages { frames, places } = images;
        self.each_frame(views, |renderer, number, batch| {
            if frames.len() <= number {
                frames.push(ImageBytes::default());
            }
            renderer.read_bytes(&mut frames[number])?;
            let own = batch
                .parts
                .iter()
                .flat_map(|part| part.cameras.clone().map(|_| part.view));
            own.enumerate()
                .for_each(|(place, view)| places[view].push((number, place)));
            Ok(())
        })
    }

    /// [`BatchRenderer::draw`], in floats, with depth and instances where the session's outputs
    /// have them: `[view][camera]`.
    ///
    /// # Errors
    /// Those of [`BatchRenderer::draw`].
    pub fn draw_images(
        &mut self,
        views: &[WorldView<'_>],
    ) -> Result<(Vec<Vec<Image>>, Vec<FrameStatistics>), SessionError> {
        let mut images: Vec<Vec<Image>> = vec![Vec::new(); views.len()];
        let statistics = self.each_frame(views, |renderer, _, batch| {
            let own = batch
                .parts
                .iter()
                .flat_map(|part| part.cameras.clone().map(|_| part.view));
            own.zip(renderer.read_images()?)
                .for_each(|(view, image)| images[view].push(image));
            Ok(())
        })?;
        Ok((images, statistics))
    }

    /// Draws `views` and leaves the images on the device, a frame each: cameras in the order of the
    /// views. They stay as they are until they are dropped, and with
    /// [`decouplegs_render::Outputs::exported`] another API may read them there.
    ///
    /// # Errors
    /// Those of [`BatchRenderer::draw`], and when too many are held already.
    pub fn draw_on_device(
        &mut self,
        views: &[WorldView<'_>],
    ) -> Result<(Vec<TakenImages>, Vec<FrameStatistics>), SessionError> {
        let mut taken = Vec::new();
        let statistics = self.each_frame(views, |renderer, _, _| {
            taken.extend(renderer.take_images()?);
            Ok(())
        })?;
        Ok((taken, statistics))
    }

    /// Submits a frame a batch, and calls `done` with each as it is finished.
    fn each_frame(
        &mut self,
        views: &[WorldView<'_>],
        mut done: impl FnMut(&mut Renderer, usize, &Batch) -> Result<(), SessionError>,
    ) -> Result<Vec<FrameStatistics>, SessionError> {
        self.drain();
        if let Some(view) = views
            .iter()
            .position(|view| !view.world.scene().is_on(&self.gpu))
        {
            return Err(SessionError::OtherSession { view });
        }
        let batches = batches(views, self.pixels_max())?;
        let renderers: Vec<usize> = batches
            .iter()
            .map(|batch| self.renderer_of(&batch.scene))
            .collect();
        let mut statistics = Vec::with_capacity(batches.len());
        // Each renderer finishes its frames in the order of their submission, so all frames are
        // finished in the order of the batches.
        let mut finish =
            |own_renderers: &mut Vec<Renderer>, number: usize| -> Result<(), SessionError> {
                let renderer = &mut own_renderers[renderers[number]];
                statistics.push(renderer.finish()?);
                done(renderer, number, &batches[number])
            };
        let mut waiting: VecDeque<usize> = VecDeque::new();
        for (number, batch) in batches.iter().enumerate() {
            if waiting.len() >= self.options.frames_in_flight.max(1)
                && let Some(oldest) = waiting.pop_front()
            {
                finish(&mut self.renderers, oldest)?;
            }
            submit(&mut self.renderers[renderers[number]], batch, views)?;
            waiting.push_back(number);
        }
        waiting
            .into_iter()
            .try_for_each(|oldest| finish(&mut self.renderers, oldest))?;
        Ok(statistics)
    }

    /// Releases frames that a call before left in flight when it failed.
    fn drain(&mut self) {
        // Frames that fail are nobody's any more; the loop ends when none is in flight.
        for renderer in &mut self.renderers {
            while renderer.is_busy() {
                let _ = renderer.finish();
            }
        }
    }

    /// Pixels that one buffer of images can hold.
    fn pixels_max(&self) -> u64 {
        let bytes = match self.options.outputs.color {
            ColorFormat::F32 => 16,
            ColorFormat::U8 => 4,
        };
        self.gpu.limits().storage_buffer_bytes_max / bytes
    }
}

fn submit(
    renderer: &mut Renderer,
    batch: &Batch,
    views: &[WorldView<'_>],
) -> Result<(), SessionError> {
    let agents = batch
        .parts
        .iter()
        .flat_map(|part| views[part.view].world.agents());
    let places: Vec<DVec3> = agents.map(|agent| agent.placed.pose.translation).collect();
    batch.scene.ready_light(&places);
    let live = batch.scene.live();
    let cast = batch.cast(&live, views);
    Ok(renderer.submit(cast.over(&live), &batch.cameras(views))?)
}
