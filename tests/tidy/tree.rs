//! The sources of the repository as text.

use std::fs;
use std::path::Path;

use super::code::code_only;

/// One file, its path relative to the repository with `/` between folders.
pub struct SourceFile {
    pub path: String,
    pub text: String,
    /// The text with comments and literals blanked out, line for line, if this is a Rust or GLSL
    /// file; else empty.
    pub code: String,
}

impl SourceFile {
    pub fn new(path: &str, text: &str) -> Self {
        let code = if is_source(path) {
            code_only(text)
        } else {
            String::new()
        };
        Self {
            path: path.to_owned(),
            text: text.to_owned(),
            code,
        }
    }

    pub fn name(&self) -> &str {
        self.path.rsplit('/').next().unwrap_or(&self.path)
    }

    pub fn stem(&self) -> &str {
        self.name().split('.').next().unwrap_or_default()
    }

    pub fn is_rust(&self) -> bool {
        self.path.ends_with(".rs")
    }

    /// True for Rust and GLSL.
    pub fn is_source(&self) -> bool {
        is_source(&self.path)
    }
}

fn is_source(path: &str) -> bool {
    [".rs", ".comp", ".glsl"]
        .iter()
        .any(|end| path.ends_with(end))
}

/// All files that people write.
pub struct Tree {
    pub files: Vec<SourceFile>,
}

impl Tree {
    pub fn of_repository() -> Self {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let mut files = Vec::new();
        collect(root, root, &mut files);
        files.sort_by(|a, b| a.path.cmp(&b.path));
        Self { files }
    }
}

/// Built or downloaded folders, at the top or in a fuzzing crate.
const NOT_OURS: [&str; 4] = ["target", "out", "corpus", "artifacts"];

/// True if people write the files of the folder with this name. Hidden folders are those of tools,
/// but for that of the CI run.
fn is_ours(folder: &str) -> bool {
    !NOT_OURS.contains(&folder) && (folder == ".ci" || !folder.starts_with('.'))
}

fn collect(root: &Path, folder: &Path, files: &mut Vec<SourceFile>) {
    for entry in fs::read_dir(folder).expect("the repository can be read") {
        let path = entry.expect("the repository can be read").path();
        let name = path
            .file_name()
            .and_then(|name| name.to_str())
            .unwrap_or_default();
        if path.is_dir() {
            if is_ours(name) {
                collect(root, &path, files);
            }
        } else if name == ".git" {
            // In a worktree this is a file of git's.
        } else if let Ok(text) = fs::read_to_string(&path) {
            // Images and other files that are not UTF-8 are passed over.
            let relative = path
                .strip_prefix(root)
                .expect("the walk stays inside the repository");
            files.push(SourceFile::new(
                &relative.to_string_lossy().replace('\\', "/"),
                &text,
            ));
        }
    }
}
