//! The commit that the server was built from.

use std::process::Command;

fn main() {
    println!(
        "cargo:rustc-env=DECOUPLEGS_GIT_HASH={}",
        git(&["rev-parse", "HEAD"]).unwrap_or_default()
    );
    if let Some(log) = git(&["rev-parse", "--git-path", "logs/HEAD"]) {
        println!("cargo:rerun-if-changed={log}");
    }
}

/// Output of git in the folder of this package; none without git or without a repository.
fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    let said = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| said.trim().to_owned())
}
