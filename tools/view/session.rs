//! The thread that serves the clients: commands in, images out. Another thread draws them.

mod driving;
mod replacing;
mod work;

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender};
use std::time::{Duration, Instant};

use decouplegs::scene::Camera;
use decouplegs::session::Session;
use serde_json::{Value, json};

use self::driving::WaitingStep;
use crate::clock::Clock;
use crate::draw_thread::DrawThread;
use crate::drawing::Drawer;
use crate::drive_thread::DriveThread;
use crate::events::{Event, Outbox, Outgoing};
use crate::protocol::{Acknowledgement, Command, Pane, Request, View};
use crate::recording::Recorder;
use crate::render_command::{RenderOptions, render_command};
use crate::source::Source;
use crate::uploads;

/// Updates that a client may have before it has shown the first: one on the way, one in work.
const CREDITS: u32 = 2;

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
    /// Number of works that were done when its last update began.
    served: u64,
}

/// Recording of a client.
enum Recording {
    None,
    /// Recording that waits for its next turn.
    Waits(Box<Recorder>),
    /// Recording whose next images are in work.
    InWork,
}

/// Serves all clients.
pub struct Viewer {
    session: Arc<Session>,
    /// Name of the device.
    device: String,
    draws: DrawThread,
    drives: DriveThread,
    /// Episodes that are lent for a step.
    driving: usize,
    /// Steps that wait for it.
    steps: VecDeque<WaitingStep>,
    /// True while an update or images of a recording are in work: one at a time, so that each shows
    /// the newest state.
    in_work: bool,
    /// True if the last work was that of a recording.
    recorded_last: bool,
    /// Number of works that were done, but for picks.
    done: u64,
    /// Questions for pixels that are not answered yet.
    picks: usize,
    /// Scene or episode that is shown, and the one to compare it with.
    sources: Vec<Source>,
    /// Number of files that took the place of what was shown before.
    shown: u32,
    clients: BTreeMap<u64, Client>,
    clock: Clock,
    recording: Recording,
    /// Options that `render` needs too.
    options: RenderOptions,
    /// Splats of a source that pages are sent at most.
    splats_max: usize,
}

impl Viewer {
    /// Viewer of `sources`, at least one, whose scenes are on the device of `drawer`. Commands that
    /// render the same have `options`; pages are sent at
    /// most `splats_max` splats of a source. What is drawn comes back by `events`, which
    /// [`Viewer::run`] serves.
    ///
    /// # Errors
    /// Returns an error if the system has no thread.
    pub fn new(
        drawer: Drawer,
        sources: Vec<Source>,
        (options, splats_max): (RenderOptions, usize),
        events: SyncSender<Event>,
    ) -> std::io::Result<Self> {
        let driven = events.clone();
        let tell_driven = move |done| driven.send(Event::Driven(done)).is_ok();
        let tell = move |done| events.send(Event::Done(done)).is_ok();
        let mut viewer = Self {
            session: Arc::clone(drawer.session()),
            device: drawer.device(),
            draws: DrawThread::start(drawer, tell)?,
            drives: DriveThread::start(tell_driven)?,
            driving: 0,
            steps: VecDeque::new(),
            in_work: false,
            recorded_last: false,
            done: 0,
            picks: 0,
            sources,
            shown: 0,
            clients: BTreeMap::new(),
            clock: Clock::new(),
            recording: Recording::None,
            options,
            splats_max,
        };
        viewer.set_time(viewer.span_s()[0]);
        // Clients learn it when they come.
        let _ = viewer.clock.news(viewer.sources[0].time_s());
        Ok(viewer)
    }

    /// Shows `time_s` first.
    pub fn begin_at(&mut self, time_s: f64) {
        self.set_time(time_s);
        let _ = self.clock.news(self.sources[0].time_s());
    }

    /// Serves `events` until the program ends: events that wait are left where `ending` is true.
    pub fn run(mut self, events: Receiver<Event>, ending: &AtomicBool) {
        while !ending.load(Ordering::SeqCst) {
            let first = match self.clock.playing && !self.clients.is_empty() {
                // While something plays, as many updates are made as clients show.
                true => events.recv_timeout(Duration::from_millis(5)),
                false => events.recv().map_err(|_| RecvTimeoutError::Disconnected),
            };
            match first {
                Ok(Event::Stop) | Err(RecvTimeoutError::Disconnected) => break,
                Ok(event) => self.take(event),
                Err(RecvTimeoutError::Timeout) => {}
            }
            // All commands first: of several views of one client only the last is rendered.
            while let Ok(event) = events.try_recv() {
                if ending.load(Ordering::SeqCst) {
                    break;
                }
                self.take(event);
            }
            self.advance();
            if let Some(news) = self.clock.news(self.sources[0].time_s()) {
                self.tell(&news);
            }
            self.begin_work();
        }
        // Work that is done now finds nobody who listens, and does not wait for room.
        drop(events);
        self.draws.end();
        self.drives.end();
    }

