//! `decouplegs open-loop`: a planner shown two sources of images along the same log.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Result, ensure};
use decouplegs::asset::write_atomically;
use decouplegs::drive::OrientedBox;
use decouplegs::drive::oriented_box::time_to_collision;
use decouplegs::drive::score::{Moments, TTC_HORIZON_S, plan_ade_m};
use decouplegs::episode::open_loop::{Images, plans};
use decouplegs::episode::{Appearance, EpisodeError, ObservationRenderer, Simulation, chosen};
use decouplegs::logs::read_episode_log;
use decouplegs::planner::{Timeouts, images};
use decouplegs::render::Image;
use decouplegs::scene::episode::{Episode, EpisodeTick};
use decouplegs::scene::{Plan, Pose, Rig, TimedPose, Trajectory};
use decouplegs_alpasim::egodriver::{DriverOptions, SensorLens};
use decouplegs_alpasim::planner_name::PlannerName;
use serde_json::{Value, json};

use crate::arguments::{print, transfer_in};
use crate::background::BackgroundArguments;
use crate::device::DeviceArguments;
use crate::episode_report::spread;
use crate::outputs::Force;
use crate::sites::Sites;

/// Show a planner two sources of images along the same log, such as real images and rendered ones,
/// and compare its plans. The ego drives as in the log, regardless of the plans
#[derive(clap::Args)]
pub struct Arguments {
    /// Log that the ego follows
    log: PathBuf,
    /// Planner, by its name in `drive`; not one that replays a log
    #[arg(long, value_name = "PLANNER")]
    planner: PlannerName,
    /// Reference images: a folder of CAMERA_STEP.png, as `drive --images all` writes them
    /// (front_0000.png), or .jpg; or `rendered`
    #[arg(long, value_name = "DIR|rendered", default_value = "rendered")]
    reference: PathBuf,
    /// Images to compare with: a folder, or `rendered`
    #[arg(long, value_name = "DIR|rendered")]
    other: PathBuf,
    /// Folder that the scenario's files are relative to (default: the log's)
    #[arg(long, value_name = "DIR")]
    base: Option<PathBuf>,
    /// Ego that is followed, by its name, where the log has several [default: the first]
    #[arg(long, value_name = "EGO")]
    ego: Option<String>,
    /// Light transfer for the cars of rendered images
    #[arg(long, value_name = "FILE")]
    light: Option<PathBuf>,
    /// Write the figures, step by step, to this file
    #[arg(long, value_name = "FILE.json")]
    json: Option<PathBuf>,
    #[command(flatten)]
    background: BackgroundArguments,
    #[command(flatten)]
    device: DeviceArguments,
    #[command(flatten)]
    driver: DriverOptions,
    #[command(flatten)]
    force: Force,
}

/// A planner's answers to one source.
struct Answers {
    name: String,
    plans: Vec<Option<Plan>>,
    /// Mean displacement of each plan from the driven path, meters.
    ade_m: Vec<Option<f64>>,
    /// Time to collision of each plan, if it were driven, seconds.
    ttc_s: Vec<Option<f64>>,
}

pub fn run(arguments: &Arguments) -> Result<()> {
    arguments.force.files(&[&arguments.log], &arguments.json)?;
    let episode = read_episode_log(&arguments.log)?;
    let episode = match &arguments.ego {
        Some(name) => episode.with_first_named(name)?,
        None => episode,
    };
    ensure!(
        !episode.steps.is_empty(),
        "{} has no steps to show a planner",
        arguments.log.display()
    );
    let answers =
        [&arguments.reference, &arguments.other].map(|source| answers(arguments, &episode, source));
    let [reference, other] = answers;
    let (reference, other) = (reference?, other?);
    let differences: Vec<Option<f64>> = reference
        .plans
        .iter()
        .zip(&other.plans)
        .map(|(a, b)| Some(difference_m(a.as_ref()?, b.as_ref()?)))
        .collect();
    let report = to_json(&episode, &[&reference, &other], &differences);
    if let Some(path) = &arguments.json {
        write_atomically(path, |file| writeln!(file, "{report:#}"))?;
    }
    print(&text(&[&reference, &other], &differences))
}

