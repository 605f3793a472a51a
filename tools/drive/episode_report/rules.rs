//! Rules of the road, and sub-scores in the terms of NAVSIM, as text, JSON and HTML.

use decouplegs::drive::score::{
    Breach, Conduct, ConductKind, ExtendedPdmScore, LaneKeeping, Moments,
};
use decouplegs::scene::Level;
use serde_json::{Value, json};

use super::{Scored, score, spread};
use crate::page::{Page, Table};

/// Figures of a set of episodes, by the names of their columns.
const COLUMNS: [&str; 10] = [
    "all rules",
    "progress",
    "PDMS",
    "EPDMS",
    "lane kept",
    "speed limits",
    "over edge, s",
    "on crossing",
    "blocking",
    "wrong turn",
];

/// Score of an episode from 0 to 1; `None` where the log does not tell it.
type ScoreOf = fn(&Scored) -> Option<f64>;

/// Scores of an episode, by the names of their columns.
pub const SCORES: [(&str, ScoreOf); 6] = [
    (COLUMNS[0], |one| one.conduct.all_rules_score),
    (COLUMNS[1], |one| Some(one.conduct.reference.share)),
    (COLUMNS[2], |one| Some(one.pdm.pdm_score)),
    (COLUMNS[3], |one| Some(one.extended_pdm.score)),
    (COLUMNS[4], |one| {
        Some(one.conduct.lane_keeping?.kept_share())
    }),
    (COLUMNS[5], |one| one.score.speed_compliance),
];

/// A table, a line a level.
pub fn text(scored: &[Scored]) -> String {
    let mut text = String::from("rules and sub-scores\nlevel   ");
    for column in COLUMNS {
        text.push_str(&format!("  {column:>20}"));
    }
    text.push('\n');
    for (level, figures) in rows(scored) {
        text.push_str(&format!("{level:<8}"));
        for figure in figures {
            text.push_str(&format!("  {figure:>20}"));
        }
        text.push('\n');
    }
    text
}

/// The same table and what its columns are.
pub fn part(page: &mut Page, scored: &[Scored]) {
    page.heading("Rules and sub-scores");
    let mut table = Table::new(std::iter::once("level").chain(COLUMNS));
    for (level, figures) in rows(scored) {
        table.row(std::iter::once(level.to_owned()).chain(figures));
    }
    page.table(&table);
    page.note(
        "These stand beside the driving score and do not change it. Progress: the ego's way along its route as a share of that of a reference at \
         the same time, which has the same cruising speed, meets nobody, and waits at red lights and stop signs too: a red light costs nothing. \
         All rules: progress, times the factors of DS, times 0.70 for each time that the ego stood on a crossing without need or blocked the road (5 s or \
         longer) or went through a junction from a lane that does not lead there, times the compliance with speed limits, times the share of time in which it kept \
         its lane. Lane kept: share of time on lanes, junctions apart, in which no side was more than 0.15 m over an edge without a change of lanes. Speed limits: \
         nuPlan's compliance. PDMS and EPDMS: NAVSIM's formulas, taken from what was driven. A dash: the logs, of versions before 4, do not tell it, or the map has no speed limits.",
    );
}

/// The figures of each level, and of all where there are several.
fn rows(scored: &[Scored]) -> Vec<(&'static str, Vec<String>)> {
    let mut levels: Vec<Option<Level>> = scored.iter().map(Scored::level).collect();
    levels.sort();
    levels.dedup();
    let row = |level: Option<Level>| {
        let of_level = scored.iter().filter(move |one| one.level() == level);
        let name = level.map_or("own", Level::name);
        (name, figures(&of_level.collect::<Vec<_>>()))
    };
    let mut rows: Vec<_> = levels.into_iter().map(row).collect();
    if rows.len() > 1 {
        rows.push(("all", figures(&scored.iter().collect::<Vec<_>>())));
    }
    rows
}

fn figures(scored: &[&Scored]) -> Vec<String> {
    let moments = |figure: &dyn Fn(&Scored) -> Option<f64>| {
        let values: Vec<f64> = scored.iter().filter_map(|one| figure(one)).collect();
        Moments::from_values(&values)
    };
    let knows = scored.iter().any(|one| one.conduct.lane_keeping.is_some());
    let breaches = |kind: ConductKind| {
        let counts = scored.iter().map(|one| one.conduct.count(kind));
        match knows || kind == ConductKind::Blocking {
            true => counts.sum::<usize>().to_string(),
            false => "-".to_owned(),
        }
    };
    let over_s = moments(&|one| Some(one.conduct.lane_keeping?.over_edge_s));
    let scores = SCORES
        .iter()
        .map(|(_, figure)| moments(figure).map_or("-".to_owned(), |moments| score(&moments)));
    let counts = [
        ConductKind::OnCrossing,
        ConductKind::Blocking,
        ConductKind::WrongTurn,
    ];
    let over = std::iter::once(spread(over_s.as_ref(), 1));
    scores.chain(over).chain(counts.map(breaches)).collect()
}

