//! Difficulty of generated scenarios, as reference planners meet it.

use std::io::Write;
use std::sync::Arc;

use anyhow::Result;
use decouplegs::asset::write_atomically;
use decouplegs::episode::Site;
use decouplegs::planner::DrivingStyle;
use decouplegs::scene::Level;
use decouplegs::winnable::{MET_S, MeasuredDifficulty};
use rayon::prelude::*;
use serde_json::{Map, Value, json};

use super::folder::RunFolder;
use super::jobs::Job;
use crate::arguments::print;
use crate::progress;

/// Measures the scenarios of `jobs`, prints a line for each level, and writes `difficulty.json`.
pub fn tell(jobs: &[Job], site: &Arc<Site>, folder: &RunFolder) -> Result<()> {
    let bar = progress::bar("difficulties", jobs.len());
    let measured = jobs.par_iter().map(|job| {
        let measured = MeasuredDifficulty::new(&job.scenario, site);
        bar.inc(1);
        measured
    });
    let measured: Vec<MeasuredDifficulty> = measured.collect::<Result<_, _>>()?;
    bar.finish_and_clear();
    let named = jobs.iter().zip(&measured);
    let named = named.map(|(job, measured)| (job.scenario.name.clone(), to_json(measured)));
    let all = Value::Object(named.collect::<Map<_, _>>());
    write_atomically(&folder.difficulty(), |file| writeln!(file, "{all:#}"))?;
    print(&text(jobs, &measured))
}

fn to_json(measured: &MeasuredDifficulty) -> Value {
    let names = DrivingStyle::ALL
        .iter()
        .map(|style| style.name().to_owned());
    let won = names.zip(measured.won.map(Value::Bool));
    json!({
        "won": won.collect::<Map<_, _>>(),
        "lost_share": measured.lost_share(),
        "reaction_s": measured.reaction_s,
        "interactions": measured.interactions,
    })
}

/// A table with a line for each level.
fn text(jobs: &[Job], measured: &[MeasuredDifficulty]) -> String {
    let mut text = format!(
        "difficulty, as reference planners met it: the share of {} that lose, the median of the least time to react, road users met within {MET_S:.0} s\n\
         level    scenarios  lost  react, s  met\n",
        DrivingStyle::ALL.map(DrivingStyle::name).join(", ")
    );
    for level in Level::ALL {
        let of_level = jobs.iter().zip(measured);
        let of_level = of_level.filter(|(job, _)| job.scenario.level == Some(level));
        let of_level: Vec<&MeasuredDifficulty> = of_level.map(|(_, measured)| measured).collect();
        if of_level.is_empty() {
            continue;
        }
        let mean = |value: fn(&MeasuredDifficulty) -> f64| {
            of_level.iter().map(|measured| value(measured)).sum::<f64>() / of_level.len() as f64
        };
        let mut reactions_s: Vec<f64> = of_level.iter().filter_map(|one| one.reaction_s).collect();
        reactions_s.sort_by(f64::total_cmp);
        let median = reactions_s.get(reactions_s.len() / 2);
        text.push_str(&format!(
            "{:<8} {:>9}  {:>4.2}  {:>8}  {:>3.1}\n",
            level.name(),
            of_level.len(),
            mean(MeasuredDifficulty::lost_share),
            median.map_or("-".into(), |reaction_s| format!("{reaction_s:.2}")),
            mean(|measured| measured.interactions),
        ));
    }
    text
}
