//! Checks of the rules. Words that a rule forbids are put together from halves, so that this file
//! keeps the rules too.

use super::Finding;
use super::code::functions;
use super::tree::{SourceFile, Tree};

/// Kernels that belong to a stage of another name, as `(kernel, stage)`: a stage of several
/// dispatches has one file or folder.
const KERNELS_OF_A_STAGE: &[(&str, &str)] = &[
    ("cull_agents", "agents"),
    ("project_agents", "agents"),
    ("project_lidar", "lidar"),
    ("project_lidar_agents", "lidar"),
    ("list_lidar", "lidar"),
    ("trace_lidar", "lidar"),
    ("plan_lists", "tile_sort"),
    ("count_pairs", "tile_sort"),
    ("plan_buckets", "tile_sort"),
    ("fill_pairs", "tile_sort"),
    ("split_slabs", "tile_sort"),
    ("sort_buckets", "tile_sort"),
    ("plan_merges", "merge_lists"),
];

/// Crates of the workspace that the crate of a `Cargo.toml` may use.
const MAY_USE: &[(&str, &[&str])] = &[
    ("engine/scene/Cargo.toml", &[]),
    ("engine/spirv/Cargo.toml", &[]),
    ("engine/gpu/Cargo.toml", &["decouplegs-spirv"]),
    ("shaders/Cargo.toml", &["decouplegs-spirv"]),
    ("engine/asset/Cargo.toml", &["decouplegs-scene"]),
    ("engine/drive/Cargo.toml", &["decouplegs-scene"]),
    ("engine/synth/Cargo.toml", &["decouplegs-scene"]),
    ("engine/train/Cargo.toml", &["decouplegs-scene"]),
    ("engine/calibrate/Cargo.toml", &["decouplegs-scene"]),
    (
        "engine/logs/Cargo.toml",
        &["decouplegs-asset", "decouplegs-scene"],
    ),
    (
        "engine/recording/Cargo.toml",
        &["decouplegs-asset", "decouplegs-scene"],
    ),
    (
        "engine/render/Cargo.toml",
        &["decouplegs-scene", "decouplegs-gpu", "decouplegs-shaders"],
    ),
    (
        "engine/session/Cargo.toml",
        &[
            "decouplegs-asset",
            "decouplegs-gpu",
            "decouplegs-render",
            "decouplegs-scene",
            "decouplegs-train",
        ],
    ),
    (
        "engine/sim/Cargo.toml",
        &[
            "decouplegs-asset",
            "decouplegs-drive",
            "decouplegs-logs",
            "decouplegs-scene",
            "decouplegs-session",
            "decouplegs-synth",
            "decouplegs-train",
        ],
    ),
    (
        "tools/cli/Cargo.toml",
        &[
            "decouplegs-asset",
            "decouplegs-gpu",
            "decouplegs-render",
            "decouplegs-scene",
            "decouplegs-synth",
            "decouplegs-train",
        ],
    ),
    ("benches/Cargo.toml", &["decouplegs", "decouplegs-cli"]),
    // What is not here is not built for the first image: no vehicles, no server, no benchmarks.
    (
        "tools/Cargo.toml",
        &[
            "decouplegs-asset",
            "decouplegs-cli",
            "decouplegs-gpu",
            "decouplegs-render",
            "decouplegs-scene",
            "decouplegs-session",
            "decouplegs-synth",
            "decouplegs-train",
        ],
    ),
    (
        "tools/drive/Cargo.toml",
        &[
            "decouplegs",
            "decouplegs-calibrate",
            "decouplegs-cli",
            "decouplegs-alpasim",
            "decouplegs-recording",
        ],
    ),
    (
        "tools/alpasim/Cargo.toml",
        &["decouplegs", "decouplegs-cli"],
    ),
    ("tools/connections/Cargo.toml", &[]),
    (
        "tools/server/Cargo.toml",
        &[
            "decouplegs",
            "decouplegs-cli",
            "decouplegs-connections",
            "decouplegs-alpasim",
        ],
    ),
    (
        "tools/view/Cargo.toml",
        &[
            "decouplegs",
            "decouplegs-cli",
            "decouplegs-connections",
            "decouplegs-alpasim",
        ],
    ),
    (
        "tools/python/Cargo.toml",
        &["decouplegs", "decouplegs-sharing"],
    ),
    ("tools/python/sharing/Cargo.toml", &[]),
    ("tools/c/Cargo.toml", &["decouplegs"]),
];

