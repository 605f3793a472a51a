//! `boxes.json`: bounding boxes of the agents in each image.

use std::io::Write;
use std::path::Path;

use anyhow::{Context, Result};
use decouplegs_asset::write_atomically;
use decouplegs_render::{Image, Plane};
use decouplegs_scene::bounding_box::{ImageBox, agent_box, visible_boxes};
use decouplegs_scene::{Camera, Pose, SplatScene};
use serde_json::{Value, json};

use super::coverage::Counter;
use super::labels::Labels;
use crate::scene_source::DrawInput;

/// Bounding boxes of the images so far.
pub struct BoxList<'a> {
    input: &'a DrawInput,
    /// Pose and size of the box of each agent, in the order of the scene file; `None` for those
    /// that are absent.
    placed: Vec<Option<(Pose, [f64; 3])>>,
    labels: &'a Labels,
    counter: Counter,
    images: Vec<Value>,
}

impl<'a> BoxList<'a> {
    /// Planes that boxes are made of.
    pub const PLANES: [Plane; 2] = [Plane::Instance, Plane::DepthMedian];

    pub fn new(input: &'a DrawInput, labels: &'a Labels, counter: Counter) -> Self {
        let loaded = &input.loaded;
        let mut placed = vec![None; loaded.agent_labels.len()];
        for plain in &loaded.plain_agents {
            placed[usize::from(plain.instance) - 1] = Some((plain.pose, plain.dims_m));
        }
        for agent in &loaded.agents {
            let pose = agent.pose_at(input.time_s);
            let dims_m = loaded.assets[agent.asset].dims_m;
            placed[usize::from(agent.instance) - 1] = pose.map(|pose| (pose, dims_m));
        }
        let in_f64 = |(pose, dims_m): (Pose, [f32; 3])| (pose, dims_m.map(f64::from));
        Self {
            input,
            placed: placed.into_iter().map(|one| one.map(in_f64)).collect(),
            labels,
            counter,
            images: Vec::new(),
        }
    }

    /// Adds the agents that are in `image`, or would be if nothing hid them.
    pub fn add(&mut self, camera: &Camera, image: &Image) -> Result<()> {
        let loaded = &self.input.loaded;
        let instances = image.instance().context("the image has no instances")?;
        let scene_m = image.depth_median();
        let scene_m = scene_m.context("the image has no median depth")?;
        let ids = loaded.agent_labels.len() + 1;
        let visible = visible_boxes(instances, image.width, ids);
        let mut agents = Vec::new();
        for (index, label) in loaded.agent_labels.iter().enumerate() {
            let instance = index + 1;
            let found = self.placed[index]
                .and_then(|(pose, dims_m)| Some((agent_box(camera, &pose, dims_m)?, dims_m)));
            let seen = visible[instance];
            if found.is_none() && seen.is_none() {
                continue;
            }
            let agent = found.and_then(|_| alone(self.input, instance as u16));
            let coverage = match &agent {
                Some(agent) => {
                    let agent = (agent, instance as u16);
                    Some(self.counter.coverage(agent, camera, (instances, scene_m))?)
                }
                None => None,
            };
            let box_3d = found.map(|(found, dims_m)| {
                let q = found.camera_from_box.rotation;
                json!({
                    "position_m": found.camera_from_box.translation.to_array(),
                    "rotation_wxyz": [q.w, q.x, q.y, q.z],
                    "size_m": dims_m,
                })
            });
            agents.push(json!({
                "name": label.name,
                "class": self.labels.class(instance),
                "moving": self.labels.moves(instance),
                "instance": instance,
                "camera_from_box": box_3d,
                "amodal_px": found.map(|(found, _)| edges(&found.amodal)),
                "amodal_in_image_px": found.map(|(found, _)| edges(&found.in_image)),
                "tight_px": seen.map(|seen| edges(&seen.tight)),
                "visible_pixels": seen.map_or(0, |seen| seen.pixels),
                "visible_fraction": coverage.and_then(|all| all.visible_fraction()),
                "truncated_fraction": coverage.and_then(|all| all.truncated_fraction()),
            }));
        }
        self.images.push(json!({
            "camera": camera.name,
            "width_px": image.width,
            "height_px": image.height,
            "agents": agents,
        }));
        Ok(())
    }

    pub fn write(&self, path: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(&json!({
            "time_s": self.input.time_s,
            "images": self.images,
        }))?;
        Ok(write_atomically(path, |file| {
            file.write_all(text.as_bytes())
        })?)
    }
}

/// The world of one agent alone; `None` where it is absent.
fn alone(input: &DrawInput, instance: u16) -> Option<SplatScene> {
    let loaded = &input.loaded;
    let mut splat_scene = SplatScene {
        origin: loaded.splat_scene.origin,
        rules: loaded.splat_scene.rules,
        ..SplatScene::default()
    };
    let coded = loaded
        .agents
        .iter()
        .find(|agent| agent.instance == instance);
    if let Some(agent) = coded {
        let pose = agent.pose_at(input.time_s)?;
        let splats = loaded.assets[agent.asset].decoded(0);
        splat_scene.bake_instance(&splats, &pose, agent.sh_frame, instance);
    } else {
        let ids = loaded.splat_scene.instance_from_splat.iter().zip(0..);
        let own: Vec<u32> = ids
            .filter_map(|(id, splat)| (*id == instance).then_some(splat))
            .collect();
        splat_scene.splats = loaded.splat_scene.splats.select(&own);
    }
    Some(splat_scene)
}

/// Left, top, right and bottom edge, pixels.
fn edges(of: &ImageBox) -> [f64; 4] {
    [of.min_px.x, of.min_px.y, of.max_px.x, of.max_px.y]
}
