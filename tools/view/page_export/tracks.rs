//! Samples of what moves in a source, for a page that interpolates between them.

use std::collections::HashMap;

use base64::{Engine, engine::general_purpose::STANDARD};
use decouplegs::scene::Pose;
use glam::DVec3;
use serde_json::{Value, json};

use crate::frame_state::camera_json;
use crate::source::Source;

/// Most samples of a track: what lasts longer has fewer per second.
const SAMPLES_MAX: f64 = 20_000.0;
/// Times that differ by less are the same, seconds.
const SAME_S: f64 = 1e-6;

/// Poses of one thing, at equal steps from the sample `first` on.
struct Track {
    /// Facts that do not change.
    facts: Value,
    first: usize,
    poses: Vec<Pose>,
}

/// Samples of the ego, agents and cameras of a source.
pub struct Samples {
    start_s: f64,
    step_s: f64,
    count: usize,
    ego: Track,
    agents: Vec<Track>,
    cameras: Vec<Track>,
}

impl Track {
    fn new(facts: Value, first: usize) -> Self {
        let poses = Vec::new();
        Self {
            facts,
            first,
            poses,
        }
    }

    fn end(&self) -> usize {
        self.first + self.poses.len()
    }

    fn stands(&self) -> bool {
        self.poses.windows(2).all(|two| two[0] == two[1])
    }

    /// The track for the page. One that stands still has one pose.
    fn json(&self, origin: DVec3) -> Value {
        let told = if self.stands() { 1 } else { self.poses.len() };
        let poses = self.poses.iter().take(told);
        let numbers = poses.flat_map(|pose| {
            let [x, y, z] = (pose.translation - origin).to_array();
            let [a, b, c, d] = pose.rotation.to_array();
            [x, y, z, a, b, c, d].map(|number| number as f32)
        });
        let bytes: Vec<u8> = numbers.flat_map(f32::to_le_bytes).collect();
        let mut json = self.facts.clone();
        json["first"] = self.first.into();
        json["last"] = self.end().saturating_sub(1).into();
        json["poses"] = STANDARD.encode(bytes).into();
        json
    }
}

impl Samples {
    /// Samples of `source` over all its time, at its own step or a little faster, so that steps
    /// divide it evenly.
    pub fn take(source: &mut Source) -> Self {
        let [start_s, end_s] = source.span_s();
        let duration_s = end_s - start_s;
        let steps = (duration_s / source.step_s() - SAME_S).ceil();
        let steps = steps.clamp(0.0, SAMPLES_MAX);
        let mut samples = Self {
            start_s,
            step_s: if steps > 0.0 { duration_s / steps } else { 0.0 },
            count: steps as usize + 1,
            ego: Track::new(json!({}), 0),
            agents: Vec::new(),
            cameras: Vec::new(),
        };
        let mut latest = HashMap::new();
        for sample in 0..samples.count {
            source.set_time(start_s + duration_s * sample as f64 / steps.max(1.0));
            samples.add(sample, source, &mut latest);
        }
        source.set_time(start_s);
        samples
    }

    /// Adds the state of `source` as the sample `sample`. `latest`: the newest track of each agent.
    fn add(
        &mut self,
        sample: usize,
        source: &Source,
        latest: &mut HashMap<(String, Option<usize>), usize>,
    ) {
        self.ego.poses.push(source.ego());
        for agent in source.boxes() {
            let known = latest.get(&(agent.name.clone(), agent.asset)).copied();
            // One that was gone for a while has another track.
            let known = known.filter(|&at| self.agents[at].end() == sample);
            let at = known.unwrap_or(self.agents.len());
            if at == self.agents.len() {
                let facts = json!({
                    "name": agent.name,
                    "id": agent.instance,
                    "size_m": agent.size_m,
                    "asset": agent.asset,
                });
                self.agents.push(Track::new(facts, sample));
                latest.insert((agent.name, agent.asset), at);
            }
            self.agents[at].poses.push(agent.pose);
        }
        for (at, camera) in source.cameras().iter().enumerate() {
            if at == self.cameras.len() {
                let mut facts = camera_json(camera);
                facts["name"] = camera.name.clone().into();
                self.cameras.push(Track::new(facts, sample));
            }
            self.cameras[at].poses.push(camera.world_from_camera);
        }
    }

    /// Number of agents that move and have splats of their own.
    pub fn moving(&self) -> usize {
        let agents = self.agents.iter();
        let moving = agents.filter(|track| !track.facts["asset"].is_null() && !track.stands());
        let mut names: Vec<&str> = moving
            .filter_map(|track| track.facts["name"].as_str())
            .collect();
        names.sort_unstable();
        names.dedup();
        names.len()
    }

    /// Samples per second; 0 where there is one.
    pub fn per_s(&self) -> f64 {
        if self.step_s > 0.0 {
            self.step_s.recip()
        } else {
            0.0
        }
    }

    /// Cameras of the file for the page: their images, and their tracks relative to the origin of
    /// the world.
    pub fn cameras(&self) -> Value {
        self.cameras
            .iter()
            .map(|track| track.facts.clone())
            .collect()
    }

    /// Tracks for the page, relative to `origin`.
    pub fn tracks(&self, origin: DVec3) -> Value {
        let all =
            |tracks: &[Track]| -> Value { tracks.iter().map(|track| track.json(origin)).collect() };
        json!({
            "start_s": self.start_s,
            "step_s": self.step_s,
            "count": self.count,
            "origin_m": origin.to_array(),
            "ego": self.ego.json(origin),
            "agents": all(&self.agents),
            "cameras": all(&self.cameras),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_stands_still_has_one_pose() {
        let mut track = Track::new(json!({"name": "car"}), 3);
        track.poses = vec![Pose::IDENTITY; 4];
        let numbers = |track: &Track| {
            let json = track.json(DVec3::ZERO);
            let poses = STANDARD.decode(json["poses"].as_str().unwrap()).unwrap();
            (
                json["first"].clone(),
                json["last"].clone(),
                poses.len() / 28,
            )
        };
        assert_eq!(numbers(&track), (3.into(), 6.into(), 1));
        track.poses[3].translation.x = 1.0;
        assert_eq!(numbers(&track), (3.into(), 6.into(), 4));
    }
}
