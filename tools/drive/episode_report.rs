//! Scores of episodes as text, JSON and one HTML page.

mod birds_eye;
mod charts;
mod commanded;
mod comparison;
mod devices;
mod egos;
mod hd_score;
mod page;
mod rules;
mod scored;
mod timing;

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use decouplegs::asset::write_atomically;
use decouplegs::drive::score::{
    EpisodeScore, Infraction, InfractionKind, Moments, SetSummary, Summary,
};
use decouplegs::explain::one_line;
use decouplegs::scene::Level;
use decouplegs::scene::episode::EpisodeEnd;
use serde_json::{Value, json};

use crate::sites::Sites;

pub use comparison::compare;
pub use devices::DeviceUse;
pub use hd_score::{HdScores, Hugsim};
pub use scored::{Scored, WayPoint};

/// Folder in which `drive` keeps the images of the episode with the log `log`.
pub fn images_beside(log: &Path) -> PathBuf {
    let root = log.parent().and_then(Path::parent).unwrap_or(Path::new(""));
    root.join("images")
        .join(log.file_stem().unwrap_or_default())
}

/// Sums up, and refuses sums that cannot be: they would be a fault of the scoring.
pub fn summary(scored: &[Scored]) -> Result<Summary> {
    let scores: Vec<EpisodeScore> = scored.iter().map(|scored| scored.score.clone()).collect();
    let summary = Summary::from_scores(&scores);
    summary
        .check()
        .map_err(anyhow::Error::msg)
        .context("the scores contradict each other")?;
    Ok(summary)
}

/// The figures of each level, from easy to extreme, and of all where there are several.
pub fn rows(summary: &Summary) -> Vec<(&'static str, SetSummary)> {
    let mut rows: Vec<_> = summary
        .levels
        .iter()
        .map(|(level, set)| (level.map_or("own", Level::name), *set))
        .collect();
    if rows.len() > 1 {
        rows.extend(summary.all.map(|all| ("all", all)));
    }
    rows
}

/// Mean of a figure that is never below zero and its 95 % confidence interval, or a dash where
/// there is none.
pub fn spread(moments: Option<&Moments>, digits: usize) -> String {
    let within = |moments: &Moments| {
        let interval = moments.interval().map(|[low, high]| [low.max(0.0), high]);
        with_interval(moments.mean, interval, digits)
    };
    moments.map_or("-".into(), within)
}

/// Mean of a score from 0 to 1 and its 95 % confidence interval.
pub fn score(moments: &Moments) -> String {
    let interval = moments.interval();
    let interval = interval.map(|ends| ends.map(|end| end.clamp(0.0, 1.0)));
    with_interval(moments.mean, interval, 3)
}

/// Share of episodes and its 95 % confidence interval.
pub fn share(moments: &Moments) -> String {
    with_interval(moments.mean, Some(moments.share_interval()), 2)
}

fn with_interval(mean: f64, interval: Option<[f64; 2]>, digits: usize) -> String {
    match interval {
        None => format!("{mean:.digits$}"),
        Some([low, high]) => format!("{mean:.digits$} [{low:.digits$}, {high:.digits$}]"),
    }
}

/// The table of the paper, a line a level.
pub fn text(scored: &[Scored]) -> Result<String> {
    let mut text = format!(
        "means with their 95 % confidence intervals; DS: driving score, SR: success rate, RC: route completion, minTTC: least time to collision\n{:<8} {:>8}  {:>20}  {:>17}  {:>20}  {:>18}  {:>10} {:>8} {:>8} {:>8} {:>9} {:>9}\n",
        "level",
        "episodes",
        "DS",
        "SR",
        "RC",
        "minTTC, s",
        "collisions",
        "at fault",
        "static",
        "off-road",
        "wrong way",
        "red/stop"
    );
    for (level, set) in rows(&summary(scored)?) {
        text.push_str(&format!(
            "{level:<8} {:>8}  {:>20}  {:>17}  {:>20}  {:>18}  {:>10} {:>8} {:>8} {:>8} {:>9} {:>9}\n",
            set.count(),
            score(&set.driving_score),
            share(&set.success),
            score(&set.route_completion),
            spread(set.min_ttc_s.as_ref(), 2),
            set.collisions,
            set.collisions_at_fault,
            set.obstacle_collisions,
            set.layout_infractions,
            set.wrong_ways,
            format!("{}/{}", set.red_lights, set.stop_signs),
        ));
    }
    let all = rows(&summary(scored)?).into_iter().last();
    if let Some((_, set)) = all.filter(|(_, set)| set.unavoidable_collisions > 0) {
        text.push_str(&format!(
            "{} of {} collisions could not be avoided by braking\n",
            set.unavoidable_collisions, set.collisions
        ));
    }
    text.push_str(&rules::text(scored));
    text.push_str(&egos::text(scored));
    Ok(text)
}

