//! An episode as a scene: its place with all road users on the ways that they took.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, anyhow, bail};
use decouplegs::asset::maps::lane_json;
use decouplegs::asset::packed_scene::is_package;
use decouplegs::asset::{
    CodedAsset, Provenance, SceneAgent, SceneFile, SceneLight, SceneRecording, SeenFrom, inria_ply,
    write_coded,
};
use decouplegs::episode::{Moments, Site};
use decouplegs::gpu::Gpu;
use decouplegs::names::UniqueNames;
use decouplegs::scene::episode::Episode;
use decouplegs::scene::scenario::Place;
use decouplegs::scene::{Pose, Presence, Scenario, ShFrame, TimedPose, Trajectory};
use decouplegs::session::{Session, SessionOptions};

/// A road user, lamp or sign over the time in which it shows one asset without a break.
struct Shown {
    name: String,
    class: Option<&'static str>,
    asset: usize,
    sh_frame: Option<ShFrame>,
    poses: Vec<TimedPose>,
    /// Index of the last moment at which it is there.
    last: usize,
}

/// Writes the scene of `episode` at `site` into `folder`, whose name will be another. `light` is
/// the transfer of its run, and paths of the scenario are relative to `base`. Words on what was
/// written.
///
/// # Errors
/// Returns an error for a place that is a package, or where vehicles move otherwise than in the
/// log.
pub fn write(
    gpu: &Gpu,
    episode: &Episode,
    site: &Arc<Site>,
    (base, light): (&Path, Option<&Path>),
    folder: &Path,
) -> Result<String> {
    let session = Session::on(gpu, &SessionOptions::default());
    let moments = super::moments_of(episode, site, &site.add_to(&session)?)?;
    let scenario = &episode.head.scenario;
    let shown = shown(scenario, &moments);
    let mut scene = place(scenario, site, base, folder)?;
    let last = moments.as_slice().len() - 1;
    let mut written = HashMap::new();
    scene.agents.clear();
    for one in shown {
        let asset = match written.get(&one.asset) {
            Some(file) => PathBuf::clone(file),
            None => {
                let file = PathBuf::from(format!("assets/{:03}.safetensors", one.asset));
                write_asset(&folder.join(&file), site, one.asset)?;
                written.insert(one.asset, file.clone());
                file
            }
        };
        scene.agents.push(agent(one, asset, last)?);
    }
    let ego = moments.as_slice().iter().map(|moment| TimedPose {
        time_s: moment.time_s,
        pose: moment.ego,
    });
    scene.ego = Some(way(ego.collect())?);
    scene.ego_height_m = Some(0.5 * scenario.ego.size.height_m);
    scene.recording.vehicle_size = Some(scenario.ego.size);
    if let (Some(lit), Some(light)) = (&mut scene.light, light) {
        lit.transfer = Some(std::path::absolute(light)?);
    }
    lane_json::write(&folder.join("lanes.json"), &site.lanes)?;
    scene.write(&folder.join("scene.toml"))?;
    Ok(format!(
        "scene.toml with {} agents of {} assets over {:.1} s, and lanes.json",
        scene.agents.len(),
        written.len(),
        moments.as_slice()[last].time_s
    ))
}

/// The scene of the place alone.
fn place(scenario: &Scenario, site: &Site, base: &Path, folder: &Path) -> Result<SceneFile> {
    if let Place::Scene { scene, .. } = &scenario.place {
        let scene = base.join(scene);
        if is_package(&scene) {
            bail!(
                "{} is a package: `convert` makes a scene of one, in which an episode can be exported",
                scene.display()
            );
        }
        let from = scene.parent().unwrap_or(Path::new(""));
        let file = SceneFile::read(&scene)?.moved_to_folder(from, folder);
        return file.with_context(|| format!("{} cannot be named from there", scene.display()));
    }
    let loaded = &site.loaded;
    let splats = &loaded.splat_scene;
    inria_ply::write(&folder.join("background.ply"), &splats.splats)?;
    let light = loaded.light.as_ref().map(|light| SceneLight {
        transfer: None,
        relighting: light.relighting,
        ambient: light.ambient,
        shadows: light.shadows,
        casting: light.casting.clone(),
    });
    Ok(SceneFile {
        origin: splats.origin,
        sky: splats.sky,
        fog: splats.fog,
        rules: splats.rules,
        rig: loaded.rig.clone(),
        recording: SceneRecording {
            seen_from: Some(SeenFrom::Everywhere),
            ..SceneRecording::default()
        },
        light,
        ..SceneFile::of_background("background.ply")
    })
}

/// All that images show over the episode, in the order in which it appears.
fn shown(scenario: &Scenario, moments: &Moments) -> Vec<Shown> {
    let mut all: Vec<Shown> = Vec::new();
    let mut of_name: HashMap<&str, usize> = HashMap::new();
    for (index, moment) in moments.as_slice().iter().enumerate() {
        for one in moment.world.agents().iter().filter(|one| one.present) {
            let timed = TimedPose {
                time_s: moment.time_s,
                pose: one.placed.pose,
            };
            let before = of_name.get(one.name.as_str()).map(|&place| &mut all[place]);
            if let Some(before) = before
                && before.last + 1 == index
                && before.asset == one.placed.asset
            {
                before.last = index;
                before.poses.push(timed);
                continue;
            }
            let number = usize::from(one.placed.instance).checked_sub(1);
            let is_road_user = |number: &usize| *number < scenario.agent_count();
            of_name.insert(&one.name, all.len());
            all.push(Shown {
                name: one.name.clone(),
                class: number
                    .filter(is_road_user)
                    .map(|number| scenario.agent(number).1.name()),
                asset: one.placed.asset,
                sh_frame: one.placed.sh_frame,
                poses: vec![timed],
                last: index,
            });
        }
    }
    // Names of scenes are unique, and those of files.
    let mut names = UniqueNames::default();
    for one in &mut all {
        one.name = names.give(one.name.replace('/', "_"));
    }
    all
}

/// The agent of a scene file, which is there while `one` is.
fn agent(one: Shown, asset: PathBuf, last: usize) -> Result<SceneAgent> {
    let span_s = [one.poses[0].time_s, one.poses[one.poses.len() - 1].time_s];
    let is_always = one.poses.len() == last + 1;
    Ok(SceneAgent {
        name: one.name,
        class: one.class.map(str::to_owned),
        asset,
        sh_frame: one.sh_frame,
        trajectory: way(one.poses)?,
        present: match is_always {
            true => Presence::ALWAYS,
            false => Presence::new(vec![span_s])?,
        },
    })
}

/// A trajectory; one that stands has its first pose alone.
fn way(poses: Vec<TimedPose>) -> Result<Trajectory> {
    let first: Pose = poses[0].pose;
    if poses.iter().all(|timed| timed.pose == first) {
        return Ok(Trajectory::standing(first));
    }
    Trajectory::new(poses).map_err(|error| anyhow!("the log's moments are no trajectory: {error}"))
}

fn write_asset(path: &Path, site: &Site, asset: usize) -> Result<()> {
    let folder = path.parent().unwrap_or(Path::new(""));
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    let cloud = site.loaded.assets[asset].clone();
    let provenance = Provenance {
        source: "export".into(),
        ..Provenance::default()
    };
    Ok(write_coded(path, &CodedAsset { cloud, provenance })?)
}
