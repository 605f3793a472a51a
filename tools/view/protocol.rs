//! Messages between the page and the renderer.
//!
//! The page sends commands as JSON. The viewer answers with JSON and with images. Each image has a
//! header of 32 bytes, all fields little-endian.

use decouplegs_cli::camera_path::{CameraPath, Key};
use decouplegs_cli::free_view::{FOVS_DEG, FreeLens, FreeView};
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Panes that one client may have: the cameras of a large rig.
pub const PANES_MAX: usize = 16;
/// Width and height of a pane, pixels.
pub const SIDES_PX: [u32; 2] = [16, 4096];
/// Pixels of all panes of one client.
pub const PIXELS_MAX: u64 = 32 << 20;
/// Speeds of playing, seconds of the scene per second.
pub const SPEEDS: [f64; 2] = [0.1, 10.0];
/// Images per second of a recording.
pub const RATES_HZ: [f64; 2] = [0.1, 240.0];
/// Images of each pane of one recording.
const IMAGES_MAX: f64 = 1e5;
/// Bytes of the name of a file.
const NAME_BYTES_MAX: usize = 120;
/// Bytes of one command.
pub const COMMAND_BYTES_MAX: usize = 1 << 16;

/// A command of the page.
#[derive(Clone, Debug, Deserialize, PartialEq)]
pub struct Request {
    /// Number that its acknowledgement repeats.
    pub sequence: u64,
    /// Command and its values.
    #[serde(flatten)]
    pub command: Command,
}

/// Kinds of commands.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(tag = "command", rename_all = "snake_case")]
pub enum Command {
    /// Sets what the client sees.
    Look(View),
    /// Sets the time.
    Time {
        /// Time of the scene, seconds.
        time_s: f64,
    },
    /// Moves by steps and pauses.
    Step {
        /// Steps, negative to earlier.
        by: i32,
    },
    /// Plays or pauses.
    Play {
        /// True to play.
        playing: bool,
        /// Seconds of the scene per second.
        speed: f64,
        /// True to begin again at the end.
        looping: bool,
    },
    /// Asks for the clock, and whether an image is in work.
    State,
    /// Asks for the agent and the place at a pixel.
    Pick {
        /// Number of the pane.
        stream: u16,
        /// Pixel, shares of the image's width and height.
        at: [f64; 2],
    },
    /// Asks for the command that renders the image of a pane.
    #[serde(rename = "render_command")]
    CopyRender {
        /// Number of the pane.
        stream: u16,
    },
    /// Drags an agent over the ground.
    Drag {
        /// Number of the pane.
        stream: u16,
        /// Name of the agent.
        agent: String,
        /// Pixel at which it was taken, shares of the image's width and height.
        from: [f64; 2],
        /// Pixel at which the mouse is.
        to: [f64; 2],
        /// True if the agent does not snap to lanes.
        #[serde(default)]
        free: bool,
        /// True if the mouse was released.
        done: bool,
    },
    /// Changes the agents of the scene.
    Edit(Edit),
    /// Writes the log of a live episode to a new file in the current folder.
    SaveLog {
        /// Name of the file, ending with .log.
        file: String,
    },
    /// Records what the panes show.
    Record(Recording),
    /// Says that an update is on the screen, so that another may be sent.
    Shown {
        /// Number of the update.
        update: u32,
    },
}

/// Change of a scene's agents.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(tag = "edit", rename_all = "snake_case")]
pub enum Edit {
    /// Turns an agent about the vertical.
    Turn {
        /// Name of the agent.
        agent: String,
        /// Angle, radians; above 0 to the left.
        by_rad: f64,
    },
    /// Moves the whole track of an agent in its own frame and in time.
    Shift {
        /// Name of the agent.
        agent: String,
        /// Delay, seconds; below 0 earlier.
        later_s: f64,
        /// Meters ahead.
        forward_m: f64,
        /// Meters to the left.
        left_m: f64,
    },
    /// Takes an agent out.
    Remove {
        /// Name of the agent.
        agent: String,
    },
    /// Puts a copy of an agent behind it.
    Duplicate {
        /// Name of the agent.
        agent: String,
    },
    /// Shows an agent as another asset of the scene.
    Swap {
        /// Name of the agent.
        agent: String,
        /// Path of the asset, as the scene file names it.
        asset: String,
    },
    /// Takes back the last change.
    Undo,
    /// Makes the change again that was taken back last.
    Redo,
    /// Writes the scene to a new file beside the old one.
    Save {
        /// Name of the file, ending with .toml.
        file: String,
    },
}

