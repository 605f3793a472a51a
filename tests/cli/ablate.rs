//! `decouplegs ablate`, small.

use std::path::PathBuf;

use decouplegs::asset::{LightTransferFile, write_light_transfer};
use decouplegs::scene::{AmbientDescriptor, LightTransfer, sh};

use super::*;

/// A light transfer that leaves colors as they are in gray light of a half, and makes them as
/// bright as light is otherwise.
fn transfer(folder: &Path) -> PathBuf {
    let path = folder.join("theta.safetensors");
    let row = ([0.0; AmbientDescriptor::LEN], 0.0);
    let mut transfer = LightTransfer {
        sh_degree: 0,
        gain: vec![row; 3],
        offset: vec![row; 3],
        neutral: AmbientDescriptor::uniform([0.5; 3]),
        confidence: None,
    };
    for channel in 0..3 {
        transfer.gain[channel].0[channel] = 2.0 * sh::Y0 as f32;
    }
    let file = LightTransferFile {
        transfer,
        tool_version: "0".into(),
        sources: [].into(),
        settings: [].into(),
    };
    write_light_transfer(&path, &file).unwrap();
    path
}

const SMALL: [&str; 18] = [
    "--background",
    "4000",
    "--agents",
    "2",
    "--agent-splats",
    "400",
    "--size",
    "96x54",
    "--moments",
    "1",
    "--frames",
    "3",
    "--views",
    "4",
    "--cameras-used",
    "3",
    "--seed",
    "1",
];

#[test]
fn cars_are_put_back_and_the_system_is_measured_without_its_parts() {
    let folder = tempfile::tempdir().unwrap();
    let [page, figures] = ["ablate.html", "ablate.json"].map(|name| folder.path().join(name));
    let light = transfer(folder.path());
    let files = [
        "ablate",
        "--light",
        text(&light),
        "--out",
        text(&page),
        "--json",
        text(&figures),
    ];
    let said = succeed(
        &[
            &files[..],
            &SMALL,
            &["--weather", "clear", "--weather", "dusk"],
        ]
        .concat(),
    );
    let figures: Value =
        serde_json::from_slice(&fs::read(figures).unwrap()).expect("--json writes JSON");

    let weathers = figures["reinsertion"].as_array().unwrap();
    assert_eq!(
        weathers
            .iter()
            .map(|found| found["weather"].as_str().unwrap())
            .collect::<Vec<_>>(),
        ["clear", "dusk"]
    );
    for weather in weathers {
        let psnr_db = |name: &str| {
            let arm = weather["arms"]
                .as_array()
                .unwrap()
                .iter()
                .find(|arm| arm["arm"] == name);
            let vehicles = &arm.unwrap_or_else(|| panic!("no arm {name}"))["vehicles"];
            assert!(
                vehicles["pixels"].as_u64().unwrap() > 0
                    && vehicles["angle_deg"]["max"].is_number(),
                "{vehicles}"
            );
            vehicles["psnr_db"].as_f64().unwrap()
        };
        let arms = [
            "no relighting",
            "ours",
            "ours, no shadows",
            "ours, uncompressed",
            "best affine on DC",
        ];
        let best = psnr_db("truth colors, compressed");
        assert!(
            arms.iter().all(|arm| psnr_db(arm) < best),
            "nothing is nearer than the truth itself: {weather}"
        );
        let is_dusk = weather["weather"] == "dusk";
        assert!(
            !is_dusk || psnr_db("best affine on DC") > psnr_db("no relighting"),
            "dusk is not white: {weather}"
        );
    }

    let rows = figures["system"]["rows"].as_array().unwrap();
    let row = |name: &str| {
        rows.iter()
            .find(|row| row["row"] == name)
            .unwrap_or_else(|| panic!("no row {name}"))
    };
    assert_eq!(
        (rows.len(), &figures["system"]["weather"]),
        (5, &"clear".into())
    );
    assert!(
        rows.iter()
            .all(|row| row["images_per_s"].as_f64().unwrap() > 0.0)
    );
    let error_m = |name: &str, of: &str| row(name)["placing"][of].as_f64().unwrap();
    for of in ["ade_truth_m", "ade_lane_m"] {
        let [full, logged] = ["full", "no map-guided registration"].map(|name| error_m(name, of));
        assert!(full < logged && logged > 0.3, "{of}: {full} {logged}");
    }
    let angle_deg = |name: &str, at: &str| row(name)[at]["angle_deg"]["mean"].as_f64().unwrap();
    assert_eq!(
        angle_deg("full", "at_truth"),
        angle_deg("no map-guided registration", "at_truth")
    );
    assert_ne!(
        angle_deg("full", "as_placed"),
        angle_deg("no map-guided registration", "as_placed")
    );
    assert_eq!(row("full")["paper"]["fps"], 35.4);

    let page = fs::read_to_string(page).unwrap();
    stress::assert_page_stands_alone(&page);
    for part in [
        "truth colors, compressed",
        "no map-guided registration",
        "data:image/png;base64,",
        "<svg",
        "RTX 4090",
    ] {
        assert!(page.contains(part), "{part}");
    }
    assert!(
        said.contains("dusk") && said.contains("no asset compression"),
        "{said}"
    );
}

#[test]
fn without_drift_there_is_nothing_to_register() {
    let folder = tempfile::tempdir().unwrap();
    let [page, figures] = ["ablate.html", "ablate.json"].map(|name| folder.path().join(name));
    let light = transfer(folder.path());
    let files = [
        "ablate",
        "--light",
        text(&light),
        "--out",
        text(&page),
        "--json",
        text(&figures),
        "--weather",
        "overcast",
    ];
    succeed(
        &[
            &files[..],
            &SMALL,
            &["--drift-m", "0", "--drift-deg", "0", "--noise-m", "0"],
        ]
        .concat(),
    );
    let figures: Value = serde_json::from_slice(&fs::read(figures).unwrap()).unwrap();
    let rows = figures["system"]["rows"].as_array().unwrap();
    let logged = rows
        .iter()
        .find(|row| row["row"] == "no map-guided registration")
        .unwrap();
    assert!(
        logged["placing"]["ade_truth_m"].as_f64().unwrap() < 1e-9,
        "{logged}"
    );
    assert_eq!(
        logged["as_placed"], logged["at_truth"],
        "cars stand where they truly stand"
    );
}

#[test]
fn nonsense_is_refused_with_what_there_is() {
    let folder = tempfile::tempdir().unwrap();
    let light = transfer(folder.path());
    let page = folder.path().join("ablate.html");
    let run = |more: &[&'static str]| {
        [
            &["ablate", "--light", text(&light), "--out", text(&page)][..],
            more,
        ]
        .concat()
    };
    assert!(fail(2, &["ablate"]).contains("--light"));
    assert!(fail(2, &run(&["--weather", "fog"])).contains("overcast"));
    assert!(fail(2, &run(&["--agents", "0"])).contains("at least 1"));
    assert!(fail(2, &run(&["--drift-m", "-1"])).contains("-1"));
    assert!(fail(2, &run(&["--size", "800"])).contains("800"));
    let missing = folder.path().join("none.safetensors");
    assert!(
        fail(
            1,
            &["ablate", "--light", text(&missing), "--out", text(&page)]
        )
        .contains("none.safetensors")
    );
    let nowhere = folder.path().join("none/ablate.html");
    assert!(
        fail(
            1,
            &["ablate", "--light", text(&light), "--out", text(&nowhere)]
        )
        .contains("make it first")
    );
    assert!(!page.exists());
}
