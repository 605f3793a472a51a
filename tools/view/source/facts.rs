//! Facts and states of a source for the page, as JSON.

use decouplegs::asset::lidar_names;
use serde_json::{Value, json};

use super::{Course, Source};
use crate::played::Played;
use crate::viewpoint::pose_json;
use crate::{extent, splat_stream};

impl Source {
    /// Facts that do not change while a scene is played: cameras, counts, lanes, as JSON.
    pub fn facts(&self) -> Value {
        let cameras: Vec<Value> = (self.now.cameras.iter())
            .map(|camera| {
                let k = &camera.intrinsics;
                json!({"name": camera.name, "width_px": k.width_px, "height_px": k.height_px})
            })
            .collect();
        let loaded = self.loaded();
        let lanes = match &self.course {
            Course::Scene(course) => course.lane_lines(),
            Course::Episode(played, _) => played.lane_lines(),
        };
        let own = loaded.rig.lidars().map(|lidar| lidar.name.as_str());
        let lidars: Vec<&str> = own.chain(lidar_names()).collect();
        let first = self.now.cameras.first();
        let first = first.map_or(self.now.ego, |camera| camera.world_from_camera);
        let has_rig = loaded.rig.cameras().next().is_some();
        json!({
            "title": self.title,
            "cameras": cameras,
            "step_s": self.step_s(),
            "has_ego": self.episode().is_some() || has_rig,
            "is_captured": has_rig && extent::is_captured(loaded),
            "background_splats": self.on_device.background_splats(),
            "assets": loaded.assets.len(),
            "first_camera": pose_json(&first),
            "extent": if has_rig { Value::Null } else { extent::facts(&loaded.splat_scene) },
            "lanes": lanes,
            "lidars": lidars,
            "browser": splat_stream::rules_json(&loaded.splat_scene),
        })
    }

    /// Facts that change with edits and steps: counts, undo, score, as JSON.
    pub fn changing_facts(&self) -> Value {
        let edits = match &self.course {
            Course::Scene(course) => course.edit_facts(),
            Course::Episode(_, edited) => {
                let edited = edited.as_ref();
                edited.map_or(Value::Null, |edited| edited.facts())
            }
        };
        let plain = self.loaded().plain_agents.len();
        json!({
            "span_s": self.span_s(),
            "agents": self.now.world.agents().len(),
            "plain_agents": plain,
            "splats": self.splats.version(),
            "edits": edits,
            "log": self.episode().map(Played::facts),
        })
    }

    /// Poses and boxes of the agents that are present at the time that was set, and of the ego.
    pub fn state(&self) -> Value {
        let agents: Vec<Value> = (self.boxes().into_iter())
            .map(|agent| {
                json!({
                    "name": agent.name,
                    "id": agent.instance,
                    "class": agent.class,
                    "pose": pose_json(&agent.pose),
                    "size_m": agent.size_m,
                    "speed_mps": agent.speed_mps,
                    "fixed": agent.fixed,
                    "asset": agent.asset,
                })
            })
            .collect();
        let plans = self.episode().map(|played| played.plans(self.now.time_s));
        let (plan, alternatives) = plans.unwrap_or_default();
        json!({
            "agents": agents,
            "ego": pose_json(&self.now.ego),
            "plan": plan,
            "alternatives": alternatives,
        })
    }
}