    fn take(&mut self, event: Event) {
        match event {
            Event::Joined(id, outbox) => {
                let _ = outbox.try_send(Outgoing::Text(self.facts().to_string()));
                let _ = outbox.try_send(Outgoing::Text(self.changing_facts().to_string()));
                let client = Client {
                    outbox,
                    view: View::default(),
                    look: 0,
                    stale: true,
                    credits: CREDITS,
                    update: 0,
                    scale: 0,
                    served: 0,
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
            Event::Splats(source, answer) => {
                let source = self.sources.get(source);
                // Who asked may be gone.
                let _ = answer.send(source.map(|source| source.splats(self.splats_max)));
            }
            Event::Show(source, answer) => {
                // Who sent it may be gone.
                let _ = answer.send(self.show(*source));
            }
            Event::Command(id, request) => self.command(id, request),
            Event::Done(done) => self.take_done(done),
            Event::Driven(driven) => self.take_driven(driven),
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
        if let Command::Pick { stream, at } = request.command {
            // It is answered when the place is found.
            if let Err(error) = self.pick(id, request.sequence, stream, at) {
                self.answer(id, request.sequence, Err(error));
            }
            return;
        }
        if let Command::Step { by } = request.command {
            self.step(id, request.sequence, by);
            return;
        }
        let done = self.carry_out(id, request.command);
        self.answer(id, request.sequence, done);
    }

    fn answer(&mut self, id: u64, sequence: u64, done: Result<Value, String>) {
        let (result, error) = match done {
            Ok(result) => (result, None),
            Err(error) => (Value::Null, Some(error)),
        };
        let answer = Acknowledgement {
            kind: "ack",
            sequence,
            error: error.as_deref(),
            result: &result,
        };
        self.send(id, Outgoing::Text(json!(answer).to_string()));
    }

    /// Does `command`. Returns the answer of commands that ask for something.
    fn carry_out(&mut self, id: u64, command: Command) -> Result<Value, String> {
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
            Command::Time { time_s } => {
                self.end_steps(&Ok(()));
                self.set_time(time_s);
            }
            Command::Play {
                playing,
                speed,
                looping,
            } => {
                self.end_steps(&Ok(()));
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
            Command::State => {
                let mut state = self.clock.message(self.sources[0].time_s());
                state["type"] = "state".into();
                state["drawing"] = self.in_work.into();
                state["drawn"] = self.done.into();
                return Ok(state);
            }
            Command::CopyRender { stream } => {
                let (pane, camera) = self.shown(id, stream)?;
                let source = &self.sources[pane.source];
                let (course, time_s) = (source.scene()?, source.time_s());
                return render_command(course, &pane, &camera, time_s, &self.options);
            }
            Command::Drag {
                stream,
                agent,
                from,
                to,
                free,
                done,
            } => {
                self.end_steps(&Ok(()));
                self.clock.playing = false;
                let (_, camera) = self.shown(id, stream)?;
                let how = (free, done);
                let moved = self.sources[0].drag(&agent, &camera, [from, to], how, &self.session);
                // Also where it is refused: what was dragged is where it was.
                self.set_time(self.sources[0].time_s());
                moved?;
                if done {
                    self.tell_changes();
                }
            }
            Command::Edit(edit) => {
                self.end_steps(&Ok(()));
                self.clock.playing = false;
                let said = self.sources[0].edit(&edit, &self.session)?;
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
                if !matches!(self.recording, Recording::None) {
                    return Err("a recording goes on: wait until it is done".into());
                }
                let view = self.clients.get(&id).map(|client| client.view.clone());
                let recorder = Recorder::begin(id, view.unwrap_or_default(), &recording)?;
                self.clock.playing = false;
                self.recording = Recording::Waits(Box::new(recorder));
            }
            Command::Step { .. } | Command::Pick { .. } | Command::Shown { .. } => {}
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

    /// Facts that stay as long as the same is shown.
    fn facts(&self) -> Value {
        json!({
            "type": "scene",
            "sources": self.sources.iter().map(Source::facts).collect::<Vec<_>>(),
            "device": self.device,
            "clock": self.clock.message(self.sources[0].time_s()),
            "shown": self.shown,
            "file_bytes_max": uploads::BYTES_MAX,
        })
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
        self.clock.revision += 1;
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
            self.begin_driving();
            if self.clock.time_s >= reached_s {
                // It waits for the planner, and shows what it has shown.
                self.clock.advanced = Instant::now();
                return;
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

    /// Sends, or drops a client that does not read.
    fn send(&mut self, id: u64, message: Outgoing) {
        let client = self.clients.get(&id);
        if client.is_some_and(|client| client.outbox.try_send(message).is_err()) {
            self.clients.remove(&id);
        }
    }
}