/// Images of the panes at a row of times, written to a new folder in the current one.
#[derive(Clone, Debug, Deserialize, PartialEq)]
pub struct Recording {
    /// Name of the folder.
    pub folder: String,
    /// First and last time, seconds.
    pub span_s: [f64; 2],
    /// Images per second of the scene.
    pub rate_hz: f64,
    /// Keys of the way that cameras of the user take; none where they stay.
    #[serde(default)]
    pub path: Vec<Key>,
}

/// Panes of a client.
#[derive(Clone, Debug, Default, Deserialize, PartialEq)]
pub struct View {
    /// Panes, rendered together.
    pub panes: Vec<Pane>,
    /// True while the user moves a camera.
    #[serde(default)]
    pub moving: bool,
    /// True if images may be smaller and have losses while something moves.
    #[serde(default = "yes")]
    pub reduce: bool,
    /// Name of a LiDAR whose points are sent while nothing moves.
    #[serde(default)]
    pub lidar: Option<String>,
}

/// One pane.
#[derive(Clone, Debug, Deserialize, PartialEq)]
pub struct Pane {
    /// Number of the pane on the page.
    pub stream: u16,
    /// Width, pixels.
    pub width_px: u32,
    /// Height, pixels.
    pub height_px: u32,
    /// Scene or episode that is shown: 0, or 1 for the one to compare with.
    #[serde(default)]
    pub source: usize,
    /// Camera that looks.
    pub camera: CameraRequest,
    /// Quantity that is shown.
    #[serde(default)]
    pub channel: Channel,
    /// True if agents are shown.
    #[serde(default = "yes")]
    pub agents: bool,
}

impl Pane {
    /// True if the image is that of a camera of a vehicle: color, with agents.
    pub fn shows_all(&self) -> bool {
        self.agents && self.channel == Channel::Color
    }
}

/// Camera of a pane.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum CameraRequest {
    /// A camera of the scene, by name. Its image has its own size, or is smaller where the pane is.
    Named {
        /// Name of the camera.
        name: String,
    },
    /// A pinhole, relative to the world.
    Free(Pinhole),
    /// A pinhole, relative to a vehicle.
    Attached {
        /// Name of the agent; none for the ego vehicle.
        agent: Option<String>,
        /// Pose and field of view.
        #[serde(flatten)]
        pinhole: Pinhole,
    },
}

/// Pose and field of view of a pinhole: x right, y down, z forward.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
pub struct Pinhole {
    /// Position, meters.
    pub position_m: [f64; 3],
    /// Rotation, a quaternion x, y, z, w; any length above 0.
    pub rotation: [f64; 4],
    /// Vertical field of view, degrees.
    pub fov_deg: f64,
}

impl Pinhole {
    /// The pinhole as commands take it.
    pub fn view(&self) -> FreeView {
        FreeView {
            position_m: self.position_m,
            rotation: self.rotation,
            lens: FreeLens::Fov(self.fov_deg),
        }
    }
}

/// Quantity that a pane shows.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, Hash, Ord, PartialEq, PartialOrd)]
#[serde(rename_all = "snake_case")]
pub enum Channel {
    /// Color of the image.
    #[default]
    Color,
    /// Expected depth.
    Depth,
    /// Distance from the camera.
    Range,
    /// Agents, a color each.
    Instance,
    /// Surface normals.
    Normal,
    /// Optical flow.
    Flow,
    /// Opacity of each pixel.
    Alpha,
}

const fn yes() -> bool {
    true
}

/// Reason why a text is no command.
#[derive(Debug, PartialEq)]
pub struct Refused {
    /// Number of the command, where it has one.
    pub sequence: Option<u64>,
    /// A sentence.
    pub reason: String,
}