/// Plans of the planner for the images of `source`.
fn answers(arguments: &Arguments, episode: &Episode, source: &Path) -> Result<Answers> {
    let timeouts = Timeouts {
        answer: Duration::from_secs(60),
        ..Timeouts::default()
    };
    let mut planner = arguments.planner.open(timeouts, &arguments.driver)?;
    ensure!(
        !planner.sees().lidars,
        "{} asks for sweeps of LiDARs, and an open loop shows images alone",
        arguments.planner
    );
    let base = arguments
        .base
        .as_deref()
        .or(arguments.log.parent())
        .unwrap_or(Path::new(""));
    let is_rendered = source == Path::new("rendered");
    let gpu = is_rendered.then(|| arguments.device.open()).transpose()?;
    let scenario = &episode.head.scenario;
    let appearance = Appearance {
        transfer: transfer_in(arguments.light.as_deref())?,
        only_cars: scenario.has_only_cars(),
    };
    let sites = Sites::new(gpu.as_slice(), arguments.background, appearance);
    let ready = sites.get(&scenario.place, base)?;
    let size_px = episode
        .head
        .drawn_by
        .as_ref()
        .map(|by| [by.width_px, by.height_px]);
    let wanted = planner.sees().cameras;
    let plans = match sites.sessions().first() {
        Some(session) => {
            let scene = &sites.scene(&ready, 0)?;
            let rig = chosen(&ready.site.loaded.rig, &wanted, size_px)?;
            let renderer = ObservationRenderer::new(session.batch_renderer(), scene, rig, 1);
            let mut renderer = arguments.planner.fit(renderer, &arguments.driver)?;
            let rig = renderer.rig().clone();
            let mut shadow = Simulation::new(&episode.head.scenario, &ready.site)?;
            let drawn = |step: u32| -> Result<Images> {
                renderer.draw(&shadow, step).map_err(EpisodeError::from)?;
                let readings = renderer.readings();
                let images = images(&readings).map(|frame| frame.rgba.to_vec()).collect();
                shadow.advance_with(&episode.plans_at(step), |_| {});
                Ok(images)
            };
            plans(episode, &ready.site, &rig, planner.as_mut(), drawn)?
        }
        None => {
            ensure!(
                arguments.driver.driver_lens == SensorLens::Own,
                "--driver-lens f-theta draws cameras anew, and {} has images already",
                source.display()
            );
            let rig = rig_of_folder(arguments, episode, source, wanted)?;
            plans(episode, &ready.site, &rig, planner.as_mut(), |step| {
                read_images(source, &rig, step)
            })?
        }
    };
    Ok(judged(source, episode, plans))
}

/// Cameras as the place has them, at the size of the images in the folder.
fn rig_of_folder(
    arguments: &Arguments,
    episode: &Episode,
    source: &Path,
    wanted: decouplegs::planner::Cameras,
) -> Result<Rig> {
    let base = arguments
        .base
        .as_deref()
        .or(arguments.log.parent())
        .unwrap_or(Path::new(""));
    let rig = decouplegs::episode::rig_of(&episode.head.scenario.place, base)?;
    let mut rig = chosen(&rig, &wanted, None)?;
    for camera in rig.cameras_mut() {
        let image = Image::read(&path_of(source, &camera.name, 0))?;
        camera.intrinsics = camera.intrinsics.resized(image.width, image.height);
    }
    Ok(rig)
}

/// Endings of images in a folder.
const ENDINGS: [&str; 3] = ["png", "jpg", "jpeg"];

/// The image of a camera at a step; with the first ending where there is none.
fn path_of(folder: &Path, camera: &str, step: u32) -> PathBuf {
    let path = |ending: &str| folder.join(format!("{camera}_{step:04}.{ending}"));
    let there = ENDINGS
        .iter()
        .map(|ending| path(ending))
        .find(|path| path.is_file());
    there.unwrap_or_else(|| path(ENDINGS[0]))
}

fn read_images(folder: &Path, rig: &Rig, step: u32) -> Result<Images> {
    let read = |camera: &decouplegs::scene::RigCamera| -> Result<Vec<u8>> {
        let path = path_of(folder, &camera.name, step);
        let image = Image::read(&path)?;
        let (wanted, found) = (
            [camera.intrinsics.width_px, camera.intrinsics.height_px],
            [image.width, image.height],
        );
        ensure!(
            wanted == found,
            "{} is {found:?} pixels large; expected {wanted:?}, as the first",
            path.display()
        );
        let bytes = image.rgb.iter().flat_map(|rgb| {
            let byte = |value: f32| (value.clamp(0.0, 1.0) * 255.0).round() as u8;
            [byte(rgb[0]), byte(rgb[1]), byte(rgb[2]), 255]
        });
        Ok(bytes.collect())
    };
    rig.cameras().map(read).collect()
}

