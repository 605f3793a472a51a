//! Tracks of the agents: `sequence_tracks.json`.

use std::collections::{BTreeMap, HashMap};

use decouplegs_scene::{Pose, Presence, TimedPose, Trajectory};
use glam::{DQuat, DVec3};
use serde::Deserialize;

use crate::DecodeError;

/// Name of the entry.
pub(super) const TRACKS: &str = "sequence_tracks.json";
/// A track that begins and ends within this of the scene, seconds, is there all the time.
const WHOLE_S: f64 = 0.11;

/// A road user of the recording.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct BoxTrack {
    /// Class, as scene files name it; `None` if the package has an empty one.
    pub(super) class: Option<String>,
    /// Poses of the middle of its box, world coordinates.
    pub(super) trajectory: Trajectory,
    /// Times at which it is tracked.
    pub(super) present: Presence,
}

#[derive(Deserialize)]
struct Sequence {
    tracks_data: Data,
}

#[derive(Deserialize)]
struct Data {
    tracks_id: Vec<serde_json::Value>,
    tracks_label_class: Vec<String>,
    tracks_timestamps_us: Vec<Vec<i64>>,
    tracks_poses: Vec<Vec<[f64; 7]>>,
}

/// The tracks in `text` by their ids, times from `start_us` on in seconds, in a scene that ends at
/// `end_s`.
///
/// # Errors
/// A sentence that names the track at fault.
pub(super) fn read(
    text: &[u8],
    start_us: i64,
    end_s: f64,
) -> Result<HashMap<String, BoxTrack>, DecodeError> {
    let malformed = |reason: String| DecodeError::Malformed(format!("{TRACKS}: {reason}"));
    // Every sequence is one drive; others have a single one.
    let sequences: BTreeMap<String, Sequence> =
        serde_json::from_slice(text).map_err(|error| malformed(error.to_string()))?;
    let mut tracks = HashMap::new();
    for data in sequences.into_values().map(|sequence| sequence.tracks_data) {
        let count = data.tracks_id.len();
        let lengths = [
            data.tracks_label_class.len(),
            data.tracks_timestamps_us.len(),
            data.tracks_poses.len(),
        ];
        if lengths.iter().any(|length| *length != count) {
            return Err(malformed(format!(
                "{count} ids, and {lengths:?} classes, lists of times and lists of poses"
            )));
        }
        let rest = data.tracks_label_class.into_iter();
        let rest = rest.zip(data.tracks_timestamps_us).zip(data.tracks_poses);
        for (id, ((class, times), poses)) in data.tracks_id.into_iter().zip(rest) {
            let id = match id {
                serde_json::Value::String(id) => id,
                id => id.to_string(),
            };
            if times.is_empty() {
                continue;
            }
            let track = track(class, &times, &poses, start_us, end_s)
                .map_err(|reason| malformed(format!("track {id}: {reason}")))?;
            tracks.insert(id, track);
        }
    }
    Ok(tracks)
}

fn track(
    class: String,
    times: &[i64],
    poses: &[[f64; 7]],
    start_us: i64,
    end_s: f64,
) -> Result<BoxTrack, String> {
    if times.len() != poses.len() {
        return Err(format!("{} times for {} poses", times.len(), poses.len()));
    }
    let timed = |(&time_us, &[x, y, z, qx, qy, qz, qw]): (&i64, &[f64; 7])| {
        let rotation = DQuat::from_xyzw(qx, qy, qz, qw);
        let is_rotation = rotation.is_finite() && rotation.length() > 1e-6;
        is_rotation.then(|| TimedPose {
            time_s: seconds(time_us, start_us),
            pose: Pose::new(rotation.normalize(), DVec3::new(x, y, z)),
        })
    };
    let knots: Option<Vec<TimedPose>> = times.iter().zip(poses).map(timed).collect();
    let knots = knots.ok_or("a quaternion is no rotation")?;
    let trajectory = Trajectory::new(knots).map_err(|reason| reason.to_string())?;
    let class = class.to_lowercase();
    Ok(BoxTrack {
        class: match class.as_str() {
            "" => None,
            "automobile" => Some("car".into()),
            _ => Some(class),
        },
        present: presence(&trajectory, end_s)?,
        trajectory,
    })
}

/// Times of a track: half a step of its own before its first pose to half a step after its last;
/// all times where that is the whole scene.
fn presence(way: &Trajectory, end_s: f64) -> Result<Presence, String> {
    if way.start_s() <= WHOLE_S && way.end_s() >= end_s - WHOLE_S {
        return Ok(Presence::ALWAYS);
    }
    let steps = way.poses().len().saturating_sub(1).max(1) as f64;
    let half_s = 0.5 * (way.end_s() - way.start_s()) / steps;
    let interval = [way.start_s() - half_s, way.end_s() + half_s];
    Presence::new(vec![interval]).map_err(|reason| reason.to_string())
}

/// Seconds from `start_us` to `time_us`.
pub(super) fn seconds(time_us: i64, start_us: i64) -> f64 {
    time_us.saturating_sub(start_us) as f64 * 1e-6
}
