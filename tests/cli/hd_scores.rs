//! HD-Scores of logs, of plans and of what was driven.

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
