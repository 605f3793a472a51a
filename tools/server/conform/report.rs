//! Results of all checks, as text and JSON.

use std::fmt::Write;

use serde_json::{Value, json};

use super::check::{Check, Outcome};

/// Results of one server.
#[derive(Clone, Debug)]
pub struct Report {
    /// Address of the server.
    pub target: String,
    /// Scene that was asked for.
    pub scene: String,
    /// Camera that was looked through.
    pub camera: String,
    /// Each check with its outcome, in the order in which they were run.
    pub results: Vec<(Check, Outcome)>,
}

impl Report {
    /// Checks that failed.
    #[must_use]
    pub fn failed(&self) -> Vec<Check> {
        let failed = |(check, outcome): &(Check, Outcome)| {
            matches!(outcome, Outcome::Failed(_)).then_some(*check)
        };
        self.results.iter().filter_map(failed).collect()
    }

    /// Counts of checks by outcome, one line.
    #[must_use]
    pub fn summary(&self) -> String {
        let count = |word: &str| {
            let of_word = self.results.iter().filter(|(_, o)| o.word() == word);
            of_word.count()
        };
        format!(
            "{} at {}, scene {}, camera {}: {} passed, {} failed, {} skipped\n",
            if count("FAILED") == 0 {
                "conforms"
            } else {
                "does not conform"
            },
            self.target,
            self.scene,
            self.camera,
            count("passed"),
            count("FAILED"),
            count("skipped")
        )
    }

    /// One line of the table.
    #[must_use]
    pub fn line(check: Check, outcome: &Outcome) -> String {
        let mut line = String::new();
        // Writing to a string does not fail.
        let _ = writeln!(line, "{:<8} {}", outcome.word(), check.asks());
        let _ = writeln!(line, "         {} [{}]", outcome.detail(), check.rests_on());
        line
    }

    /// All results.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let checks = self.results.iter().map(|(check, outcome)| {
            json!({
                "check": format!("{check:?}"),
                "asks": check.asks(),
                "rests_on": check.rests_on(),
                "outcome": outcome.word().to_lowercase(),
                "detail": outcome.detail(),
            })
        });
        json!({
            "target": self.target,
            "scene": self.scene,
            "camera": self.camera,
            "checks": checks.collect::<Vec<_>>(),
        })
    }
}
