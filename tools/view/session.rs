//! The thread that renders: commands in, images out.

use std::collections::BTreeMap;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use decouplegs::gpu::Gpu;
use decouplegs::render::rendered_image::preview;
use decouplegs::render::{ColorFormat, FrameStatistics, Outputs, Plane};

use decouplegs::scene::lens::FThetaReference;
use decouplegs::scene::{Camera, Intrinsics, Lens, RayMap, Rules};
use decouplegs::session::{
    BatchRenderer, HostImages, Session, SessionError, SessionOptions, WorldView,
};
use decouplegs_cli::{jpeg, png_bytes};
use serde_json::json;

use crate::protocol::{
    Acknowledgement, Channel, Command, FLAG_EXACT, FLAG_LAST, Header, ImageKind, Pane, Request,
    View,
};
use crate::source::{Source, pose_json, scaled};

/// Updates that a client may have before it has shown the first: one on the way, one in work.
const CREDITS: u32 = 2;
/// Quality of JPEG while something moves.
const QUALITY_MOVING: u8 = 75;
/// Scales of images while something moves.
const SCALES: [f64; 3] = [1.0, 0.5, 0.25];
/// An update that takes longer is followed by a smaller one.
const SLOW: Duration = Duration::from_millis(100);
/// An update that takes less is followed by a larger one.
const FAST: Duration = Duration::from_millis(20);

/// Messages to a client.
#[derive(Debug)]
pub enum Outgoing {
    /// JSON text.
    Text(String),
    /// An image with its header.
    Image(Vec<u8>),
}

/// Way to a client. A client that leaves hundreds of messages unread is dropped.
pub type Outbox = tokio::sync::mpsc::Sender<Outgoing>;

/// Events for the thread that renders.
pub enum Event {
    /// A client came.
    Joined(u64, Outbox),
    /// A client went.
    Left(u64),
    /// A client sent a command.
    Command(u64, Request),
    /// The program ends.
    Stop,
}

struct Client {
    outbox: Outbox,
    view: View,
    /// True if it has not seen the newest state at full size.
    stale: bool,
    credits: u32,
    /// Number of the last update.
    update: u32,
    /// Index of the scale while something moves.
    scale: usize,
}

struct Clock {
    time_s: f64,
    playing: bool,
    looping: bool,
    speed: f64,
    advanced: Instant,
}

/// Image of a pane before it is encoded.
struct Drawn {
    rgba: Vec<u8>,
    size_px: [u32; 2],
}

/// Renders for all clients.
pub struct Viewer {
    gpu: Gpu,
    rules: Rules,
    source: Source,
    color: BatchRenderer,
    /// Renderers of other channels, made when one is asked for.
    channels: BTreeMap<Channel, BatchRenderer>,
    images: HostImages,
    clients: BTreeMap<u64, Client>,
    clock: Clock,
}