/// Further crates for a crate's own tests: they need something to drive on.
const MAY_TEST_WITH: &[(&str, &str)] = &[
    ("engine/drive/Cargo.toml", "decouplegs-asset"),
    ("engine/drive/Cargo.toml", "decouplegs-synth"),
    ("engine/train/Cargo.toml", "decouplegs-synth"),
    ("engine/calibrate/Cargo.toml", "decouplegs-synth"),
    ("engine/session/Cargo.toml", "decouplegs-synth"),
    ("tools/Cargo.toml", "decouplegs"),
    ("benches/Cargo.toml", "decouplegs-calibrate"),
];

/// Findings for the lines of `texts` in which `fault` sees one.
pub fn lines_with(
    file: &SourceFile,
    text: &str,
    fault: impl Fn(&str) -> Option<String>,
) -> Vec<Finding> {
    let lines = text.lines().enumerate();
    lines
        .filter_map(|(i, line)| {
            Some(Finding {
                path: file.path.clone(),
                line: i + 1,
                what: fault(line)?,
            })
        })
        .collect()
}

/// Positions of `word` in `text` with nothing of a name on either side.
pub fn words_at(text: &str, word: &str) -> impl Iterator<Item = usize> {
    let part_of_a_name = |c: char| c.is_alphanumeric() || c == '_';
    text.match_indices(word).filter_map(move |(at, word)| {
        let before = text[..at].ends_with(part_of_a_name);
        let after = text[at + word.len()..].starts_with(part_of_a_name);
        (!before && !after).then_some(at)
    })
}

/// True if `word` stands in `text` with nothing of a name on either side.
pub fn has_word(text: &str, word: &str) -> bool {
    words_at(text, word).next().is_some()
}

pub fn nothing_undone(tree: &Tree) -> Vec<Finding> {
    let words = [
        concat!("TO", "DO"),
        concat!("FIX", "ME"),
        concat!("XX", "X"),
    ];
    let code = [
        concat!("to", "do!"),
        concat!("unimpl", "emented!"),
        concat!("#[ign", "ore"),
    ];
    let fault = |line: &str| {
        let word = words.iter().find(|word| has_word(line, word));
        word.or_else(|| code.iter().find(|part| line.contains(*part)))
            .map(|found| format!("{found} in {:?}", line.trim()))
    };
    tree.files
        .iter()
        .flat_map(|file| lines_with(file, &file.text, fault))
        .collect()
}

pub fn named_for_a_subject(tree: &Tree) -> Vec<Finding> {
    let empty_words = [
        "util", "utils", "helper", "helpers", "common", "manager", "misc",
    ];
    let parts_of = |path: &str| -> Vec<String> {
        path.split(['/', '.', '_', '-'])
            .map(str::to_lowercase)
            .collect()
    };
    let bad = tree.files.iter().filter_map(|file| {
        let parts = parts_of(&file.path);
        let word = parts
            .iter()
            .find(|part| empty_words.contains(&part.as_str()))?;
        Some(Finding {
            path: file.path.clone(),
            line: 0,
            what: format!("{word:?} names no subject"),
        })
    });
    bad.collect()
}

fn is_gpu(file: &SourceFile) -> bool {
    file.path.starts_with("engine/gpu/")
}

/// True for files at the boundary to C: the C library, and the Python package with the code that
/// shares memory with CUDA.
fn is_boundary(file: &SourceFile) -> bool {
    file.path.starts_with("tools/c/") || file.path.starts_with("tools/python/")
}

pub fn unsafe_only_in_gpu(tree: &Tree) -> Vec<Finding> {
    let fault = |line: &str| has_word(line, "unsafe").then(|| line.trim().to_owned());
    tree.files
        .iter()
        .filter(|file| file.is_rust() && !is_gpu(file) && !is_boundary(file))
        .flat_map(|file| lines_with(file, &file.code, fault))
        .collect()
}

pub fn unsafe_is_explained(tree: &Tree) -> Vec<Finding> {
    let mut findings = Vec::new();
    for file in tree.files.iter().filter(|file| file.is_rust()) {
        let lines: Vec<(&str, &str)> = file.text.lines().zip(file.code.lines()).collect();
        for (i, (_, code)) in lines.iter().enumerate() {
            let opens = code.split("unsafe").skip(1).any(|rest| {
                let rest = rest.trim_start();
                rest.starts_with('{') || rest.starts_with("impl") || rest.is_empty()
            });
            if opens && has_word(code, "unsafe") && !explained(&lines[..=i]) {
                findings.push(Finding {
                    path: file.path.clone(),
                    line: i + 1,
                    what: code.trim().to_owned(),
                });
            }
        }
    }
    findings
}

