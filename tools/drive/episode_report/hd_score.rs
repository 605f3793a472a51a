//! HD-Scores as text and JSON.

use std::path::Path;

use anyhow::{Context, Result};
use clap::ValueEnum;
use decouplegs::drive::score::{HdScore, Moments};
use decouplegs::scene::Level;
use glam::DVec2;
use serde_json::{Value, json};

use super::{Scored, score};
use crate::sites::Sites;

/// Kinds of HD-Scores.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Hugsim {
    /// HUGSIM's own formula, from the plan of each step
    AsPublished,
    /// HUGSIM's terms, taken from what was driven
    #[value(alias = "corrected")]
    Driven,
}

/// HD-Scores of episodes, in their order.
pub struct HdScores {
    kind: Hugsim,
    scores: Vec<HdScore>,
    /// Episodes whose road is not known: its drivable area counts as kept.
    without_road: usize,
}

impl HdScores {
    /// The scores of `scored`, whose places tell where the road is.
    ///
    /// # Errors
    /// Returns an error for an episode whose plans are too short for [`Hugsim::AsPublished`].
    pub fn from_scored(scored: &[Scored], kind: Hugsim, sites: &Sites) -> Result<Self> {
        let mut without_road = 0;
        let of = |scored: &Scored| match kind {
            Hugsim::Driven => Ok(HdScore::from_driven(&scored.whole()?)),
            Hugsim::AsPublished => {
                // Logs are in a folder of the run, to which its files are relative.
                let run = scored.log.parent().and_then(Path::parent);
                let ready = sites
                    .get(&scored.place(), run.unwrap_or(Path::new("")))
                    .ok();
                let surface = ready.as_ref().map(|ready| &ready.site.surface);
                let is_road = surface.map(|surface| |at: DVec2| surface.contains(at));
                without_road += usize::from(is_road.is_none());
                let is_road = is_road
                    .as_ref()
                    .map(|is_road| is_road as &dyn Fn(DVec2) -> bool);
                HdScore::from_plans(&scored.whole()?, is_road).with_context(|| {
                    format!(
                        "{}: HUGSIM judges plans of at least 1.5 s, and none is so long; use --hugsim driven",
                        scored.log.display()
                    )
                })
            }
        };
        let scores = scored.iter().map(of).collect::<Result<_>>()?;
        Ok(Self {
            kind,
            scores,
            without_road,
        })
    }

    /// A table, a line per level.
    pub fn text(&self, scored: &[Scored]) -> String {
        let columns = ["HD-Score", "RC", "NC", "DAC", "TTC", "comfort"];
        let mut text = format!(
            "\nHD-Score {}: RC x mean of NC x DAC x (5 TTC + 2 comfort) / 7\n{:<8} {:>8}",
            self.description(),
            "level",
            "episodes"
        );
        for column in columns {
            text.push_str(&format!("  {column:>20}"));
        }
        text.push('\n');
        for (level, scores) in self.sets(scored) {
            text.push_str(&format!("{level:<8} {:>8}", scores.len()));
            for terms in terms(&scores) {
                let shown =
                    Moments::from_values(&terms).map_or("-".into(), |moments| score(&moments));
                text.push_str(&format!("  {shown:>20}"));
            }
            text.push('\n');
        }
        if self.without_road > 0 {
            text.push_str(&format!(
                "DAC is 1 in {} episodes whose place is not there\n",
                self.without_road
            ));
        }
        text
    }

    pub fn to_json(&self, scored: &[Scored]) -> Value {
        let episodes = scored.iter().zip(&self.scores).map(|(scored, score)| {
            json!({
                "name": scored.name(), "level": scored.level().map(Level::name), "hd_score": score.hd_score,
                "route_completion": score.route_completion, "no_collision": score.no_collision,
                "drivable_area": score.drivable_area, "time_to_collision": score.time_to_collision,
                "comfort": score.comfort,
            })
        });
        json!({
            "variant": self.name(), "episodes_without_road": self.without_road,
            "episodes": episodes.collect::<Vec<_>>(),
        })
    }

    fn name(&self) -> &'static str {
        match self.kind {
            Hugsim::AsPublished => "as published",
            Hugsim::Driven => "driven",
        }
    }

    fn description(&self) -> &'static str {
        match self.kind {
            Hugsim::AsPublished => "of HUGSIM, of the plans, as published",
            Hugsim::Driven => "in the manner of HUGSIM, of what was driven",
        }
    }

    /// The scores of each level, and of all where there are several.
    fn sets(&self, scored: &[Scored]) -> Vec<(&'static str, Vec<HdScore>)> {
        let mut levels: Vec<Option<Level>> = scored.iter().map(Scored::level).collect();
        levels.dedup();
        let of = |level: Option<Level>| {
            let pairs = scored.iter().zip(&self.scores);
            let chosen = pairs.filter(|(scored, _)| scored.level() == level);
            (
                level.map_or("own", Level::name),
                chosen.map(|(_, score)| *score).collect(),
            )
        };
        let mut sets: Vec<_> = levels.iter().map(|level| of(*level)).collect();
        if sets.len() > 1 {
            sets.push(("all", self.scores.clone()));
        }
        sets
    }
}

/// The score and its terms, each of all `scores`.
fn terms(scores: &[HdScore]) -> [Vec<f64>; 6] {
    let of = |term: fn(&HdScore) -> f64| scores.iter().map(term).collect();
    [
        of(|score| score.hd_score),
        of(|score| score.route_completion),
        of(|score| score.no_collision),
        of(|score| score.drivable_area),
        of(|score| score.time_to_collision),
        of(|score| score.comfort),
    ]
}
