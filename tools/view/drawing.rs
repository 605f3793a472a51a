//! Images of panes, agents under the mouse, and points of LiDARs.

use std::collections::BTreeMap;
use std::sync::Arc;

use decouplegs::gpu::Gpu;
use decouplegs::render::rendered_image::preview;
use decouplegs::render::{ColorFormat, FrameStatistics, Outputs, Plane};
use decouplegs::scene::lidar::{PointFrame, ReturnOptions};
use decouplegs::scene::{Camera, Lidar};
use decouplegs::session::{
    BatchRenderer, HostImages, Session, SessionError, SessionOptions, World, WorldView,
};
use decouplegs_cli::background::BackgroundArguments;
use glam::DVec3;

use crate::played::LoggedImage;
use crate::protocol::{Channel, Pane};

/// Points that a page is sent of one sweep.
const POINTS_MAX: usize = 200_000;

/// View to draw.
pub struct Shot {
    /// Pane that it is for.
    pub pane: Pane,
    /// Camera, in the size of the image.
    pub camera: Camera,
    /// World that the pane shows.
    pub world: World,
    /// Image that a log has of the same camera and time.
    pub logged: Option<LoggedImage>,
}

/// Sweep to trace.
pub struct SweepShot {
    /// LiDAR, for the sweep that ends at the time that is shown.
    pub lidar: Lidar,
    /// Position of the ego, world coordinates, meters.
    pub origin: DVec3,
    /// World that is shown, with agents.
    pub world: World,
}

/// Image of a pane before it is encoded.
pub struct Drawn {
    /// 8-bit RGBA, rows from the top.
    pub rgba: Vec<u8>,
    /// Width and height, pixels.
    pub size_px: [u32; 2],
}

/// Agent and place at a pixel.
pub struct Picked {
    /// Instance id of the agent; none for the background.
    pub instance: Option<u16>,
    /// Place in the world, meters; none where nothing is.
    pub position_m: Option<DVec3>,
}

/// Renderers of one device.
pub struct Drawer {
    gpu: Gpu,
    session: Arc<Session>,
    color: BatchRenderer,
    /// Renderers of other channels, made when one is asked for.
    channels: BTreeMap<Channel, BatchRenderer>,
    picker: Option<BatchRenderer>,
    images: HostImages,
}

/// Renderer of `outputs` on `gpu`, with the other options of `session`.
fn renderer_of(gpu: &Gpu, session: &Session, outputs: Outputs) -> BatchRenderer {
    let mut options = session.options().clone();
    options.render.outputs = outputs;
    Session::on(gpu, &options).batch_renderer()
}

fn planes(planes: impl IntoIterator<Item = Plane>) -> Outputs {
    Outputs {
        color: ColorFormat::F32,
        planes: planes.into_iter().collect(),
        ..Outputs::default()
    }
}

fn plane_of(channel: Channel) -> Option<Plane> {
    match channel {
        Channel::Color | Channel::Alpha => None,
        Channel::Depth => Some(Plane::Depth),
        Channel::Range => Some(Plane::Range),
        Channel::Instance => Some(Plane::Instance),
        Channel::Normal => Some(Plane::Normal),
        Channel::Flow => Some(Plane::FlowForward),
    }
}

impl Drawer {
    /// Renderers on `gpu`, whose backgrounds are stored and drawn as `background` says.
    pub fn new(gpu: &Gpu, background: BackgroundArguments) -> Self {
        // As `decouplegs render` does: each scene by its own rules.
        let mut options = SessionOptions {
            bakes_light_on_demand: false,
            ..SessionOptions::default()
        };
        background.apply_to(&mut options.render);
        // The page shows them.
        options.render.stage_times = true;
        let session = Arc::new(Session::on(gpu, &options));
        Self {
            gpu: gpu.clone(),
            color: session.batch_renderer(),
            session,
            channels: BTreeMap::new(),
            picker: None,
            images: HostImages::default(),
        }
    }

    /// Session that holds the scenes.
    pub fn session(&self) -> &Arc<Session> {
        &self.session
    }

    /// Name of the device.
    pub fn device(&self) -> String {
        self.gpu.info().to_string()
    }

