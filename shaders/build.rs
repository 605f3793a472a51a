//! Writes `kernels.rs` from the compiled kernels in `spirv`, one `pub static` per kernel, and
//! `constants.rs` from the numbers that the shared GLSL names. Fails if a shader is newer than its
//! SPIR-V.

use std::collections::BTreeSet;
use std::env;

include!("sources.rs");

fn main() {
    let here =
        PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").expect("cargo sets CARGO_MANIFEST_DIR"));
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    println!("cargo::rerun-if-changed={}", here.display());
    // The compiler itself must build while the kernels are stale.
    if env::var_os("CARGO_FEATURE_COMPILE").is_none() {
        refuse_stale_kernels(&here);
    }

    let (mut source, mut names) = (String::new(), Vec::new());
    for path in paths_with(&here.join("spirv"), "spv") {
        let stem = path
            .file_stem()
            .and_then(|stem| stem.to_str())
            .expect("a kernel's file name is UTF-8");
        let bytes = fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let (words, rest) = bytes.as_chunks::<4>();
        assert!(
            rest.is_empty(),
            "{}: {} bytes are not a whole number of words; run `make shaders`",
            path.display(),
            bytes.len()
        );
        let words: Vec<u32> = words.iter().map(|word| u32::from_le_bytes(*word)).collect();
        writeln!(
            source,
            "/// `{stem}.comp`.\npub static {}: Kernel = Kernel {{ name: \"{stem}\", spirv: &{words:?} }};",
            stem.to_uppercase()
        )
        .expect("writing to a string cannot fail");
        names.push(format!("&{}", stem.to_uppercase()));
    }
    writeln!(
        source,
        "/// All kernels.\npub static ALL: [&Kernel; {}] = [{}];",
        names.len(),
        names.join(", ")
    )
    .expect("writing to a string cannot fail");
    fs::write(out.join("kernels.rs"), source).expect("OUT_DIR is writable");
    fs::write(out.join("constants.rs"), constants(&here.join("include")))
        .expect("OUT_DIR is writable");
}

/// Panics with the names of the shaders whose digest is not the one that was compiled.
fn refuse_stale_kernels(shaders: &Path) {
    let (now, compiled) = (
        digests(shaders),
        text_of(&shaders.join("spirv").join(DIGESTS)),
    );
    let [now, compiled] = [&now, &compiled].map(|list| list.lines().collect::<BTreeSet<&str>>());
    let changed = now.symmetric_difference(&compiled);
    let stale: BTreeSet<&str> = changed
        .filter_map(|line| line.split_whitespace().last())
        .collect();
    assert!(
        stale.is_empty(),
        "shaders/spirv was compiled from another version of {}. Run `make shaders`, which compiles all shaders, and commit the result.",
        stale.into_iter().collect::<Vec<_>>().join(", ")
    );
}

/// A `pub const` for every line `const uint NAME = NUMBER;` or `const float NAME = NUMBER;` of the
/// shared GLSL. Expressions are left out.
fn constants(folder: &Path) -> String {
    let mut source = String::new();
    for path in paths_with(folder, "glsl") {
        let (file, text) = (name_of(&path), text_of(&path));
        for line in text.lines().filter_map(|line| line.strip_prefix("const ")) {
            let words: Vec<&str> = line
                .split(';')
                .next()
                .unwrap_or_default()
                .split_whitespace()
                .collect();
            let constant = match words[..] {
                ["uint", name, "=", value] => number(value.trim_end_matches('u'))
                    .map(|value| (name, "u32", value.to_string())),
                ["float", name, "=", value] => value
                    .parse::<f64>()
                    .ok()
                    .map(|value| (name, "f32", format!("{value:?}_f64 as f32"))),
                _ => None,
            };
            if let Some((name, kind, value)) = constant {
                writeln!(
                    source,
                    "/// `{name}` of `{file}`.\npub const {name}: {kind} = {value};"
                )
                .expect("writing to a string cannot fail");
            }
        }
    }
    source
}

fn number(text: &str) -> Option<u32> {
    text.strip_prefix("0x").map_or_else(
        || text.parse().ok(),
        |digits| u32::from_str_radix(digits, 16).ok(),
    )
}
