//! Two runs of the same scenarios side by side: paired differences, and where the egos part.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use decouplegs::asset::write_atomically;
use decouplegs::drive::score::Moments;
use decouplegs::scene::Level;
use serde_json::{Value, json};

use super::{Scored, WayPoint, rules, score, share};
use crate::page::{Figure, Page, Table};
use crate::plot::{Axis, Plot, Series};

/// Egos part where they are farther from each other than this at the same time, meters.
const PART_M: f64 = 0.5;
/// Pairs that are listed on the console.
const SHOWN_MAX: usize = 5;

/// An episode of each run with the same scenario.
struct Pair<'a> {
    first: &'a Scored,
    second: &'a Scored,
    /// Time at which the egos part, seconds.
    parts_s: Option<f64>,
}

impl Pair<'_> {
    fn difference(&self) -> f64 {
        self.first.score.driving_score - self.second.score.driving_score
    }
}

/// Figures of the pairs of a level.
struct Row {
    name: &'static str,
    scores: [Moments; 2],
    successes: [Moments; 2],
    difference: Moments,
    rules: Vec<Compared>,
}

/// Score of all rules, or one in the terms of NAVSIM, over the pairs of which both logs tell it.
struct Compared {
    name: &'static str,
    scores: [Moments; 2],
    difference: Moments,
}

/// Compares `first` with `second`, and writes comparison.json and comparison.html to `out`. Returns
/// the text of the table.
///
/// # Errors
/// Returns an error if no scenario was driven in both, or a file cannot be written.
pub fn compare(first: &[Scored], second: &[Scored], out: Option<&Path>) -> Result<String> {
    let mut pairs: Vec<Pair> = first.iter().filter_map(|one| pair(one, second)).collect();
    ensure!(
        !pairs.is_empty(),
        "no scenario was driven in both runs: of {} and {} episodes, none have the same scenario; \
         drive both with the same --level, --episodes and --seed",
        first.len(),
        second.len()
    );
    pairs.sort_by(|a, b| b.difference().abs().total_cmp(&a.difference().abs()));
    let unpaired = first.len() + second.len() - 2 * pairs.len();
    let names = [&pairs[0].first, &pairs[0].second].map(|run| &run.head.planner.name);
    let rows = rows(&pairs)?;
    let mut text = format!(
        "first: {}, second: {}; {} pairs, {unpaired} episodes without a partner; DS: driving score, SR: success rate\n{}",
        names[0],
        names[1],
        pairs.len(),
        table(&rows)
    );
    for pair in pairs
        .iter()
        .take(SHOWN_MAX)
        .filter(|pair| pair.difference() != 0.0)
    {
        let _ = writeln!(text, "  {}", sentence(pair));
    }
    if let Some(out) = out {
        std::fs::create_dir_all(out)
            .with_context(|| format!("{} cannot be made", out.display()))?;
        let (json, html) = (out.join("comparison.json"), out.join("comparison.html"));
        let report = to_json(&rows, &pairs, unpaired);
        write_atomically(&json, |file| writeln!(file, "{report:#}"))?;
        let page = page(&rows, &pairs, names.map(String::as_str));
        write_atomically(&html, |file| file.write_all(page.as_bytes()))?;
        let _ = writeln!(text, "{}\n{}", json.display(), html.display());
    }
    Ok(text)
}

fn pair<'a>(first: &'a Scored, others: &'a [Scored]) -> Option<Pair<'a>> {
    let scenario = &first.head.scenario;
    let second = others
        .iter()
        .find(|other| other.head.scenario == *scenario)?;
    Some(Pair {
        first,
        second,
        parts_s: parts_s(&first.way, &second.way),
    })
}

/// First time at which two egos are farther from each other than [`PART_M`], seconds; `None` where
/// they keep together as long as both drive.
fn parts_s(first: &[WayPoint], second: &[WayPoint]) -> Option<f64> {
    let mut points = first.iter().zip(second);
    points
        .find(|(a, b)| a.position_m.distance(b.position_m) > PART_M)
        .map(|(a, _)| a.time_s)
}

