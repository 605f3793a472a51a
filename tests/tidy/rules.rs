//! The rules. Words that a rule forbids are put together from halves here, so that this file keeps the rules too.

use super::tree::{SourceFile, Tree};
use super::{Finding, Rule};

/// Kernels that belong to a stage of another name, as `(kernel, stage)`: a stage of several dispatches has one file.
const KERNELS_OF_A_STAGE: &[(&str, &str)] = &[("sort_count", "sort"), ("sort_scan", "sort"), ("sort_scatter", "sort")];

/// Every rule.
pub const RULES: &[Rule] = &[
    Rule {
        name: "nothing is left undone: finish it, or write an issue",
        check: nothing_undone,
        kept_by: &[("engine/a.rs", "// A todo list is a list.\nlet unimplemented = 1;")],
        broken_by: &[
            ("engine/a.rs", concat!("// TO", "DO: later")),
            ("shaders/a.comp", concat!("// FIX", "ME")),
            ("tools/a.rs", concat!("fn a() { unimpl", "emented!() }")),
            ("tests/a.rs", concat!("#[ign", "ore = \"slow\"]\nfn a() {}")),
        ],
    },
    Rule {
        name: "a file is named for its subject",
        check: named_for_a_subject,
        kept_by: &[("engine/gpu/src/memory.rs", "")],
        broken_by: &[
            ("engine/gpu/src/utils.rs", ""),
            ("engine/scene/src/common/pose.rs", ""),
            ("tools/resource_manager.rs", ""),
            ("shaders/include/helpers.glsl", ""),
        ],
    },
    Rule {
        name: "unsafe code stays in engine/gpu",
        check: unsafe_only_in_gpu,
        kept_by: &[
            ("engine/gpu/src/a.rs", "// SAFETY: checked above.\nunsafe { a() }"),
            ("tools/main.rs", "#![forbid(unsafe_code)]\n// unsafe in a comment\nlet a = \"unsafe\";"),
        ],
        broken_by: &[("engine/render/src/a.rs", "fn a() { unsafe { b() } }")],
    },
    Rule {
        name: "every unsafe block and impl says above it why it is sound, after 'SAFETY:'",
        check: unsafe_is_explained,
        kept_by: &[(
            "engine/gpu/src/a.rs",
            "// SAFETY: `b` outlives the call,\n// and nobody else has it.\nlet a =\n    unsafe { b() };\nunsafe fn c() {}",
        )],
        broken_by: &[
            ("engine/gpu/src/a.rs", "fn a() {\n    unsafe { b() };\n}"),
            ("engine/gpu/src/a.rs", "// SAFETY: this is about the first.\nlet a = 1;\nlet b = unsafe { c() };"),
            ("engine/gpu/src/a.rs", "/// A thing.\nunsafe impl Send for A {}"),
        ],
    },
    Rule {
        name: "Vulkan's types stay in engine/gpu",
        check: vulkan_only_in_gpu,
        kept_by: &[("engine/gpu/src/a.rs", "use ash::vk;"), ("engine/render/src/a.rs", "// as vk::Buffer is to gpu")],
        broken_by: &[("engine/render/src/a.rs", "fn a(buffer: vk::Buffer) {}"), ("tools/a.rs", "use ash::Entry;")],
    },
    Rule {
        name: "a shader says in its first line, behind #version, what it is",
        check: shader_says_what_it_is,
        kept_by: &[("shaders/include/a.glsl", "// The constants.\n"), ("shaders/b.comp", "#version 460\n// Adds.\n")],
        broken_by: &[("shaders/a.comp", "#version 460\nlayout(local_size_x = 64) in;\n// Adds.\n"), ("shaders/b.glsl", "")],
    },
    Rule {
        name: "a kernel shares its stem with the stage that runs it",
        check: kernel_has_a_stage,
        kept_by: &[("shaders/a.comp", "// A"), ("engine/render/src/stages/a.rs", ""), ("shaders/include/b.glsl", "// B")],
        broken_by: &[("shaders/a.comp", "// A")],
    },
    Rule {
        name: "no path of one machine in what others read",
        check: no_machine_paths,
        kept_by: &[("README.md", "a framework/root of the /temporary kind"), ("tests/a.rs", concat!("\"/t", "mp/x\""))],
        broken_by: &[
            ("README.md", concat!("see /wo", "rk/main")),
            ("tools/a.rs", concat!("let a = \"/t", "mp\";")),
            (".ci/run", concat!("cd /ro", "ot/a")),
            ("benches/README.md", concat!("in /ho", "me/someone")),
        ],
    },
    Rule {
        name: "a function fits a screen: 70 lines",
        check: functions_fit_a_screen,
        kept_by: &[("engine/a.rs", "fn a() -> u32 {\n    { 1 }\n}\ntrait B { fn b(); }\n")],
        broken_by: &[(
            "engine/a.rs",
            // 71 lines.
            "fn a() {\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n\n}\n",
        )],
    },
];

