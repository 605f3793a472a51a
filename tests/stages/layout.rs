//! Constants that host and shaders both spell out. Their structures are compared when the host is
//! compiled (`shaders/interfaces/records.rs`).

use std::fs;
use std::path::Path;

use decouplegs::scene::{lidar, light, rules};

/// The number that a shader's `const NAME = ...` stands for: a number, or a quotient of two.
fn constant(text: &str, name: &str) -> Option<f64> {
    let line = text
        .lines()
        .find(|line| line.starts_with("const ") && line.split_whitespace().nth(2) == Some(name))?;
    let value = line.split('=').nth(1)?.split(';').next()?.trim();
    let number = |text: &str| text.trim().trim_end_matches('u').parse::<f64>().ok();
    match value.split_once('/') {
        Some((above, below)) => Some(number(above)? / number(below)?),
        None => number(value),
    }
}

#[test]
fn constants_of_the_rules_are_the_same_on_host_and_device() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("shaders");
    let paths = [folder.join("include"), folder]
        .into_iter()
        .flat_map(|folder| fs::read_dir(folder).unwrap())
        .map(|entry| entry.unwrap().path())
        .filter(|path| {
            let extension = path.extension().unwrap_or_default();
            extension == "glsl" || extension == "comp"
        });
    let texts: Vec<String> = paths
        .map(|path| fs::read_to_string(path).unwrap())
        .collect();
    let of = |name: &str| -> Vec<f64> {
        texts
            .iter()
            .filter_map(|text| constant(text, name))
            .collect()
    };
    for (name, expected) in [
        ("ALPHA_MIN", rules::ALPHA_MIN),
        ("TRANSMITTANCE_MIN", rules::TRANSMITTANCE_MIN),
        (
            "TRANSMITTANCE_MIN_INCLUSIVE",
            rules::TRANSMITTANCE_MIN_INCLUSIVE,
        ),
        ("DILATION_PX2", rules::DILATION_PX2),
        ("ECHO_SEPARATION_M", lidar::ECHO_SEPARATION_M),
        ("ECHO_WEIGHT_MIN", lidar::ECHO_WEIGHT_MIN),
        ("SHADING_LIGHT_MIN", light::LIGHT_MIN),
        ("SHADING_LIGHTS", light::SHADING_LIGHTS as f64),
    ] {
        assert_eq!(of(name), [expected], "{name}");
    }
    assert_eq!(constant("const float A = 1.0 / 4.0;", "A"), Some(0.25));
    assert_eq!(constant("const float A = 1.0 / 4.0;", "B"), None);
}
