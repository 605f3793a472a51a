//! Compiles every `.comp` of this folder to `spirv/NAME.spv` with shaderc, and writes the interface
//! of each as Rust to `interfaces/NAME.rs`. With `--check` it writes nothing and fails if a file
//! would change.

mod rust_source;

use std::env;
use std::process::ExitCode;

use rust_source::rust_files;

include!("sources.rs");

fn main() -> ExitCode {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let check = match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [] => false,
        ["--check"] => true,
        _ => {
            eprintln!("Usage: compile-shaders [--check]");
            return ExitCode::from(2);
        }
    };
    let shaders = Path::new(env!("CARGO_MANIFEST_DIR"));
    match run(shaders, check) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}

/// Compiles the shaders and writes or compares the results.
fn run(shaders: &Path, check: bool) -> Result<(), String> {
    let folder = shaders.join("spirv");
    let compiler =
        shaderc::Compiler::new().map_err(|error| format!("shaderc does not start: {error}"))?;
    let mut files = vec![(folder.join(DIGESTS), digests(shaders).into_bytes())];
    let mut modules = Vec::new();
    for path in paths_with(shaders, "comp") {
        let name = name_of(&path).trim_end_matches(".comp").to_owned();
        let bytes = compile(&compiler, shaders, &path)?;
        files.push((folder.join(format!("{name}.spv")), bytes.clone()));
        modules.push((name, bytes));
    }
    let interfaces = shaders.join("interfaces");
    files.extend(rust_files(&modules, &interfaces)?);
    let deleted: Vec<PathBuf> = [paths_with(&folder, "spv"), paths_with(&interfaces, "rs")]
        .concat()
        .into_iter()
        .filter(|path| !files.iter().any(|(file, _)| file == path))
        .collect();
    if check {
        let differs =
            |(path, content): &&(PathBuf, Vec<u8>)| fs::read(path).ok().as_ref() != Some(content);
        let mut stale: Vec<&str> = files
            .iter()
            .filter(differs)
            .map(|(path, _)| name_of(path))
            .collect();
        stale.extend(deleted.iter().map(|path| name_of(path)));
        return match stale[..] {
            [] => Ok(()),
            _ => Err(format!(
                "shaders/spirv and shaders/interfaces are not what is made of the shaders: {}. Run `make shaders`.",
                stale.join(", ")
            )),
        };
    }
    for (path, content) in &files {
        fs::write(path, content).map_err(|error| format!("{}: {error}", path.display()))?;
    }
    for path in &deleted {
        fs::remove_file(path).map_err(|error| format!("{}: {error}", path.display()))?;
    }
    Ok(())
}

/// SPIR-V of one kernel, little endian.
fn compile(compiler: &shaderc::Compiler, shaders: &Path, path: &Path) -> Result<Vec<u8>, String> {
    let mut options =
        shaderc::CompileOptions::new().map_err(|error| format!("shaderc options: {error}"))?;
    options.set_target_env(
        shaderc::TargetEnv::Vulkan,
        shaderc::EnvVersion::Vulkan1_3 as u32,
    );
    options.set_optimization_level(shaderc::OptimizationLevel::Performance);
    // Interfaces have the names in the source: debug information keeps them.
    options.set_generate_debug_info();
    options.set_warnings_as_errors();
    options.set_include_callback(|name, _, _, _| {
        let path = shaders.join("include").join(name);
        let content =
            fs::read_to_string(&path).map_err(|error| format!("{}: {error}", path.display()))?;
        Ok(shaderc::ResolvedInclude {
            resolved_name: name.to_owned(),
            content,
        })
    });
    let artifact = compiler
        .compile_into_spirv(
            &text_of(path),
            shaderc::ShaderKind::Compute,
            name_of(path),
            "main",
            Some(&options),
        )
        .map_err(|error| error.to_string())?;
    Ok(artifact
        .as_binary()
        .iter()
        .flat_map(|word| word.to_le_bytes())
        .collect())
}
