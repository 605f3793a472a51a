//! Compiles every `.comp` beside this file to SPIR-V and writes `kernels.rs`, one `pub static` a kernel.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::{env, fs};

fn main() {
    let here = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").expect("cargo sets CARGO_MANIFEST_DIR"));
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    println!("cargo::rerun-if-changed={}", here.display());

    let compiler = shaderc::Compiler::new().expect("the shaderc compiler starts");
    let (mut source, mut names) = (String::new(), Vec::new());
    for path in kernel_paths(&here) {
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
}

fn kernel_paths(folder: &Path) -> Vec<PathBuf> {
    let mut paths: Vec<PathBuf> = fs::read_dir(folder)
        .expect("the shaders folder is readable")
        .map(|entry| entry.expect("the shaders folder is readable").path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "comp"))
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
