// Shader sources and their digests. Included by `build.rs` and by `compile.rs`, which must agree on
// them.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

/// Name of the list of digests, in the folder of the compiled kernels.
const DIGESTS: &str = "sources.txt";

/// Files of `folder` with `ending`, in the order of their names.
fn paths_with(folder: &Path, ending: &str) -> Vec<PathBuf> {
    let entries =
        fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut paths: Vec<PathBuf> = entries
        .map(|entry| {
            entry
                .expect("a readable folder has readable entries")
                .path()
        })
        .filter(|path| {
            path.extension()
                .is_some_and(|extension| extension == ending)
        })
        .collect();
    paths.sort();
    paths
}

/// Content of a source file. Panics with its name, since a build cannot go on without it.
fn text_of(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Name of a source file without its folder.
fn name_of(path: &Path) -> &str {
    path.file_name()
        .and_then(|name| name.to_str())
        .expect("a shader's file name is UTF-8")
}

/// One line per shader source, kernels first: its name and the FNV-1a hash (64 bits) of its
/// content. It detects a forgotten `make shaders`. Tampering is detected by recompiling, in
/// `.ci/run`.
fn digests(shaders: &Path) -> String {
    let mut lines = String::new();
    for path in [
        paths_with(shaders, "comp"),
        paths_with(&shaders.join("include"), "glsl"),
    ]
    .concat()
    {
        let hash = text_of(&path)
            .bytes()
            .fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
                (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
            });
        writeln!(lines, "{hash:016x} {}", name_of(&path)).expect("writing to a string cannot fail");
    }
    lines
}
