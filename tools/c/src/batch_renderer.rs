//! Batch renderers: worlds become images.

use std::ffi::c_void;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Instant;

use decouplegs::render::{ColorFormat, FrameStatistics, Image, Outputs, PlaneMap, PlaneValues};
use decouplegs::scene::Camera;
use decouplegs::session::{BatchRenderer, HostImages, Session, SessionError, WorldView};

use crate::arguments::{array, give_growing, out, out_handle};
use crate::boundary::{Call, guarded};
use crate::handles::{Registry, alone};
use crate::session::{DgsSession, SESSIONS};
use crate::status::{DgsStatus, Failure};
use crate::types::{DgsCamera, DgsImage, DgsImageKind, DgsLidarPoint, DgsStatistics, DgsView};
use crate::world::{DgsWorld, HeldWorld, WORLDS};

/// Draws worlds and keeps the images.
pub struct DgsBatchRenderer(());

/// Object behind a batch renderer handle.
pub struct HeldBatchRenderer {
    session: Arc<Session>,
    drawing: Mutex<Drawing>,
}

pub static BATCH_RENDERERS: Registry<HeldBatchRenderer> = Registry::new("batch renderer");

impl HeldBatchRenderer {
    pub fn lock(&self) -> Result<MutexGuard<'_, Drawing>, Failure> {
        alone("batch renderer", &self.drawing)
    }

    /// The world of view number `index`, which must be of this batch renderer's session.
    pub fn world(
        &self,
        call: &mut Call,
        index: usize,
        world: *const DgsWorld,
    ) -> Result<Arc<HeldWorld>, Failure> {
        let world = WORLDS
            .find(call, world)
            .map_err(|failure| failure.with_subject(&format!("view {index}")))?;
        if !Arc::ptr_eq(&world.session, &self.session) {
            let text = "belongs to another session than the batch renderer: its device knows nothing of it";
            return Err(Failure::new(
                DgsStatus::InvalidHandle,
                format!("the world of view {index} {text}"),
            ));
        }
        Ok(world)
    }
}

/// A batch renderer and what it drew last.
pub struct Drawing {
    pub renderer: BatchRenderer,
    /// Kept from draw to draw, their memory is used again.
    bytes: HostImages,
    drawn: Drawn,
    statistics: DgsStatistics,
    /// Points of the last sweep.
    pub points: Vec<DgsLidarPoint>,
}

enum Drawn {
    /// Empty: nothing was drawn yet, or the last draw failed.
    Nothing,
    /// Images in [`Drawing::bytes`].
    Bytes,
    /// `[view][camera]`
    Images(Vec<Vec<CameraImages>>),
}

/// One camera's images, those that the session has.
struct CameraImages {
    size_px: [u32; 2],
    rgba_u8: Vec<[u8; 4]>,
    rgba_f32: Vec<[f32; 4]>,
    planes: PlaneMap,
}

impl CameraImages {
    fn new(image: Image, color: ColorFormat) -> Self {
        let pixels = || {
            image
                .rgb
                .iter()
                .zip(&image.alpha)
                .map(|(&[r, g, b], &a)| [r, g, b, a])
        };
        // They were bytes on the device, so nothing is lost.
        let bytes = |pixel: [f32; 4]| pixel.map(|value| (255.0 * value).round() as u8);
        let (rgba_u8, rgba_f32) = match color {
            ColorFormat::U8 => (pixels().map(bytes).collect(), Vec::new()),
            ColorFormat::F32 => (Vec::new(), pixels().collect()),
        };
        let size_px = [image.width, image.height];
        Self {
            size_px,
            rgba_u8,
            rgba_f32,
            planes: image.planes,
        }
    }
}

/// A batch renderer that draws as the session's options say. One for each thread that draws, and
/// one for each use, is fastest: it keeps its memory from draw to draw.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_batch_renderer_new(
    session: *const DgsSession,
    renderer: *mut *mut DgsBatchRenderer,
) -> DgsStatus {
    guarded(|call| {
        // SAFETY: as the header asks of all pointers.
        let made = unsafe { out_handle("renderer", renderer) }?;
        let session = Arc::clone(&*SESSIONS.find(call, session)?);
        let renderer = session.batch_renderer();
        let (bytes, drawn, statistics) = (
            HostImages::default(),
            Drawn::Nothing,
            DgsStatistics::default(),
        );
        let drawing = Mutex::new(Drawing {
            renderer,
            bytes,
            drawn,
            statistics,
            points: Vec::new(),
        });
        made.write(BATCH_RENDERERS.add(HeldBatchRenderer { session, drawing }));
        Ok(())
    })
}