/// Findings for the lines of `texts` in which `fault` sees one.
fn lines_with(file: &SourceFile, text: &str, fault: impl Fn(&str) -> Option<String>) -> Vec<Finding> {
    let lines = text.lines().enumerate();
    lines.filter_map(|(i, line)| Some(Finding { path: file.path.clone(), line: i + 1, what: fault(line)? })).collect()
}

/// Whether `word` stands in `text` with nothing of a name on either side.
fn has_word(text: &str, word: &str) -> bool {
    let part_of_a_name = |c: char| c.is_alphanumeric() || c == '_';
    text.match_indices(word)
        .any(|(at, _)| !text[..at].ends_with(part_of_a_name) && !text[at + word.len()..].starts_with(part_of_a_name))
}

fn nothing_undone(tree: &Tree) -> Vec<Finding> {
    let words = [concat!("TO", "DO"), concat!("FIX", "ME"), concat!("XX", "X")];
    let code = [concat!("to", "do!"), concat!("unimpl", "emented!"), concat!("#[ign", "ore")];
    let fault = |line: &str| {
        let word = words.iter().find(|word| has_word(line, word));
        word.or_else(|| code.iter().find(|part| line.contains(*part))).map(|found| format!("{found} in {:?}", line.trim()))
    };
    tree.files.iter().flat_map(|file| lines_with(file, &file.text, fault)).collect()
}

fn named_for_a_subject(tree: &Tree) -> Vec<Finding> {
    let empty_words = ["util", "utils", "helper", "helpers", "common", "manager", "misc"];
    let parts_of = |path: &str| -> Vec<String> { path.split(['/', '.', '_', '-']).map(str::to_lowercase).collect() };
    let bad = tree.files.iter().filter_map(|file| {
        let parts = parts_of(&file.path);
        let word = parts.iter().find(|part| empty_words.contains(&part.as_str()))?;
        Some(Finding { path: file.path.clone(), line: 0, what: format!("{word:?} names no subject") })
    });
    bad.collect()
}

fn is_gpu(file: &SourceFile) -> bool {
    file.path.starts_with("engine/gpu/")
}

fn unsafe_only_in_gpu(tree: &Tree) -> Vec<Finding> {
    let fault = |line: &str| has_word(line, "unsafe").then(|| line.trim().to_owned());
    tree.files
        .iter()
        .filter(|file| file.is_rust() && !is_gpu(file))
        .flat_map(|file| lines_with(file, &file.code, fault))
        .collect()
}

fn unsafe_is_explained(tree: &Tree) -> Vec<Finding> {
    let mut findings = Vec::new();
    for file in tree.files.iter().filter(|file| file.is_rust()) {
        let lines: Vec<(&str, &str)> = file.text.lines().zip(file.code.lines()).collect();
        for (i, (_, code)) in lines.iter().enumerate() {
            let opens = code.split("unsafe").skip(1).any(|rest| {
                let rest = rest.trim_start();
                rest.starts_with('{') || rest.starts_with("impl") || rest.is_empty()
            });
            if opens && has_word(code, "unsafe") && !explained(&lines[..=i]) {
                findings.push(Finding { path: file.path.clone(), line: i + 1, what: code.trim().to_owned() });
            }
        }
    }
    findings
}

