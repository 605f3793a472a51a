//! Modules of one crate that use each other, and files that are none.

use std::collections::BTreeSet;

use super::Finding;
use super::tree::{SourceFile, Tree};

/// Pairs of modules of one crate that use each other, as `(crate, first, second)`.
const MAY_USE_EACH_OTHER: &[(&str, &str, &str)] = &[
    ("engine/asset/src", "packed_scene", "scene_file"),
    ("engine/gpu/src", "queue", "ticket"),
    ("tools/c/src", "types", "world"),
];

/// The folder of the crate of a source file, and the module in it; none for tests and crate roots.
fn module_of(path: &str) -> Option<(&str, &str)> {
    let products = [
        "tools/cli/src",
        "tools/drive",
        "tools/alpasim",
        "tools/connections",
        "tools/server",
        "tools/view",
        "tools/c/src",
        "tools/python/src",
        "tools/python/sharing/src",
    ];
    let product = products
        .iter()
        .find(|root| path.starts_with(&format!("{root}/")));
    let root = match product {
        Some(root) => root,
        None if path.starts_with("tools/") => "tools",
        None => &path[..path.find("/src/")? + "/src".len()],
    };
    let rest = path.strip_prefix(root)?.strip_prefix('/')?;
    let module = rest.split(['/', '.']).next()?;
    let counts =
        rest.ends_with(".rs") && !rest.contains("tests") && !["lib", "main"].contains(&module);
    counts.then_some((root, module))
}

/// The modules that `code` names behind `crate::`.
fn modules_used(code: &str) -> impl Iterator<Item = &str> {
    code.split("crate::")
        .skip(1)
        .flat_map(|rest| match rest.strip_prefix('{') {
            Some(list) => outer_names(list),
            None => vec![name_at(rest)],
        })
}

/// The name with which `text` begins.
fn name_at(text: &str) -> &str {
    let end = text.find(|c: char| !c.is_alphanumeric() && c != '_');
    &text[..end.unwrap_or(text.len())]
}

/// The first name of each entry of a list in braces, whose opening brace is left out. Names in
/// braces within are members of these.
fn outer_names(list: &str) -> Vec<&str> {
    let (mut depth, mut start, mut names) = (0, 0, Vec::new());
    for (at, c) in list.char_indices() {
        match c {
            '{' => depth += 1,
            '}' if depth > 0 => depth -= 1,
            ',' | '}' if depth == 0 => {
                names.push(name_at(list[start..at].trim_start()));
                start = at + 1;
                if c == '}' {
                    break;
                }
            }
            _ => {}
        }
    }
    names
}

pub fn modules_do_not_use_each_other(tree: &Tree) -> Vec<Finding> {
    let sources = tree
        .files
        .iter()
        .filter_map(|file| Some((file, module_of(&file.path)?)));
    let uses: BTreeSet<(&str, &str, &str)> = sources
        .flat_map(|(file, (root, module))| {
            let product = file.code.split("#[cfg(test)]").next().unwrap_or("");
            modules_used(product).map(move |used| (root, module, used))
        })
        .collect();
    let each_other = uses.iter().filter(|&&(root, module, used)| {
        module < used
            && uses.contains(&(root, used, module))
            && !MAY_USE_EACH_OTHER.contains(&(root, module, used))
    });
    let finding = |(root, module, used): &(&str, &str, &str)| Finding {
        path: (*root).to_owned(),
        line: 0,
        what: format!("{module} and {used} use each other"),
    };
    each_other.map(finding).collect()
}

/// Folders whose Rust files are programs of their own.
const PROGRAMS_IN: [&str; 3] = ["examples", "fuzz_targets", "tests"];

/// A file that no other declares as its module is never compiled, and its tests never run.
pub fn every_file_is_a_module_of_another(tree: &Tree) -> Vec<Finding> {
    let rust = || tree.files.iter().filter(|file| file.is_rust());
    let manifests = || tree.files.iter().filter(|file| file.name() == "Cargo.toml");
    let lost = rust().filter(|file| {
        let folder = file.path.rsplit_once('/').map_or("", |(folder, _)| folder);
        let stem = file.stem();
        let is_program = ["main", "lib", "build"].contains(&stem)
            || PROGRAMS_IN
                .iter()
                .any(|name| folder.ends_with(name) && stem != "mod")
            || manifests().any(|manifest| manifest.text.contains(&format!("{}\"", file.name())));
        // The file `a/mod.rs` is the module `a` beside its folder.
        let (name, folder) = match stem {
            "mod" => folder
                .rsplit_once('/')
                .map_or((folder, ""), |(above, name)| (name, above)),
            _ => (stem, folder),
        };
        let declared = format!("mod {name};");
        // By an attribute, or by `include!`.
        let by_path = format!("{}\"", file.name());
        let declares = |other: &SourceFile| {
            let other_folder = other.path.rsplit_once('/').map_or("", |(folder, _)| folder);
            let is_near = other_folder == folder || other.path == format!("{folder}.rs");
            (is_near && other.code.contains(&declared)) || other.text.contains(&by_path)
        };
        !is_program && !rust().any(declares)
    });
    let finding = |file: &SourceFile| Finding {
        path: file.path.clone(),
        line: 0,
        what: "no file declares it as its module: it is never compiled".into(),
    };
    lost.map(finding).collect()
}
