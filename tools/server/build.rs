//! Code from the messages in `proto/`, without a compiler from outside.

use std::error::Error;
use std::process::Command;

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo:rerun-if-changed=proto");
    let files = protox::compile(
        [
            "sensorsim.proto",
            "physics.proto",
            "lidar.proto",
            "egodriver.proto",
        ],
        ["proto"],
    )?;
    let mut messages = tonic_prost_build::Config::new();
    messages.enable_type_names();
    tonic_prost_build::configure()
        .bytes(".")
        .codec_path("crate::codec::BoundedCodec")
        .compile_fds_with_config(files, messages)?;
    println!(
        "cargo:rustc-env=DECOUPLEGS_GIT_HASH={}",
        git(&["rev-parse", "HEAD"]).unwrap_or_default()
    );
    if let Some(log) = git(&["rev-parse", "--git-path", "logs/HEAD"]) {
        println!("cargo:rerun-if-changed={log}");
    }
    Ok(())
}

/// Output of git in the folder of this package; none without git or without a repository.
fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    let said = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| said.trim().to_owned())
}
