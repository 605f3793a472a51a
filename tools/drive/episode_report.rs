//! Scores of episodes as text, JSON and one HTML page.

mod birds_eye;
mod charts;
mod comparison;
mod devices;
mod hd_score;
mod page;
mod timing;

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use decouplegs::asset::write_atomically;
use decouplegs::drive::score::{
    EpisodeScore, Infraction, InfractionKind, Moments, PdmScore, SetSummary, Summary,
};
use decouplegs::episode::StepTime;
use decouplegs::explain::one_line;
use decouplegs::scene::Level;
use decouplegs::scene::episode::{Episode, EpisodeEnd};
use decouplegs::scene::scenario::Place;
use glam::DVec2;
use serde_json::{Value, json};

use crate::seen::Seen;
use crate::sites::Sites;

pub use comparison::compare;
pub use devices::DeviceUse;
pub use hd_score::{HdScores, Hugsim};

/// An episode and what it is worth.
pub struct Scored {
    pub episode: Episode,
    pub score: EpisodeScore,
    pub pdm: PdmScore,
    pub log: PathBuf,
    /// Folder of its images, if there are any.
    pub images: PathBuf,
    /// Record of what was seen of a captured place.
    pub seen: Seen,
    /// Times of its steps; none if it was driven before.
    pub times: Option<Vec<StepTime>>,
}

impl Scored {
    pub fn new(
        episode: Episode,
        log: PathBuf,
        images: PathBuf,
        times: Option<Vec<StepTime>>,
    ) -> Result<Self> {
        let score = EpisodeScore::new(&episode);
        Ok(Self {
            pdm: PdmScore::new(&episode, &score),
            score,
            seen: Seen::beside(&log)?,
            episode,
            log,
            images,
            times,
        })
    }

    pub fn name(&self) -> &str {
        &self.episode.head.scenario.name
    }

    /// The place, as it is where nothing is drawn: all weathers and sizes have the same lanes.
    pub fn place(&self) -> Place {
        match &self.episode.head.scenario.place {
            Place::Street { weather, seed, .. } => Place::Street {
                weather: *weather,
                background: 0,
                agent_splats: 0,
                seed: *seed,
            },
            place => place.clone(),
        }
    }

    /// True if the ego was at fault.
    pub fn at_fault(&self) -> bool {
        self.score.infractions.iter().any(Infraction::at_fault)
    }

    pub fn level(&self) -> Option<Level> {
        self.episode.head.scenario.level
    }

    /// Reason of its end, for people.
    pub fn ending(&self) -> String {
        let warm_up_s = self.score.warm_up_s;
        let how = self.how_it_ended();
        if warm_up_s > 0.0 {
            return format!("{how} (the planner had no plan yet for {warm_up_s:.1} s)");
        }
        how
    }

    fn how_it_ended(&self) -> String {
        match &self.episode.end {
            EpisodeEnd::RouteDone => "route done".into(),
            EpisodeEnd::Collision { agent } => {
                let name = self.episode.head.scenario.agent(*agent).0;
                let hit = |infraction: &Infraction| match infraction.kind {
                    InfractionKind::Collision {
                        agent: other,
                        fault,
                        ..
                    } if other == *agent => Some(fault.why()),
                    _ => None,
                };
                let why = self
                    .score
                    .infractions
                    .iter()
                    .find_map(hit)
                    .unwrap_or("nobody knows why");
                format!("collision with {name}: {why}")
            }
            EpisodeEnd::Obstacle { obstacle } => {
                format!("collision with a {}", obstacle.kind.name())
            }
            EpisodeEnd::OffRoad => "off the road for good".into(),
            EpisodeEnd::OffRoute => "too far from the route".into(),
            EpisodeEnd::Time => "time over".into(),
            EpisodeEnd::Planner { reason } => format!("planner failed: {reason}"),
        }
    }
}

impl Scored {
    /// Position of the ego at a time, or at the last moment before it, meters.
    pub fn place_m(&self, time_s: f64) -> DVec2 {
        let start = self.episode.start.ego.position_m;
        let before = self
            .episode
            .instants()
            .take_while(|instant| instant.time_s <= time_s + 1e-9);
        before
            .last()
            .map_or(start, |instant| instant.ego.position_m)
    }