/// Options of a session that renders as `decouplegs render` does.
pub fn options(rules: Rules, channel: Channel) -> SessionOptions {
    let mut options = SessionOptions {
        rules: Some(rules),
        bakes_light_on_demand: false,
        ..SessionOptions::default()
    };
    if channel != Channel::Color {
        options.render.outputs = Outputs {
            color: ColorFormat::F32,
            planes: plane_of(channel).into_iter().collect(),
            ..Outputs::default()
        };
    }
    options
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

impl Viewer {
    /// A viewer of `source` on `gpu`.
    pub fn new(gpu: &Gpu, rules: Rules, source: Source, color: BatchRenderer) -> Self {
        Self {
            gpu: gpu.clone(),
            rules,
            clock: Clock {
                time_s: source.span_s()[0],
                playing: false,
                looping: false,
                speed: 1.0,
                advanced: Instant::now(),
            },
            source,
            color,
            channels: BTreeMap::new(),
            images: HostImages::default(),
            clients: BTreeMap::new(),
        }
    }

    /// Serves `events` until the program ends.
    pub fn run(&mut self, events: &Receiver<Event>) {
        loop {
            let first = match self.is_busy() {
                // While something plays, as many updates are made as clients show.
                true => events.recv_timeout(Duration::from_millis(5)),
                false => events.recv().map_err(|_| RecvTimeoutError::Disconnected),
            };
            match first {
                Ok(Event::Stop) | Err(RecvTimeoutError::Disconnected) => return,
                Ok(event) => self.take(event),
                Err(RecvTimeoutError::Timeout) => {}
            }
            // All commands first: of several views of one client only the last is rendered.
            while let Ok(event) = events.try_recv() {
                match event {
                    Event::Stop => return,
                    event => self.take(event),
                }
            }
            self.advance();
            self.update_clients();
        }
    }

    fn is_busy(&self) -> bool {
        let waits = |client: &Client| client.stale && client.credits > 0;
        self.clock.playing && !self.clients.is_empty() || self.clients.values().any(waits)
    }

    fn take(&mut self, event: Event) {
        match event {
            Event::Joined(id, outbox) => {
                let _ = outbox.try_send(Outgoing::Text(self.source.facts().to_string()));
                let client = Client {
                    outbox,
                    view: View::default(),
                    stale: true,
                    credits: CREDITS,
                    update: 0,
                    scale: 0,
                };
                self.clients.insert(id, client);
            }
            Event::Left(id) => {
                self.clients.remove(&id);
                // Nobody looks: the scene does not play on for hours.
                self.clock.playing &= !self.clients.is_empty();
            }
            Event::Command(id, request) => self.command(id, request),
            Event::Stop => {}
        }
    }

    fn command(&mut self, id: u64, request: Request) {
        let Some(client) = self.clients.get_mut(&id) else {
            return;
        };
        let mut error = None;
        match request.command {
            Command::Shown { update } => {
                if update <= client.update {
                    client.credits = (client.credits + 1).min(CREDITS);
                }
                return;
            }
            Command::Look(view) => {
                let mut cameras = view.panes.iter().map(|pane| self.source.camera(pane));
                match cameras.find_map(Result::err) {
                    Some(reason) => error = Some(reason),
                    None => (client.view, client.stale) = (view, true),
                }
            }
            Command::Time { time_s } => self.set_time(time_s),
            Command::Step { by } => {
                self.clock.playing = false;
                let step_s = self.source.step_s();
                let begin_s = self.source.span_s()[0];
                let step = ((self.clock.time_s - begin_s) / step_s).round() + f64::from(by);
                self.set_time(begin_s + step * step_s);
            }
            Command::Play {
                playing,
                speed,
                looping,
            } => {
                let [begin_s, end_s] = self.source.span_s();
                if playing && self.clock.time_s >= end_s {
                    self.set_time(begin_s);
                }
                self.clock.playing = playing && end_s > begin_s;
                (self.clock.speed, self.clock.looping) = (speed, looping);
                self.clock.advanced = Instant::now();
                self.mark_all_stale();
            }
        }
        let answer = Acknowledgement {
            kind: "ack",
            sequence: request.sequence,
            error: error.as_deref(),
        };
        self.send(id, Outgoing::Text(json!(answer).to_string()));
    }

    fn set_time(&mut self, time_s: f64) {
        let [begin_s, end_s] = self.source.span_s();
        self.clock.time_s = time_s.clamp(begin_s, end_s);
        self.clock.advanced = Instant::now();
        self.source.set_time(self.clock.time_s);
        self.mark_all_stale();
    }

    fn mark_all_stale(&mut self) {
        (self.clients.values_mut()).for_each(|client| client.stale = true);
    }

    fn advance(&mut self) {
        if !self.clock.playing {
            return;
        }
        let [begin_s, end_s] = self.source.span_s();
        let elapsed_s = self.clock.advanced.elapsed().as_secs_f64();
        let mut time_s = self.clock.time_s + elapsed_s * self.clock.speed;
        if time_s >= end_s {
            self.clock.playing = self.clock.looping;
            time_s = match self.clock.looping {
                true => begin_s,
                false => end_s,
            };
        }
        self.set_time(time_s);
    }

    /// Sends an update to each client that has not seen the newest state and has credit for it.
    fn update_clients(&mut self) {
        let due = |(&id, client): (&u64, &Client)| {
            (client.stale && client.credits > 0 && !client.view.panes.is_empty()).then_some(id)
        };
        let due: Vec<u64> = self.clients.iter().filter_map(due).collect();
        for id in due {
            if let Err(error) = self.update(id) {
                let text = decouplegs::explain::explain(&error);
                let message = json!({"type": "error", "text": text});
                self.send(id, Outgoing::Text(message.to_string()));
                // The same would fail again: wait for another view or time.
                if let Some(client) = self.clients.get_mut(&id) {
                    client.stale = false;
                }
            }
        }
    }

    fn update(&mut self, id: u64) -> Result<(), SessionError> {
        let since = Instant::now();
        let Some(client) = self.clients.get_mut(&id) else {
            return Ok(());
        };
        let reduced = client.view.reduce && (client.view.moving || self.clock.playing);
        let scale = if reduced { SCALES[client.scale] } else { 1.0 };
        client.update = client.update.wrapping_add(1);
        client.credits -= 1;
        client.stale = false;
        let (update, view) = (client.update, client.view.clone());
        let time_s = self.source.time_s();
        let cameras: Vec<(usize, Camera)> = (view.panes.iter().enumerate())
            .filter_map(|(index, pane)| {
                // An agent may be gone by now: its pane keeps the last image.
                let mut camera = self.source.camera(pane).ok()?;
                camera.intrinsics = scaled(&camera.intrinsics, scale);
                Some((index, camera))
            })
            .collect();
        let (drawn, statistics) = self.draw(&view, &cameras)?;
        let rendered = since.elapsed();
        let kind = match reduced {
            true => ImageKind::Jpeg,
            false => ImageKind::Png,
        };
        let mut messages = Vec::new();
        for (place, ((index, _), image)) in cameras.iter().zip(&drawn).enumerate() {
            let bytes = match kind {
                ImageKind::Jpeg => jpeg::encode(&image.rgba, image.size_px, QUALITY_MOVING),
                ImageKind::Png => png_bytes::encode(&image.rgba, image.size_px),
            };
            // Sides are at most 4096 pixels, which both formats hold.
            let Ok(bytes) = bytes else { continue };
            let is_last = place + 1 == drawn.len();
            let header = Header {
                stream: view.panes[*index].stream,
                kind,
                flags: (FLAG_EXACT * u8::from(!reduced)) | (FLAG_LAST * u8::from(is_last)),
                update,
                time_us: (1e6 * time_s).round() as i64,
                size_px: image.size_px.map(|side_px| side_px as u16),
            };
            messages.push(Outgoing::Image([&header.bytes()[..], &bytes].concat()));
        }
        let all = since.elapsed();
        let logged = cameras
            .iter()
            .zip(&drawn)
            .filter_map(|((index, _), image)| {
                let pane = &view.panes[*index];
                (self.source).is_logged(pane, image.size_px, &image.rgba)
            });
        let logged = logged.reduce(|all, same| all && same);
        let badge = match (reduced, scale) {
            (false, _) => match logged {
                None => "exact".to_owned(),
                Some(true) => "exact, same bits as the log".to_owned(),
                Some(false) => "exact, other bits than the log".to_owned(),
            },
            (true, 1.0) => format!("JPEG {QUALITY_MOVING}"),
            (true, scale) => format!("1/{} size while moving", 1.0 / scale),
        };
        let mut state = self.source.state();
        state["type"] = "frame".into();
        state["update"] = update.into();
        state["time_s"] = time_s.into();
        state["playing"] = self.clock.playing.into();
        state["speed"] = self.clock.speed.into();
        state["badge"] = badge.into();
        state["panes"] = (cameras.iter())
            .map(|(index, camera)| pane_json(&view.panes[*index], camera))
            .collect();
        state["times_ms"] = times_json(&statistics, rendered, all);
        self.send(id, Outgoing::Text(state.to_string()));
        messages
            .into_iter()
            .for_each(|message| self.send(id, message));
        if let Some(client) = self.clients.get_mut(&id).filter(|_| reduced) {
            match all {
                all if all > SLOW => client.scale = (client.scale + 1).min(SCALES.len() - 1),
                all if all < FAST => client.scale = client.scale.saturating_sub(1),
                _ => {}
            }
        }
        Ok(())
    }

    /// Images of the panes of `view` that have cameras: color in one submission, other channels one
    /// by one.
    fn draw(
        &mut self,
        view: &View,
        cameras: &[(usize, Camera)],
    ) -> Result<(Vec<Drawn>, Vec<FrameStatistics>), SessionError> {
        let pane = |index: usize| -> &Pane { &view.panes[index] };
        let in_color = |(index, _): &&(usize, Camera)| pane(*index).channel == Channel::Color;
        let views: Vec<WorldView> = (cameras.iter())
            .filter(in_color)
            .map(|(index, camera)| WorldView {
                world: self.source.world(pane(*index).agents),
                cameras: std::slice::from_ref(camera),
            })
            .collect();
        let mut statistics = Vec::new();
        if !views.is_empty() {
            statistics = self.color.draw(&views, &mut self.images)?;
        }
        let mut colored = 0;
        let mut drawn = Vec::with_capacity(cameras.len());
        for (index, camera) in cameras {
            let Pane {
                channel, agents, ..
            } = *pane(*index);
            if channel == Channel::Color {
                drawn.push(Drawn {
                    rgba: self.images.rgba(colored, 0).to_vec(),
                    size_px: self.images.size_px(colored, 0),
                });
                colored += 1;
                continue;
            }
            let (gpu, rules) = (&self.gpu, self.rules);
            let renderer = (self.channels.entry(channel))
                .or_insert_with(|| Session::on(gpu, &options(rules, channel)).batch_renderer());
            let world_view = WorldView {
                world: self.source.world(agents),
                cameras: std::slice::from_ref(camera),
            };
            let (images, times) = renderer.draw_images(&[world_view])?;
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

    /// Sends, or drops a client that does not read.
    fn send(&mut self, id: u64, message: Outgoing) {
        let client = self.clients.get(&id);
        if client.is_some_and(|client| client.outbox.try_send(message).is_err()) {
            self.clients.remove(&id);
        }
    }
}

fn pane_json(pane: &Pane, camera: &Camera) -> serde_json::Value {
    let k = &camera.intrinsics;
    json!({
        "stream": pane.stream,
        "pose": pose_json(&camera.world_from_camera),
        "size_px": [k.width_px, k.height_px],
        "focal_px": [k.fx_px, k.fy_px],
        "center_px": [k.cx_px, k.cy_px],
        "lens": lens_json(k),
    })
}

/// Lens as the page projects by it; null for pinholes. A windshield is left out: boxes behind one
/// are off by its refraction.
fn lens_json(k: &Intrinsics) -> serde_json::Value {
    let mut json = match k.lens {
        Lens::Pinhole => return serde_json::Value::Null,
        Lens::OpenCv(lens) => json!({
            "kind": "opencv",
            "radial": lens.radial,
            "tangential": lens.tangential,
            "thin_prism": lens.thin_prism,
        }),
        Lens::Fisheye(lens) => json!({"kind": "fisheye", "radial": lens.radial}),
        Lens::FTheta(lens) => json!({
            "kind": "ftheta",
            "follows_pixel_distance": lens.reference == FThetaReference::PixelDistanceToAngle,
            "pixel_distance_to_angle": lens.pixel_distance_to_angle,
            "angle_to_pixel_distance": lens.angle_to_pixel_distance,
            "linear_cde": lens.linear_cde,
        }),
    };
    json["limit_rad"] = RayMap::new(k).limit_rad().into();
    json
}

fn times_json(
    statistics: &[FrameStatistics],
    rendered: Duration,
    all: Duration,
) -> serde_json::Value {
    let ms = |duration: Duration| 1e3 * duration.as_secs_f64();
    let gpu: Duration = statistics.iter().map(|frame| frame.gpu_time).sum();
    json!({"gpu": ms(gpu), "render": ms(rendered), "encode": ms(all - rendered)})
}
