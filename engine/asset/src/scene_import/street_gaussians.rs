//! Scenes of Street Gaussians (zju3dv/street_gaussians, `lib/models/street_gaussian_model.py`): a
//! dictionary of models, or a PLY with an element for each.

use std::cell::Cell;

use decouplegs_scene::{Pose, Presence, SplatCloud, TimedPose, Track, Trajectory};

use super::colors::of_matrices;
use super::sky::{SkyRules, sky_of, with_sky};
use super::{ImportOptions, ImportedActor, ImportedScene};
use crate::checkpoint::{Checkpoint, Names, Node, Tensor, cloud_of};
use crate::inria_ply::mean_weights;
use crate::memory::{cloud_bytes, decoded_bytes_max};
use crate::ply::Ply;
use crate::{DecodeError, inria_ply};

const NAMES: Names = Names {
    means: "xyz",
    scales: "scaling",
    rotations: "rotation",
    opacities: "opacity",
    dc: "feature_dc",
    rest: "feature_rest",
};

const SOURCE: &str = "Street Gaussians";
const SKY: &str = "sky_cubemap";
const COLORS: &str = "color_correction";

/// The cube is looked up in the direction of the world and clamped (`lib/models/sky_cubemap.py`).
const SKY_RULES: SkyRules = SkyRules {
    sky_from_world: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    clamps: true,
    clamps_splats: false,
};
const BACKGROUND: &str = "background";
const ACTOR: &str = "obj_";
/// Prefix of the names of PLY elements, before the model's name.
const ELEMENT: &str = "vertex_";
/// Element of the background, which tells such files from others.
pub(super) const BACKGROUND_ELEMENT: &str = "vertex_background";

/// The scene of a checkpoint, whose models are the values of `root`.
pub(super) fn scene(
    checkpoint: &Checkpoint<'_>,
    root: &Node,
    options: &ImportOptions,
) -> Result<ImportedScene, DecodeError> {
    let tree = &checkpoint.tree;
    let over_time = Cell::new(0);
    let dc = |tensor: &Tensor<'_>| {
        over_time.set(
            over_time.get() + usize::from(tensor.shape().get(1).is_some_and(|&terms| terms > 1)),
        );
        mean_dc(tensor)
    };
    let cloud = |name: &str| {
        cloud_of(
            checkpoint,
            tree.get(root, name).unwrap_or(&Node::None),
            &NAMES,
            dc,
        )
    };
    let background = cloud(BACKGROUND)?;
    let mut actors = Vec::new();
    let mut notes = Vec::new();
    // Many names may stand for the same tensors.
    let mut decoded_bytes = cloud_bytes(background.len() as u64, background.sh_degree);
    for key in tree
        .keys(root)
        .filter(|&key| ![BACKGROUND, SKY, COLORS].contains(&key))
    {
        if is_actor(key) {
            let splats = cloud(key)?;
            decoded_bytes += cloud_bytes(splats.len() as u64, splats.sh_degree);
            if decoded_bytes > decoded_bytes_max(checkpoint.file_bytes) {
                let message = format!(
                    "its models name the same tensors so often that they take {decoded_bytes} bytes and more"
                );
                return Err(DecodeError::Malformed(message));
            }
            actors.push(ImportedActor {
                name: key.to_owned(),
                class: None,
                splats,
                trajectory: None,
                present: Presence::ALWAYS,
            });
        } else if matches!(tree.get(root, key), Some(Node::Dictionary(_))) {
            notes.push(left_out(key));
        }
    }
    notes_on_time(over_time.get(), &mut notes);
    let mut scene = finished(background, actors, notes, options)?;
    if let Some(model) = tree.get(root, SKY) {
        let sky = sky_of(checkpoint, model, &SKY_RULES)?;
        with_sky(&mut scene, SKY, sky);
    }
    if let Some(model) = tree.get(root, COLORS) {
        of_matrices(checkpoint, (COLORS, model), options.image, &mut scene)?;
    }
    Ok(scene)
}

/// The scene of a PLY.
pub(super) fn scene_of_ply(
    ply: &Ply<'_>,
    options: &ImportOptions,
) -> Result<ImportedScene, DecodeError> {
    let background = inria_ply::decode_ply(ply, BACKGROUND_ELEMENT)?;
    let mut actors = Vec::new();
    let mut notes = Vec::new();
    let mut over_time = 0;
    for element in ply.names() {
        let Some(name) = element.strip_prefix(ELEMENT) else {
            continue;
        };
        if is_actor(name) {
            over_time += usize::from(
                ply.property_names(element)
                    .filter(|name| name.starts_with("f_dc_"))
                    .count()
                    > 3,
            );
            let splats = inria_ply::decode_ply(ply, element)?;
            actors.push(ImportedActor {
                name: name.to_owned(),
                class: None,
                splats,
                trajectory: None,
                present: Presence::ALWAYS,
            });
        } else if name != BACKGROUND {
            notes.push(left_out(name));
        }
    }
    notes_on_time(over_time, &mut notes);
    finished(background, actors, notes, options)
}