/// Writes report.json and report.html to `out`, with the use of `devices` that were named. The text
/// of the table.
pub fn write(
    scored: &[Scored],
    sites: &Sites,
    devices: Option<&DeviceUse>,
    out: &Path,
) -> Result<String> {
    std::fs::create_dir_all(out).with_context(|| format!("{} cannot be made", out.display()))?;
    let (json, html) = (out.join("report.json"), out.join("report.html"));
    let mut report = to_json(scored)?;
    if let Some(devices) = devices {
        let by_episode = devices.by_episode();
        for (episode, scored) in report["episodes"]
            .as_array_mut()
            .into_iter()
            .flatten()
            .zip(scored)
        {
            // Null if no line says so: the run was killed between the log and the line.
            let device = by_episode.get(scored.scenario_name()).copied().cloned();
            episode["device"] = device.unwrap_or_default();
        }
        report["device_use"] = devices.to_json(scored);
    }
    write_atomically(&json, |file| writeln!(file, "{report:#}"))?;
    let page = page::page(scored, sites, devices, out)?;
    write_atomically(&html, |file| file.write_all(page.as_bytes()))?;
    let mut text = text(scored)?;
    text.push_str(&timing::text(scored));
    text.push_str(&commanded::text(scored));
    text.push_str(&devices.map_or(String::new(), |devices| devices.text(scored)));
    text.push_str(&unseen(scored));
    text.push_str(&failed_planners(scored));
    text.push_str(&format!("{}\n{}\n", json.display(), html.display()));
    Ok(text)
}

/// Episodes with a warning about what was seen that are named on the console.
const UNSEEN_SHOWN_MAX: usize = 3;

/// Number of episodes that show a captured place badly, and the first of them.
fn unseen(scored: &[Scored]) -> String {
    let warned = scored
        .iter()
        .map(|scored| (scored.name(), scored.seen.warnings()))
        .filter(|(_, warnings)| !warnings.is_empty());
    let warned: Vec<_> = warned.collect();
    if warned.is_empty() {
        return String::new();
    }
    let mut text = format!(
        "the place is shown badly in {} of {} episodes, whose scores say little:\n",
        warned.len(),
        scored.len()
    );
    for (name, warnings) in warned.iter().take(UNSEEN_SHOWN_MAX) {
        text.push_str(&format!("  {name}: {}\n", warnings.join("; ")));
    }
    text
}

/// Episodes whose planner failed that are named on the console.
const FAILED_SHOWN_MAX: usize = 3;

/// A line for each of the first episodes that ended because the planner failed, and how many there
/// are.
fn failed_planners(scored: &[Scored]) -> String {
    let failed: Vec<&Scored> = scored
        .iter()
        .filter(|scored| matches!(scored.end, EpisodeEnd::Planner { .. }))
        .collect();
    if failed.is_empty() {
        return String::new();
    }
    let mut text = format!(
        "the planner failed in {} of {} episodes:\n",
        failed.len(),
        scored.len()
    );
    for scored in failed.iter().take(FAILED_SHOWN_MAX) {
        text.push_str(&format!(
            "  {}: {}\n",
            scored.name(),
            one_line(&scored.ending())
        ));
    }
    text
}

fn to_json(scored: &[Scored]) -> Result<Value> {
    let levels: serde_json::Map<String, Value> = rows(&summary(scored)?)
        .iter()
        .map(|(name, set)| ((*name).to_owned(), set_to_json(set)))
        .collect();
    let planner = scored.first().map(|scored| &scored.head.planner);
    let drawn_by = scored
        .first()
        .and_then(|scored| scored.head.drawn_by.as_ref());
    Ok(json!({
        "planner": planner.map(|planner| json!({
            "name": planner.name, "cameras": planner.cameras,
            "localization": planner.localization, "privileged": planner.privileged,
        })),
        "drawn_by": drawn_by.map(|by| json!({
            "device": by.device, "width_px": by.width_px, "height_px": by.height_px, "every": by.every,
        })),
        "levels": levels,
        "episodes": scored.iter().map(episode_to_json).collect::<Vec<_>>(),
        "times": timing::to_json(scored),
    }))
}

fn set_to_json(set: &SetSummary) -> Value {
    let moments = |moments: &Moments| {
        json!({
            "n": moments.count, "mean": moments.mean, "std": moments.std, "interval_95": moments.interval(),
        })
    };
    json!({
        "episodes": set.count(),
        "driving_score": moments(&set.driving_score),
        "success_rate": json!({
            "n": set.success.count, "mean": set.success.mean, "std": set.success.std,
            "interval_95": set.success.share_interval(),
        }),
        "route_completion": moments(&set.route_completion),
        "min_ttc_s": set.min_ttc_s.as_ref().map(moments),
        "plan_ade_m": set.plan_ade_m.as_ref().map(moments),
        "ttc_short_share": moments(&set.ttc_short_share),
        "collisions": set.collisions,
        "collisions_at_fault": set.collisions_at_fault,
        "unavoidable_collisions": set.unavoidable_collisions,
        "pedestrian_collisions": set.pedestrian_collisions,
        "obstacle_collisions": set.obstacle_collisions,
        "layout_infractions": set.layout_infractions,
        "wrong_ways": set.wrong_ways,
        "ended_by_others": set.ended_by_others,
        "counted_completion": moments(&set.counted_completion),
        "red_lights": set.red_lights,
        "stop_signs": set.stop_signs,
    })
}

