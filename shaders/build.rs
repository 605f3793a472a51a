//! Compiles every `.comp` beside this file to SPIR-V and writes `kernels.rs`, one `pub static` a kernel. Numbers that the shared GLSL names
//! go to `constants.rs`, so that the host has them from there.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::{env, fs};

fn main() {
    let here = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").expect("cargo sets CARGO_MANIFEST_DIR"));
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    println!("cargo::rerun-if-changed={}", here.display());

    let compiler = shaderc::Compiler::new().expect("the shaderc compiler starts");
    let (mut source, mut names) = (String::new(), Vec::new());
    for path in paths_with(&here, "comp") {
        let stem = path.file_stem().and_then(|stem| stem.to_str()).expect("a shader's file name is UTF-8");
        let words = compile(&compiler, &here, &path);
        writeln!(
            source,
            "/// `{stem}.comp`.\npub static {}: Kernel = Kernel {{ name: \"{stem}\", spirv: &{words:?} }};",
            stem.to_uppercase()
        )
        .expect("writing to a string cannot fail");
        names.push(format!("&{}", stem.to_uppercase()));
    }
    writeln!(source, "/// All kernels.\npub static ALL: [&Kernel; {}] = [{}];", names.len(), names.join(", "))
        .expect("writing to a string cannot fail");
    fs::write(out.join("kernels.rs"), source).expect("OUT_DIR is writable");
    fs::write(out.join("constants.rs"), constants(&here.join("include"))).expect("OUT_DIR is writable");
}

/// A `pub const` for every line `const uint NAME = NUMBER;` or `const float NAME = NUMBER;` of the shared GLSL. Expressions are left out.
fn constants(folder: &Path) -> String {
    let mut source = String::new();
    for path in paths_with(folder, "glsl") {
        let file = path.file_name().and_then(|name| name.to_str()).expect("a shader's file name is UTF-8");
        let text = fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        for line in text.lines().filter_map(|line| line.strip_prefix("const ")) {
            let words: Vec<&str> = line.split(';').next().unwrap_or_default().split_whitespace().collect();
            let constant = match words[..] {
                ["uint", name, "=", value] => number(value.trim_end_matches('u')).map(|value| (name, "u32", value.to_string())),
                ["float", name, "=", value] => {
                    value.parse::<f64>().ok().map(|value| (name, "f32", format!("{value:?}_f64 as f32")))
                }
                _ => None,
            };
            if let Some((name, kind, value)) = constant {
                writeln!(source, "/// `{name}` of `{file}`.\npub const {name}: {kind} = {value};")
                    .expect("writing to a string cannot fail");
            }
        }
    }
    source
}

fn number(text: &str) -> Option<u32> {
    text.strip_prefix("0x").map_or_else(|| text.parse().ok(), |digits| u32::from_str_radix(digits, 16).ok())
}

fn paths_with(folder: &Path, ending: &str) -> Vec<PathBuf> {
    let mut paths: Vec<PathBuf> = fs::read_dir(folder)
        .expect("the shaders folder is readable")
        .map(|entry| entry.expect("the shaders folder is readable").path())
        .filter(|path| path.extension().is_some_and(|extension| extension == ending))
        .collect();
    paths.sort();
    paths
}

fn compile(compiler: &shaderc::Compiler, folder: &Path, path: &Path) -> Vec<u32> {
    let mut options = shaderc::CompileOptions::new().expect("shaderc options start");
    options.set_target_env(shaderc::TargetEnv::Vulkan, shaderc::EnvVersion::Vulkan1_3 as u32);
    options.set_optimization_level(shaderc::OptimizationLevel::Performance);
    // Kernels are bound by the names in the source: debug information keeps them.
    options.set_generate_debug_info();
    options.set_warnings_as_errors();
    options.set_include_callback(|name, _, _, _| {
        let path = folder.join("include").join(name);
        let content = fs::read_to_string(&path).map_err(|error| format!("{}: {error}", path.display()))?;
        Ok(shaderc::ResolvedInclude { resolved_name: name.to_owned(), content })
    });
    let text = fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let name = path.file_name().and_then(|name| name.to_str()).expect("a shader's file name is UTF-8");
    match compiler.compile_into_spirv(&text, shaderc::ShaderKind::Compute, name, "main", Some(&options)) {
        Ok(artifact) => artifact.as_binary().to_vec(),
        Err(error) => panic!("{error}"),
    }
}
