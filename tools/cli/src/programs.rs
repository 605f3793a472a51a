//! The programs that `decouplegs` is made of. It runs the others by its own subcommands, as git and
//! cargo do, so that a build of one waits for no other.

use std::collections::HashSet;
use std::io::Write;
use std::process::ExitCode;
use std::sync::{Mutex, PoisonError};

use anyhow::Result;
use decouplegs_scene::explain::explain;

/// Warnings that libraries log, each printed once.
struct Warnings {
    told: Mutex<HashSet<String>>,
}

/// Most warnings of libraries that are printed.
const WARNINGS_MAX: usize = 100;

impl log::Log for Warnings {
    fn enabled(&self, metadata: &log::Metadata) -> bool {
        metadata.level() <= log::Level::Warn && metadata.target().starts_with("decouplegs")
    }

    fn log(&self, record: &log::Record) {
        if !self.enabled(record.metadata()) {
            return;
        }
        let sentence = record.args().to_string();
        let mut told = self.told.lock().unwrap_or_else(PoisonError::into_inner);
        if told.len() < WARNINGS_MAX && !told.contains(&sentence) {
            crate::arguments::warn(&sentence);
            told.insert(sentence);
        }
    }

    fn flush(&self) {}
}

/// Prints what libraries warn of on standard error from now on.
pub fn print_warnings() {
    let warnings = Box::new(Warnings {
        told: Mutex::default(),
    });
    // A second call changes nothing.
    if log::set_boxed_logger(warnings).is_ok() {
        log::set_max_level(log::LevelFilter::Warn);
    }
}

/// A program with subcommands of the command line of `decouplegs`.
#[derive(Debug, PartialEq, Eq)]
pub struct Program {
    /// Name of its file.
    pub name: &'static str,
    /// Folder of its package, relative to that of the sources.
    pub folder: &'static str,
    /// Subcommands, each with the sentence that describes it.
    pub commands: &'static [(&'static str, &'static str)],
}

/// Vehicles, roads and logs.
pub const DRIVE: Program = Program {
    name: "decouplegs-drive",
    folder: "tools/drive",
    commands: &[
        (
            "import",
            "Make a scene to drive in from a recording and the splats that were trained on its images: \
             the rig, the way of the vehicle, views, lanes along the way and labeled boxes",
        ),
        (
            "lidar",
            "Sweep a scene with a LiDAR: one file of points per sweep, listed as they are written",
        ),
        (
            "edit",
            "Move, swap, remove, add and time agents of a scene, and write it as a new scene file",
        ),
        (
            "pack",
            "Pack a scene into one USDZ that AlpaSim's runtime and CARLA's NuRec scripts read",
        ),
        (
            "map",
            "Describe and draw the lanes of a map: kinds, lengths, heights, links; and tracks on it",
        ),
        (
            "register",
            "Register tracks to the lanes of a map and to the ground of a scene",
        ),
        (
            "calibrate-light",
            "Fit the effect of light on the colors of agents",
        ),
        (
            "drive",
            "Drive episodes in closed loop: render the cameras, ask the planner, move the ego, let \
             traffic react. Finished episodes stay in --out; the same command resumes a stopped run",
        ),
        (
            "replay",
            "Repeat the plans of a log and compare: the motion of all vehicles and the score to the \
             last bit, images by their hashes. Exits with 1 if something differs",
        ),
        (
            "open-loop",
            "Show a planner two sources of images along the same log, such as real images and \
             rendered ones, and compare its plans. The ego drives as in the log, regardless of the \
             plans",
        ),
        (
            "realism",
            "Measure how far a scene is from the recording that it was made of, or simulated traffic \
             from recorded traffic",
        ),
        (
            "score",
            "Score episodes again from their logs, without rendering",
        ),
        (
            "export",
            "Write an episode as a data set: images, LiDAR sweeps and boxes of all road users, at \
             each step; or as a scene",
        ),
    ],
};

/// The viewer.
pub const VIEW: Program = Program {
    name: "decouplegs-view",
    folder: "tools/view",
    commands: &[(
        "view",
        "Look into a scene or an episode in the browser: fly, play, edit agents, compare",
    )],
};

/// The render server, of whose subcommands `decouplegs` has one.
pub const SERVER: Program = Program {
    name: "decouplegs-server",
    folder: "tools/server",
    commands: &[(
        "conform",
        "Ask a sensorsim server (AlpaSim, NuRec, decouplegs-server) what simulators ask, and judge \
         its answers",
    )],
};

/// Benchmarks and experiments.
pub const LAB: Program = Program {
    name: "decouplegs-lab",
    folder: "benches",
    commands: &[
        (
            "bench",
            "Measure frames on a GPU: time per stage, memory by purpose, and error against the f64 \
             reference",
        ),
        (
            "stress",
            "Measure frame time, memory and error against the number of moving agents, for several \
             modes of rendering",
        ),
        (
            "ablate",
            "Reinsert cars into streets that they were removed from, and leave out parts of the \
             system one by one",
        ),
    ],
};

/// All programs but `decouplegs` itself.
pub const PROGRAMS: [&Program; 4] = [&DRIVE, &VIEW, &SERVER, &LAB];

/// The exit code of `done`: 0, or 1 for an error, which is said on standard error.
#[must_use]
pub fn exit_code(done: &Result<()>) -> ExitCode {
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // Where standard error is full or closed, there is nobody to tell.
            let _ = std::io::stderr().write_all(explain(error.as_ref()).as_bytes());
            ExitCode::FAILURE
        }
    }
}
