//! Code from the messages in `proto/`, without a compiler from outside.

use std::error::Error;

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
    Ok(())
}