fn rows(pairs: &[Pair]) -> Result<Vec<Row>> {
    let levels = Level::ALL.map(|level| (level.name(), Some(level)));
    let mut rows = Vec::new();
    for (name, level) in levels.into_iter().chain([("own", None)]) {
        let of_level = pairs.iter().filter(|pair| pair.first.level() == level);
        rows.extend(row(name, &of_level.collect::<Vec<_>>()));
    }
    if rows.len() > 1 {
        rows.extend(row("all", &pairs.iter().collect::<Vec<_>>()));
    }
    ensure!(!rows.is_empty(), "no pair has a level");
    Ok(rows)
}

fn row(name: &'static str, pairs: &[&Pair]) -> Option<Row> {
    let moments = |value: &dyn Fn(&Pair) -> f64| {
        Moments::from_values(&pairs.iter().map(|pair| value(pair)).collect::<Vec<_>>())
    };
    let success = |scored: &Scored| f64::from(u8::from(scored.score.success));
    Some(Row {
        name,
        scores: [
            moments(&|pair| pair.first.score.driving_score)?,
            moments(&|pair| pair.second.score.driving_score)?,
        ],
        successes: [
            moments(&|pair| success(pair.first))?,
            moments(&|pair| success(pair.second))?,
        ],
        difference: moments(&|pair| pair.difference())?,
        rules: compared(pairs),
    })
}

fn compared(pairs: &[&Pair]) -> Vec<Compared> {
    let of_score = |(name, figure): &(&'static str, fn(&Scored) -> Option<f64>)| {
        let both = pairs.iter();
        let both = both.filter_map(|pair| Some([figure(pair.first)?, figure(pair.second)?]));
        let both: Vec<[f64; 2]> = both.collect();
        let moments = |value: fn(&[f64; 2]) -> f64| {
            Moments::from_values(&both.iter().map(value).collect::<Vec<_>>())
        };
        Some(Compared {
            name,
            scores: [moments(|both| both[0])?, moments(|both| both[1])?],
            difference: moments(|both| both[0] - both[1])?,
        })
    };
    rules::SCORES.iter().filter_map(of_score).collect()
}

fn difference(moments: &Moments) -> String {
    let interval = moments.interval();
    interval.map_or(format!("{:+.3}", moments.mean), |[low, high]| {
        format!("{:+.3} [{low:+.3}, {high:+.3}]", moments.mean)
    })
}

fn table(rows: &[Row]) -> String {
    let mut text = format!(
        "{:<8} {:>5}  {:>20}  {:>20}  {:>24}  {:>17}  {:>17}\n",
        "level", "pairs", "DS first", "DS second", "difference", "SR first", "SR second"
    );
    for row in rows {
        let _ = writeln!(
            text,
            "{:<8} {:>5}  {:>20}  {:>20}  {:>24}  {:>17}  {:>17}",
            row.name,
            row.difference.count,
            score(&row.scores[0]),
            score(&row.scores[1]),
            difference(&row.difference),
            share(&row.successes[0]),
            share(&row.successes[1]),
        );
    }
    let _ = writeln!(
        text,
        "rules and sub-scores\n{:<8} {:<12} {:>5}  {:>20}  {:>20}  {:>24}",
        "level", "score", "pairs", "first", "second", "difference"
    );
    for (level, one) in of_rules(rows) {
        let _ = writeln!(
            text,
            "{level:<8} {:<12} {:>5}  {:>20}  {:>20}  {:>24}",
            one.name,
            one.difference.count,
            score(&one.scores[0]),
            score(&one.scores[1]),
            difference(&one.difference),
        );
    }
    text
}

/// The scores of rules with the names of their levels.
fn of_rules(rows: &[Row]) -> impl Iterator<Item = (&'static str, &Compared)> {
    rows.iter()
        .flat_map(|row| row.rules.iter().map(|one| (row.name, one)))
}

fn parting(pair: &Pair) -> String {
    pair.parts_s
        .map_or("same way".into(), |time_s| format!("part at {time_s:.1} s"))
}

fn sentence(pair: &Pair) -> String {
    format!(
        "{}: {:.3} ({}) and {:.3} ({}), {}",
        pair.first.name(),
        pair.first.score.driving_score,
        pair.first.ending(),
        pair.second.score.driving_score,
        pair.second.ending(),
        parting(pair)
    )
}