/// Reads a command and checks its numbers.
///
/// # Errors
/// Returns an error when `text` is not a command or a number is out of range.
pub fn parse(text: &str) -> Result<Request, Refused> {
    let request: Request = serde_json::from_str(text).map_err(|error| Refused {
        sequence: serde_json::from_str(text)
            .ok()
            .and_then(|json: Value| json.get("sequence")?.as_u64()),
        reason: format!("not a command: {error}"),
    })?;
    check(&request.command).map_err(|reason| Refused {
        sequence: Some(request.sequence),
        reason,
    })?;
    Ok(request)
}

fn check(command: &Command) -> Result<(), String> {
    match command {
        Command::Look(view) => check_view(view),
        Command::Time { time_s } if !time_s.is_finite() => {
            Err(format!("time_s: expected seconds, found {time_s}"))
        }
        Command::Play { speed, .. } => within("speed", *speed, SPEEDS),
        Command::Pick { at, .. } => check_pixel(*at),
        Command::Drag { from, to, .. } => check_pixel(*from).and_then(|()| check_pixel(*to)),
        Command::SaveLog { file } => check_name(file, ".log"),
        Command::Record(recording) => check_recording(recording),
        Command::Time { .. }
        | Command::Step { .. }
        | Command::State
        | Command::CopyRender { .. }
        | Command::Edit(_)
        | Command::Shown { .. } => Ok(()),
    }
}

fn check_pixel(at: [f64; 2]) -> Result<(), String> {
    at.iter()
        .try_for_each(|&share| within("pixel", share, [-1.0, 2.0]))
}

/// Checks that `name` is the name of a file, not a path, that ends with `ending`.
///
/// # Errors
/// A sentence.
pub fn check_name(name: &str, ending: &str) -> Result<(), String> {
    let fits = |character: char| character.is_alphanumeric() || "-_ .".contains(character);
    let stem = name.strip_suffix(ending).unwrap_or("");
    let is_name = !stem.is_empty() && !stem.starts_with('.') && name.len() <= NAME_BYTES_MAX;
    match is_name && name.chars().all(fits) {
        true => Ok(()),
        false => Err(format!(
            "expected a name of letters, digits, spaces, '-', '_' and '.'{}, found {name:?}",
            if ending.is_empty() {
                String::new()
            } else {
                format!(", ending with {ending}")
            }
        )),
    }
}

fn check_recording(recording: &Recording) -> Result<(), String> {
    check_name(&recording.folder, "")?;
    within("rate_hz", recording.rate_hz, RATES_HZ)?;
    if !recording.path.is_empty() {
        CameraPath::from_keys(recording.path.clone())?;
    }
    let [begin_s, end_s] = recording.span_s;
    let images = (end_s - begin_s) * recording.rate_hz;
    match begin_s <= end_s && images < IMAGES_MAX {
        true => Ok(()),
        false => Err(format!(
            "span_s: expected a first time not after the last, and at most {IMAGES_MAX} images, found {begin_s} to {end_s} s"
        )),
    }
}

fn check_view(view: &View) -> Result<(), String> {
    if view.panes.len() > PANES_MAX {
        return Err(format!(
            "panes: expected at most {PANES_MAX}, found {}",
            view.panes.len()
        ));
    }
    let mut pixels = 0;
    for pane in &view.panes {
        if pane.source > 1 {
            return Err(format!("source: expected 0 or 1, found {}", pane.source));
        }
        let sides = SIDES_PX.map(f64::from);
        within("width_px", f64::from(pane.width_px), sides)?;
        within("height_px", f64::from(pane.height_px), sides)?;
        pixels += u64::from(pane.width_px) * u64::from(pane.height_px);
        let (CameraRequest::Free(pinhole) | CameraRequest::Attached { pinhole, .. }) = &pane.camera
        else {
            continue;
        };
        within("fov_deg", pinhole.fov_deg, FOVS_DEG)?;
        let numbers = pinhole.position_m.iter().chain(&pinhole.rotation);
        let length_squared: f64 = pinhole.rotation.iter().map(|x| x * x).sum();
        let is_rotation = length_squared.is_finite() && length_squared > 1e-12;
        if !is_rotation || !numbers.into_iter().all(|x| x.abs() < 1e9) {
            return Err(
                "camera: expected a position within 1e9 m and a rotation above length 0".into(),
            );
        }
    }
    if pixels > PIXELS_MAX {
        return Err(format!(
            "panes: expected at most {PIXELS_MAX} pixels in all, found {pixels}: make them smaller"
        ));
    }
    Ok(())
}

