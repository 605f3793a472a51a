//! Generated scenarios of a run.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context, Result, bail};
use decouplegs::drive::generate::{Difficulty, Generator};
use decouplegs::episode::Site;
use decouplegs::logs::write_scenario;
use decouplegs::scene::Level;
use decouplegs::winnable::is_winnable;
use rayon::prelude::*;

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
        let mut scenario = generator.scenario(level, arguments.seed, index)?;
        scenario = stepped(scenario, arguments);
        let mut replacement = 0;
        while arguments.winnable && !is_winnable(&scenario, &site)? {
            replacement += 1;
            if replacement > REPLACEMENTS {
                bail!(
                    "{}: lane-follow won none of {replacement} scenarios with a tenth of the time to spare: try an easier level of --time-budget or --density",
                    scenario.name
                );
            }
            let other = generator.scenario_instead(level, arguments.seed, index, replacement)?;
            scenario = stepped(other, arguments);
        }
        replaced.fetch_add(usize::from(replacement > 0), Ordering::Relaxed);
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
    let jobs = places.par_iter().map(job).collect();
    bar.finish_and_clear();
    let replaced = replaced.into_inner();
    if replaced > 0 {
        warn(&format!(
            "{replaced} of {} scenarios were replaced, as lane-follow did not win them",
            places.len()
        ));
    }
    jobs
}