/// Whether a comment with the word stands on the last of `lines` or in front of the statement that ends there.
fn explained(lines: &[(&str, &str)]) -> bool {
    let (last, above) = lines.split_last().expect("there is the line with the block");
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

fn vulkan_only_in_gpu(tree: &Tree) -> Vec<Finding> {
    let fault = |line: &str| {
        let seen = ["vk::", "ash::"].iter().any(|path| has_word(&line.replace("::", ":: "), path));
        seen.then(|| line.trim().to_owned())
    };
    tree.files
        .iter()
        .filter(|file| file.is_rust() && !is_gpu(file))
        .flat_map(|file| lines_with(file, &file.code, fault))
        .collect()
}

fn shader_says_what_it_is(tree: &Tree) -> Vec<Finding> {
    let shaders = tree.files.iter().filter(|file| file.path.ends_with(".comp") || file.path.ends_with(".glsl"));
    let first_line =
        |file: &&SourceFile| file.text.lines().find(|line| !line.starts_with("#version")).unwrap_or_default().to_owned();
    let silent = shaders.filter(|file| !first_line(file).starts_with("//"));
    let what = "the first line is no comment".to_owned();
    silent.map(|file| Finding { path: file.path.clone(), line: 1, what: what.clone() }).collect()
}

fn kernel_has_a_stage(tree: &Tree) -> Vec<Finding> {
    let kernels = tree.files.iter().filter(|file| file.path.starts_with("shaders/") && file.path.ends_with(".comp"));
    let alone = kernels.filter_map(|file| {
        let stage = KERNELS_OF_A_STAGE.iter().find(|(kernel, _)| *kernel == file.stem()).map_or(file.stem(), |(_, stage)| stage);
        let twin = format!("engine/render/src/stages/{stage}.rs");
        let missing = !tree.files.iter().any(|other| other.path == twin);
        missing.then(|| Finding { path: file.path.clone(), line: 0, what: format!("{twin} does not exist") })
    });
    alone.collect()
}

fn no_machine_paths(tree: &Tree) -> Vec<Finding> {
    let folders = [concat!("/wo", "rk"), concat!("/ro", "ot"), concat!("/t", "mp"), concat!("/ho", "me")];
    let fault = |line: &str| {
        let absolute = |folder: &&&str| {
            line.match_indices(**folder).any(|(at, found)| {
                let starts = !line[..at].ends_with(|c: char| c.is_alphanumeric() || "_.-})*".contains(c));
                starts && !line[at + found.len()..].starts_with(|c: char| c.is_alphanumeric() || "_-".contains(c))
            })
        };
        folders.iter().find(absolute).map(|folder| format!("{folder} in {:?}", line.trim()))
    };
    let read_by_others = tree.files.iter().filter(|file| !file.path.starts_with("tests/"));
    read_by_others.flat_map(|file| lines_with(file, &file.text, fault)).collect()
}

fn functions_fit_a_screen(tree: &Tree) -> Vec<Finding> {
    const LINES_MAX: usize = 70;
    let mut findings = Vec::new();
    for file in tree.files.iter().filter(|file| file.is_rust()) {
        for (at, _) in file.code.match_indices("fn ") {
            let starts_a_word = !file.code[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_');
            let lines = function_lines(&file.code[at..]);
            if starts_a_word && lines > LINES_MAX {
                let line = file.code[..at].lines().count().max(1);
                findings.push(Finding { path: file.path.clone(), line, what: format!("a function of {lines} lines") });
            }
        }
    }
    findings
}

/// Lines from the start of `code` to the brace that closes its first block; 0 where a `;` comes before any block.
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
