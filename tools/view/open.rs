//! Scenes, logs and scenarios, as named on the command line.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, bail, ensure};
use clap::Parser;
use decouplegs::asset::{SplatFormat, is_scene_file};
use decouplegs::episode::{Appearance, Site};
use decouplegs::logs::{read_episode_log, read_scenario};
use decouplegs::planner::{DrivingStyle, PlannerChoice};
use decouplegs::scene::Scenario;
use decouplegs::scene::episode::Episode;
use decouplegs::session::Session;
use decouplegs_alpasim::egodriver::DriverOptions;
use decouplegs_alpasim::planner_name::PlannerName;
use decouplegs_cli::arguments::transfer_in;
use decouplegs_cli::progress;
use decouplegs_cli::scene_source::{DrawInput, SceneOptions};

use crate::demo::demo;
use crate::played::Played;
use crate::render_command::RenderOptions;
use crate::scenario_edits::{LivePlanner, Place, ScenarioEditor};
use crate::scene_course::SceneCourse;
use crate::source::Source;

/// Scene or episode that is shown, and the one to compare it with.
#[derive(clap::Args)]
pub struct SourceArguments {
    #[arg(value_name = "FILE", help = format!("Splats ({}), a scene (.toml, .usdz), the log of an episode (.log) or a scenario (.toml); without it the demo scene, which is made if absent", SplatFormat::EXTENSIONS))]
    file: Option<PathBuf>,
    #[command(flatten)]
    options: SceneOptions,
    /// Planner that drives a scenario while you watch, as in 'decouplegs drive' [default:
    /// lane-follow]
    #[arg(long, value_name = "PLANNER")]
    planner: Option<PlannerName>,
    /// Compare with this: another scene, another log, or a planner that drives the same scenario
    #[arg(long, value_name = "FILE|PLANNER")]
    against: Option<String>,
    /// Lanes of a scene, to show and to snap agents to that are moved [default: lanes.json beside
    /// the scene]
    #[arg(long, value_name = "FILE")]
    map: Option<PathBuf>,
    /// Folder that the files of a log or a scenario are relative to [default: its own]
    #[arg(long, value_name = "DIR")]
    base: Option<PathBuf>,
    /// Ego that is followed, by its name, where the log has several [default: the first]
    #[arg(long, value_name = "EGO")]
    ego: Option<String>,
    /// Light transfer for the cars of a log or a scenario, as given to 'drive'
    #[arg(long, value_name = "FILE")]
    light: Option<PathBuf>,
    #[command(flatten)]
    driver: DriverOptions,
}

/// Options of a scene where none is given.
#[derive(clap::Parser)]
struct NoOptions {
    #[command(flatten)]
    options: SceneOptions,
}

/// Opens the splats at `path`, which a page sent as `name`, as if they were named on the command
/// line without options.
///
/// # Errors
/// Returns an error if the file is at fault, or the device has not the memory.
pub fn dropped(path: &Path, name: &str, session: &Session) -> Result<Source> {
    let none = NoOptions::try_parse_from(["view"])?;
    let input = DrawInput::with_options(path, &none.options)?;
    let course = SceneCourse::dropped(input, name);
    Ok(Source::of_scene(course, name.to_owned(), session)?)
}

/// Kind of a file that can be shown.
enum Input {
    Scene,
    Log(Box<Episode>),
    Scenario(Box<Scenario>),
}

/// Reads `path` as far as its kind must be known.
fn input(path: &Path) -> Result<Input> {
    if path.extension().is_some_and(|extension| extension == "log") {
        return Ok(Input::Log(Box::new(read_episode_log(path)?)));
    }
    if is_scene_file(path) {
        // Both are TOML: a scenario has a place, which no scene has.
        let text = std::fs::read_to_string(path).unwrap_or_default();
        let has_place = text.lines().any(|line| line.trim().starts_with("[place"));
        if has_place {
            return Ok(Input::Scenario(Box::new(read_scenario(path)?)));
        }
    }
    Ok(Input::Scene)
}

impl SourceArguments {
    /// Options of scenes that `render` needs too, with the other `words` that it needs.
    pub fn render_options(&self, words: Vec<String>) -> RenderOptions {
        RenderOptions {
            words,
            rules: self.options.rules_words(),
            cameras: self.options.cameras_words(),
        }
    }

    /// File that is shown, if one is named.
    pub fn file(&self) -> Option<&Path> {
        self.file.as_deref()
    }