/// Closes a batch renderer. Its images go with it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_batch_renderer_close(renderer: *mut DgsBatchRenderer) -> DgsStatus {
    guarded(|_| BATCH_RENDERERS.close(renderer))
}

/// Draws `count` views, at least one, and waits for the images. Worlds over one scene that follow
/// one another are drawn together, 32 cameras at a time. Where it fails, the batch renderer has no
/// images and is as good as before.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_batch_renderer_draw(
    renderer: *mut DgsBatchRenderer,
    views: *const DgsView,
    count: usize,
) -> DgsStatus {
    guarded(|call| {
        let held = BATCH_RENDERERS.find(call, renderer)?;
        let mut drawing = held.lock()?;
        drawing.forget();
        // SAFETY: as the header asks of all pointers; a view is of pointers and a number.
        let views = unsafe { array("views", views, count) }?;
        let numbered = views.iter().enumerate();
        // SAFETY: the views' pointers too are as the header asks.
        let seen = numbered.map(|(index, view)| unsafe { Seen::new(call, &held, index, view) });
        let seen = seen.collect::<Result<Vec<_>, _>>()?;
        drawing.draw_seen(&seen)
    })
}

/// A view, looked up.
pub struct Seen {
    pub world: Arc<HeldWorld>,
    pub cameras: Vec<Camera>,
}

impl Seen {
    /// Converts view number `index`, `view`, for the batch renderer `held`.
    ///
    /// # Safety
    /// The view's pointers are NULL or as the header asks.
    unsafe fn new(
        call: &mut Call,
        held: &HeldBatchRenderer,
        index: usize,
        view: &DgsView,
    ) -> Result<Self, Failure> {
        let world = held.world(call, index, view.world)?;
        // SAFETY: promised by our caller; a camera is of numbers.
        let cameras = unsafe {
            array(
                &format!("cameras of view {index}"),
                view.cameras,
                view.camera_count,
            )
        }?;
        if cameras.is_empty() {
            return Err(Failure::argument(format!(
                "view {index} has no cameras: give it at least one"
            )));
        }
        let named = |(number, camera): (usize, &DgsCamera)| {
            camera.to_camera(format!("view {index}, camera {number}"))
        };
        let cameras = cameras
            .iter()
            .enumerate()
            .map(named)
            .collect::<Result<_, _>>()?;
        Ok(Self { world, cameras })
    }
}

impl Drawing {
    /// Takes the images of the last draw away.
    pub fn forget(&mut self) {
        self.drawn = Drawn::Nothing;
    }

    /// Draws views that were looked up, at least one.
    pub fn draw_seen(&mut self, seen: &[Seen]) -> Result<(), Failure> {
        if seen.is_empty() {
            return Err(Failure::argument("no views were given: draw at least one"));
        }
        let worlds = seen.iter().map(|seen| seen.world.read());
        let worlds = worlds.collect::<Result<Vec<_>, _>>()?;
        let views: Vec<WorldView<'_>> = worlds
            .iter()
            .zip(seen)
            .map(|(world, seen)| WorldView {
                world,
                cameras: &seen.cameras,
            })
            .collect();
        Ok(self.draw(&views)?)
    }

