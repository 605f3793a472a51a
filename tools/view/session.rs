//! The thread that renders: commands in, images out.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use decouplegs::explain::explain;
use decouplegs::scene::Camera;
use decouplegs::session::SessionError;
use decouplegs_cli::{jpeg, png_bytes};
use serde_json::{Value, json};

use crate::drawing::Drawer;
use crate::events::{Event, Outbox, Outgoing};
use crate::frame_state::{QUALITY_MOVING, badge, pane_json, times_json};
use crate::image_header::{FLAG_EXACT, FLAG_LAST, Header, ImageKind};
use crate::protocol::{Acknowledgement, Command, Pane, Request, View};
use crate::recording::Recorder;
use crate::source::{Source, scaled};

/// Updates that a client may have before it has shown the first: one on the way, one in work.
const CREDITS: u32 = 2;
/// Scales of images while something moves.
const SCALES: [f64; 3] = [1.0, 0.5, 0.25];
/// An update that takes longer is followed by a smaller one.
const SLOW: Duration = Duration::from_millis(100);
/// An update that takes less is followed by a larger one.
const FAST: Duration = Duration::from_millis(20);

struct Client {
    outbox: Outbox,
    view: View,
    /// Number of the command that asked for the view.
    look: u64,
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

/// Renders for all clients.
pub struct Viewer {
    drawer: Drawer,
    /// Scene or episode that is shown, and the one to compare it with.
    sources: Vec<Source>,
    clients: BTreeMap<u64, Client>,
    clock: Clock,
    recorder: Option<Recorder>,
}

impl Viewer {
    /// Viewer of `sources`, at least one, whose scenes are on the device of `drawer`.
    pub fn new(drawer: Drawer, sources: Vec<Source>) -> Self {
        let mut viewer = Self {
            drawer,
            sources,
            clients: BTreeMap::new(),
            clock: Clock {
                time_s: 0.0,
                playing: false,
                looping: false,
                speed: 1.0,
                advanced: Instant::now(),
            },
            recorder: None,
        };
        viewer.set_time(viewer.span_s()[0]);
        viewer
    }

    /// Serves `events` until the program ends: events that wait are left where `ending` is true.
    pub fn run(&mut self, events: &Receiver<Event>, ending: &AtomicBool) {
        while !ending.load(Ordering::SeqCst) {
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
                if ending.load(Ordering::SeqCst) {
                    return;
                }
                self.take(event);
            }
            self.advance();
            self.record();
            self.update_clients();
        }
    }

    fn is_busy(&self) -> bool {
        let waits = |client: &Client| client.stale && client.credits > 0;
        self.clock.playing && !self.clients.is_empty()
            || self.recorder.is_some()
            || self.clients.values().any(waits)
    }

