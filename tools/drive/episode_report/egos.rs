//! A line for each ego of the episodes that have several.

use decouplegs::explain::one_line;

use super::Scored;

/// Most egos that are listed on the console.
const SHOWN_MAX: usize = 32;

/// Planner, score and end of each ego; nothing where no episode has several.
pub fn text(scored: &[Scored]) -> String {
    let egos = || {
        let several = scored.iter();
        several.filter(|scored| scored.head.scenario.egos.count() > 1)
    };
    let count = egos().count();
    if count == 0 {
        return String::new();
    }
    let mut text = "egos of episodes with several:\n".to_owned();
    for ego in egos().take(SHOWN_MAX) {
        text.push_str(&format!(
            "  {}, {}: DS {:.3}, RC {:.3}, {}\n",
            ego.name(),
            ego.head.planner.name,
            ego.score.driving_score,
            ego.score.route_completion,
            one_line(&ego.ending())
        ));
    }
    if count > SHOWN_MAX {
        text.push_str(&format!("  and {} more\n", count - SHOWN_MAX));
    }
    text
}