    fn draw(&mut self, views: &[WorldView<'_>]) -> Result<(), SessionError> {
        let begun = Instant::now();
        let Outputs { color, planes, .. } = self.renderer.options().outputs;
        let frames = if color == ColorFormat::U8 && planes.is_empty() {
            let frames = self.renderer.draw(views, &mut self.bytes)?;
            self.drawn = Drawn::Bytes;
            frames
        } else {
            let (images, frames) = self.renderer.draw_images(views)?;
            let converted = |cameras: Vec<Image>| {
                let cameras = cameras.into_iter();
                cameras
                    .map(|image| CameraImages::new(image, color))
                    .collect()
            };
            self.drawn = Drawn::Images(images.into_iter().map(converted).collect());
            frames
        };
        self.statistics = summed(&frames);
        self.statistics.memory_bytes = self.renderer.gpu().memory().total_bytes;
        self.statistics.wall_ms = 1e3 * begun.elapsed().as_secs_f64();
        Ok(())
    }

    /// The image of a camera, where there is one.
    fn image(&self, view: usize, camera: usize, kind: u32) -> Result<DgsImage, Failure> {
        match &self.drawn {
            Drawn::Nothing => Err(Failure::not_found(
                "there are no images: nothing was drawn, or the last draw failed",
            )),
            Drawn::Bytes => {
                let there = view < self.bytes.views() && camera < self.bytes.cameras(view);
                if !there {
                    return Err(no_camera(view, camera));
                }
                let bytes =
                    (kind == DgsImageKind::RgbaU8 as u32).then(|| self.bytes.rgba(view, camera));
                image(kind, self.bytes.size_px(view, camera), bytes)
            }
            Drawn::Images(views) => {
                let images = views
                    .get(view)
                    .and_then(|cameras| cameras.get(camera))
                    .ok_or_else(|| no_camera(view, camera))?;
                let size_px = images.size_px;
                let plane = DgsImageKind::plane(kind).and_then(|plane| images.planes.get(&plane));
                match plane {
                    Some(PlaneValues::F32(values)) => image(kind, size_px, Some(values)),
                    Some(PlaneValues::U16(values)) => image(kind, size_px, Some(values)),
                    None if kind == DgsImageKind::RgbaU8 as u32 => {
                        image(kind, size_px, of_some(&images.rgba_u8))
                    }
                    None if kind == DgsImageKind::RgbaF32 as u32 => {
                        image(kind, size_px, of_some(&images.rgba_f32))
                    }
                    None => image::<u8>(kind, size_px, None),
                }
            }
        }
    }
}

fn no_camera(view: usize, camera: usize) -> Failure {
    Failure::not_found(format!(
        "the last draw had no camera {camera} in a view {view}; both are counted from 0"
    ))
}

/// `None` for an empty plane: images have at least one pixel.
fn of_some<T>(plane: &[T]) -> Option<&[T]> {
    (!plane.is_empty()).then_some(plane)
}

/// The image whose values are `values`, rows from the top.
fn image<T>(
    kind: u32,
    [width_px, height_px]: [u32; 2],
    values: Option<&[T]>,
) -> Result<DgsImage, Failure> {
    if kind > DgsImageKind::LAST {
        return Err(Failure::argument(format!(
            "kind is {kind}: expected a DgsImageKind, 0 to {}",
            DgsImageKind::LAST
        )));
    }
    let values = values.ok_or_else(|| {
        let text = "the session has no images of this kind: ask for it in DgsSessionOptions (color, depth, instance, planes)";
        Failure::new(DgsStatus::Unsupported, text)
    })?;
    let pixel_bytes = size_of_val(values) / (width_px as usize * height_px as usize);
    Ok(DgsImage {
        data: values.as_ptr().cast::<c_void>(),
        row_bytes: pixel_bytes * width_px as usize,
        pixel_bytes: pixel_bytes as u32,
        width_px,
        height_px,
        kind,
    })
}

fn summed(frames: &[FrameStatistics]) -> DgsStatistics {
    DgsStatistics {
        frames: frames.len() as u32,
        agents: frames.iter().map(|frame| frame.agents as u32).sum(),
        redrawn: frames.iter().map(|frame| frame.redrawn).sum(),
        gpu_ms: frames
            .iter()
            .map(|frame| 1e3 * frame.gpu_time.as_secs_f64())
            .sum(),
        splats_listed: frames
            .iter()
            .map(|frame| u64::from(frame.required.records))
            .sum(),
        ..DgsStatistics::default()
    }
}

/// The image that camera `camera` of view `view` of the last draw took, both from 0; `kind` is a
/// DgsImageKind. The pixels stay until the batch renderer draws or is closed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_batch_renderer_image(
    renderer: *const DgsBatchRenderer,
    view: usize,
    camera: usize,
    kind: u32,
    image: *mut DgsImage,
) -> DgsStatus {
    guarded(|call| {
        // SAFETY: as the header asks of all pointers.
        let target = unsafe { out("image", image) }?;
        target.write(
            BATCH_RENDERERS
                .find(call, renderer)?
                .lock()?
                .image(view, camera, kind)?,
        );
        Ok(())
    })
}

/// Writes the statistics of the last successful draw to `statistics`, whose `struct_bytes` is set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_batch_renderer_statistics(
    renderer: *const DgsBatchRenderer,
    statistics: *mut DgsStatistics,
) -> DgsStatus {
    guarded(|call| {
        let held = BATCH_RENDERERS.find(call, renderer)?;
        let drawing = held.lock()?;
        // SAFETY: as the header asks of all pointers.
        unsafe {
            give_growing(
                "statistics",
                statistics,
                DgsStatistics::FIRST_BYTES,
                &drawing.statistics,
            )
        }
    })
}
