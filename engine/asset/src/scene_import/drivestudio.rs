//! Checkpoints of drivestudio (ziyc/drivestudio, `models/trainers/base.py` and
//! `models/nodes/rigid.py`), with which OmniRe is made.

use decouplegs_scene::{Pose, Presence, SplatCloud, TimedPose, Trajectory, sh};
use glam::{DQuat, DVec3};

use super::colors::of_embeddings;
use super::sky::{SkyRules, sky_of, with_sky};
use super::{ImportOptions, ImportedActor, ImportedScene};
use crate::DecodeError;
use crate::activation::sigmoid;
use crate::checkpoint::{Checkpoint, Names, Node, Tensor, cloud_of, plain_dc};

const NAMES: Names = Names {
    means: "_means",
    scales: "_scales",
    rotations: "_quats",
    opacities: "_opacities",
    dc: "_features_dc",
    rest: "_features_rest",
};

const BACKGROUND: &str = "Background";
const RIGID: &str = "RigidNodes";
const SKY: &str = "Sky";
const COLORS: &str = "Affine";

/// The cube is looked up in the direction (x, z, -y), and splats are clamped before it is added
/// (`models/modules.py` and `models/trainers/base.py`).
const SKY_RULES: SkyRules = SkyRules {
    sky_from_world: [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]],
    clamps: false,
    clamps_splats: true,
};

/// Descriptions of the other models of a checkpoint.
const LEFT_OUT: [(&str, &str); 4] = [
    (
        "DeformableNodes",
        "what deforms (cyclists, say) needs its network",
    ),
    ("SMPLNodes", "walking people need their body model"),
    (
        "CamPose",
        "corrections of camera poses belong to its cameras",
    ),
    (
        "CamPosePerturb",
        "perturbations of camera poses belong to training",
    ),
];

/// The scene of `models`.
pub(super) fn scene(
    checkpoint: &Checkpoint<'_>,
    models: &Node,
    options: &ImportOptions,
) -> Result<ImportedScene, DecodeError> {
    let tree = &checkpoint.tree;
    let mut notes = Vec::new();
    let background = tree.get(models, BACKGROUND).ok_or_else(|| {
        let there: Vec<&str> = tree.keys(models).take(12).collect();
        DecodeError::Malformed(format!(
            "its models have no '{BACKGROUND}', only: {}",
            there.join(", ")
        ))
    })?;
    let background = cloud(checkpoint, background)?;
    let actors = match tree.get(models, RIGID) {
        Some(rigid) => actors(checkpoint, rigid, options, &mut notes)?,
        None => Vec::new(),
    };
    for key in tree
        .keys(models)
        .filter(|key| ![BACKGROUND, RIGID, SKY, COLORS].contains(key))
    {
        let why = LEFT_OUT
            .iter()
            .find(|(name, _)| *name == key)
            .map_or("it is no model of splats that is known", |(_, why)| why);
        let shown: String = key.chars().take(40).collect();
        notes.push(format!("{shown} is left out: {why}"));
    }
    if !actors.is_empty() {
        notes.push(format!(
            "frames have no times in the checkpoint: {} a second are taken",
            options.frame_rate_hz
        ));
    }
    let mut scene = ImportedScene {
        background,
        actors,
        notes,
        ..ImportedScene::empty("drivestudio")
    };
    if let Some(model) = tree.get(models, SKY) {
        let sky = sky_of(checkpoint, model, &SKY_RULES)?;
        with_sky(&mut scene, SKY, sky);
    }
    if let Some(model) = tree.get(models, COLORS) {
        of_embeddings(checkpoint, (COLORS, model), options.image, &mut scene)?;
    }
    Ok(scene)
}

/// The splats of a model. Without view-dependence drivestudio keeps colors as logits, not as
/// harmonics.
fn cloud(checkpoint: &Checkpoint<'_>, model: &Node) -> Result<SplatCloud, DecodeError> {
    let mut cloud = cloud_of(checkpoint, model, &NAMES, plain_dc)?;
    if cloud.sh_degree == 0 {
        for color in &mut cloud.sh_dc {
            *color = color.map(|logit| ((f64::from(sigmoid(logit)) - 0.5) / sh::Y0) as f32);
        }
    }
    Ok(cloud)
}

/// Frames and instances of the rigid models.
struct Poses {
    frames: usize,
    instances: usize,
    /// `[frame][instance]`, as all of these.
    quaternions_wxyz: Vec<f64>,
    translations_m: Vec<f64>,
    is_there: Vec<bool>,
}

