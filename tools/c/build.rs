//! Names the shared library by the version of its functions and structs, so that programs which
//! were linked with one version are not started with another.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    if std::env::var("CARGO_CFG_TARGET_OS").is_ok_and(|system| system == "linux") {
        // The number is DGS_ABI_VERSION; a test compares them.
        println!("cargo::rustc-cdylib-link-arg=-Wl,-soname,libdecouplegs_c.so.1");
    }
}
