//! `decouplegs calibrate-light`, small.

use std::path::PathBuf;

use super::*;

/// A lat-long image of 32 x 16 px with a bright spot in a colored sky, as Radiance HDR without run
/// lengths.
fn probe(folder: &Path, name: &str, spot: (i32, i32), sky: [u8; 3], sun: [u8; 3]) -> PathBuf {
    let mut bytes = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 16 +X 32\n".to_vec();
    for (y, x) in (0..16).flat_map(|y| (0..32).map(move |x| (y, x))) {
        let near = (x - spot.0).abs() + (y - spot.1).abs() < 4;
        let rgb = if near {
            sun
        } else if y < 8 {
            sky
        } else {
            [90, 80, 70]
        };
        // The shared exponent: 128 stands for 2^0 over mantissas of 256, 131 for eight times as
        // much.
        bytes.extend([rgb[0], rgb[1], rgb[2], if near { 131 } else { 128 }]);
    }
    let path = folder.join(name);
    fs::write(&path, bytes).unwrap();
    path
}

/// Seven of them that differ in hue and height.
fn probes(folder: &Path) -> PathBuf {
    let probes = folder.join("probes");
    fs::create_dir_all(&probes).unwrap();
    probe(&probes, "a.hdr", (5, 2), [60, 90, 180], [250, 230, 200]);
    probe(&probes, "b.hdr", (15, 6), [180, 120, 90], [250, 150, 80]);
    probe(&probes, "c.hdr", (22, 4), [130, 130, 135], [180, 190, 220]);
    probe(&probes, "d.hdr", (28, 7), [40, 50, 70], [200, 240, 130]);
    probe(&probes, "e.hdr", (11, 5), [90, 160, 120], [240, 120, 220]);
    probe(&probes, "f.hdr", (18, 1), [100, 70, 110], [160, 250, 240]);
    probe(&probes, "g.hdr", (25, 3), [70, 110, 60], [250, 220, 90]);
    probes
}

fn car(folder: &Path) -> PathBuf {
    let sizes = [
        "--background",
        "10",
        "--agents",
        "1",
        "--agent-splats",
        "800",
        "--degree",
        "1",
        "--seed",
        "5",
    ];
    succeed(
        &[
            ["synth", "street", "--out", text(folder)].as_slice(),
            &sizes,
        ]
        .concat(),
    );
    folder.join("assets/car_00.ply")
}

#[test]
fn a_transfer_is_calibrated_measured_and_the_same_every_time() {
    let folder = tempfile::tempdir().unwrap();
    let (car, probes) = (car(folder.path()), probes(folder.path()));
    let [first, second, report] = ["first.safetensors", "second.safetensors", "report.html"]
        .map(|name| folder.path().join(name));
    let calibrated = |out: &Path, more: &[&str]| {
        let always = [
            "calibrate-light",
            text(&car),
            "--probes",
            text(&probes),
            "--out",
            text(out),
            "--samples",
            "200",
            "--force",
        ];
        succeed(&[&always, more].concat())
    };
    let said = calibrated(&first, &["--report", text(&report)]);
    for part in [
        "degree 1",
        "200 splats",
        "7 probes",
        "objective seen",
        "a.hdr",
        "g.hdr",
        "all",
    ] {
        assert!(said.contains(part), "{part}: {said}");
    }
    let all: Vec<&str> = said
        .lines()
        .find(|line| line.starts_with("all"))
        .expect("a total")
        .split_whitespace()
        .collect();
    let [none, relit, affine]: [f64; 3] = std::array::from_fn(|at| all[at + 1].parse().unwrap());
    assert!(affine <= relit && relit < none, "{said}");
    let html = fs::read_to_string(&report).unwrap();
    assert!(
        html.matches("data:image/png").count() == 7 * 4 + 2 && html.contains("d.hdr"),
        "images of seven probes"
    );

    calibrated(&second, &[]);
    let bytes = fs::read(&first).unwrap();
    assert!(
        bytes == fs::read(&second).unwrap(),
        "the same command wrote other bytes"
    );
    let header_end = 8 + u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    let header: Value = serde_json::from_slice(&bytes[8..header_end]).unwrap();
    assert_eq!(
        header["__metadata__"]["format"],
        "decouplegs-light-transfer"
    );
    assert_eq!(header["gain_weights"]["shape"], serde_json::json!([12, 27]));
    assert_eq!(
        header["__metadata__"]["sources.car_00.ply"]
            .as_str()
            .unwrap()
            .len(),
        64
    );

    calibrated(
        &second,
        &[
            "--objective",
            "coefficients",
            "--ridge",
            "0.01",
            "--degree",
            "0",
        ],
    );
    assert!(
        bytes != fs::read(&second).unwrap(),
        "other options wrote the same bytes"
    );
}

#[test]
fn what_cannot_be_calibrated_is_refused_and_nothing_is_left_behind() {
    let folder = tempfile::tempdir().unwrap();
    let car = car(folder.path());
    let (one, none) = (folder.path().join("one"), folder.path().join("none"));
    fs::create_dir(&one).unwrap();
    fs::create_dir(&none).unwrap();
    let only = probe(&one, "only.hdr", (5, 2), [60, 90, 180], [250, 230, 200]);
    let out = folder.path().join("theta.safetensors");
    let refused = |probes: &Path, more: &[&str]| {
        let always = [
            "calibrate-light",
            text(&car),
            "--probes",
            text(probes),
            "--out",
            text(&out),
            "--samples",
            "50",
        ];
        fail(1, &[&always, more].concat())
    };
    assert!(refused(&none, &[]).contains("no probe"));
    assert!(refused(&one, &["--rotations", "1"]).contains("at least 28"));
    let said = refused(&one, &[]);
    assert!(
        said.contains("of 28 dimensions") && said.contains("probes of other places"),
        "{said}"
    );
    assert!(refused(&one, &["--ridge=-1"]).contains("-1"));
    assert!(refused(&folder.path().join("absent"), &[]).contains("absent"));
    fs::write(
        &only,
        b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 16 +X 32\n\x05\x05",
    )
    .unwrap();
    assert!(refused(&one, &[]).contains("only.hdr"));
    assert!(!out.exists());
    let lone = folder.path().join("no such folder/theta.safetensors");
    let arguments = [
        "calibrate-light",
        text(&car),
        "--probes",
        text(&one),
        "--out",
        text(&lone),
    ];
    assert!(fail(1, &arguments).contains("no such folder"));
    assert!(fail(2, &["calibrate-light", "--probes", "a", "--out", "b"]).contains("ASSET"));
}