fn to_json(rows: &[Row], pairs: &[Pair], unpaired: usize) -> Value {
    let moments =
        |moments: &Moments| json!({ "mean": moments.mean, "interval_95": moments.interval() });
    let share = |moments: &Moments| json!({ "mean": moments.mean, "interval_95": moments.share_interval() });
    let of_rules = |one: &Compared| {
        json!({
            "score": one.name, "pairs": one.difference.count,
            "means": one.scores.each_ref().map(moments), "difference": moments(&one.difference),
        })
    };
    let row = |row: &Row| {
        json!({
            "level": row.name, "pairs": row.difference.count,
            "driving_score": row.scores.each_ref().map(moments),
            "success_rate": row.successes.each_ref().map(share),
            "difference": moments(&row.difference),
            "rules": row.rules.iter().map(of_rules).collect::<Vec<_>>(),
        })
    };
    let pair = |pair: &Pair| {
        json!({
            "name": pair.first.name(), "parts_s": pair.parts_s,
            "driving_score": [pair.first.score.driving_score, pair.second.score.driving_score],
            "ending": [pair.first.ending(), pair.second.ending()],
        })
    };
    json!({
        "without_partner": unpaired,
        "levels": rows.iter().map(row).collect::<Vec<_>>(),
        "pairs": pairs.iter().map(pair).collect::<Vec<_>>(),
    })
}

fn page(rows: &[Row], pairs: &[Pair], [first, second]: [&str; 2]) -> String {
    let mut page = Page::new(&format!("{first} and {second}"));
    page.text(&format!(
        "First run: {first}. Second run: {second}. Each pair is the same scenario, so the difference is of the planners."
    ));
    page.heading("Scores");
    let mut table = Table::new([
        "level",
        "pairs",
        "DS first",
        "DS second",
        "difference",
        "SR first",
        "SR second",
    ]);
    for row in rows {
        table.row([
            row.name.to_owned(),
            row.difference.count.to_string(),
            score(&row.scores[0]),
            score(&row.scores[1]),
            difference(&row.difference),
            share(&row.successes[0]),
            share(&row.successes[1]),
        ]);
    }
    page.table(&table);
    page.note(
        "DS, driving score, and SR, success rate, with their 95 % confidence intervals; the difference is the mean over pairs of the first \
         minus the second. An interval without zero is a difference that chance hardly explains.",
    );
    page.row([Figure::svg(&differences(pairs))]);
    page.heading("Rules and sub-scores");
    let mut table = Table::new(["level", "score", "pairs", "first", "second", "difference"]);
    for (level, one) in of_rules(rows) {
        table.row([
            level.to_owned(),
            one.name.to_owned(),
            one.difference.count.to_string(),
            score(&one.scores[0]),
            score(&one.scores[1]),
            difference(&one.difference),
        ]);
    }
    page.table(&table);
    page.note("What these are, the reports of the two runs say. Pairs of which a log does not tell a score are left out of it.");
    page.heading("Pairs, largest differences first");
    let mut table = Table::new([
        "scenario",
        "DS first",
        "DS second",
        "first ends",
        "second ends",
        "the egos",
    ]);
    for pair in pairs {
        table.row([
            pair.first.name().to_owned(),
            format!("{:.3}", pair.first.score.driving_score),
            format!("{:.3}", pair.second.score.driving_score),
            pair.first.ending(),
            pair.second.ending(),
            parting(pair),
        ]);
    }
    page.table(&table);
    page.finish()
}

/// Differences of all pairs in descending order.
fn differences(pairs: &[Pair]) -> String {
    let mut values: Vec<f64> = pairs.iter().map(Pair::difference).collect();
    values.sort_by(|a, b| b.total_cmp(a));
    let points = (1..=values.len())
        .map(|rank| rank as f64)
        .zip(values.iter().copied());
    let name = "DS first - DS second";
    let zero = vec![(1.0, 0.0), (values.len() as f64, 0.0)];
    let plot = Plot {
        title: "Differences of driving scores",
        x: Axis::linear("pairs, by difference"),
        y: Axis::linear(name),
        series: vec![
            Series::curve(name, 0, points.collect()),
            Series::guide(0, zero),
        ],
    };
    plot.to_svg()
}