/// True if a comment with the word stands on the last of `lines` or in front of the statement that
/// ends there.
fn explained(lines: &[(&str, &str)]) -> bool {
    let (last, above) = lines
        .split_last()
        .expect("there is the line with the block");
    let mut in_statement = true;
    last.0.contains("SAFETY:")
        || above
            .iter()
            .rev()
            .take_while(|(text, code)| {
                let comment = code.trim().is_empty() && !text.trim().is_empty();
                in_statement &= comment || !code.trim_end().ends_with([';', '{', '}', ',']);
                in_statement
            })
            .any(|(text, _)| text.contains("SAFETY:"))
}

pub fn vulkan_only_in_gpu(tree: &Tree) -> Vec<Finding> {
    let fault = |line: &str| {
        let seen = ["vk::", "ash::"]
            .iter()
            .any(|path| has_word(&line.replace("::", ":: "), path));
        seen.then(|| line.trim().to_owned())
    };
    tree.files
        .iter()
        .filter(|file| file.is_rust() && !is_gpu(file))
        .flat_map(|file| lines_with(file, &file.code, fault))
        .collect()
}

pub fn shader_says_what_it_is(tree: &Tree) -> Vec<Finding> {
    let shaders = tree
        .files
        .iter()
        .filter(|file| file.path.ends_with(".comp") || file.path.ends_with(".glsl"));
    let first_line = |file: &&SourceFile| {
        file.text
            .lines()
            .find(|line| !line.starts_with("#version"))
            .unwrap_or_default()
            .to_owned()
    };
    let silent = shaders.filter(|file| !first_line(file).starts_with("//"));
    let what = "the first line is no comment".to_owned();
    silent
        .map(|file| Finding {
            path: file.path.clone(),
            line: 1,
            what: what.clone(),
        })
        .collect()
}

pub fn kernel_has_its_stem(tree: &Tree) -> Vec<Finding> {
    let kernels = tree
        .files
        .iter()
        .filter(|file| file.path.starts_with("shaders/") && file.path.ends_with(".comp"));
    let alone = kernels.filter_map(|file| {
        let stem = KERNELS_OF_A_STAGE
            .iter()
            .find(|(kernel, _)| *kernel == file.stem())
            .map_or(file.stem(), |(_, stage)| stage);
        let places = [
            "engine/render/src/stages",
            "engine/render/src/twins",
            "tests/stages",
        ];
        let exists = |path: String| tree.files.iter().any(|other| other.path == path);
        let missing: Vec<String> = (places.iter().map(|folder| format!("{folder}/{stem}")))
            .filter(|path| !exists(format!("{path}.rs")) && !exists(format!("{path}/mod.rs")))
            .map(|path| path + ".rs")
            .collect();
        let finding = || Finding {
            path: file.path.clone(),
            line: 0,
            what: format!("missing: {}", missing.join(", ")),
        };
        (!missing.is_empty()).then(finding)
    });
    alone.collect()
}

pub fn crates_depend_one_way(tree: &Tree) -> Vec<Finding> {
    let depends = |file: &SourceFile, allowed: &[&str]| {
        let tests_from = file
            .text
            .find("[dev-dependencies]")
            .unwrap_or(file.text.len());
        let is_for_tests =
            |line: &str| line.as_ptr().addr() - file.text.as_ptr().addr() > tests_from;
        let fault = |line: &str| {
            let used = line
                .split(['.', ' ', '='])
                .next()
                .filter(|name| *name == "decouplegs" || name.starts_with("decouplegs-"))?;
            let may_test =
                is_for_tests(line) && MAY_TEST_WITH.contains(&(file.path.as_str(), used));
            (!allowed.contains(&used) && !may_test).then(|| format!("{used} is above or beside it"))
        };
        lines_with(file, &file.text, fault)
    };
    let known = tree
        .files
        .iter()
        .filter_map(|file| Some((file, MAY_USE.iter().find(|(path, _)| *path == file.path)?.1)));
    known
        .flat_map(|(file, allowed)| depends(file, allowed))
        .collect()
}