fn judged(source: &Path, episode: &Episode, plans: Vec<Option<Plan>>) -> Answers {
    let instants: Vec<&EpisodeTick> = episode.instants().collect();
    let pose = |instant: &EpisodeTick| {
        Pose::from_yaw(instant.ego.yaw_rad, instant.ego.position_m.extend(0.0))
    };
    let driven = Trajectory::new(
        instants
            .iter()
            .map(|instant| TimedPose {
                time_s: instant.time_s,
                pose: pose(instant),
            })
            .collect(),
    );
    let mut before = 0;
    let (mut ade_m, mut ttc_s) = (Vec::new(), Vec::new());
    for (plan, step) in plans.iter().zip(&episode.steps) {
        let instant = instants[before];
        let ade =
            |plan: &Plan| plan_ade_m(plan, &pose(instant), instant.time_s, driven.as_ref().ok()?);
        ade_m.push(plan.as_ref().and_then(ade));
        ttc_s.push(
            plan.as_ref()
                .and_then(|plan| plan_ttc_s(episode, instant, plan)),
        );
        before += step.instants.len();
    }
    Answers {
        name: source.display().to_string(),
        plans,
        ade_m,
        ttc_s,
    }
}

/// The time to collision at `instant` if the ego took the plan's mean velocity over its first
/// second.
fn plan_ttc_s(episode: &Episode, instant: &EpisodeTick, plan: &Plan) -> Option<f64> {
    let velocity = instant.ego.to_world(plan.at(1.0)) - instant.ego.position_m;
    let ego = OrientedBox::for_vehicle(&instant.ego, &episode.head.scenario.ego.size);
    let agents = instant.agents.iter().zip(&episode.head.agent_sizes);
    let times = agents.filter_map(|(state, size)| {
        let state = state.as_ref()?;
        time_to_collision(
            &ego,
            velocity,
            &OrientedBox::for_vehicle(state, size),
            state.velocity(),
            TTC_HORIZON_S,
        )
    });
    times.min_by(f64::total_cmp)
}

/// Times at which two plans are compared, seconds: those of a nuScenes planner.
const COMPARED_S: [f64; 6] = [0.5, 1.0, 1.5, 2.0, 2.5, 3.0];

/// Mean distance of two plans from each other, meters.
fn difference_m(a: &Plan, b: &Plan) -> f64 {
    COMPARED_S
        .iter()
        .map(|&time_s| a.at(time_s).distance(b.at(time_s)))
        .sum::<f64>()
        / COMPARED_S.len() as f64
}

fn known(values: &[Option<f64>]) -> Vec<f64> {
    values.iter().flatten().copied().collect()
}

fn min_ttc_s(answers: &Answers) -> Option<f64> {
    known(&answers.ttc_s).into_iter().min_by(f64::total_cmp)
}

fn text(answers: &[&Answers; 2], differences_m: &[Option<f64>]) -> String {
    let mut text = format!(
        "{:<32} {:>6}  {:>22}  {:>9}\n",
        "images", "plans", "mADE, m", "minTTC, s"
    );
    for answers in answers {
        let ade_m = known(&answers.ade_m);
        let ttc_s = min_ttc_s(answers).map_or("-".into(), |ttc_s| format!("{ttc_s:.2}"));
        let plans = answers.plans.iter().flatten().count();
        text.push_str(&format!(
            "{:<32} {plans:>6}  {:>22}  {ttc_s:>9}\n",
            answers.name,
            spread(Moments::from_values(&ade_m).as_ref(), 3)
        ));
    }
    let mut known = known(differences_m);
    known.sort_by(f64::total_cmp);
    let last = known
        .last()
        .map_or("-".into(), |worst| format!("{worst:.3}"));
    let gap_m = mean_ade_m(answers[0]).zip(mean_ade_m(answers[1]));
    let gap_m = gap_m.map_or("-".into(), |(a, b)| format!("{:.3}", (a - b).abs()));
    let ttc = TtcGap::new(answers);
    text.insert_str(
        0,
        &format!(
            "plans differ by {} m (mean over {} frames), by at most {last} m; their mADE by {gap_m} m\n\
             times to collision differ by {:.2} s on average, and are shorter by up to {:.2} s, longer by up to {:.2} s (of {TTC_HORIZON_S:.0} s)\n",
            spread(Moments::from_values(&known).as_ref(), 3),
            known.len(),
            ttc.mean_s,
            ttc.shorter_s,
            ttc.longer_s,
        ),
    );
    text
}