    fn take(&mut self, event: Event) {
        match event {
            Event::Joined(id, outbox) => {
                let sources: Vec<Value> = self.sources.iter().map(Source::facts).collect();
                let facts = json!({
                    "type": "scene",
                    "sources": sources,
                    "device": self.drawer.device(),
                });
                let _ = outbox.try_send(Outgoing::Text(facts.to_string()));
                let _ = outbox.try_send(Outgoing::Text(self.changing_facts().to_string()));
                let client = Client {
                    outbox,
                    view: View::default(),
                    look: 0,
                    stale: true,
                    credits: CREDITS,
                    update: 0,
                    scale: 0,
                };
                self.clients.insert(id, client);
            }
            Event::Left(id) => {
                self.clients.remove(&id);
                self.sources[0].end_drag();
                self.mark_all_stale();
                // No client is left: the scene does not play on for hours.
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
        if let Command::Shown { update } = request.command {
            if update <= client.update {
                client.credits = (client.credits + 1).min(CREDITS);
            }
            return;
        }
        if let Command::Look(_) = request.command {
            client.look = request.sequence;
        }
        let done = self.done(id, request.command);
        let (result, error) = match done {
            Ok(result) => (result, None),
            Err(error) => (Value::Null, Some(error)),
        };
        let answer = Acknowledgement {
            kind: "ack",
            sequence: request.sequence,
            error: error.as_deref(),
            result: &result,
        };
        self.send(id, Outgoing::Text(json!(answer).to_string()));
    }

    /// Does `command`. Returns the answer of commands that ask for something.
    fn done(&mut self, id: u64, command: Command) -> Result<Value, String> {
        match command {
            Command::Look(view) => {
                for pane in &view.panes {
                    self.source(pane)?.camera(pane)?;
                }
                if let Some(name) = &view.lidar {
                    self.sources[0].lidar(name)?;
                }
                if let Some(client) = self.clients.get_mut(&id) {
                    (client.view, client.stale) = (view, true);
                }
            }
            Command::Time { time_s } => self.set_time(time_s),
            Command::Step { by } => self.step(by)?,
            Command::Play {
                playing,
                speed,
                looping,
            } => {
                let [begin_s, end_s] = self.span_s();
                let goes_on = self.sources.iter().any(Source::goes_on);
                if playing && self.clock.time_s >= end_s && !goes_on {
                    self.set_time(begin_s);
                }
                self.clock.playing = playing && (end_s > begin_s || goes_on);
                (self.clock.speed, self.clock.looping) = (speed, looping);
                self.clock.advanced = Instant::now();
                self.mark_all_stale();
            }
            Command::Pick { stream, at } => return self.pick(id, stream, at),
            Command::Drag {
                stream,
                agent,
                from,
                to,
                free,
                done,
            } => {
                self.clock.playing = false;
                let (_, camera) = self.shown(id, stream)?;
                let session = self.drawer.session();
                let how = (free, done);
                let moved = self.sources[0].drag(&agent, &camera, [from, to], how, session);
                // Also where it is refused: what was dragged is where it was.
                self.set_time(self.sources[0].time_s());
                moved?;
                if done {
                    self.tell_changes();
                }
            }
            Command::Edit(edit) => {
                self.clock.playing = false;
                let said = self.sources[0].edit(&edit, self.drawer.session())?;
                self.set_time(self.sources[0].time_s());
                self.tell_changes();
                return Ok(json!({"said": said}));
            }
            Command::SaveLog { file } => {
                let played = self.sources[0].episode();
                let played = played.ok_or("a scene has no log: save it as a scene")?;
                return Ok(json!({"said": played.save(file.as_ref())?}));
            }
            Command::Record(recording) => {
                if self.recorder.is_some() {
                    return Err("a recording goes on: wait until it is done".into());
                }
                let view = self.clients.get(&id).map(|client| client.view.clone());
                let recorder = Recorder::begin(id, view.unwrap_or_default(), &recording)?;
                self.clock.playing = false;
                self.recorder = Some(recorder);
            }
            Command::Shown { .. } => {}
        }
        Ok(Value::Null)
    }

    fn source(&self, pane: &Pane) -> Result<&Source, String> {
        let none = || "there is nothing to compare with: start the viewer with --against".into();
        self.sources.get(pane.source).ok_or_else(none)
    }

    /// A pane of a client, and its camera at full size.
    fn shown(&self, id: u64, stream: u16) -> Result<(Pane, Camera), String> {
        let view = self.clients.get(&id).map(|client| &client.view);
        let mut panes = view.into_iter().flat_map(|view| &view.panes);
        let pane = panes.find(|pane| pane.stream == stream);
        let pane = pane.ok_or_else(|| format!("there is no view {stream}"))?;
        Ok((pane.clone(), self.source(pane)?.camera(pane)?))
    }

    fn pick(&mut self, id: u64, stream: u16, at: [f64; 2]) -> Result<Value, String> {
        let (pane, camera) = self.shown(id, stream)?;
        let source = &self.sources[pane.source];
        let picked = self.drawer.pick(source, &camera, at);
        let picked = picked.map_err(|error| explain(&error))?;
        let position_m = picked.position_m.map(|at_m| at_m.to_array());
        Ok(json!({"agent": picked.agent, "position_m": position_m}))
    }

    fn step(&mut self, by: i32) -> Result<(), String> {
        self.clock.playing = false;
        let step_s = self.sources[0].step_s();
        let begin_s = self.span_s()[0];
        let step = ((self.clock.time_s - begin_s) / step_s).round() + f64::from(by);
        let time_s = begin_s + step * step_s;
        if by > 0 && time_s > self.reached_s() {
            self.drive_on()?;
        }
        self.set_time(time_s);
        Ok(())
    }

    /// First and last time of all sources, seconds.
    fn span_s(&self) -> [f64; 2] {
        let spans = self.sources.iter().map(Source::span_s);
        let both = |a: [f64; 2], b: [f64; 2]| [a[0].min(b[0]), a[1].max(b[1])];
        spans.reduce(both).unwrap_or_default()
    }

    /// Last time that is reached: that of the episode that goes on and is least far, if there is
    /// one.
    fn reached_s(&self) -> f64 {
        let live = self.sources.iter().filter(|source| source.goes_on());
        let ends = live.map(|source| source.span_s()[1]);
        ends.fold(self.span_s()[1], f64::min)
    }

    fn changing_facts(&self) -> Value {
        let sources: Vec<Value> = self.sources.iter().map(Source::changing_facts).collect();
        let mut episodes = self.sources.iter().map(Source::episode);
        let parts_s = match (episodes.next().flatten(), episodes.next().flatten()) {
            (Some(one), Some(other)) => one.parts_from(other),
            _ => None,
        };
        json!({
            "type": "change",
            "span_s": self.span_s(),
            "sources": sources,
            "parts_s": parts_s,
        })
    }

    fn tell_changes(&mut self) {
        self.tell(&self.changing_facts());
    }

    /// Sends `message` to all clients.
    fn tell(&mut self, message: &Value) {
        let clients: Vec<u64> = self.clients.keys().copied().collect();
        for id in clients {
            self.send(id, Outgoing::Text(message.to_string()));
        }
    }

    /// Drives one more step of the episodes that go on and are least far.
    fn drive_on(&mut self) -> Result<(), String> {
        let reached_s = self.reached_s();
        let live = self.sources.iter_mut().filter(|source| source.goes_on());
        for source in live.filter(|source| source.span_s()[1] <= reached_s) {
            source.drive_on()?;
        }
        self.tell_changes();
        Ok(())
    }

    fn set_time(&mut self, time_s: f64) {
        let begin_s = self.span_s()[0];
        self.clock.time_s = time_s.clamp(begin_s, self.reached_s().max(begin_s));
        self.clock.advanced = Instant::now();
        self.show_at(self.clock.time_s);
        self.mark_all_stale();
    }

    /// Puts all sources at a time, which need not be that of the clock.
    fn show_at(&mut self, time_s: f64) {
        (self.sources.iter_mut()).for_each(|source| source.set_time(time_s));
    }

    fn mark_all_stale(&mut self) {
        (self.clients.values_mut()).for_each(|client| client.stale = true);
    }

    fn advance(&mut self) {
        if !self.clock.playing {
            return;
        }
        let (begin_s, reached_s) = (self.span_s()[0], self.reached_s());
        let elapsed_s = self.clock.advanced.elapsed().as_secs_f64();
        let mut time_s = self.clock.time_s + elapsed_s * self.clock.speed;
        if time_s >= reached_s && self.sources.iter().any(Source::goes_on) {
            if let Err(error) = self.drive_on() {
                self.clock.playing = false;
                self.tell(&json!({"type": "error", "text": error}));
            }
        } else if time_s >= reached_s {
            self.clock.playing = self.clock.looping;
            time_s = match self.clock.looping {
                true => begin_s,
                false => reached_s,
            };
        }
        self.set_time(time_s);
    }

    /// Writes the images of the next time of a recording.
    fn record(&mut self) {
        let Some(mut recorder) = self.recorder.take() else {
            return;
        };
        let client = recorder.client;
        let message = match recorder.next_s() {
            Some(time_s) => match self.record_at(&mut recorder, time_s) {
                Ok(()) => {
                    let progress = recorder.progress();
                    self.recorder = Some(recorder);
                    json!({"type": "recording", "progress": progress})
                }
                Err(error) => json!({"type": "recording", "error": error}),
            },
            None => match recorder.finish() {
                Ok(said) => json!({"type": "recording", "said": said}),
                Err(error) => json!({"type": "recording", "error": error}),
            },
        };
        self.send(client, Outgoing::Text(message.to_string()));
    }

    fn record_at(&mut self, recorder: &mut Recorder, time_s: f64) -> Result<(), String> {
        self.show_at(time_s);
        let view = recorder.view.clone();
        let panes: Vec<(&Pane, Camera)> = (view.panes.iter())
            .filter_map(|pane| Some((pane, self.source(pane).ok()?.camera(pane).ok()?)))
            .collect();
        let drawn = self.drawer.draw(&self.sources, &panes);
        self.show_at(self.clock.time_s);
        let (drawn, _) = drawn.map_err(|error| explain(&error))?;
        let panes: Vec<&Pane> = panes.iter().map(|(pane, _)| *pane).collect();
        recorder.write(&panes, &drawn)
    }

    /// Sends an update to each client that has not seen the newest state and has credit for it.
    fn update_clients(&mut self) {
        let due = |(&id, client): (&u64, &Client)| {
            (client.stale && client.credits > 0 && !client.view.panes.is_empty()).then_some(id)
        };
        let due: Vec<u64> = self.clients.iter().filter_map(due).collect();
        for id in due {
            if let Err(error) = self.update(id) {
                let message = json!({"type": "error", "text": explain(&error)});
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
        let (update, look, view) = (client.update, client.look, client.view.clone());
        let time_s = self.sources[0].time_s();
        let panes: Vec<(&Pane, Camera)> = (view.panes.iter())
            .filter_map(|pane| {
                // An agent may be gone by now: its pane keeps the last image.
                let mut camera = self.source(pane).ok()?.camera(pane).ok()?;
                camera.intrinsics = scaled(&camera.intrinsics, scale);
                Some((pane, camera))
            })
            .collect();
        let (drawn, statistics) = self.drawer.draw(&self.sources, &panes)?;
        let rendered = since.elapsed();
        let kind = match reduced {
            true => ImageKind::Jpeg,
            false => ImageKind::Png,
        };
        let header = |stream: u16, kind: ImageKind, size_px: [u32; 2]| Header {
            stream,
            kind,
            flags: FLAG_EXACT * u8::from(!reduced),
            update,
            time_us: (1e6 * time_s).round() as i64,
            size_px: size_px.map(|side_px| side_px as u16),
        };
        let mut messages = Vec::new();
        for ((pane, _), image) in panes.iter().zip(&drawn) {
            let bytes = match kind {
                ImageKind::Jpeg => jpeg::encode(&image.rgba, image.size_px, QUALITY_MOVING),
                _ => png_bytes::encode(&image.rgba, image.size_px),
            };
            // Sides are at most 4096 pixels, which both formats hold.
            let Ok(bytes) = bytes else { continue };
            messages.push((header(pane.stream, kind, image.size_px), bytes));
        }
        let mut fault = None;
        if let Some(name) = view.lidar.as_ref().filter(|_| !reduced) {
            match self.drawer.points(&self.sources[0], name) {
                Ok(bytes) => messages.push((header(0, ImageKind::Points, [0, 0]), bytes)),
                Err(error) => fault = Some(error),
            }
        }
        if let Some((header, _)) = messages.last_mut() {
            header.flags |= FLAG_LAST;
        }
        let all = since.elapsed();
        let logged = panes.iter().zip(&drawn).filter_map(|((pane, _), image)| {
            self.sources[pane.source].is_logged(pane, image.size_px, &image.rgba)
        });
        let logged = logged.reduce(|all, same| all && same);
        let badge = badge(reduced.then_some(scale), logged);
        let state = json!({
            "type": "frame",
            "update": update,
            "look": look,
            "time_s": time_s,
            "playing": self.clock.playing,
            "speed": self.clock.speed,
            "badge": badge,
            "images": messages.len(),
            "panes": panes.iter().map(|(pane, camera)| pane_json(pane, camera)).collect::<Vec<_>>(),
            "sources": self.sources.iter().map(Source::state).collect::<Vec<_>>(),
            "times_ms": times_json(&statistics, rendered, all),
            "error": fault,
        });
        self.send(id, Outgoing::Text(state.to_string()));
        for (header, bytes) in messages {
            self.send(id, Outgoing::Image([&header.bytes()[..], &bytes].concat()));
        }
        if let Some(client) = self.clients.get_mut(&id).filter(|_| reduced) {
            match all {
                all if all > SLOW => client.scale = (client.scale + 1).min(SCALES.len() - 1),
                all if all < FAST => client.scale = client.scale.saturating_sub(1),
                _ => {}
            }
        }
        Ok(())
    }

    /// Sends, or drops a client that does not read.
    fn send(&mut self, id: u64, message: Outgoing) {
        let client = self.clients.get(&id);
        if client.is_some_and(|client| client.outbox.try_send(message).is_err()) {
            self.clients.remove(&id);
        }
    }
}