pub fn crates_forbid_unsafe(tree: &Tree) -> Vec<Finding> {
    let is_first = |file: &&SourceFile| {
        (file.name() == "main.rs" && !is_test(file)) || file.name() == "lib.rs"
    };
    let safe = |file: &&SourceFile| is_first(file) && !is_gpu(file) && !is_boundary(file);
    let open = tree
        .files
        .iter()
        .filter(|file| safe(file) && !file.code.contains("#![forbid(unsafe_code)]"));
    open.map(|file| Finding {
        path: file.path.clone(),
        line: 0,
        what: "#![forbid(unsafe_code)] is missing".into(),
    })
    .collect()
}

/// True for tests, whose tables of cases are long.
fn is_test(file: &SourceFile) -> bool {
    file.path.starts_with("tests/") || file.path.contains("/tests/") || file.stem() == "tests"
}

pub fn files_have_an_end(tree: &Tree) -> Vec<Finding> {
    const LINES_MAX: usize = 550;
    const TEST_LINES_MAX: usize = 600;
    let sources = tree.files.iter().filter(|file| file.is_source());
    let long = sources
        .map(|file| (file, file.text.lines().count()))
        .filter(|(file, lines)| {
            *lines
                > if is_test(file) {
                    TEST_LINES_MAX
                } else {
                    LINES_MAX
                }
        });
    long.map(|(file, lines)| Finding {
        path: file.path.clone(),
        line: 0,
        what: format!("{lines} lines"),
    })
    .collect()
}

pub fn no_machine_paths(tree: &Tree) -> Vec<Finding> {
    let folders = [
        concat!("/wo", "rk"),
        concat!("/ro", "ot"),
        concat!("/t", "mp"),
        concat!("/ho", "me"),
    ];
    let fault = |line: &str| {
        let absolute = |folder: &&&str| {
            line.match_indices(**folder).any(|(at, found)| {
                let starts =
                    !line[..at].ends_with(|c: char| c.is_alphanumeric() || "_.-})*".contains(c));
                starts
                    && !line[at + found.len()..]
                        .starts_with(|c: char| c.is_alphanumeric() || "_-".contains(c))
            })
        };
        folders
            .iter()
            .find(absolute)
            .map(|folder| format!("{folder} in {:?}", line.trim()))
    };
    let read_by_others = tree
        .files
        .iter()
        .filter(|file| !file.path.starts_with("tests/"));
    read_by_others
        .flat_map(|file| lines_with(file, &file.text, fault))
        .collect()
}

pub fn functions_fit_a_screen(tree: &Tree) -> Vec<Finding> {
    const LINES_MAX: usize = 95;
    const TEST_LINES_MAX: usize = 160;
    let mut findings = Vec::new();
    for file in tree.files.iter().filter(|file| file.is_rust()) {
        for (line, function) in functions(&file.code) {
            let lines = function_lines(function);
            let most = if is_test(file) {
                TEST_LINES_MAX
            } else {
                LINES_MAX
            };
            if lines > most {
                findings.push(Finding {
                    path: file.path.clone(),
                    line,
                    what: format!("a function of {lines} lines"),
                });
            }
        }
    }
    findings
}

/// Lines from the start of `code` to the brace that closes its first block; 0 where a `;` comes
/// before any block.
fn function_lines(code: &str) -> usize {
    let (mut braces, mut brackets) = (0_usize, 0_usize);
    for (at, c) in code.char_indices() {
        match c {
            '[' => brackets += 1,
            ']' => brackets = brackets.saturating_sub(1),
            // Inside brackets it is the type [T; N].
            ';' if braces == 0 && brackets == 0 => return 0,
            '{' => braces += 1,
            '}' if braces == 1 => return code[..=at].lines().count(),
            '}' => braces = braces.saturating_sub(1),
            _ => {}
        }
    }
    0
}

/// Functions called `of`: at the call, `X::of(y)` does not say what is made.
pub fn no_function_is_called_of(tree: &Tree) -> Vec<Finding> {
    let fault = |line: &str| {
        let mut functions = words_at(line, concat!("fn ", "of"));
        let found = functions.any(|at| line[at + "fn of".len()..].starts_with(['(', '<']));
        found.then(|| "a function called `of`: new, from_*, for_*, or what it returns".to_owned())
    };
    let files = tree.files.iter().filter(|file| file.is_rust());
    files
        .flat_map(|file| lines_with(file, &file.code, fault))
        .collect()
}
