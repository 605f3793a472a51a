//! Words and comments. Retired words are put together from halves, so that this file keeps the
//! rules too.

use super::Finding;
use super::checks::{has_word, lines_with};
use super::tree::Tree;

/// Words that a doc comment must not begin with: what follows them is a riddle away from the item.
const RELATIVE_WORDS: [&str; 15] = [
    "What",
    "How",
    "Where",
    "Whether",
    "When",
    "Who",
    "Whose",
    "Whom",
    "Which",
    "Why",
    "Its",
    "Of",
    "As",
    concat!("Every", "body"),
    "Nobody",
];

/// The text of a doc comment's line, if `line` is one.
fn doc_text(line: &str) -> Option<&str> {
    let line = line.trim_start();
    let text = line
        .strip_prefix("///")
        .or_else(|| line.strip_prefix("//!"))?;
    Some(text.trim())
}

pub fn docs_name_their_subject(tree: &Tree) -> Vec<Finding> {
    let mut findings = Vec::new();
    for file in tree.files.iter().filter(|file| file.is_rust()) {
        let mut in_doc = false;
        for (i, line) in file.text.lines().enumerate() {
            let text = doc_text(line);
            let begins = !in_doc;
            // The line below a heading begins too.
            in_doc = text.is_some_and(|text| !text.starts_with("# "));
            let first = text
                .and_then(|text| text.split_whitespace().next())
                .unwrap_or_default();
            if begins && RELATIVE_WORDS.contains(&first) {
                findings.push(Finding {
                    path: file.path.clone(),
                    line: i + 1,
                    what: format!("begins with {first:?}: name the thing, or what it does"),
                });
            }
        }
    }
    findings
}

/// Docs of one word. Names of files and of other interfaces stand alone: `kernel.comp`, [`name`].
pub fn docs_say_something(tree: &Tree) -> Vec<Finding> {
    let mut findings = Vec::new();
    for file in tree.files.iter().filter(|file| file.is_rust()) {
        let docs: Vec<Option<&str>> = file.text.lines().map(doc_text).collect();
        for (i, doc) in docs.iter().enumerate() {
            let beside = |at: Option<usize>| at.and_then(|at| *docs.get(at)?).is_some();
            let alone = !beside(i.checked_sub(1)) && !beside(i.checked_add(1));
            let is_word = |text: &&str| {
                let word = text.strip_suffix('.').unwrap_or_default();
                !word.is_empty() && word.chars().all(char::is_alphanumeric)
            };
            if let Some(word) = doc.filter(|text| alone && is_word(text)) {
                findings.push(Finding {
                    path: file.path.clone(),
                    line: i + 1,
                    what: format!("says {word:?} and no more"),
                });
            }
        }
    }
    findings
}

pub fn comments_are_narrow(tree: &Tree) -> Vec<Finding> {
    const COLUMNS_MAX: usize = 100;
    let fault = |line: &str| {
        let comment = line
            .trim_start()
            .strip_prefix("//")?
            .trim_start_matches(['/', '!'])
            .trim();
        // Tables, and what has no space to break at.
        let breaks = !comment.starts_with('|') && comment.contains(' ');
        let columns = line.chars().count();
        (breaks && columns > COLUMNS_MAX).then(|| format!("a comment of {columns} columns"))
    };
    let files = tree.files.iter().filter(|file| file.is_source());
    files
        .flat_map(|file| lines_with(file, &file.text, fault))
        .collect()
}

/// Words that the field has better ones for, with those. `CHANGELOG.md` tells of them.
const RETIRED_WORDS: &[(&str, &str)] = &[
    (concat!("pict", "ure"), "image"),
    (concat!("pict", "ures"), "images"),
    (concat!("col", "our"), "color"),
    (concat!("cen", "tre"), "center"),
    (concat!("met", "re"), "meter"),
    (concat!("met", "res"), "meters"),
    (concat!("neigh", "bour"), "neighbor"),
    (concat!("behav", "iour"), "behavior"),
    (concat!("raster", "isation"), "rasterization"),
    (concat!("fir", "sts"), "offsets"),
    (concat!("macro ", "tile"), "coarse tile"),
    (concat!("macro ", "tiles"), "coarse tiles"),
    (concat!("macro_", "tile"), "coarse_tile"),
    (concat!("render ", "tile"), "fine tile"),
    (concat!("render ", "tiles"), "fine tiles"),
    (concat!("who", "ever"), "the vehicle, caller or reader that"),
    (concat!("Who", "ever"), "the vehicle, caller or reader that"),
    (concat!("some", "body"), "a vehicle, a caller"),
    (concat!("Some", "body"), "a vehicle, a caller"),
    (concat!("every", "body"), "all vehicles"),
    (concat!("Every", "body"), "all vehicles"),
    (concat!("made ", "up"), "synthetic, generated"),
    (concat!("looked ", "at"), "examined"),
    (concat!("Resident", "World"), "GpuScene"),
    (concat!("Frame", "Slot"), "FrameInFlight"),
    (concat!("Yard", "stick"), "QualityMeter"),
    (concat!("Show", "case"), "ExampleCrops"),
    (concat!("reach", "_m"), "radius_m, distance_max_m"),
    (concat!("squared_", "reach"), "squared_radius"),
    (concat!("SIGMA_", "REACH"), "SIGMA_SPREAD"),
];

/// Exceptions for retired words: keys of files on disk, and compiled test kernels.
const MAY_USE_RETIRED: &[(&str, &str)] = &[
    ("engine/gpu/tests/", concat!("pict", "ure")),
    (
        "engine/logs/src/scenario_file/form.rs",
        concat!("behav", "iour"),
    ),
];

pub fn no_retired_words(tree: &Tree) -> Vec<Finding> {
    let texts = [".rs", ".comp", ".glsl", ".md", ".py", ".pyi", ".c", ".h"];
    let files = tree.files.iter().filter(|file| {
        file.path != "CHANGELOG.md" && texts.iter().any(|end| file.path.ends_with(end))
    });
    let mut findings = Vec::new();
    for file in files {
        let allowed = |word: &str| {
            let mut exceptions = MAY_USE_RETIRED.iter();
            exceptions.any(|(path, other)| file.path.starts_with(path) && *other == word)
        };
        let fault = |line: &str| {
            let found = RETIRED_WORDS
                .iter()
                .find(|(word, _)| has_word(line, word) && !allowed(word));
            found.map(|(word, better)| format!("{word:?}: say {better:?}"))
        };
        findings.extend(lines_with(file, &file.text, fault));
    }
    findings
}
