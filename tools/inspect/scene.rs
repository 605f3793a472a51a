//! What a scene file lists: cameras, the ego vehicle's way, agents.

use std::path::PathBuf;

use decouplegs::asset::{LoadedScene, SceneFile};
use decouplegs::scene::{RigCamera, ShFrame, Trajectory, World};
use glam::DVec3;
use serde_json::{Value, json};

use super::summary::Lines;

/// Cameras, ego and agents of a scene.
pub struct Listing {
    cameras: Vec<RigCamera>,
    ego: Trajectory,
    agents: Vec<Agent>,
}

struct Agent {
    instance: usize,
    name: String,
    asset: PathBuf,
    /// Splats of the asset, or of its finest level.
    splats: usize,
    sh_frame: &'static str,
    trajectory: Trajectory,
}

impl Listing {
    /// Lists `scene`, of which `loaded` was read and `world` baked.
    pub fn of(scene: &SceneFile, loaded: &LoadedScene, world: &World) -> Self {
        let mut splats = vec![0; scene.agents.len() + 1];
        world.instance_from_splat.iter().for_each(|&instance| splats[usize::from(instance)] += 1);
        let agent = |(index, agent): (usize, &decouplegs::asset::SceneAgent)| {
            let coded = loaded.agents.iter().find(|coded| usize::from(coded.instance) == index + 1);
            let sh_frame = coded.map_or_else(|| agent.sh_frame.unwrap_or_default(), |coded| coded.sh_frame);
            Agent {
                instance: index + 1,
                name: agent.name.clone(),
                asset: agent.asset.clone(),
                splats: splats[index + 1],
                sh_frame: if sh_frame == ShFrame::World { "world" } else { "canonical" },
                trajectory: agent.trajectory.clone(),
            }
        };
        Self {
            cameras: scene.rig.cameras.clone(),
            ego: loaded.ego.clone(),
            agents: scene.agents.iter().enumerate().map(agent).collect(),
        }
    }

    pub fn to_text(&self) -> String {
        let mut lines = Lines::default();
        lines.line("cameras", &self.cameras.len().to_string());
        for RigCamera { name, intrinsics, rig_from_camera } in &self.cameras {
            let forward = rig_from_camera.rotation * DVec3::Z;
            let yaw_deg = forward.y.atan2(forward.x).to_degrees();
            let fov_deg = (2.0 * (0.5 * f64::from(intrinsics.width_px) / intrinsics.fx_px).atan()).to_degrees();
            let at = metres(rig_from_camera.translation);
            let (width_px, height_px) = (intrinsics.width_px, intrinsics.height_px);
            lines.line(
                "",
                &format!("{name}: {width_px}x{height_px}, {fov_deg:.1} degrees wide, at {at}, turned {yaw_deg:.1} degrees"),
            );
        }
        lines.line("ego", &way_to_text(&self.ego));
        lines.line("agents", &self.agents.len().to_string());
        for Agent { instance, name, asset, splats, sh_frame, trajectory } in &self.agents {
            let (asset, way) = (asset.display(), way_to_text(trajectory));
            lines.line("", &format!("{instance} {name}: {asset}, {splats} splats, colours {sh_frame}, {way}"));
        }
        lines.into_text()
    }

    pub fn to_json(&self) -> Value {
        let camera = |camera: &RigCamera| {
            json!({
                "name": camera.name,
                "width_px": camera.intrinsics.width_px,
                "height_px": camera.intrinsics.height_px,
                "position_m": camera.rig_from_camera.translation.to_array(),
            })
        };
        let agent = |agent: &Agent| {
            json!({
                "instance": agent.instance,
                "name": agent.name,
                "asset": agent.asset.to_string_lossy(),
                "splats": agent.splats,
                "sh_frame": agent.sh_frame,
                "trajectory": way_to_json(&agent.trajectory),
            })
        };
        json!({
            "cameras": self.cameras.iter().map(camera).collect::<Vec<_>>(),
            "ego": way_to_json(&self.ego),
            "agents": self.agents.iter().map(agent).collect::<Vec<_>>(),
        })
    }
}

fn way_to_text(way: &Trajectory) -> String {
    let poses = way.poses();
    match poses {
        [only] => format!("stands at {}", metres(only.pose.translation)),
        _ => format!(
            "{:.1} s to {:.1} s, {} poses, {:.1} m from {} to {}",
            way.start_s(),
            way.end_s(),
            poses.len(),
            length_m(way),
            metres(poses[0].pose.translation),
            metres(poses[poses.len() - 1].pose.translation)
        ),
    }
}

fn way_to_json(way: &Trajectory) -> Value {
    json!({ "start_s": way.start_s(), "end_s": way.end_s(), "poses": way.poses().len(), "length_m": length_m(way) })
}

/// Along the straight pieces between its poses.
fn length_m(way: &Trajectory) -> f64 {
    way.poses().windows(2).map(|pair| pair[0].pose.translation.distance(pair[1].pose.translation)).sum()
}

fn metres(position: DVec3) -> String {
    format!("({:.2}, {:.2}, {:.2}) m", position.x, position.y, position.z)
}
