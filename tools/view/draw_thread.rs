//! The thread that draws: work goes in, and comes back as an event. Commands do not wait for it.

use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use decouplegs::explain::explain;
use decouplegs::scene::Camera;
use decouplegs::session::World;
use decouplegs_cli::{jpeg, png_bytes};
use serde_json::{Value, json};

use crate::drawing::{Drawer, Picked, Shot, SweepShot};
use crate::frame_state::{QUALITY_MOVING, badge, pane_json, times_json};
use crate::image_header::{FLAG_EXACT, FLAG_LAST, Header, ImageKind};
use crate::recording::Recorder;

/// Work for the thread that draws. It holds all that it needs: the scene may go on meanwhile.
pub enum Work {
    /// Images of what a client looks at.
    Update(Box<Update>),
    /// Agent and place at a pixel.
    Pick(Box<Pick>),
    /// Images of the next time of a recording.
    Record(Box<Recorder>, Vec<Shot>),
    /// End of a recording.
    Finish(Box<Recorder>),
}

/// Images for a client.
pub struct Update {
    /// The client.
    pub client: u64,
    /// Number of the update.
    pub number: u32,
    /// Time that is shown, seconds.
    pub time_s: f64,
    /// Views to draw.
    pub shots: Vec<Shot>,
    /// Sweep to trace for the page's points.
    pub sweep: Option<SweepShot>,
    /// Scale of images that may have losses; `None`: exact images.
    pub reduced: Option<f64>,
    /// State that goes with the images.
    pub state: Value,
}

/// Question for what is at a pixel.
pub struct Pick {
    /// Client that asks.
    pub client: u64,
    /// Number of its command.
    pub sequence: u64,
    /// Source of the pane.
    pub source: usize,
    /// World that is shown.
    pub world: World,
    /// Camera at full size.
    pub camera: Camera,
    /// Pixel, shares of the image's width and height.
    pub at: [f64; 2],
}

/// Work that is done. Errors are sentences.
pub enum Done {
    /// Images for a client.
    Update {
        /// The client.
        client: u64,
        /// State and images.
        encoded: Result<Encoded, String>,
        /// Time that drawing and encoding took.
        took: Duration,
        /// True if its images may be smaller.
        is_reduced: bool,
    },
    /// Answer to a question for a pixel.
    Pick {
        /// Client that asked.
        client: u64,
        /// Number of its command.
        sequence: u64,
        /// Source of the pane.
        source: usize,
        /// Agent and place that are there.
        picked: Result<Picked, String>,
    },
    /// Recording whose next images are written.
    Recorded(Box<Recorder>, Result<(), String>),
    /// Recording that has ended.
    Finished {
        /// Client that asked for it.
        client: u64,
        /// Sentence about what was written.
        said: Result<String, String>,
    },
}

/// An update as it is sent.
pub struct Encoded {
    /// State, JSON.
    pub state: String,
    /// Images with their headers.
    pub images: Vec<Vec<u8>>,
}

/// The thread that draws.
pub struct DrawThread {
    works: Sender<Work>,
    thread: JoinHandle<()>,
}

impl DrawThread {
    /// Starts the thread, which draws with `drawer` and hands over what is done by `tell`, until
    /// that is false.
    ///
    /// # Errors
    /// Returns an error if the system has no thread.
    pub fn start(
        drawer: Drawer,
        tell: impl Fn(Done) -> bool + Send + 'static,
    ) -> std::io::Result<Self> {
        let (works, inbox) = channel();
        let thread = std::thread::Builder::new()
            .name("drawing".into())
            .spawn(move || run(drawer, &inbox, tell))?;
        Ok(Self { works, thread })
    }

    /// Hands over work. It is done in the order in which it comes; none if the thread has failed.
    pub fn give(&self, work: Work) {
        let _ = self.works.send(work);
    }