/// `obj_` and a number: the name goes into a file's.
fn is_actor(name: &str) -> bool {
    name.strip_prefix(ACTOR).is_some_and(|number| {
        !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit())
    })
}

fn left_out(name: &str) -> String {
    let shown: String = name.chars().take(40).collect();
    let why = match name {
        "sky" => {
            "its splats lie around the scene: set 'sky' in the scene file to a color like theirs"
        }
        "actor_pose" => "it holds corrections of tracks that are in the data set, not the tracks",
        "pose_correction" => "corrections of camera poses belong to its cameras",
        _ => "it is no model of splats that is known",
    };
    format!("{shown} is left out: {why}")
}

fn notes_on_time(over_time: usize, notes: &mut Vec<String>) {
    if over_time > 0 {
        notes.push(format!("{over_time} models have colors that change with time (Fourier): their mean over time is kept"));
    }
}

/// The scene, with actors placed where `options` say.
fn finished(
    background: SplatCloud,
    mut actors: Vec<ImportedActor>,
    mut notes: Vec<String>,
    options: &ImportOptions,
) -> Result<ImportedScene, DecodeError> {
    let mut lost = 0;
    for actor in &mut actors {
        let track = options
            .tracks
            .iter()
            .find(|track| names(&actor.name, &track.id));
        actor.trajectory = track.map(trajectory_of).transpose()?;
        actor.class = track.map(|track| track.class.clone());
        actor.present = actor
            .trajectory
            .as_ref()
            .map_or(Presence::ALWAYS, presence_of);
        lost += usize::from(actor.trajectory.is_none());
    }
    if lost > 0 {
        notes.push(format!(
            "{lost} of {} actors are written and not placed: their tracks are in the data set; give them with --tracks",
            actors.len()
        ));
    }
    Ok(ImportedScene {
        background,
        actors,
        notes,
        ..ImportedScene::empty(SOURCE)
    })
}

/// True if a track called `id` is that of the model called `name`.
fn names(name: &str, id: &str) -> bool {
    let number = |text: &str| text.parse::<u64>().ok();
    name == id || (number(id).is_some() && name.strip_prefix(ACTOR).and_then(number) == number(id))
}

/// A track as a way: level, with the last heading where a point tells none.
fn trajectory_of(track: &Track) -> Result<Trajectory, DecodeError> {
    let mut yaw_rad = track
        .points
        .iter()
        .find_map(|point| point.yaw_rad)
        .unwrap_or(0.0);
    let poses = track.points.iter().map(|point| {
        yaw_rad = point.yaw_rad.unwrap_or(yaw_rad);
        TimedPose {
            time_s: point.time_s,
            pose: Pose::from_yaw(yaw_rad, point.position()),
        }
    });
    Trajectory::new(poses.collect())
        .map_err(|message| DecodeError::Malformed(format!("track {}: {message}", track.id)))
}

/// Times of a track, from half a step before its first point to half a step after its last one.
/// A step is the mean time between points. A track of one point stands there always.
fn presence_of(trajectory: &Trajectory) -> Presence {
    let steps = trajectory.poses().len() - 1;
    let (start_s, end_s) = (trajectory.start_s(), trajectory.end_s());
    let half_s = 0.5 * (end_s - start_s) / steps.max(1) as f64;
    match steps {
        0 => Presence::ALWAYS,
        _ => Presence::new(vec![[start_s - half_s, end_s + half_s]]).unwrap_or_default(),
    }
}

/// DC of `[N, terms, 3]`: the mean over time of the terms of a Fourier series (`IDFT` in
/// `lib/utils/sh_utils.py`).
fn mean_dc(tensor: &Tensor<'_>) -> Result<Vec<[f32; 3]>, DecodeError> {
    let &[count, terms, 3] = tensor.shape() else {
        return Err(DecodeError::Malformed(format!(
            "'{}' has the shape {:?}, expected [N, terms, 3]",
            NAMES.dc,
            tensor.shape()
        )));
    };
    let weights = mean_weights(terms)?;
    let mut values = tensor.f64s();
    let mut color = || {
        let mut sum = [0.0; 3];
        for weight in &weights {
            sum = sum.map(|channel: f64| channel + weight * values.next().unwrap_or_default());
        }
        sum.map(|channel| channel as f32)
    };
    Ok((0..count).map(|_| color()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tracks_are_found_by_name_and_by_number() {
        assert!(names("obj_007", "obj_007") && names("obj_007", "7") && names("obj_007", "007"));
        assert!(!names("obj_007", "8") && !names("obj_007", "car") && !names("obj_007", ""));
        assert!(
            is_actor("obj_007") && !is_actor("obj_") && !is_actor("obj_../x") && !is_actor("sky")
        );
    }

    #[test]
    fn the_mean_over_time_is_the_constant_term() {
        let weights = mean_weights(5).unwrap();
        assert!((weights[0] - 1.0).abs() < 1e-12);
        assert!(
            weights[1..].iter().all(|weight| weight.abs() < 1e-9),
            "{weights:?}"
        );
    }
}