fn actors(
    checkpoint: &Checkpoint<'_>,
    rigid: &Node,
    options: &ImportOptions,
    notes: &mut Vec<String>,
) -> Result<Vec<ImportedActor>, DecodeError> {
    let splats = cloud(checkpoint, rigid)?;
    let ids = tensor(checkpoint, rigid, "points_ids")?;
    if ids.len() != splats.len() {
        let message = format!(
            "'points_ids' has {} entries for {} splats of {RIGID}",
            ids.len(),
            splats.len()
        );
        return Err(DecodeError::Malformed(message));
    }
    let poses = Poses::read(checkpoint, rigid)?;
    let mut of_instance: Vec<Vec<u32>> = vec![Vec::new(); poses.instances];
    for (splat, id) in ids.f64s().enumerate() {
        let members = if id >= 0.0 {
            of_instance.get_mut(id as usize)
        } else {
            None
        };
        let members = members.ok_or_else(|| {
            DecodeError::Malformed(format!(
                "splat {splat} belongs to instance {id}; there are {}",
                poses.instances
            ))
        })?;
        members.push(splat as u32);
    }
    let mut actors = Vec::new();
    let (mut empty, mut unseen) = (0, 0);
    for (instance, members) in of_instance.iter().enumerate() {
        if members.is_empty() {
            empty += 1;
            continue;
        }
        let trajectory = poses.trajectory(instance, options.frame_rate_hz)?;
        let present = poses.presence(instance, options.frame_rate_hz)?;
        unseen += usize::from(trajectory.is_none());
        actors.push(ImportedActor {
            name: format!("rigid_{instance:03}"),
            class: None,
            splats: splats.select(members),
            trajectory,
            present,
        });
    }
    if empty > 0 {
        notes.push(format!(
            "{empty} instances of {RIGID} have no splats left and are left out"
        ));
    }
    if unseen > 0 {
        notes.push(format!(
            "{unseen} instances of {RIGID} are in no frame: written, and not placed"
        ));
    }
    Ok(actors)
}

impl Poses {
    fn read(checkpoint: &Checkpoint<'_>, rigid: &Node) -> Result<Self, DecodeError> {
        let translations = tensor(checkpoint, rigid, "instances_trans")?;
        let quaternions = tensor(checkpoint, rigid, "instances_quats")?;
        let visible = tensor(checkpoint, rigid, "instances_fv")?;
        let wrong = |what: &str, tensor: &Tensor<'_>| {
            DecodeError::Malformed(format!(
                "'{what}' has the shape {:?}, expected frames x instances",
                tensor.shape()
            ))
        };
        let &[frames, instances, 3] = translations.shape() else {
            return Err(wrong("instances_trans", &translations));
        };
        if quaternions.shape() != [frames, instances, 4] {
            return Err(wrong("instances_quats", &quaternions));
        }
        if visible.shape() != [frames, instances] {
            return Err(wrong("instances_fv", &visible));
        }
        Ok(Self {
            frames,
            instances,
            quaternions_wxyz: quaternions.f64s().collect(),
            translations_m: translations.f64s().collect(),
            is_there: visible.f64s().map(|value| value != 0.0).collect(),
        })
    }

    /// Times of the frames that have an instance, each from half a frame before it to half a frame
    /// after it.
    fn presence(&self, instance: usize, frame_rate_hz: f64) -> Result<Presence, DecodeError> {
        let mut frames: Vec<[usize; 2]> = Vec::new();
        for frame in 0..self.frames {
            if !self.is_there[frame * self.instances + instance] {
                continue;
            }
            match frames.last_mut() {
                Some(run) if run[1] + 1 == frame => run[1] = frame,
                _ => frames.push([frame; 2]),
            }
        }
        if matches!(frames[..], [[0, last]] if last + 1 == self.frames) {
            return Ok(Presence::ALWAYS);
        }
        let interval_s = |[first, last]: [usize; 2]| {
            [
                (first as f64 - 0.5) / frame_rate_hz,
                (last as f64 + 0.5) / frame_rate_hz,
            ]
        };
        // A missing frame is between two runs: their ends do not meet.
        Presence::new(frames.into_iter().map(interval_s).collect())
            .map_err(|reason| DecodeError::Malformed(format!("instance {instance}: {reason}")))
    }

    /// Trajectory of an instance over the frames that have it.
    fn trajectory(
        &self,
        instance: usize,
        frame_rate_hz: f64,
    ) -> Result<Option<Trajectory>, DecodeError> {
        let mut poses: Vec<TimedPose> = Vec::new();
        for frame in 0..self.frames {
            let at = frame * self.instances + instance;
            if !self.is_there[at] {
                continue;
            }
            let [w, x, y, z] = std::array::from_fn(|i| self.quaternions_wxyz[4 * at + i]);
            let rotation = DQuat::from_xyzw(x, y, z, w);
            let translation = DVec3::from_slice(&self.translations_m[3 * at..3 * at + 3]);
            if !(translation.is_finite()
                && rotation.is_finite()
                && rotation.length_squared() > 1e-12)
            {
                return Err(DecodeError::Malformed(format!(
                    "instance {instance} has no pose in frame {frame}"
                )));
            }
            poses.push(TimedPose {
                time_s: frame as f64 / frame_rate_hz,
                pose: Pose::new(rotation, translation),
            });
        }
        if poses.is_empty() {
            return Ok(None);
        }
        Trajectory::new(poses)
            .map(Some)
            .map_err(|message| DecodeError::Malformed(format!("instance {instance}: {message}")))
    }
}

fn tensor<'a>(
    checkpoint: &Checkpoint<'a>,
    model: &Node,
    name: &str,
) -> Result<Tensor<'a>, DecodeError> {
    let node = checkpoint.tree.get(model, name);
    checkpoint.tensor(
        node.ok_or_else(|| DecodeError::Malformed(format!("{RIGID} has no '{name}'")))?,
        name,
    )
}
