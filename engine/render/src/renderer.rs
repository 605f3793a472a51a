//! Draws worlds: the public face of the frame.

use std::time::{Duration, Instant};

use decouplegs_gpu::{DeviceKind, Gpu, QueueRole, StageTime};
use decouplegs_scene::{Camera, EarlyStop, Rules, World};

use crate::RenderError;
use crate::capacity::{Capacity, SortShape};
use crate::frame::{FrameBuffers, FrameShape, Stages, record_frame};
use crate::layout::{Needs, View};
use crate::output::Outputs;
use crate::picture::Picture;
use crate::resident::ResidentWorld;
use crate::stages::ProjectVariant;

/// Splats an index can name with room for a camera beside it.
const SPLATS_MAX: usize = 1 << 27;

/// Entries of a list that may not be cut that a software device blends: llvmpipe ends all loops of a thread after 65,535
/// rounds in total, silently, and a thread of blend makes up to four a list entry.
const UNCUT_PAIRS_MAX_IN_SOFTWARE: u32 = 16_000;

/// Frames that may outgrow their buffers in a row: each list can grow once, and once more for what it hid.
const ATTEMPTS_MAX: u32 = 6;

/// How pictures are made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderOptions {
    /// The definition of a picture.
    pub rules: Rules,
    /// What is asked for.
    pub outputs: Outputs,
    /// Highest degree of spherical harmonics that is evaluated, whatever the world stores.
    pub sh_degree_max: u8,
    /// Macro tiles whose list is longer are blended in segments of this length (the last up to half longer), side
    /// by side. Shorter segments balance better and take more memory: 32 KiB of partial result each. Above 2^24 lists are not
    /// cut.
    pub segment_pairs: u32,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self { rules: Rules::DEFAULT, outputs: Outputs::default(), sh_degree_max: 3, segment_pairs: 1024 }
    }
}

/// What a frame took.
#[derive(Clone, Debug)]
pub struct FrameStatistics {
    /// How many of each it listed.
    pub needs: Needs,
    /// How many it had room for.
    pub capacity: Capacity,
    /// How often it was drawn again because a list outgrew its buffer.
    pub redrawn: u32,
    /// GPU time from the first command to the last.
    pub gpu_time: Duration,
    /// GPU time by stage, in order.
    pub stages: Vec<StageTime>,
    /// Wall clock from the call to the finished picture, redrawing included.
    pub wall_time: Duration,
    /// Host time to record and submit the last drawing.
    pub record_time: Duration,
}

/// Draws worlds on one device with one set of options. Buffers are kept from frame to frame and grow as needed.
pub struct Renderer {
    gpu: Gpu,
    options: RenderOptions,
    sort: SortShape,
    stages: Vec<(ProjectVariant, Stages)>,
    capacity: Option<Capacity>,
    frame: Option<FrameBuffers>,
    view: Option<View>,
}

impl Renderer {
    /// A renderer on `gpu`. Kernels are built when the first world of a kind is drawn.
    #[must_use]
    pub fn new(gpu: &Gpu, options: RenderOptions) -> Self {
        let limits = gpu.limits();
        let sort = SortShape::for_device(limits.subgroup_size, limits.workgroup_threads_max);
        Self { gpu: gpu.clone(), options, sort, stages: Vec::new(), capacity: None, frame: None, view: None }
    }

    /// The device it draws on.
    #[must_use]
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// How it draws.
    #[must_use]
    pub fn options(&self) -> &RenderOptions {
        &self.options
    }

    /// Starts with room for exactly `capacity` instead of a guess: for those who know their scene, and for tests of growth.
    #[must_use]
    pub fn with_capacity(mut self, capacity: Capacity) -> Self {
        self.capacity = Some(capacity);
        self
    }

    /// Copies `world` to the device, its splats in the order given.
    ///
    /// # Errors
    /// When it has too many splats, or the device not the memory.
    pub fn upload(&self, world: &World) -> Result<ResidentWorld, RenderError> {
        let splats = world.splats.len();
        if splats > SPLATS_MAX {
            return Err(RenderError::TooManySplats { splats, max: SPLATS_MAX });
        }
        ResidentWorld::upload(&self.gpu, world)
    }