    /// Opens all that is shown: the demo scene where no file is named.
    ///
    /// # Errors
    /// Returns an error if a file is at fault, or the device has not the memory.
    pub fn open(&self, session: &Session) -> Result<Vec<Source>> {
        let path = match &self.file {
            Some(path) => path.clone(),
            None => demo()?,
        };
        let opened = input(&path)?;
        ensure!(
            self.ego.is_none() || matches!(opened, Input::Log(_)),
            "{}: --ego names an ego of a log (.log)",
            path.display()
        );
        let mut sources = match opened {
            Input::Scene => self.scenes(&path, session)?,
            Input::Log(episode) => {
                let episode = Box::new(self.followed(*episode)?);
                self.episodes(&path, &Start::Log(episode), session)?
            }
            Input::Scenario(scenario) => {
                let planner = self.planner.clone();
                let planner = planner.unwrap_or(PlannerName::Engine(PlannerChoice::LaneFollow(
                    DrivingStyle::Normal,
                )));
                self.episodes(&path, &Start::Live(scenario, planner), session)?
            }
        };
        if let Some(time_s) = self.time_s() {
            begin_at(&mut sources, time_s, &path)?;
        }
        Ok(sources)
    }

    /// A log with the ego that is followed in the place of the first.
    fn followed(&self, episode: Episode) -> Result<Episode> {
        match &self.ego {
            Some(name) => Ok(episode.with_first_named(name)?),
            None => Ok(episode),
        }
    }

    /// Time that is shown first, seconds, if one was given.
    pub fn time_s(&self) -> Option<f64> {
        self.options.time_s()
    }

    /// `planner`, with the options for drivers.
    fn live(&self, planner: PlannerName) -> LivePlanner {
        LivePlanner {
            name: planner,
            driver: self.driver.clone(),
        }
    }

    fn scenes(&self, path: &Path, session: &Session) -> Result<Vec<Source>> {
        let shown = path.display();
        ensure!(
            self.planner.is_none() && self.base.is_none() && self.light.is_none(),
            "{shown}: --planner, --base and --light are for scenarios and logs. 'decouplegs drive' generates scenarios in a scene"
        );
        let open = |path: &Path| -> Result<Source> {
            let input = DrawInput::with_options(path, &self.options)?;
            input.warn_of_shapes();
            let copying = progress::spinner(format!("copying {} to the device", path.display()));
            let course = SceneCourse::new(input, path, self.map.as_deref())?;
            let source = Source::of_scene(course, path.display().to_string(), session)?;
            copying.finish_and_clear();
            Ok(source)
        };
        let mut sources = vec![open(path)?];
        if let Some(against) = &self.against {
            let other = Path::new(against);
            match input(other)? {
                Input::Scene => sources.push(open(other)?),
                _ => bail!("--against {against}: a scene is compared with a scene"),
            }
        }
        Ok(sources)
    }

