//! The example of the format's page, run by Python with the public `safetensors` package. Skipped,
//! aloud, without them.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use decouplegs_asset::write_coded;
use serde_json::Value;

use crate::sample::coded_cone;

/// A Python that has what the example imports; DECOUPLEGS_PYTHON names another than `python3`.
fn python() -> Option<PathBuf> {
    let python =
        std::env::var_os("DECOUPLEGS_PYTHON").map_or_else(|| "python3".into(), PathBuf::from);
    let tried = Command::new(&python)
        .args(["-c", "import safetensors, numpy"])
        .output();
    match tried {
        Ok(Output { status, .. }) if status.success() => return Some(python),
        Ok(Output { stderr, .. }) => println!(
            "skipped: {}: {}",
            python.display(),
            String::from_utf8_lossy(&stderr).trim()
        ),
        Err(error) => println!("skipped: {}: {error}", python.display()),
    }
    println!(
        "install the Python packages safetensors and numpy, or name a Python that has them in DECOUPLEGS_PYTHON"
    );
    None
}

/// The example of the format's page.
fn example() -> String {
    let page =
        std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("coded-asset.md"))
            .unwrap();
    let from = page.find("```python\n").expect("the page has an example") + "```python\n".len();
    let length = page[from..].find("```").expect("the example ends");
    page[from..from + length].to_owned()
}

/// True if `rows`, an array of arrays, are `expected` to one part in a million of the largest.
fn close<const N: usize>(rows: &Value, expected: &[[f32; N]]) -> bool {
    let most = expected
        .as_flattened()
        .iter()
        .fold(0.0f32, |most, value| most.max(value.abs()));
    let rows = rows.as_array().unwrap();
    let near = |(row, expected): (&Value, &[f32; N])| {
        (0..N).all(|column| {
            (row[column].as_f64().unwrap() - f64::from(expected[column])).abs()
                <= 1e-6 * f64::from(most)
        })
    };
    rows.len() == expected.len() && rows.iter().zip(expected).all(near)
}

#[test]
fn python_reads_what_is_drawn() {
    let Some(python) = python() else { return };
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("car.safetensors");
    let asset = coded_cone();
    write_coded(&path, &asset).unwrap();
    let results = "print(json.dumps([x.tolist() for x in (means, scales, opacities[:, None], colors.reshape(len(means), -1))]))";
    let run = Command::new(python)
        .current_dir(&directory)
        .arg("-c")
        .arg(example() + results)
        .output()
        .unwrap();
    assert!(
        run.status.success(),
        "{}",
        String::from_utf8_lossy(&run.stderr)
    );
    let found: Value = serde_json::from_slice(&run.stdout).unwrap();
    let drawn = asset.cloud.decoded(0);
    assert!(close(&found[0], &drawn.means), "means");
    let mut scales = drawn.scales.clone();
    scales
        .iter_mut()
        .for_each(|scales| scales.sort_by(|a, b| b.total_cmp(a)));
    assert!(close(&found[1], &scales), "scales");
    let opacities: Vec<[f32; 1]> = drawn.opacities.iter().map(|&opacity| [opacity]).collect();
    assert!(close(&found[2], &opacities), "opacities");
    let colors: Vec<[f32; 48]> = (0..drawn.len())
        .map(|splat| {
            let coefficients = [&[drawn.sh_dc[splat]], drawn.rest_of(splat)].concat();
            coefficients.into_flattened().try_into().unwrap()
        })
        .collect();
    assert!(close(&found[3], &colors), "colours");
    // The comparison can fail.
    let moved: Vec<[f32; 3]> = drawn
        .means
        .iter()
        .map(|&[x, y, z]| [x, y, z + 1e-4])
        .collect();
    assert!(!close(&found[0], &moved));
}
