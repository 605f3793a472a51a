//! Agents that are cut out of a captured background: their splats become an asset of their own.

use std::path::{Path, PathBuf};

use anyhow::{Result, ensure};
use decouplegs::asset::{SceneAgent, SceneFile, inria_ply, read_placed_splats};
use decouplegs::scene::{Pose, Presence, ShFrame, SplatCloud, Trajectory};
use glam::DVec3;

use super::change::CutBox;
use super::replace_background;

/// Splats this far above the bottom of a box are still those of the ground, meters.
const GROUND_M: f64 = 0.05;
/// Fewer splats are no agent.
const SPLATS_MIN: usize = 20;
/// Side of the squares below an agent in which ground is looked for, meters.
const SQUARE_M: f64 = 0.5;

/// Cuts `boxes` out of the background of `scene`, whose paths are relative to `folder`: new assets
/// and the background without them are written there. Lines that tell what was done.
pub fn cut(scene: &mut SceneFile, boxes: &[CutBox], folder: &Path) -> Result<String> {
    let path = folder.join(&scene.background);
    let placed = read_placed_splats(&path)?;
    let cloud = &placed.cloud;
    let origin = scene.origin + placed.origin;
    let mut is_left = vec![true; cloud.len()];
    let mut files: Vec<(PathBuf, SplatCloud)> = Vec::new();
    let mut report = String::new();
    for own in boxes {
        let agent_from_world = own.pose.inverse();
        let local = |splat: usize| agent_from_world.transform(origin + cloud.mean_m(splat));
        let half_m = 0.5 * own.dims_m;
        let inside: Vec<u32> = (0..cloud.len())
            .filter(|&splat| {
                let at = local(splat).abs();
                is_left[splat] && at.cmple(half_m).all() && local(splat).z > GROUND_M - half_m.z
            })
            .map(|splat| splat as u32)
            .collect();
        ensure!(
            inside.len() >= SPLATS_MIN,
            "{} has {} splats in the box of {}: expected {SPLATS_MIN} or more; are its place (the middle of the box), angle and size right?",
            path.display(),
            inside.len(),
            own.name
        );
        inside
            .iter()
            .for_each(|&splat| is_left[splat as usize] = false);
        // The asset has the agent's frame, and its colors turn with it.
        let to_agent = Pose::new(
            agent_from_world.rotation,
            agent_from_world.transform(origin),
        );
        let asset = cloud.select(&inside).placed(&to_agent, true);
        let file = PathBuf::from(format!("{}.ply", own.name));
        scene.add_agent(SceneAgent {
            name: own.name.clone(),
            class: None,
            asset: file.clone(),
            sh_frame: Some(ShFrame::Canonical),
            trajectory: Trajectory::standing(own.pose),
            present: Presence::ALWAYS,
        })?;
        let bare = bare_share(cloud, &is_left, own, origin);
        report.push_str(&format!(
            "{}: {} splats; {:.0} % of the ground below it was never seen and stays a hole\n",
            own.name,
            inside.len(),
            100.0 * bare
        ));
        files.push((file, asset));
    }
    let left: Vec<u32> = (0..cloud.len())
        .filter(|&splat| is_left[splat])
        .map(|splat| splat as u32)
        .collect();
    let background = PathBuf::from("background_cut.ply");
    files.push((background.clone(), cloud.select(&left)));
    for (file, _) in &files {
        let path = folder.join(file);
        ensure!(
            path.symlink_metadata().is_err(),
            "{} exists, and nothing that exists is replaced: give --out another folder, or the agent another name",
            path.display()
        );
    }
    for (file, cloud) in &files {
        inria_ply::write(&folder.join(file), cloud)?;
    }
    replace_background(scene, background, &placed, folder)?;
    Ok(report)
}

/// Share of the squares below a box in which no splat near its bottom is left.
fn bare_share(cloud: &SplatCloud, is_left: &[bool], own: &CutBox, origin: DVec3) -> f64 {
    let agent_from_world = own.pose.inverse();
    let half_m = 0.5 * own.dims_m;
    let count = |side_m: f64| (2.0 * side_m / SQUARE_M).ceil().max(1.0) as usize;
    let (columns, rows) = (count(half_m.x), count(half_m.y));
    let mut is_covered = vec![false; columns * rows];
    for splat in (0..cloud.len()).filter(|&splat| is_left[splat]) {
        let at = agent_from_world.transform(origin + cloud.mean_m(splat));
        let is_ground = (at.z + half_m.z).abs() < 0.3;
        let (x, y) = ((at.x + half_m.x) / SQUARE_M, (at.y + half_m.y) / SQUARE_M);
        if is_ground && (0.0..columns as f64).contains(&x) && (0.0..rows as f64).contains(&y) {
            is_covered[y as usize * columns + x as usize] = true;
        }
    }
    let bare = is_covered.iter().filter(|covered| !**covered).count();
    bare as f64 / is_covered.len() as f64
}