    fn episodes(&self, path: &Path, start: &Start, session: &Session) -> Result<Vec<Source>> {
        ensure!(
            !self.options.are_of_scenes() && self.map.is_none(),
            "{}: an episode has its own cameras, lanes and rules: leave out the options of scenes",
            path.display()
        );
        let is_log = matches!(start, Start::Log(_));
        ensure!(
            !is_log || self.options.size_px().is_none() && self.planner.is_none(),
            "{}: a log has its own size and planner: leave out --size, and give a planner to compare with by --against",
            path.display()
        );
        let scenario = start.scenario();
        let against = self.against.as_deref();
        let against_log = against.filter(|against| against.ends_with(".log"));
        let against_log = against_log
            .map(|file| {
                let log = self.followed(read_episode_log(Path::new(file))?)?;
                anyhow::Ok((Path::new(file), log))
            })
            .transpose()?;
        let others = against_log.iter().map(|(_, other)| &other.head.scenario);
        let appearance = Appearance {
            transfer: transfer_in(self.light.as_deref())?,
            only_cars: others
                .chain([scenario])
                .all(|scenario| scenario.has_only_cars()),
        };
        let place_of = |path: &Path, scenario: &Scenario| -> Result<Place> {
            let base = self.base.as_deref().or(path.parent());
            let opening = progress::spinner(format!("opening the place of {}", path.display()));
            let site = Site::open(
                &scenario.place,
                base.unwrap_or(Path::new("")),
                Some(&appearance),
            );
            let site = Arc::new(site.context("the place of the episode is not usable")?);
            let scene = site.add_to(session)?;
            opening.finish_and_clear();
            Ok(Place { site, scene })
        };
        let place = place_of(path, scenario)?;
        let seen_px = self.options.size_px();
        let mut sources = vec![match start {
            Start::Log(episode) => logged(&place, path, episode)?,
            Start::Live(scenario, planner) => {
                let (scenario, planner) = ((**scenario).clone(), self.live(planner.clone()));
                let edited = ScenarioEditor::new(path, place.clone(), scenario, planner, seen_px);
                Source::of_live(edited, session)?
            }
        }];
        let Some(against) = against else {
            return Ok(sources);
        };
        if let Some((other, episode)) = &against_log {
            // One place is on the device once.
            let place = match episode.head.scenario.place == scenario.place {
                true => place,
                false => place_of(other, &episode.head.scenario)?,
            };
            sources.push(logged(&place, other, episode)?);
        } else {
            let planner: PlannerName = against.parse().map_err(|error: String| {
                anyhow::anyhow!(
                    "--against {against}: neither the name of a log (.log) nor a planner: {error}"
                )
            })?;
            let logged_px = match start {
                Start::Log(episode) => episode.head.drawn_by.as_ref(),
                Start::Live(..) => None,
            };
            let logged_px = logged_px.map(|by| [by.width_px, by.height_px]);
            let seen_px = seen_px.or(logged_px);
            let scenario = scenario.clone();
            let planner = self.live(planner);
            let edited = ScenarioEditor::new(path, place, scenario, planner, seen_px);
            sources.push(Source::of_live(edited, session)?);
            if is_log {
                drive_to_the_end(&mut sources[1])?;
            }
        }
        Ok(sources)
    }
}

/// Scenario, and how it is driven.
enum Start {
    Log(Box<Episode>),
    Live(Box<Scenario>, PlannerName),
}

impl Start {
    fn scenario(&self) -> &Scenario {
        match self {
            Self::Log(episode) => &episode.head.scenario,
            Self::Live(scenario, _) => scenario,
        }
    }
}

fn logged(place: &Place, path: &Path, episode: &Episode) -> Result<Source> {
    let played = Played::logged(episode.clone(), place.site.clone(), &place.scene)?;
    let title = path.display().to_string();
    Ok(Source::of_log(played, title, place.scene.clone()))
}

/// Difference of times that counts as none, seconds: reports round them.
const SAME_S: f64 = 1e-4;

/// Shows `time_s` first: episodes that are driven here are driven until then.
fn begin_at(sources: &mut [Source], time_s: f64, path: &Path) -> Result<()> {
    let shown = path.display();
    for source in sources.iter_mut() {
        drive_until(source, time_s)?;
        source.set_time(time_s);
    }
    let spans = sources.iter().map(Source::span_s);
    let [begin_s, end_s] = spans.fold([f64::MAX, f64::MIN], |[begin_s, end_s], span_s| {
        [begin_s.min(span_s[0]), end_s.max(span_s[1])]
    });
    // Agents of plain splats, which have no time line here, stand where they are at this time.
    let is_scene = is_scene_file(path) || path.extension().is_some_and(|it| it == "usdz");
    ensure!(
        is_scene || end_s > begin_s || sources.iter().any(|source| source.episode().is_some()),
        "{shown}: splats have no time: leave out --time"
    );
    ensure!(
        (begin_s - SAME_S..=end_s + SAME_S).contains(&time_s),
        "--time {time_s}: {shown} has {begin_s:.1} to {end_s:.1} s: give a time between them, or leave it out"
    );
    Ok(())
}

/// Drives an episode that is driven here until it ends. A scene, and a log, are as they are.
///
/// # Errors
/// Returns an error if a step cannot be driven.
pub fn drive_to_the_end(source: &mut Source) -> Result<()> {
    drive_until(source, f64::INFINITY)
}

/// Drives an episode that is driven here until it has reached `time_s`, or ends.
fn drive_until(source: &mut Source, time_s: f64) -> Result<()> {
    let steps = source.episode().map_or(0, |played| {
        let scenario = &played.episode().head.scenario;
        (time_s.min(scenario.duration_s) / scenario.step_s).ceil() as usize
    });
    let bar = progress::bar("steps", steps);
    while source.goes_on() && source.span_s()[1] < time_s {
        source.drive_on().map_err(anyhow::Error::msg)?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(())
}