/// EPDMS of an episode as a product of its terms.
pub fn extended_pdm_explained(found: &ExtendedPdmScore) -> String {
    let ExtendedPdmScore {
        no_collision,
        drivable_area,
        driving_direction,
        traffic_lights,
        progress,
        time_to_collision,
        lane_keeping,
        history_comfort,
        extended_comfort,
        score,
    } = found;
    let known = [lane_keeping, extended_comfort].map(|term| 2 * u32::from(term.is_some()));
    let weights = 12 + known[0] + known[1];
    let term = |name: &str, value: &Option<f64>, digits: usize| {
        value.map_or(String::new(), |value| {
            format!(" + 2 {name} {value:.digits$}")
        })
    };
    let (lane, comfort) = (term("LK", lane_keeping, 0), term("EC", extended_comfort, 2));
    let missing = match (lane_keeping, extended_comfort) {
        (None, None) => ", without LK and EC, which the log does not tell",
        (None, _) => ", without LK, which the log does not tell",
        (_, None) => ", without EC: no two plans overlap for 1.5 s",
        _ => "",
    };
    format!(
        "EPDMS {score:.3} = NC {no_collision:.1} × DAC {drivable_area:.0} × DDC {driving_direction:.1} × TLC {traffic_lights:.0} × (5 EP \
         {progress:.3} + 5 TTC {time_to_collision:.0}{lane} + 2 HC {history_comfort:.0}{comfort}) / {weights}{missing}"
    )
}

/// Score of all rules of an episode in words.
pub fn explained(scored: &Scored) -> String {
    let Conduct {
        reference,
        breaches,
        lane_keeping,
        all_rules_score,
    } = &scored.conduct;
    let head = all_rules_score.map_or("All rules: the log tells too little".to_owned(), |found| {
        format!("All rules {found:.3}")
    });
    let mut text = format!(
        "{head}: progress {:.3} ({:.0} m, the reference {:.0} m)",
        reference.share, reference.driven_m, reference.reference_m
    );
    if let Some(limits) = scored.score.speed_compliance {
        text.push_str(&format!(", speed limits {limits:.3}"));
    }
    if let Some(keeping) = lane_keeping {
        text.push_str(&format!(
            ", lane kept {:.3} ({:.1} s and {:.0} m over an edge, {} times)",
            keeping.kept_share(),
            keeping.over_edge_s,
            keeping.over_edge_m,
            keeping.excursions
        ));
    }
    for breach in breaches {
        text.push_str(&format!("; {}", breach_explained(breach)));
    }
    text
}

fn breach_explained(breach: &Breach) -> String {
    let lasts = match breach.kind {
        ConductKind::WrongTurn => String::new(),
        _ => format!(" for {:.1} s", breach.duration_s),
    };
    let what = breach.kind.describe();
    format!("{what} at {:.1} s{lasts}", breach.time_s)
}

/// Rules and progress of an episode.
pub fn to_json(scored: &Scored) -> Value {
    let Conduct {
        reference,
        breaches,
        lane_keeping,
        all_rules_score,
    } = &scored.conduct;
    let breach = |one: &Breach| json!({ "time_s": one.time_s, "duration_s": one.duration_s, "kind": one.kind.name() });
    let keeping = |one: &LaneKeeping| {
        json!({
            "over_edge_s": one.over_edge_s, "over_edge_m": one.over_edge_m, "excursions": one.excursions,
            "on_lanes_s": one.on_lanes_s, "kept_share": one.kept_share(),
        })
    };
    json!({
        "all_rules_score": all_rules_score,
        "reference_progress": reference.share,
        "driven_m": reference.driven_m,
        "reference_m": reference.reference_m,
        "breaches": breaches.iter().map(breach).collect::<Vec<_>>(),
        "lane_keeping": lane_keeping.as_ref().map(keeping),
    })
}

/// EPDMS and its terms.
pub fn extended_pdm_to_json(found: &ExtendedPdmScore) -> Value {
    json!({
        "score": found.score, "nc": found.no_collision, "dac": found.drivable_area,
        "ddc": found.driving_direction, "tlc": found.traffic_lights, "ep": found.progress,
        "ttc": found.time_to_collision, "lk": found.lane_keeping, "hc": found.history_comfort,
        "ec": found.extended_comfort,
    })
}