    /// Waits for the work that was given.
    ///
    /// # Panics
    /// Panics if the thread has.
    pub fn end(self) {
        drop(self.works);
        if let Err(cause) = self.thread.join() {
            std::panic::resume_unwind(cause);
        }
    }
}

fn run(mut drawer: Drawer, inbox: &Receiver<Work>, tell: impl Fn(Done) -> bool) {
    for work in inbox {
        let done = match work {
            Work::Update(update) => updated(&mut drawer, *update),
            Work::Pick(pick) => Done::Pick {
                client: pick.client,
                sequence: pick.sequence,
                source: pick.source,
                picked: (drawer.pick(&pick.world, &pick.camera, pick.at))
                    .map_err(|error| explain(&error)),
            },
            Work::Record(mut recorder, shots) => {
                let drawn = drawer.draw(&shots).map_err(|error| explain(&error));
                let written = drawn.and_then(|(drawn, _)| recorder.write(&shots, &drawn));
                Done::Recorded(recorder, written)
            }
            Work::Finish(recorder) => Done::Finished {
                client: recorder.client,
                said: recorder.finish(),
            },
        };
        // The program ends where nobody listens.
        if !tell(done) {
            return;
        }
    }
}

fn updated(drawer: &mut Drawer, update: Update) -> Done {
    let since = Instant::now();
    let (client, is_reduced) = (update.client, update.reduced.is_some());
    let encoded = encoded(drawer, update, since);
    Done::Update {
        client,
        encoded,
        took: since.elapsed(),
        is_reduced,
    }
}

fn encoded(drawer: &mut Drawer, update: Update, since: Instant) -> Result<Encoded, String> {
    let drawn = drawer.draw(&update.shots);
    let (drawn, statistics) = drawn.map_err(|error| explain(&error))?;
    let rendered = since.elapsed();
    let kind = match update.reduced {
        Some(_) => ImageKind::Jpeg,
        None => ImageKind::Png,
    };
    let header = |stream: u16, kind: ImageKind, size_px: [u32; 2]| Header {
        stream,
        kind,
        flags: FLAG_EXACT * u8::from(update.reduced.is_none()),
        update: update.number,
        time_us: (1e6 * update.time_s).round() as i64,
        size_px: size_px.map(|side_px| side_px as u16),
    };
    let mut images = Vec::new();
    for (shot, image) in update.shots.iter().zip(&drawn) {
        let bytes = match kind {
            ImageKind::Jpeg => jpeg::encode(&image.rgba, image.size_px, QUALITY_MOVING),
            _ => png_bytes::encode(&image.rgba, image.size_px),
        };
        // Sides are at most 4096 pixels, which both formats hold.
        let Ok(bytes) = bytes else { continue };
        images.push((header(shot.pane.stream, kind, image.size_px), bytes));
    }
    let mut fault = None;
    if let Some(sweep) = &update.sweep {
        match drawer.points(sweep) {
            Ok(bytes) => images.push((header(0, ImageKind::Points, [0, 0]), bytes)),
            Err(error) => fault = Some(error),
        }
    }
    if let Some((header, _)) = images.last_mut() {
        header.flags |= FLAG_LAST;
    }
    let logged = (update.shots.iter().zip(&drawn))
        .filter_map(|(shot, image)| shot.logged.as_ref()?.is(image.size_px, &image.rgba));
    let logged = logged.reduce(|all, same| all && same);
    let panes = update.shots.iter();
    let panes = panes.map(|shot| pane_json(&shot.pane, &shot.camera));
    let mut state = update.state;
    state["badge"] = badge(update.reduced, logged).into();
    state["images"] = images.len().into();
    state["panes"] = panes.collect::<Vec<_>>().into();
    state["times_ms"] = times_json(&statistics, rendered, since.elapsed());
    state["error"] = json!(fault);
    let images = images.iter();
    let images = images.map(|(header, bytes)| [&header.bytes()[..], bytes].concat());
    Ok(Encoded {
        state: state.to_string(),
        images: images.collect(),
    })
}
