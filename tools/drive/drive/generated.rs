//! Generated scenarios of a run.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context, Result, bail};
use decouplegs::drive::generate::{Difficulty, Generator};
use decouplegs::episode::Site;
use decouplegs::logs::write_scenario;
use decouplegs::scene::{Level, Scenario};
use decouplegs::winnable::is_winnable;
use rayon::prelude::*;

use super::difficulty;
use super::folder::RunFolder;
use super::jobs::{Job, stepped};
use super::{Arguments, RoadUsers, TrafficLights};
use crate::arguments::warn;
use crate::progress;

/// Scenarios that are tried in the place of one that cannot be won, at most.
const REPLACEMENTS: u32 = 30;

/// Scenarios for the levels that `arguments` name, each in a file of `folder`.
pub fn generated(arguments: &Arguments, folder: &RunFolder) -> Result<Vec<Job>> {
    let site = Site::open(&arguments.place.bare(), Path::new(""), None)
        .map(Arc::new)
        .context("no scenarios can be generated here")?;
    let options = arguments
        .place
        .options(arguments.place.background(&site, arguments.render.0 > 0))?;
    let mut generator = Generator::new(&site.lanes, options, &site.asset_sizes)?;
    match site.view_support() {
        Some(support) => generator = generator.seen_from(support.clone()),
        None => {
            if let Some(area) = arguments.place.seen(&site) {
                generator = generator.within(area);
            }
        }
    }
    if arguments.traffic_lights == TrafficLights::Off {
        generator = generator.without_lights();
    }
    if arguments.road_users == RoadUsers::Mixed {
        generator = generator.with_road_users(&site.road_users, site.obstacles.clone())?;
    }
    let generator = generator.with_difficulty(Difficulty {
        density: arguments.density,
        surprise: arguments.surprise,
        time: arguments.time_budget,
    });
    let levels = arguments.levels();
    let bar = progress::bar("scenarios", levels.len() * arguments.episodes as usize);
    let places = levels
        .into_iter()
        .flat_map(|level| (0..arguments.episodes).map(move |index| (level, index)));
    let places: Vec<(Level, u32)> = places.collect();
    let replaced = AtomicUsize::new(0);
    // Each follows from its own number.
    let job = |&(level, index): &(Level, u32)| {
        let (scenario, is_replaced) = chosen(arguments, &generator, &site, (level, index))?;
        replaced.fetch_add(usize::from(is_replaced), Ordering::Relaxed);
        let path = folder.scenario(&scenario.name);
        if !path.exists() {
            write_scenario(&path, &scenario)?;
        }
        bar.inc(1);
        Ok(Job {
            scenario,
            directory: PathBuf::new(),
            lost: None,
        })
    };
    let jobs: Vec<Job> = places.par_iter().map(job).collect::<Result<_>>()?;
    bar.finish_and_clear();
    let replaced = replaced.into_inner();
    if replaced > 0 {
        warn(&format!(
            "{replaced} of {} scenarios were replaced, as lane-follow did not win them",
            places.len()
        ));
    }
    if arguments.winnable {
        difficulty::tell(&jobs, &site, folder)?;
    }
    Ok(jobs)
}

/// Scenario `index` of `level`, and whether it stands in the place of one that cannot be won.
fn chosen(
    arguments: &Arguments,
    generator: &Generator<'_>,
    site: &Arc<Site>,
    (level, index): (Level, u32),
) -> Result<(Scenario, bool)> {
    for replacement in 0..=REPLACEMENTS {
        let scenario = generator.scenario_instead(level, arguments.seed, index, replacement)?;
        let scenario = match arguments.egos {
            Some(egos) => generator.with_egos(&scenario, egos.into())?,
            None => scenario,
        };
        let scenario = stepped(scenario, arguments);
        if !arguments.winnable || is_winnable(&scenario, site)? {
            return Ok((scenario, replacement > 0));
        }
    }
    bail!(
        "{}_{index:04}: lane-follow won none of {} scenarios with a tenth of the time to spare: try an easier level of --time-budget or --density",
        level.name(),
        REPLACEMENTS + 1
    )
}
