//! Agents as others read them: boxes with ways.

use std::path::Path;

use decouplegs_scene::{Pose, Presence, TimedPose, Trajectory};
use serde_json::{Value, json};

use super::rig::{moments, offset_of};
use super::{PackOptions, SEQUENCE};
use crate::{AssetError, SceneAgent, SceneFile, coded_asset, read_coded, read_splats};

/// Class of agents of unknown class, and of cars.
const CLASS: &str = "automobile";
/// An agent that moves by less than this, meters, stands.
const STANDS_M: f64 = 0.05;
/// An agent that turns by less than this, radians, stands.
const STANDS_RAD: f64 = 0.02;

/// `sequence_tracks.json`, of the scene in `directory`.
pub(super) fn sequence_tracks(
    scene: &SceneFile,
    directory: &Path,
    options: &PackOptions,
    span_s: (f64, f64),
) -> Result<Value, AssetError> {
    let (mut ids, mut classes, mut flags, mut times, mut poses, mut dims) =
        (vec![], vec![], vec![], vec![], vec![], vec![]);
    for agent in &scene.agents {
        let way = sampled(scene, agent, span_s);
        if way.is_empty() {
            continue;
        }
        ids.push(json!(agent.name));
        classes.push(json!(match agent.class.as_deref() {
            None | Some("car") => CLASS,
            Some(class) => class,
        }));
        flags.push(if stands(&agent.trajectory, &agent.present) {
            json!(["STATIC"])
        } else {
            json!(["DYNAMIC", "CONTROLLABLE"])
        });
        times.push(
            way.iter()
                .map(|(time_us, _)| *time_us)
                .collect::<Vec<u64>>(),
        );
        poses.push(
            way.into_iter()
                .map(|(_, pose)| pose)
                .collect::<Vec<[f64; 7]>>(),
        );
        dims.push(dims_of(&directory.join(&agent.asset))?);
    }
    let mut sequences = serde_json::Map::new();
    let data = json!({
        "tracks_data": {
            "tracks_id": ids,
            "tracks_label_class": classes,
            "tracks_flags": flags,
            "tracks_timestamps_us": times,
            "tracks_poses": poses,
        },
        "cuboidtracks_data": {"cuboids_dims": dims},
        "sequence_id": options.scene_id,
    });
    sequences.insert(SEQUENCE.to_owned(), data);
    Ok(Value::Object(sequences))
}

/// Names of the agents in `sequence_tracks.json`, in their order there.
pub(super) fn track_ids(scene: &SceneFile, span_s: (f64, f64)) -> Vec<String> {
    let agents = scene.agents.iter();
    let there = agents.filter(|agent| !sampled(scene, agent, span_s).is_empty());
    there.map(|agent| agent.name.clone()).collect()
}

/// Moments in microseconds of the package and local poses (x, y, z and a quaternion x, y, z, w):
/// where the agent's own way is known, and over the whole scene for one that stands; from its first
/// presence to its last. Tracks have no gaps: times of absence between are part of it. None for an
/// agent that is absent all the time.
fn sampled(scene: &SceneFile, agent: &SceneAgent, span_s: (f64, f64)) -> Vec<(u64, [f64; 7])> {
    let way = &agent.trajectory;
    let there_s = match agent.present.span_s() {
        Some((first_s, last_s)) => (first_s.max(span_s.0), last_s.min(span_s.1)),
        None => span_s,
    };
    let within = |(start_s, end_s): (f64, f64)| {
        let both = (start_s.max(there_s.0), end_s.min(there_s.1));
        (both.1 > both.0).then_some(both)
    };
    let known_s = within((way.start_s(), way.end_s())).or_else(|| within(span_s));
    let Some((start_s, end_s)) = known_s else {
        return Vec::new();
    };
    let local = |time_s: f64| {
        let Pose {
            rotation: q,
            translation,
        } = way.at(time_s);
        let [x, y, z] = (translation - scene.origin).to_array();
        [x, y, z, q.x, q.y, q.z, q.w]
    };
    moments(start_s, end_s, offset_of(span_s.0))
        .into_iter()
        .map(|(time_s, time_us)| (time_us, local(time_s)))
        .collect()
}

/// True if an agent with this trajectory and presence stands at one place all the time. Packages
/// call it STATIC: AlpaSim lists it in no request, because NuRec draws it as a part of the street
/// (`src/runtime/alpasim_runtime/events/camera.py:22`, `unbound_rollout.py:236`).
#[must_use]
pub fn stands(way: &Trajectory, present: &Presence) -> bool {
    let poses = way.poses();
    let first = poses[0].pose;
    let is_there = |timed: &TimedPose| {
        timed.pose.translation.distance(first.translation) < STANDS_M
            && timed.pose.rotation.angle_between(first.rotation) < STANDS_RAD
    };
    present.span_s().is_none() && poses.iter().all(is_there)
}

/// Length, width and height of an asset, meters: as a compressed one says, or of the box about the
/// means of its splats.
fn dims_of(path: &Path) -> Result<[f64; 3], AssetError> {
    if coded_asset::has_extension(path) {
        return Ok(read_coded(path)?.cloud.dims_m.map(f64::from));
    }
    let dims_m = read_splats(path)?
        .bounds()
        .half_extent()
        .map(|half_m| 2.0 * f64::from(half_m));
    if dims_m.iter().all(|side_m| side_m.is_finite()) {
        return Ok(dims_m);
    }
    Err(AssetError::Placement(format!(
        "{} has no splats that could stand somewhere",
        path.display()
    )))
}