    /// Images of `shots`: color in one submission, other channels one by one.
    ///
    /// # Errors
    /// Returns an error if the device fails.
    pub fn draw(
        &mut self,
        shots: &[Shot],
    ) -> Result<(Vec<Drawn>, Vec<FrameStatistics>), SessionError> {
        let views: Vec<WorldView> = (shots.iter())
            .filter(|shot| shot.pane.channel == Channel::Color)
            .map(Shot::view)
            .collect();
        let mut statistics = Vec::new();
        if !views.is_empty() {
            statistics = self.color.draw(&views, &mut self.images)?;
        }
        let mut colored = 0;
        let mut drawn = Vec::with_capacity(shots.len());
        for shot in shots {
            let channel = shot.pane.channel;
            if channel == Channel::Color {
                drawn.push(Drawn {
                    rgba: self.images.rgba(colored, 0).to_vec(),
                    size_px: self.images.size_px(colored, 0),
                });
                colored += 1;
                continue;
            }
            let (gpu, session) = (&self.gpu, &self.session);
            let renderer = (self.channels.entry(channel))
                .or_insert_with(|| renderer_of(gpu, session, planes(plane_of(channel))));
            let (images, times) = renderer.draw_images(&[shot.view()])?;
            statistics.extend(times);
            let image = &images[0][0];
            let shown = plane_of(channel).and_then(|plane| preview(image, plane));
            let byte = |value: f32| (255.0 * value.clamp(0.0, 1.0)).round() as u8;
            let rgba = match &shown {
                Some(preview) => (preview.rgb.iter())
                    .flat_map(|rgb| [byte(rgb[0]), byte(rgb[1]), byte(rgb[2]), 255])
                    .collect(),
                None => (image.alpha.iter())
                    .flat_map(|&alpha| [byte(alpha), byte(alpha), byte(alpha), 255])
                    .collect(),
            };
            drawn.push(Drawn {
                rgba,
                size_px: [image.width, image.height],
            });
        }
        Ok((drawn, statistics))
    }

    /// Agent and place at the pixel `at` of the image of `camera` in `world`, in shares of its
    /// size.
    ///
    /// # Errors
    /// Returns an error if the device fails.
    pub fn pick(
        &mut self,
        world: &World,
        camera: &Camera,
        at: [f64; 2],
    ) -> Result<Picked, SessionError> {
        let k = &camera.intrinsics;
        let cell = |share: f64, side_px: u32| {
            let pixel = (share * f64::from(side_px)).floor().max(0.0) as u32;
            pixel.min(side_px - 1)
        };
        let (x_px, y_px) = (cell(at[0], k.width_px), cell(at[1], k.height_px));
        let mut one = camera.clone();
        one.intrinsics = k.cropped(x_px, y_px, 1, 1);
        let (gpu, session) = (&self.gpu, &self.session);
        let picker = self.picker.get_or_insert_with(|| {
            renderer_of(gpu, session, planes([Plane::Instance, Plane::RangeMedian]))
        });
        let view = WorldView {
            world,
            cameras: std::slice::from_ref(&one),
        };
        let (images, _) = picker.draw_images(&[view])?;
        let image = &images[0][0];
        let value = |plane: Plane| image.planes.get(&plane);
        let instance = value(Plane::Instance).and_then(|values| values.as_u16()?.first().copied());
        let range_m =
            value(Plane::RangeMedian).and_then(|values| values.as_f32()?.first().copied());
        let ray = decouplegs::scene::RayMap::new(k)
            .unproject(glam::DVec2::new(x_px.into(), y_px.into()) + 0.5);
        let seen = range_m.filter(|range_m| range_m.is_finite() && *range_m > 0.0);
        let position_m = ray.zip(seen).map(|(ray, range_m)| {
            let pose = &camera.world_from_camera;
            pose.translation + pose.rotation * (ray * f64::from(range_m))
        });
        Ok(Picked {
            instance,
            position_m,
        })
    }

    /// Points of `sweep`: x, y and z relative to the ego's position, and the range, meters, as
    /// little-endian f32.
    ///
    /// # Errors
    /// A sentence, if the device fails.
    pub fn points(&mut self, sweep: &SweepShot) -> Result<Vec<u8>, String> {
        let (lidar, origin) = (&sweep.lidar, sweep.origin);
        let options = ReturnOptions::for_model(&lidar.model);
        let sweep_s = lidar.model.sweep_s;
        let traced = (self.color).trace(&sweep.world, lidar, sweep_s, options.mode);
        let traced = traced.map_err(|error| decouplegs::explain::explain(&error))?;
        let points = traced.returns(&options).points(PointFrame::World);
        let every = points.len().div_ceil(POINTS_MAX).max(1);
        let bytes = points.iter().step_by(every).flat_map(|point| {
            let at = (point.position_m - origin).as_vec3();
            [at.x, at.y, at.z, point.measured.range_m].map(f32::to_le_bytes)
        });
        Ok(bytes.flatten().collect())
    }
}

impl Shot {
    fn view(&self) -> WorldView<'_> {
        WorldView {
            world: &self.world,
            cameras: std::slice::from_ref(&self.camera),
        }
    }
}
