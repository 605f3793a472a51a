//! `decouplegs edit`: a scene with agents moved, swapped, removed and added, as a new scene file.

mod change;
mod cut;
mod haze;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use decouplegs::asset::scene_file::path_from;
use decouplegs::asset::{PlacedSplats, SceneAgent, SceneFile, is_scene_file, write_ground};
use decouplegs::footing::{Footing, dims_of};
use decouplegs::scene::{Pose, Presence, Trajectory};
use glam::DVec3;

use crate::arguments::{print, warn};
use crate::outputs::Force;
use crate::progress;
use change::{Addition, CutBox, Move, Shift, Swap, Times};

/// Move, swap, remove, add and time agents of a scene, and write it as a new scene file
///
/// Whatever the order on the command line: agents are cut out first, then haze is removed, then
/// agents are removed, added, swapped, moved and shifted. Positions are world coordinates of the
/// middle of an agent's box, meters; angles are degrees, counted from x towards y. Files that the
/// scene names stay where they are: their paths are rewritten if the new file lies in another
/// folder. Comments of the old file are lost.
#[derive(clap::Args)]
pub struct Arguments {
    /// Scene (.toml); it is not changed
    scene: PathBuf,
    /// Scene file to write
    #[arg(long, value_name = "NEW.toml", value_parser = scene_path)]
    out: PathBuf,
    /// Remove an agent; later agents of the file get other instance ids
    #[arg(long, value_name = "NAME")]
    remove: Vec<String>,
    /// Cut an agent out of the background: the splats in this box become the asset NAME.ply beside
    /// the new file, which moves like others, and the background without them is written too
    #[arg(
        long,
        value_name = "NAME=X,Y,Z,YAW_DEG,LENGTH,WIDTH,HEIGHT",
        allow_hyphen_values = true
    )]
    cut: Vec<CutBox>,
    /// Remove splats that hover above the road within METERS of the way on which the scene was
    /// recorded: they veil the wheels of cars that are put there, and no shadow falls on them.
    /// Images of the road lose some sharpness: `realism scene` tells how much
    #[arg(
        long,
        value_name = "METERS",
        num_args = 0..=1,
        default_missing_value = "2",
        value_parser = beside
    )]
    remove_haze: Option<f64>,
    /// Add an agent at a fixed pose
    #[arg(
        long,
        value_name = "NAME=ASSET,X,Y,Z,YAW_DEG",
        allow_hyphen_values = true
    )]
    add: Vec<Addition>,
    /// Use another asset; the pose stays, so an asset of another height needs --ground
    #[arg(long, value_name = "NAME=ASSET")]
    swap: Vec<Swap>,
    /// Move an agent with its whole trajectory to a new start
    #[arg(
        long = "move",
        value_name = "NAME=X,Y,Z,YAW_DEG",
        allow_hyphen_values = true
    )]
    moves: Vec<Move>,
    /// Move an agent in its own frame, at each pose of its trajectory
    #[arg(
        long,
        value_name = "NAME=FORWARD,LEFT[,YAW_DEG]",
        allow_hyphen_values = true
    )]
    shift: Vec<Shift>,
    /// Show an agent at these times alone, or always
    #[arg(
        long,
        value_name = "NAME=FROM_S,TO_S[,...]",
        allow_hyphen_values = true
    )]
    present: Vec<Times>,
    /// Place the wheels of every added, swapped, moved or shifted agent on the captured ground
    #[arg(long)]
    ground: bool,
    #[command(flatten)]
    force: Force,
}

/// Farthest from the way that haze is removed, meters.
const BESIDE_M_MAX: f64 = 20.0;

fn beside(text: &str) -> Result<f64, String> {
    let meters: Option<f64> = text.parse().ok();
    meters
        .filter(|meters| *meters > 0.0 && *meters <= BESIDE_M_MAX)
        .ok_or_else(|| format!("expected up to {BESIDE_M_MAX} m from the way, found {text:?}"))
}

fn scene_path(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    if is_scene_file(&path) {
        Ok(path)
    } else {
        Err(format!(
            "expected a name that ends with .toml, found {text:?}"
        ))
    }
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let scene = SceneFile::read(&arguments.scene)?;
    let [from, to] =
        [&arguments.scene, &arguments.out].map(|file| file.parent().unwrap_or(Path::new("")));
    let mut outputs = arguments.force.outputs(&[&arguments.scene]);
    outputs.file(&arguments.out)?;
    let mut edited = scene.moved_to_folder(from, to).with_context(|| {
        format!(
            "{} cannot be written: its folder cannot be reached",
            arguments.out.display()
        )
    })?;
    let mut report = String::new();
    if !arguments.cut.is_empty() {
        let cutting = progress::spinner("cutting agents out of the background".into());
        report = cut::cut(&mut edited, &arguments.cut, to)?;
        cutting.finish_and_clear();
    }
    if let Some(beside_m) = arguments.remove_haze {
        let clearing = progress::spinner("clearing the road of haze".into());
        report.push_str(&haze::remove(&mut edited, beside_m, to)?);
        clearing.finish_and_clear();
    }
    let touched = change(&mut edited, arguments, to)?;
    if arguments.ground {
        let background = to.join(&edited.background);
        let reading = progress::spinner(format!("reading {}", background.display()));
        let footing = Footing::open(&edited, to)?;
        reading.finish_and_clear();
        if let Some(warning) = footing.warning() {
            warn(&format!("{}: {warning}", background.display()));
        }
        for name in &touched {
            report.push_str(&set_on_ground(&mut edited, name, to, &footing)?);
        }
    }
    edited.write(&arguments.out)?;
    print(&format!(
        "{report}{}: {} agents, {} before\n",
        arguments.out.display(),
        edited.agents.len(),
        scene.agents.len()
    ))
}