    /// Draws `world` for all `cameras` in one submission and waits for the pictures.
    ///
    /// They stay on the device until the next call; [`Renderer::read_pictures`] fetches them.
    ///
    /// # Errors
    /// When a camera cannot make a picture, the device has not the memory or was lost.
    pub fn render(&mut self, world: &ResidentWorld, cameras: &[Camera]) -> Result<FrameStatistics, RenderError> {
        let start = Instant::now();
        let view = View::new(cameras, world.origin).map_err(RenderError::View)?;
        let stages = self.stages_for(world)?;
        for redrawn in 0..ATTEMPTS_MAX {
            self.fit_buffers(world, &view)?;
            let Some(frame) = &self.frame else { unreachable!("fit_buffers made them") };
            let record_start = Instant::now();
            frame.set_cameras(&view);
            let mut recorder = self.gpu.record(QueueRole::Main);
            record_frame(&mut recorder, &self.stages[stages].1, world, frame);
            let ticket = self.gpu.submit(recorder, &[])?;
            let record_time = record_start.elapsed();
            ticket.wait()?;
            let needs = frame.found_needs.read_host()[0];
            let capacity = frame.shape.capacity;
            if capacity.holds(&needs) {
                self.check_uncut_lists(&needs)?;
                let gpu_time = Duration::from_nanos(ticket.gpu_time_ns()?);
                let stages = ticket.stage_times()?;
                self.view = Some(view);
                return Ok(FrameStatistics {
                    needs,
                    capacity,
                    redrawn,
                    gpu_time,
                    stages,
                    wall_time: start.elapsed(),
                    record_time,
                });
            }
            self.capacity = Some(capacity.grown_to(&needs));
        }
        let needs = self.frame.as_ref().map(|frame| frame.found_needs.read_host());
        Err(RenderError::Unsettled { attempts: ATTEMPTS_MAX, needs: format!("{needs:?}") })
    }

    /// The pictures of the last frame, one a camera, in the order the cameras were given.
    ///
    /// Colours of [`crate::ColourFormat::U8`] come back as multiples of 1/255. Empty before the first frame.
    ///
    /// # Errors
    /// When the device was lost.
    pub fn read_pictures(&self) -> Result<Vec<Picture>, RenderError> {
        let (Some(frame), Some(view)) = (&self.frame, &self.view) else { return Ok(Vec::new()) };
        let buffers = &frame.pictures;
        let pixels: Vec<[f32; 4]> = match self.options.outputs.colour {
            crate::ColourFormat::F32 => self.gpu.read(&buffers.pictures_f32)?,
            crate::ColourFormat::U8 => {
                let words = self.gpu.read(&buffers.pictures_u8)?;
                words.iter().map(|word| word.to_le_bytes().map(|byte| f32::from(byte) / 255.0)).collect()
            }
        };
        let depths = if self.options.outputs.depth { Some(self.gpu.read(&buffers.depths_m)?) } else { None };
        let instances = if self.options.outputs.instance { Some(self.gpu.read(&buffers.instance_ids)?) } else { None };
        let pictures = view.cameras.iter().map(|camera| {
            let range = camera.first_pixel as usize..camera.first_pixel as usize + camera.pixels();
            Picture {
                width: camera.size_px[0],
                height: camera.size_px[1],
                rgb: pixels[range.clone()].iter().map(|pixel| [pixel[0], pixel[1], pixel[2]]).collect(),
                alpha: pixels[range.clone()].iter().map(|pixel| pixel[3]).collect(),
                depth: depths.as_ref().map(|depths| depths[range.clone()].to_vec()),
                instance: instances.as_ref().map(|ids| ids[range.clone()].iter().map(|&id| id as u16).collect()),
            }
        });
        Ok(pictures.collect())
    }

    /// Refuses what a software device would draw wrong without a word.
    fn check_uncut_lists(&self, needs: &Needs) -> Result<(), RenderError> {
        let uncut = self.options.rules.stop == EarlyStop::Exclusive || self.options.segment_pairs > UNCUT_PAIRS_MAX_IN_SOFTWARE;
        if uncut && self.gpu.info().kind == DeviceKind::Cpu && needs.longest > UNCUT_PAIRS_MAX_IN_SOFTWARE {
            return Err(RenderError::ListTooLong { longest: needs.longest, max: UNCUT_PAIRS_MAX_IN_SOFTWARE });
        }
        Ok(())
    }

    /// The place in `self.stages` of the kernels for `world`, built when they are new.
    fn stages_for(&mut self, world: &ResidentWorld) -> Result<usize, RenderError> {
        let variant = ProjectVariant {
            sh_degree: world.sh_degree.min(self.options.sh_degree_max),
            instances: world.has_instances && self.options.outputs.instance,
        };
        if let Some(place) = self.stages.iter().position(|(built, _)| *built == variant) {
            return Ok(place);
        }
        let RenderOptions { rules, outputs, segment_pairs, .. } = &self.options;
        let stages = Stages::new(&self.gpu, rules, outputs, variant, *segment_pairs, self.sort)?;
        self.stages.push((variant, stages));
        Ok(self.stages.len() - 1)
    }

    /// Makes the buffers what `view` of `world` needs, as far as that is known.
    fn fit_buffers(&mut self, world: &ResidentWorld, view: &View) -> Result<(), RenderError> {
        let shape = FrameShape {
            capacity: self.capacity.unwrap_or_else(|| Capacity::guess(world.splats, view.cameras.len())),
            cameras: view.cameras.len(),
            chunks: world.chunk_count(),
            bins: view.bins,
            pixels: view.pixels,
        };
        if self.frame.as_ref().is_none_or(|frame| frame.shape != shape) {
            // The old ones go first: both would not always fit.
            self.frame = None;
            self.view = None;
            self.frame = Some(FrameBuffers::new(&self.gpu, shape, &self.options.outputs, self.sort)?);
            self.capacity = Some(shape.capacity);
        }
        Ok(())
    }
}
