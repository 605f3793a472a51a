//! Words and comments. Retired words are put together from halves, so that this file keeps the
//! rules too.

use super::Finding;
use super::checks::{lines_with, words_at};
use super::tree::{SourceFile, Tree};

/// Words that a doc comment must not begin with: what follows them is a riddle away from the item,
/// a part of a sentence, or leans on the line above.
const RELATIVE_WORDS: [&str; 51] = [
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
    "And",
    "Or",
    "But",
    "It",
    "They",
    "Their",
    "Them",
    "Those",
    "These",
    "Likewise",
    "Same",
    "At",
    "By",
    "In",
    "To",
    "From",
    "On",
    "Under",
    "Until",
    "Since",
    "After",
    "Before",
    "Between",
    "Along",
    "Above",
    "Below",
    "Behind",
    "Beside",
    "Beyond",
    "Around",
    "Against",
    "With",
    "Without",
    "Within",
    "Towards",
    "While",
];

/// Words of two that a doc comment must not begin with, for the same reason.
const RELATIVE_PAIRS: [&str; 8] = [
    "The one",
    "The ones",
    "The other",
    "The others",
    "The rest",
    "A step",
    "Every so",
    "None: the",
];

/// Words before which "The same" names nothing.
const AFTER_THE_SAME: [&str; 14] = [
    "", "with", "for", "of", "in", "to", "as", "without", "and", "at", "along", "behind", "over",
    "by",
];

/// The words with which `text` begins, if a doc comment must not begin so.
fn relative_beginning(text: &str) -> Option<String> {
    let mut words = text.split(' ');
    let first = words.next().unwrap_or_default();
    let second = words.next().unwrap_or_default();
    let third = words.next().unwrap_or_default();
    let pair = format!("{first} {second}");
    let pair = pair.trim_end_matches([',', '.', ':', ';']);
    if RELATIVE_WORDS.contains(&first) || first.starts_with("...") {
        return Some(first.to_owned());
    }
    let names_nothing = match pair {
        "The same" => {
            pair.len() < first.len() + 1 + second.len() || AFTER_THE_SAME.contains(&third)
        }
        _ => RELATIVE_PAIRS.contains(&pair.trim_end_matches("'s")),
    };
    names_nothing.then(|| pair.to_owned())
}

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
            let relative = text.filter(|_| begins).and_then(relative_beginning);
            findings.extend(relative.map(|words| Finding {
                path: file.path.clone(),
                line: i + 1,
                what: format!("begins with {words:?}: name the thing, or what it does"),
            }));
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

/// Words that the field has better ones for, in lower case, with those. `CHANGELOG.md` tells of
/// them.
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
    (concat!("some", "body"), "a vehicle, a caller"),
    (concat!("every", "body"), "all vehicles"),
    (concat!("made ", "up"), "synthetic, generated"),
    (concat!("looked ", "at"), "examined"),
    (concat!("resident", "world"), "ResidentSplats"),
    (concat!("gpu", "scene"), "ResidentSplats"),
    (concat!("gpu_", "scene"), "background"),
    (concat!("live", "scene"), "Scene"),
    (concat!("session", "scene"), "Scene"),
    (concat!("scene", "snapshot"), "FrameAgents"),
    (concat!("frame", "slot"), "FrameInFlight"),
    (concat!("yard", "stick"), "QualityMeter"),
    (concat!("show", "case"), "ExampleCrops"),
    (concat!("reach", "_m"), "radius_m, distance_max_m"),
    (concat!("squared_", "reach"), "squared_radius"),
    (concat!("sigma_", "reach"), "SIGMA_SPREAD"),
];

/// Exceptions for retired words: keys of files on disk, and compiled test kernels.
const MAY_USE_RETIRED: &[(&str, &str)] = &[
    ("engine/gpu/tests/", concat!("pict", "ure")),
    (
        "engine/logs/src/scenario_file/form.rs",
        concat!("behav", "iour"),
    ),
];

/// A line in lower case without the signs of comments and continued strings around it.
fn plain(line: &str) -> String {
    let line = line.trim().trim_end_matches('\\');
    let text = line.trim_start_matches(['/', '!', '#', '*', '"']);
    text.trim().to_lowercase()
}

/// Finds retired words in any case, those of two words across the end of a line too.
pub fn no_retired_words(tree: &Tree) -> Vec<Finding> {
    let texts = [
        ".rs", ".comp", ".glsl", ".md", ".py", ".pyi", ".c", ".h", ".js", ".html",
    ];
    let files = tree.files.iter().filter(|file| {
        file.path != "CHANGELOG.md" && texts.iter().any(|end| file.path.ends_with(end))
    });
    let mut findings = Vec::new();
    for file in files {
        let allowed = |word: &str| {
            let mut exceptions = MAY_USE_RETIRED.iter();
            exceptions.any(|(path, other)| file.path.starts_with(path) && *other == word)
        };
        let lines: Vec<String> = file.text.lines().map(plain).collect();
        for (i, line) in lines.iter().enumerate() {
            let next = lines.get(i + 1).map_or("", String::as_str);
            let both = format!("{line} {next}");
            let begins_here = |word: &str| words_at(&both, word).any(|at| at < line.len());
            let mut retired = RETIRED_WORDS.iter();
            let found = retired.find(|(word, _)| begins_here(word) && !allowed(word));
            findings.extend(found.map(|(word, better)| Finding {
                path: file.path.clone(),
                line: i + 1,
                what: format!("{word:?}: say {better:?}"),
            }));
        }
    }
    findings
}

/// Public types with `Scene` in their names, by folder; none listed: any. A scene on the device is
/// the `Scene` of `session`, which Python and C show too. The others name files and what is read
/// from them, the data of a scene, and arguments that name a scene.
const MAY_BE_SCENES: &[(&str, &[&str])] = &[
    ("engine/session/src/", &["Scene"]),
    ("engine/scene/src/", &["SplatScene"]),
    ("engine/asset/src/", &[]),
    ("engine/synth/src/roads/", &["RoadsScene"]),
    ("tools/python/src/", &["Scene"]),
    ("tools/c/src/", &["DgsScene", "HeldScene"]),
    ("tools/cli/src/", &["SceneArguments", "SceneOptions"]),
    ("tools/server/", &["SceneMetadata", "SceneRegistry"]),
    ("tools/view/", &["SceneCourse"]),
];

/// Finds public types that are called a scene and are not one of [`MAY_BE_SCENES`].
pub fn a_scene_is_the_sessions(tree: &Tree) -> Vec<Finding> {
    let kinds = ["struct ", "enum ", "trait ", "type ", "union "];
    let is_product = |file: &&SourceFile| {
        file.is_rust() && !file.path.starts_with("tests/") && !file.path.contains("/tests/")
    };
    let mut findings = Vec::new();
    for file in tree.files.iter().filter(is_product) {
        let is_allowed = |name: &str| {
            let mut folders = MAY_BE_SCENES.iter();
            folders.any(|(folder, names)| {
                file.path.starts_with(folder) && (names.is_empty() || names.contains(&name))
            })
        };
        findings.extend(lines_with(file, &file.code, |line| {
            let item = line.trim_start().strip_prefix("pub ")?;
            let named = kinds.iter().find_map(|kind| item.strip_prefix(kind))?;
            let name = named.split(|c: char| !c.is_alphanumeric()).next()?;
            (name.contains("Scene") && !is_allowed(name))
                .then(|| format!("{name}: say what it is; the Scene is session's"))
        }));
    }
    findings
}
