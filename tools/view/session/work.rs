//! Work for the thread that draws, and what comes back from it.

use std::time::Duration;

use serde_json::json;

use super::{CREDITS, Client, Recording, Viewer};
use crate::draw_thread::{Done, Encoded, Pick, Update, Work};
use crate::drawing::{Picked, Shot, SweepShot};
use crate::events::Outgoing;
use crate::protocol::{Pane, View};
use crate::recording::Recorder;
use crate::source::Source;
use crate::viewpoint::scaled;

/// Scales of images while something moves.
const SCALES: [f64; 3] = [1.0, 0.5, 0.25];
/// An update that takes longer is followed by a smaller one.
const SLOW: Duration = Duration::from_millis(100);
/// An update that takes less is followed by a larger one.
const FAST: Duration = Duration::from_millis(20);
/// Questions for pixels that wait for an answer.
const PICKS_MAX: usize = 32;

impl Viewer {
    /// Asks the thread that draws for what is at a pixel.
    pub(super) fn pick(
        &mut self,
        id: u64,
        sequence: u64,
        stream: u16,
        at: [f64; 2],
    ) -> Result<(), String> {
        if self.picks >= PICKS_MAX {
            return Err("too many places were asked for at once: wait for an answer".into());
        }
        let (pane, camera) = self.shown(id, stream)?;
        self.picks += 1;
        self.draws.give(Work::Pick(Box::new(Pick {
            client: id,
            sequence,
            source: pane.source,
            world: self.sources[pane.source].world(true).clone(),
            camera,
            at,
        })));
        Ok(())
    }

    pub(super) fn take_done(&mut self, done: Done) {
        match done {
            Done::Pick {
                client,
                sequence,
                source,
                picked,
            } => {
                self.picks -= 1;
                let named = |picked: Picked| {
                    let agent = picked
                        .instance
                        .and_then(|id| self.sources.get(source)?.agent_of(id));
                    let position_m = picked.position_m.map(|at_m| at_m.to_array());
                    json!({"agent": agent, "position_m": position_m})
                };
                let answer = picked.map(named);
                self.answer(client, sequence, answer);
                return;
            }
            Done::Update {
                client: id,
                encoded,
                took,
                is_reduced,
            } => self.updated(id, encoded, is_reduced.then_some(took)),
            Done::Recorded(recorder, written) => {
                let client = recorder.client;
                let message = match written {
                    Ok(()) => {
                        let progress = recorder.progress();
                        self.recording = Recording::Waits(recorder);
                        json!({"type": "recording", "progress": progress})
                    }
                    Err(error) => {
                        self.recording = Recording::None;
                        json!({"type": "recording", "error": error})
                    }
                };
                self.send(client, Outgoing::Text(message.to_string()));
            }
            Done::Finished { client, said } => {
                self.recording = Recording::None;
                let message = match said {
                    Ok(said) => json!({"type": "recording", "said": said}),
                    Err(error) => json!({"type": "recording", "error": error}),
                };
                self.send(client, Outgoing::Text(message.to_string()));
            }
        }
        self.in_work = false;
        self.done += 1;
    }

    /// Sends what was drawn for a client. `moving`: the time that it took, if its images may be
    /// smaller.
    fn updated(&mut self, id: u64, encoded: Result<Encoded, String>, moving: Option<Duration>) {
        match encoded {
            Ok(Encoded { state, images }) => {
                self.send(id, Outgoing::Text(state));
                for image in images {
                    self.send(id, Outgoing::Image(image));
                }
            }
            Err(error) => {
                let message = json!({"type": "error", "text": error});
                self.send(id, Outgoing::Text(message.to_string()));
                // No page shows it, so that the credit is given back.
                if let Some(client) = self.clients.get_mut(&id) {
                    client.credits = (client.credits + 1).min(CREDITS);
                }
            }
        }
        let client = self.clients.get_mut(&id).zip(moving);
        match client {
            Some((client, took)) if took > SLOW => {
                client.scale = (client.scale + 1).min(SCALES.len() - 1);
            }
            Some((client, took)) if took < FAST => client.scale = client.scale.saturating_sub(1),
            _ => {}
        }
    }

    /// Gives the thread that draws its next work, if it has none: images of a recording, and of the
    /// client that is due and has waited for the longest time, in turns.
    pub(super) fn begin_work(&mut self) {
        if self.in_work {
            return;
        }
        let due =
            |client: &Client| client.stale && client.credits > 0 && !client.view.panes.is_empty();
        let waiting = self.clients.iter().filter(|(_, client)| due(client));
        let next = waiting.min_by_key(|(_, client)| client.served);
        let next = next.map(|(&id, _)| id);
        let records = next.is_none() || !self.recorded_last;
        let recording = std::mem::replace(&mut self.recording, Recording::None);
        self.recording = match recording {
            Recording::Waits(recorder) if records => {
                self.in_work = true;
                let work = match recorder.next_s() {
                    Some(time_s) => {
                        let shots = self.recorded_shots(&recorder, time_s);
                        Work::Record(recorder, shots)
                    }
                    None => Work::Finish(recorder),
                };
                self.draws.give(work);
                Recording::InWork
            }
            recording => recording,
        };
        self.recorded_last = self.in_work;
        if let Some(id) = next.filter(|_| !self.in_work) {
            self.begin_update(id);
        }
    }

    /// Views of a recording at one of its times.
    fn recorded_shots(&mut self, recorder: &Recorder, time_s: f64) -> Vec<Shot> {
        self.show_at(time_s);
        let shots = self.shots(&recorder.view_at(time_s), 1.0);
        self.show_at(self.clock.time_s);
        shots
    }

    /// Views that the panes of `view` show now. An agent may be gone by now: its pane is left out,
    /// and keeps the last image.
    fn shots(&self, view: &View, scale: f64) -> Vec<Shot> {
        let shot = |pane: &Pane| {
            let source = self.source(pane).ok()?;
            let mut camera = source.camera(pane).ok()?;
            camera.intrinsics = scaled(&camera.intrinsics, scale);
            Some(Shot {
                world: source.world(pane.agents).clone(),
                logged: source.logged_image(pane),
                pane: pane.clone(),
                camera,
            })
        };
        view.panes.iter().filter_map(shot).collect()
    }

    fn begin_update(&mut self, id: u64) {
        let done = self.done;
        let Some(client) = self.clients.get_mut(&id) else {
            return;
        };
        let is_reduced = client.view.reduce && (client.view.moving || self.clock.playing);
        let reduced = is_reduced.then(|| SCALES[client.scale]);
        client.update = client.update.wrapping_add(1);
        client.credits -= 1;
        (client.stale, client.served) = (false, done + 1);
        let (number, look, view) = (client.update, client.look, client.view.clone());
        let sweep = view.lidar.as_ref().filter(|_| !is_reduced);
        let sweep = sweep.and_then(|name| self.sources[0].lidar(name).ok());
        let sweep = sweep.map(|(lidar, origin)| SweepShot {
            lidar,
            origin,
            world: self.sources[0].world(true).clone(),
        });
        let time_s = self.sources[0].time_s();
        let state = json!({
            "type": "frame",
            "update": number,
            "look": look,
            "revision": self.clock.revision,
            "time_s": time_s,
            "playing": self.clock.playing,
            "speed": self.clock.speed,
            "sources": self.sources.iter().map(Source::state).collect::<Vec<_>>(),
        });
        self.in_work = true;
        self.draws.give(Work::Update(Box::new(Update {
            client: id,
            number,
            time_s,
            shots: self.shots(&view, reduced.unwrap_or(1.0)),
            sweep,
            reduced,
            state,
        })));
    }
}