fn within(what: &str, value: f64, [least, most]: [f64; 2]) -> Result<(), String> {
    match (least..=most).contains(&value) {
        true => Ok(()),
        false => Err(format!("{what}: expected {least} to {most}, found {value}")),
    }
}

/// Answer to a command.
#[derive(Debug, Serialize)]
pub struct Acknowledgement<'a> {
    /// Always "ack".
    #[serde(rename = "type")]
    pub kind: &'static str,
    /// Number of the command.
    pub sequence: u64,
    /// Reason why it was not done.
    pub error: Option<&'a str>,
    /// Answer of commands that ask for something.
    pub result: &'a Value,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_read_and_nonsense_is_explained() {
        let look = r#"{"sequence":7,"command":"look","panes":[{"stream":1,"width_px":640,"height_px":360,"camera":{"kind":"named","name":"front"}}]}"#;
        let request = parse(look).unwrap();
        let Command::Look(view) = &request.command else {
            panic!("{request:?}")
        };
        assert_eq!(
            (request.sequence, view.panes.len(), view.reduce),
            (7, 1, true)
        );
        assert_eq!(view.panes[0].channel, Channel::Color);
        for (text, word) in [
            ("", "not a command"),
            ("[]", "not a command"),
            (r#"{"sequence":1,"command":"explode"}"#, "explode"),
            (
                r#"{"sequence":1,"command":"play","playing":true,"speed":1e9,"looping":false}"#,
                "speed",
            ),
            (&look.replace("640", "0"), "width_px"),
            (&look.replace("640", "4294967295"), "width_px"),
            (
                &look.replace(
                    r#""kind":"named","name":"front""#,
                    r#""kind":"free","position_m":[0,0,0],"rotation":[0,0,0,0],"fov_deg":60"#,
                ),
                "rotation",
            ),
            (
                &look.replace(
                    r#""kind":"named","name":"front""#,
                    r#""kind":"free","position_m":[0,0,0],"rotation":[0,0,0,1],"fov_deg":180"#,
                ),
                "fov_deg",
            ),
        ] {
            let refused = parse(text).unwrap_err();
            assert!(refused.reason.contains(word), "{text}: {refused:?}");
            let is_numbered = text.starts_with("{\"sequence\"");
            assert_eq!(refused.sequence.is_some(), is_numbered, "{text}");
        }
    }

    /// Random edits of commands, by a linear congruential generator: none may panic.
    #[test]
    fn a_hundred_thousand_damaged_commands_are_read_or_refused() {
        let samples = [
            r#"{"sequence":7,"command":"look","panes":[{"stream":1,"width_px":640,"height_px":360,"camera":{"kind":"free","position_m":[0,1,2],"rotation":[0,0,0,1],"fov_deg":60}}]}"#,
            r#"{"sequence":1,"command":"play","playing":true,"speed":1,"looping":false}"#,
            r#"{"sequence":18446744073709551615,"command":"time","time_s":1e308}"#,
        ];
        let mut state = 7u64;
        let mut random = |below: usize| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 33) as usize % below
        };
        let mut refused = 0;
        for round in 0..100_000 {
            let mut bytes = samples[round % samples.len()].as_bytes().to_vec();
            for _ in 0..=random(4) {
                let at = random(bytes.len());
                match random(3) {
                    0 => bytes[at] = b"0189eE-+.,:[]{}\"\\nu\0"[random(20)],
                    1 => drop(bytes.drain(at..(at + random(9)).min(bytes.len()))),
                    _ => bytes.truncate(at.max(1)),
                }
                if bytes.is_empty() {
                    bytes.push(b'{');
                }
            }
            refused += usize::from(parse(&String::from_utf8_lossy(&bytes)).is_err());
        }
        assert!((50_000..100_000).contains(&refused), "{refused}");
    }
}