    /// The PDM score as a product of its terms.
    pub fn pdm_explained(&self) -> String {
        let PdmScore {
            no_collision,
            drivable_area,
            progress,
            time_to_collision,
            comfort,
            pdm_score,
        } = self.pdm;
        format!(
            "PDMS {pdm_score:.3} = NC {no_collision:.1} × DAC {drivable_area:.0} × (5 EP {progress:.3} + 5 TTC {time_to_collision:.0} + 2 C {comfort:.0}) / 12"
        )
    }

    /// Time that was lost, by what; `None` where it is less than half a second.
    pub fn time_lost(&self) -> Option<String> {
        let lost = &self.score.time_lost;
        let mut parts = Vec::new();
        let mut add = |what: &str, lost_s: f64| {
            if lost_s >= 0.05 {
                parts.push(format!("{what} {lost_s:.1} s"));
            }
        };
        add("red light", lost.light_s);
        add("behind others", lost.behind_all_s());
        if let Some((agent, behind_s)) = lost.longest_behind() {
            let name = self.episode.head.scenario.agent(agent).0;
            add(&format!("of it behind {name}"), behind_s);
        }
        add("yielding", lost.yielding_s);
        add("other", lost.other_s);
        let sum_s = lost.sum_s();
        (sum_s >= 0.5).then(|| format!("{sum_s:.1} s lost: {}", parts.join(", ")))
    }

    /// The driving score as a product, each factor with its infraction and its moment.
    pub fn explained(&self) -> String {
        let factor = |infraction: &Infraction| {
            format!(
                " × {:.2} ({} at {:.1} s)",
                infraction.factor(),
                infraction.describe(&self.episode.head),
                infraction.time_s
            )
        };
        let factors: String = self.score.infractions.iter().map(factor).collect();
        let lost = match &self.episode.end {
            EpisodeEnd::RouteDone => "",
            EpisodeEnd::Time => " (time over)",
            EpisodeEnd::Collision { .. } if self.score.ended_by_other() => {
                " (counts as 1.000: ended by a collision that was not its fault)"
            }
            EpisodeEnd::Collision { .. } | EpisodeEnd::Obstacle { .. } => {
                " (ended by the collision)"
            }
            EpisodeEnd::OffRoad => " (off the road for good)",
            EpisodeEnd::OffRoute => " (too far from the route)",
            EpisodeEnd::Planner { .. } => " (the planner failed)",
        };
        format!(
            "DS {:.3} = RC {:.3}{lost}{factors}",
            self.score.driving_score, self.score.route_completion
        )
    }
}

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
        "means with their 95 % confidence intervals\n{:<8} {:>8}  {:>20}  {:>17}  {:>20}  {:>18}  {:>10} {:>8} {:>8} {:>8} {:>9} {:>9}\n",
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
            let device = by_episode.get(scored.name()).copied().cloned();
            episode["device"] = device.unwrap_or_default();
        }
        report["device_use"] = devices.to_json(scored);
    }
    write_atomically(&json, |file| writeln!(file, "{report:#}"))?;
    let page = page::page(scored, sites, devices, out)?;
    write_atomically(&html, |file| file.write_all(page.as_bytes()))?;
    let mut text = text(scored)?;
    text.push_str(&timing::text(scored));
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
        .filter(|scored| matches!(scored.episode.end, EpisodeEnd::Planner { .. }))
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
    let planner = scored.first().map(|scored| &scored.episode.head.planner);
    let drawn_by = scored
        .first()
        .and_then(|scored| scored.episode.head.drawn_by.as_ref());
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
    let name = |agent: usize| scored.episode.head.scenario.agent(agent).0.to_owned();
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
    let scenario = &scored.episode.head.scenario;
    let place_m = |infraction: &Infraction| scored.place_m(infraction.time_s).to_array();
    let infraction = |infraction: &Infraction| match infraction.kind {
        InfractionKind::Collision { agent, user, fault } => json!({
            "time_s": infraction.time_s, "place_m": place_m(infraction), "kind": "collision", "agent": scenario.agent(agent).0, "road_user": user.name(),
            "at_fault": fault.at_fault(), "why": fault.why(),
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
        "speed_compliance": score.speed_compliance,
        "braking_max_mps2": score.comfort.braking_max_mps2,
        "lateral_acceleration_max_mps2": score.comfort.lateral_acceleration_max_mps2,
        "infractions": score.infractions.iter().map(infraction).collect::<Vec<_>>(),
        "log": scored.log.display().to_string(),
    });
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
