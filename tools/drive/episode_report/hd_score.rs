//! HD-Scores as text and JSON.

use decouplegs::drive::score::{HdScore, HdVariant, Moments};
use decouplegs::scene::Level;
use serde_json::{Value, json};

use super::{Scored, score};

/// HD-Scores of episodes, in their order.
pub struct HdScores {
    variant: HdVariant,
    scores: Vec<HdScore>,
}

impl HdScores {
    pub fn from_scored(scored: &[Scored], variant: HdVariant) -> Self {
        let scores = scored
            .iter()
            .map(|scored| HdScore::new(&scored.episode, variant));
        Self {
            variant,
            scores: scores.collect(),
        }
    }

    /// A table, a line per level.
    pub fn text(&self, scored: &[Scored]) -> String {
        let columns = ["HD-Score", "RC", "NC", "DAC", "TTC", "comfort"];
        let mut text = format!(
            "\nHD-Score of HUGSIM, {}: RC x mean of NC x DAC x (5 TTC + 2 comfort) / 7 over moments\n{:<8} {:>8}",
            self.variant_name(),
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
        json!({ "variant": self.variant_name(), "episodes": episodes.collect::<Vec<_>>() })
    }

    fn variant_name(&self) -> &'static str {
        match self.variant {
            HdVariant::AsPublished => "as published",
            HdVariant::Corrected => "corrected",
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