fn time_lost_to_json(scored: &Scored) -> Value {
    let lost = &scored.score.time_lost;
    let name = |agent: usize| scored.head.scenario.agent(agent).0.to_owned();
    let behind = lost.behind_s.iter();
    let behind: serde_json::Map<String, Value> = behind
        .map(|(&agent, &behind_s)| (name(agent), json!(behind_s)))
        .collect();
    json!({
        "red_light_s": lost.light_s,
        "behind_s": behind,
        "yielding_s": lost.yielding_s,
        "other_s": lost.other_s,
        "sum_s": lost.sum_s(),
    })
}

fn episode_to_json(scored: &Scored) -> Value {
    let score = &scored.score;
    let scenario = &scored.head.scenario;
    let place_m = |infraction: &Infraction| scored.place_m(infraction.time_s).to_array();
    let infraction = |infraction: &Infraction| match infraction.kind {
        InfractionKind::Collision {
            agent,
            user,
            fault,
            is_avoidable,
        } => json!({
            "time_s": infraction.time_s, "place_m": place_m(infraction), "kind": "collision", "agent": scenario.agent(agent).0, "road_user": user.name(),
            "at_fault": fault.at_fault(), "why": fault.why(), "avoidable": is_avoidable,
        }),
        InfractionKind::Obstacle { kind } => json!({
            "time_s": infraction.time_s, "place_m": place_m(infraction), "kind": "obstacle", "object": kind.name(), "at_fault": true,
        }),
        InfractionKind::Layout => {
            json!({ "time_s": infraction.time_s, "place_m": place_m(infraction), "kind": "off_road", "at_fault": true })
        }
        InfractionKind::WrongWay { is_far } => json!({
            "time_s": infraction.time_s, "place_m": place_m(infraction), "kind": "wrong_way", "at_fault": true, "far": is_far,
        }),
        InfractionKind::StopSign { sign } => json!({
            "time_s": infraction.time_s, "place_m": place_m(infraction), "kind": "stop_sign", "at_fault": true, "sign": sign,
        }),
        InfractionKind::RedLight { light } => json!({
            "time_s": infraction.time_s, "place_m": place_m(infraction), "kind": "red_light", "at_fault": true,
            "light": scenario.lights[light].name,
        }),
    };
    let mut episode = json!({
        "name": scored.name(),
        "level": scored.level().map(Level::name),
        "ending": scored.ending(),
        "driving_score": score.driving_score,
        "route_completion": score.route_completion,
        "counted_completion": score.counted_completion,
        "success": score.success,
        "min_ttc_s": score.min_ttc_s(),
        "ttc_short_share": score.ttc_short_share,
        "plan_ade_m": score.plan_ade_m,
        "warm_up_s": score.warm_up_s,
        "time_lost": time_lost_to_json(scored),
        "pdm_score": scored.pdm.pdm_score,
        "pdm_terms": json!({
            "nc": scored.pdm.no_collision, "dac": scored.pdm.drivable_area, "ep": scored.pdm.progress,
            "ttc": scored.pdm.time_to_collision, "c": scored.pdm.comfort,
        }),
        "extended_pdm": rules::extended_pdm_to_json(&scored.extended_pdm),
        "rules": rules::to_json(scored),
        "speed_compliance": score.speed_compliance,
        "braking_max_mps2": score.comfort.braking_max_mps2,
        "lateral_acceleration_max_mps2": score.comfort.lateral_acceleration_max_mps2,
        "infractions": score.infractions.iter().map(infraction).collect::<Vec<_>>(),
        "log": scored.log.display().to_string(),
    });
    if scenario.egos.count() > 1 {
        episode["ego"] = scenario.egos.own.name.clone().into();
        episode["planner"] = scored.head.planner.name.clone().into();
    }
    if let Some(commanded) = &scored.commanded {
        episode["agents"] = commanded::to_json(commanded, scenario);
    }
    if !scored.seen.steps.is_empty() {
        let (left, least) = (scored.seen.left(), scored.seen.least_opacity());
        episode["seen"] = json!({
            "left_at_s": left.map(|(from_s, _)| from_s),
            "left_share": left.map_or(0.0, |(_, share)| share),
            "least_opacity": least.map(|(opacity, ..)| opacity),
            "warnings": scored.seen.warnings(),
        });
    }
    episode
}