/// Makes `background`, which was written to `folder` without labels and with means relative to
/// where the splats of `scene` were placed, its background. `placed` are the splats before: ground
/// that they label, or that is about the origin from before, is written anew.
fn replace_background(
    scene: &mut SceneFile,
    background: PathBuf,
    placed: &PlacedSplats,
    folder: &Path,
) -> Result<()> {
    let origin = scene.origin + placed.origin;
    let ground_m = scene.read_ground(folder, placed)?;
    let is_kept = scene.recording.ground.is_some() && placed.origin == DVec3::ZERO;
    if !ground_m.is_empty() && !is_kept {
        let about: Vec<DVec3> = ground_m.iter().map(|point| *point - origin).collect();
        let file = background.with_extension("ground.ply");
        write_ground(&folder.join(&file), &about)?;
        scene.recording.ground = Some(file);
    }
    scene.origin = origin;
    scene.background = background;
    Ok(())
}

/// Edits `scene`, whose paths are relative to `folder`; returns the agents whose feet may have left
/// the ground, each once.
fn change(scene: &mut SceneFile, arguments: &Arguments, folder: &Path) -> Result<Vec<String>> {
    for name in &arguments.remove {
        scene.remove_agent(name)?;
    }
    for Addition {
        name,
        asset,
        position_m,
        yaw_rad,
    } in &arguments.add
    {
        let trajectory = Trajectory::standing(Pose::from_yaw(*yaw_rad, *position_m));
        let asset = asset_from(folder, asset)?;
        scene.add_agent(SceneAgent {
            name: name.clone(),
            class: None,
            asset,
            sh_frame: None,
            trajectory,
            present: Presence::ALWAYS,
        })?;
    }
    for Swap { name, asset } in &arguments.swap {
        scene.swap_asset(name, asset_from(folder, asset)?)?;
    }
    for Move {
        name,
        position_m,
        yaw_rad,
    } in &arguments.moves
    {
        scene.move_agent(name, *position_m, *yaw_rad)?;
    }
    for Shift { name, shift } in &arguments.shift {
        scene.shift_agent(name, shift)?;
    }
    for Times { name, present } in &arguments.present {
        scene.set_presence(name, present.clone())?;
    }
    let added = arguments.add.iter().map(|change| &change.name);
    let swapped = arguments.swap.iter().map(|change| &change.name);
    let moved = arguments.moves.iter().map(|change| &change.name);
    let shifted = arguments.shift.iter().map(|change| &change.name);
    let mut touched: Vec<String> = Vec::new();
    for name in added.chain(swapped).chain(moved).chain(shifted) {
        if !touched.contains(name) {
            touched.push(name.clone());
        }
    }
    Ok(touched)
}

/// The asset at `path` as a scene file in `folder` names it. It is read, so that no scene names
/// what cannot be shown.
fn asset_from(folder: &Path, path: &Path) -> Result<PathBuf> {
    dims_of(path)?;
    path_from(folder, path)
        .with_context(|| format!("{} cannot be named in the new scene", path.display()))
}

/// Sets the agent called `name` on the ground all along its way; what was done, as lines.
fn set_on_ground(
    scene: &mut SceneFile,
    name: &str,
    folder: &Path,
    footing: &Footing,
) -> Result<String> {
    let agent = scene.agent(name)?;
    let dims_m = dims_of(&folder.join(&agent.asset))?;
    let set = footing.under(&agent.trajectory, dims_m)?;
    let poses = agent.trajectory.poses().len();
    scene.set_trajectory(name, set.trajectory)?;
    let missing = poses - set.grounded;
    ensure!(
        set.grounded > 0,
        "there is no ground below agent {name:?}; move it over the street that was captured"
    );
    let left = if missing == 0 {
        String::new()
    } else {
        format!("; {missing} without ground below keep their heights")
    };
    let turned = if set.raised_max_m < 0.0 {
        "lowered"
    } else {
        "raised"
    };
    let by_m = set.raised_max_m.abs();
    Ok(format!(
        "{name}: poses on the ground {} of {poses}, {turned} by {by_m:.3} m at most{left}\n",
        set.grounded
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_is_written_as_toml() {
        assert!(scene_path("a/new.TOML").is_ok());
        assert!(scene_path("new.ply").unwrap_err().contains("new.ply"));
    }
}
