//! Taste as a test: rules about the sources themselves, each with a case that must fail.

mod checks;
mod claims;
mod code;
mod modules;
mod parameters;
mod rules;
mod tree;
mod words;

use rules::RULES;
use tree::{SourceFile, Tree};

/// A place where a rule is broken.
#[derive(Debug, PartialEq)]
pub struct Finding {
    path: String,
    /// Line of the finding from 1; 0 where it is about the file as a whole.
    line: usize,
    what: String,
}

/// A rule, with sources that keep it and sources that break it.
pub struct Rule {
    name: &'static str,
    check: fn(&Tree) -> Vec<Finding>,
    /// `(path, text)` of a tree without a finding, as close to the fault as the rule allows.
    kept_by: &'static [(&'static str, &'static str)],
    /// Files, each with exactly one finding, alone or beside those of `kept_by`.
    broken_by: &'static [(&'static str, &'static str)],
}

fn report(rule: &Rule, findings: &[Finding]) -> String {
    let lines: Vec<String> = findings
        .iter()
        .map(|found| format!("{}:{}: {}", found.path, found.line, found.what))
        .collect();
    format!("{}\n  {}", rule.name, lines.join("\n  "))
}

#[test]
fn the_sources_keep_every_rule() {
    let tree = Tree::of_repository();
    assert!(
        tree.files.len() > 20,
        "only {} files were found: the walk is broken",
        tree.files.len()
    );
    let broken: Vec<String> = RULES
        .iter()
        .map(|rule| (rule, (rule.check)(&tree)))
        .filter(|(_, findings)| !findings.is_empty())
        .map(|(rule, findings)| report(rule, &findings))
        .collect();
    assert!(broken.is_empty(), "\n{}", broken.join("\n"));
}

#[test]
fn every_rule_passes_what_keeps_it_and_finds_what_breaks_it() {
    for rule in RULES {
        let files = rule
            .kept_by
            .iter()
            .map(|&(path, text)| SourceFile::new(path, text))
            .collect();
        let findings = (rule.check)(&Tree { files });
        assert!(
            findings.is_empty(),
            "should have passed: {}",
            report(rule, &findings)
        );

        assert!(
            !rule.broken_by.is_empty(),
            "{}: no case that must fail",
            rule.name
        );
        for &(path, text) in rule.broken_by {
            let broken = || SourceFile::new(path, text);
            let mut findings = (rule.check)(&Tree {
                files: vec![broken()],
            });
            if findings.is_empty() {
                let kept = rule.kept_by.iter();
                let kept = kept.map(|&(path, text)| SourceFile::new(path, text));
                findings = (rule.check)(&Tree {
                    files: kept.chain([broken()]).collect(),
                });
            }
            assert_eq!(
                findings.len(),
                1,
                "should have failed once, on {path} with {text:?}: {}",
                report(rule, &findings)
            );
        }
    }
}
