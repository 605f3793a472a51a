//! Claims of documents: that something is so, and the tests that show it.

use std::collections::HashSet;

use super::Finding;
use super::checks::has_word;
use super::tree::Tree;

/// Documents whose claims name their tests.
const DOCUMENTS: [&str; 2] = ["README.md", "engine/README.md"];
/// Words of a claim.
const CLAIM_WORDS: [&str; 3] = ["checked", "never", "once"];
/// Least number of underscores in the last name of a path of Rust that is a test.
const UNDERSCORES_OF_A_TEST: usize = 2;

/// A paragraph, an item of a list or a row of a table, and the number of its first line.
fn paragraphs(text: &str) -> Vec<(usize, String)> {
    let mut found: Vec<(usize, String)> = Vec::new();
    let (mut in_code, mut begins) = (false, true);
    for (i, line) in text.lines().enumerate() {
        if line.starts_with("```") {
            in_code = !in_code;
        }
        if in_code || line.trim().is_empty() || line.starts_with("```") {
            begins = true;
            continue;
        }
        match found.last_mut() {
            Some((_, paragraph)) if !begins && !line.starts_with(['-', '|', '#']) => {
                *paragraph += "\n";
                *paragraph += line;
            }
            _ => found.push((i + 1, line.to_owned())),
        }
        begins = false;
    }
    found
}

/// Text between backquotes.
fn quoted(paragraph: &str) -> impl Iterator<Item = &str> {
    paragraph.split('`').skip(1).step_by(2)
}

/// Names of all tests in Rust.
fn test_names(tree: &Tree) -> HashSet<&str> {
    let mut names = HashSet::new();
    for file in tree.files.iter().filter(|file| file.is_rust()) {
        for (at, attribute) in file.text.match_indices("#[test]\n") {
            let behind = file.text[at + attribute.len()..].lines();
            let name = behind.into_iter().find_map(|line| {
                let line = line.trim_start().trim_start_matches("async ");
                line.strip_prefix("fn ")?.split('(').next()
            });
            names.extend(name);
        }
    }
    names
}

pub fn claims_name_their_tests(tree: &Tree) -> Vec<Finding> {
    let tests = test_names(tree);
    let shows = |name: &str| {
        let is_test = tests.contains(name.rsplit("::").next().unwrap_or(name));
        let is_file = name.contains("tests/") && tree.files.iter().any(|f| f.path.ends_with(name));
        is_test || is_file
    };
    let mut findings = Vec::new();
    for file in tree
        .files
        .iter()
        .filter(|file| DOCUMENTS.contains(&&*file.path))
    {
        for (line, paragraph) in paragraphs(&file.text) {
            let text = paragraph.to_lowercase();
            let claim = CLAIM_WORDS.iter().find(|word| has_word(&text, word));
            if let Some(word) = claim.filter(|_| !quoted(&paragraph).any(shows)) {
                findings.push(Finding {
                    path: file.path.clone(),
                    line,
                    what: format!("says {word:?} and names no test that shows it"),
                });
            }
        }
    }
    findings
}

pub fn named_tests_exist(tree: &Tree) -> Vec<Finding> {
    let tests = test_names(tree);
    let is_missing = |name: &str| {
        let (_, last) = name.rsplit_once("::")?;
        let is_name = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || "_:".contains(c);
        let is_test =
            last.matches('_').count() >= UNDERSCORES_OF_A_TEST && name.chars().all(is_name);
        (is_test && !tests.contains(last)).then(|| name.to_owned())
    };
    let mut findings = Vec::new();
    for file in tree.files.iter().filter(|file| file.path.ends_with(".md")) {
        for (line, paragraph) in paragraphs(&file.text) {
            for name in quoted(&paragraph).filter_map(is_missing) {
                findings.push(Finding {
                    path: file.path.clone(),
                    line,
                    what: format!("names {name}, which is no test"),
                });
            }
        }
    }
    findings
}