fn mean_ade_m(answers: &Answers) -> Option<f64> {
    Moments::from_values(&known(&answers.ade_m)).map(|moments| moments.mean)
}

/// Differences of times to collision between plans for other images and those for the reference,
/// step by step.
///
/// A time that becomes longer is no gain: a planner that sees less may also miss what it brakes
/// for. It counts as a difference like one that becomes shorter.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct TtcGap {
    /// Mean of the differences without their signs, seconds.
    mean_s: f64,
    /// Largest difference to a shorter time, seconds.
    shorter_s: f64,
    /// Largest difference to a longer time, seconds.
    longer_s: f64,
}

impl TtcGap {
    /// Gap between the answers to a reference and to other images, over steps with both plans. No
    /// collision counts as one at the horizon.
    fn new(answers: &[&Answers; 2]) -> Self {
        let steps = 0..answers[0].plans.len().min(answers[1].plans.len());
        let both = steps.filter(|&step| answers.iter().all(|one| one.plans[step].is_some()));
        let time_s = |one: &Answers, step: usize| one.ttc_s[step].unwrap_or(TTC_HORIZON_S);
        let longer_s: Vec<f64> = both
            .map(|step| time_s(answers[1], step) - time_s(answers[0], step))
            .collect();
        let total_s: f64 = longer_s.iter().map(|longer_s| longer_s.abs()).sum();
        Self {
            mean_s: total_s / longer_s.len().max(1) as f64,
            shorter_s: longer_s
                .iter()
                .fold(0.0, |most, longer_s| most.max(-longer_s)),
            longer_s: longer_s.iter().copied().fold(0.0, f64::max),
        }
    }

    fn to_json(self) -> Value {
        json!({ "mean_s": self.mean_s, "shorter_s": self.shorter_s, "longer_s": self.longer_s })
    }
}

fn to_json(episode: &Episode, answers: &[&Answers; 2], differences_m: &[Option<f64>]) -> Value {
    let source = |answers: &Answers| {
        json!({
            "images": answers.name,
            "mean_ade_m": mean_ade_m(answers),
            "min_ttc_s": min_ttc_s(answers),
            "ade_m": answers.ade_m,
            "ttc_s": answers.ttc_s,
        })
    };
    json!({
        "scenario": episode.head.scenario.name,
        "reference": source(answers[0]),
        "other": source(answers[1]),
        "plan_difference_m": differences_m,
        "ttc_difference": TtcGap::new(answers).to_json(),
        "compared_at_s": COMPARED_S,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs::scene::PlanPoint;
    use glam::DVec2;

    #[test]
    fn a_planner_that_is_blind_has_a_gap_in_its_times_to_collision() {
        let answers = |ttc_s: [Option<f64>; 4]| Answers {
            name: "images".into(),
            plans: [true, true, true, false]
                .map(|is_there| is_there.then(straight))
                .to_vec(),
            ade_m: vec![None; 4],
            ttc_s: ttc_s.to_vec(),
        };
        let seeing = answers([Some(2.0), Some(3.0), None, Some(1.0)]);
        // It no longer brakes for what is there, and for nothing instead.
        let blind = answers([None, Some(2.5), None, None]);
        let gap = TtcGap::new(&[&seeing, &blind]);
        let longer_s = TTC_HORIZON_S - 2.0;
        assert_eq!((gap.shorter_s, gap.longer_s), (0.5, longer_s));
        assert!((gap.mean_s - (longer_s + 0.5) / 3.0).abs() < 1e-12);
        assert_eq!(TtcGap::new(&[&seeing, &seeing]), TtcGap::default());
        let text = text(&[&seeing, &blind], &[]);
        assert!(text.starts_with("plans differ by"), "{text}");
    }

    fn straight() -> Plan {
        let point = PlanPoint {
            time_s: 1.0,
            position_m: DVec2::new(8.0, 0.0),
        };
        Plan::new(vec![point]).unwrap()
    }

    #[test]
    fn plans_differ_by_what_is_between_them() {
        let plan = |y: f64| {
            let point = |step: i32| PlanPoint {
                time_s: f64::from(step),
                position_m: DVec2::new(5.0 * f64::from(step), y),
            };
            Plan::new((1..=4).map(point).collect()).unwrap()
        };
        assert_eq!(difference_m(&plan(0.0), &plan(0.0)), 0.0);
        // From the ego's place to a meter aside at the first second, and a meter aside from there
        // on.
        assert!((difference_m(&plan(0.0), &plan(1.0)) - 5.5 / 6.0).abs() < 1e-12);
    }
}
