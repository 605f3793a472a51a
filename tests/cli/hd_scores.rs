//! HD-Scores of logs, of plans and of what was driven, and rules beside the driving score.

use super::drive::{blind, logs};
use super::*;

#[test]
fn plans_and_what_was_driven_have_scores_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    blind(folder.path(), &[]);
    let before = logs(folder.path());
    let path = |name: &String| folder.path().join("logs").join(name).display().to_string();
    let paths: Vec<String> = before.iter().map(|(name, _)| path(name)).collect();
    let out = folder.path().join("scored");
    let paths: Vec<&str> = paths.iter().map(String::as_str).collect();
    let mut means = Vec::new();
    for (kind, title) in [
        (
            "as-published",
            "HD-Score of HUGSIM, of the plans, as published",
        ),
        (
            "driven",
            "HD-Score in the manner of HUGSIM, of what was driven",
        ),
    ] {
        let hugsim = ["--hugsim", kind, "--force", "--out", text(&out)];
        let scored = succeed(&[&["score"], &paths[..], &hugsim].concat());
        assert!(scored.contains(title), "{scored}");
        let report = fs::read(out.join("hugsim.json")).unwrap();
        let report: Value = serde_json::from_slice(&report).unwrap();
        assert_eq!(report["episodes_without_road"], 0);
        let episodes = report["episodes"].as_array().unwrap();
        assert_eq!(episodes.len(), before.len());
        let mut sum = 0.0;
        for episode in episodes {
            let term = |name: &str| episode[name].as_f64().unwrap();
            assert!(term("hd_score") <= term("route_completion") && term("hd_score") >= 0.0);
            sum += term("hd_score");
        }
        means.push(sum);
    }
    assert!(
        means[0] != means[1],
        "plans are judged by one and not by the other"
    );
}

#[test]
fn rules_and_sub_scores_stand_beside_the_driving_score() {
    let folder = tempfile::tempdir().unwrap();
    blind(folder.path(), &[]);
    let path = |name: &String| folder.path().join("logs").join(name).display().to_string();
    let paths: Vec<String> = logs(folder.path()).iter().map(|one| path(&one.0)).collect();
    let paths: Vec<&str> = paths.iter().map(String::as_str).collect();
    let out = folder.path().join("scored");
    let scored = succeed(&[&["score"], &paths[..], &["--out", text(&out)]].concat());
    let mut lines = scored.lines().skip_while(|line| !line.starts_with("rules"));
    let columns = lines.nth(1).unwrap();
    assert!(columns.contains("EPDMS") && columns.contains("wrong turn"));
    assert!(lines.next().unwrap().starts_with("easy"), "{scored}");
    let report = fs::read(out.join("report.json")).unwrap();
    let report: Value = serde_json::from_slice(&report).unwrap();
    for episode in report["episodes"].as_array().unwrap() {
        let (rules, extended) = (&episode["rules"], &episode["extended_pdm"]);
        let share = |value: &Value| {
            let value = value.as_f64().unwrap();
            assert!((0.0..=1.0).contains(&value), "{episode}");
            value
        };
        let progress = share(&rules["reference_progress"]);
        assert!(progress >= episode["route_completion"].as_f64().unwrap() - 1e-9);
        assert!(share(&rules["all_rules_score"]) <= progress);
        assert_eq!(share(&extended["ep"]), progress);
        share(&extended["score"]);
        assert!(rules["lane_keeping"]["on_lanes_s"].as_f64().unwrap() > 0.0);
    }
    let page = fs::read_to_string(out.join("report.html")).unwrap();
    assert!(page.contains("Rules and sub-scores") && page.contains("EPDMS"));
}
