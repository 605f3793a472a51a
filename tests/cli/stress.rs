//! `decouplegs stress`, small.

use super::*;

/// A few cars on a street of a few thousand splats, drawn small, with everything that a run may be
/// asked for.
fn small_stress(folder: &Path, more: &[&str]) -> (String, Value, String) {
    let [figures, page] = ["stress.json", "stress.html"].map(|name| folder.join(name));
    let street = [
        "stress",
        "--synth",
        "--background",
        "3000",
        "--agent-splats",
        "200",
        "--assets",
        "2",
        "--degree",
        "1",
    ];
    let size = [
        "--size",
        "96x64",
        "--cameras-used",
        "1",
        "--frames",
        "3",
        "--warm-up",
        "1",
        "--views",
        "4",
    ];
    let files = ["--json", text(&figures), "--report", text(&page)];
    let said = succeed(&[&street[..], &size, &files, more].concat());
    let figures = serde_json::from_slice(&fs::read(figures).unwrap()).expect("--json writes JSON");
    (said, figures, fs::read_to_string(page).unwrap())
}

fn point<'a>(figures: &'a Value, mode: &str, agents: usize) -> &'a Value {
    let points = figures["points"].as_array().unwrap();
    let found = points
        .iter()
        .find(|point| point["mode"] == mode && point["agents"] == agents);
    found.unwrap_or_else(|| panic!("no point of {mode} with {agents} agents: {figures}"))
}

#[test]
fn modes_are_measured_against_agents_and_compared_with_vanilla() {
    let folder = tempfile::tempdir().unwrap();
    let modes = "vanilla,prune,decoupled,decoupled-serial,sh0,keep=0.3";
    let (said, figures, page) = small_stress(
        folder.path(),
        &["--agents", "0,3", "--modes", modes, "--samples", "2"],
    );
    assert_eq!(
        (
            figures["points"].as_array().unwrap().len(),
            said.lines().count()
        ),
        (12, 13),
        "{said}"
    );
    assert_eq!(
        (
            &figures["width_px"],
            &figures["cameras"],
            &figures["background_splats"]
        ),
        (&96.into(), &1.into(), &3000.into())
    );
    // Frames 0 and 2 of 3, a tenth of a second apart: the warm-up takes nothing of the drive.
    let start_s = figures["start_s"].as_f64().unwrap();
    let sampled = figures["samples_s"]
        .as_array()
        .unwrap()
        .iter()
        .map(|time_s| time_s.as_f64().unwrap() - start_s);
    assert!(
        sampled
            .zip([0.0, 0.2])
            .all(|(found_s, expected_s)| (found_s - expected_s).abs() < 1e-9),
        "{figures}"
    );
    let splats = |mode, agents| {
        point(&figures, mode, agents)["world_splats"]
            .as_u64()
            .unwrap()
    };
    assert_eq!(
        [
            splats("vanilla", 3),
            splats("decoupled", 3),
            splats("prune", 3)
        ],
        [3600, 3000, 1224]
    );
    for mode in ["vanilla", "prune", "decoupled"] {
        let memory = &point(&figures, mode, 3)["memory_bytes"];
        let held = ["scene", "assets"]
            .iter()
            .filter_map(|purpose| memory["by_purpose"][*purpose].as_u64())
            .sum::<u64>();
        let predicted = memory["predicted_scene"].as_u64().unwrap();
        assert!(
            predicted <= held && held < predicted * 3 / 2,
            "{mode}: {memory}"
        );
        assert_eq!(
            memory["by_purpose"]
                .as_object()
                .unwrap()
                .values()
                .filter_map(Value::as_u64)
                .sum::<u64>(),
            memory["total"]
        );
    }
    let decibels = |mode, agents, of: &str| point(&figures, mode, agents)["fidelity"][of].as_f64();
    assert_eq!(
        point(&figures, "decoupled", 0)["fidelity"]["equal"],
        true,
        "without agents both draw the same splats"
    );
    let psnr_db = decibels("decoupled", 3, "psnr_all_db").expect("compression loses something");
    assert!(psnr_db > 30.0, "{psnr_db} dB");
    assert_eq!(
        Some(psnr_db),
        decibels("decoupled-serial", 3, "psnr_all_db"),
        "overlap changes no image"
    );
    assert!(
        decibels("keep=0.3", 3, "psnr_vehicles_db") < decibels("decoupled", 3, "psnr_vehicles_db"),
        "{figures}"
    );
    assert!(
        decibels("sh0", 3, "psnr_all_db").unwrap() < psnr_db,
        "{figures}"
    );
    assert!(
        point(&figures, "vanilla", 3)["fidelity"].is_null()
            && figures["memory_lines"]["total_by_agent"].is_object()
    );
    assert_page_stands_alone(&page);
    for part in [
        "S (1 to 2)",
        "no such count was measured",
        "M (3 to 5)",
        "data:image/png;base64,",
        "Vanilla is flattered",
        "keep=0.3",
    ] {
        assert!(page.contains(part), "{part}");
    }
}

/// Asserts that the page names no other resource, and holds no number that is none.
pub fn assert_page_stands_alone(page: &str) {
    // Bytes of images may spell anything.
    let mut parts = page.split(";base64,");
    let mut text = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        text.push_str(part.split_once('"').map_or("", |(_, after)| after));
    }
    for outside in [
        "http", "src=\"/", "@import", "url(", "<script", "<link", "NaN", "inf\"",
    ] {
        assert!(!text.contains(outside), "{outside} in the page");
    }
}

#[test]
fn a_mode_that_takes_too_much_memory_is_reported_and_the_run_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    // The copies of fifteen cars are 3000 splats: twice the background alone, which takes 229 kB.
    let more = [
        "--agents",
        "1,15",
        "--modes",
        "vanilla,decoupled",
        "--memory-limit",
        "400kB",
        "--samples",
        "0",
    ];
    let (said, figures, page) = small_stress(folder.path(), &more);
    let refused = &point(&figures, "vanilla", 15)["out_of_memory"];
    assert!(
        refused["needed_bytes"].as_u64().unwrap() > 400_000,
        "{refused}"
    );
    assert!(
        refused["known"].as_str().unwrap().contains("predicted"),
        "{refused}"
    );
    assert!(
        said.contains("out of memory") && page.contains("vanilla out of memory"),
        "{said}"
    );
    // What frames need beside the scene is known only afterwards.
    let counted = &point(&figures, "decoupled", 15)["out_of_memory"];
    assert!(
        counted["known"].as_str().unwrap().contains("counted"),
        "{counted}"
    );
    assert_page_stands_alone(&page);
}

#[test]
fn a_scene_file_brings_its_own_agents_compressed_or_not() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    small_asset(&folder.path().join("ball.safetensors"));
    let scene = folder.path().join("scene.toml");
    let agent = "\n[[agent]]\nname = \"ball\"\nasset = \"ball.safetensors\"\nposition_m = [-50.0, -5.0, 1.0]\n";
    fs::write(&scene, fs::read_to_string(&scene).unwrap() + agent).unwrap();
    let figures = folder.path().join("stress.json");
    let short = [
        "--frames",
        "2",
        "--warm-up",
        "1",
        "--views",
        "4",
        "--samples",
        "1",
        "--force",
        "--json",
        text(&figures),
    ];
    let run = |more: &[&'static str]| [&["stress", text(&scene)][..], &short, more].concat();
    succeed(&run(&[
        "--agents",
        "3",
        "--cameras-used",
        "2",
        "--modes",
        "vanilla,decoupled",
    ]));
    let figures: Value = serde_json::from_slice(&fs::read(&figures).unwrap()).unwrap();
    assert_eq!(
        (&figures["cameras"], &figures["originals_known"]),
        (&2.into(), &false.into())
    );
    assert_eq!(
        (
            &figures["assets"][0]["splats"],
            &figures["assets"][2]["coded_splats"]
        ),
        (&300.into(), &3.into())
    );
    assert_eq!(point(&figures, "vanilla", 3)["world_splats"], 4603);
    assert!(fail(1, &run(&["--agents", "4"])).contains("3 agents"));
    assert!(fail(1, &run(&["--agents", "3", "--modes", "colors=16"])).contains("ball.safetensors"));
    assert!(fail(1, &run(&["--agents", "3", "--cameras-used", "7"])).contains("6 cameras"));
    let world = folder.path().join("background.ply");
    assert!(fail(1, &["stress", text(&world)]).contains("scene file"));
}

#[test]
fn nonsense_is_refused_with_what_there_is() {
    assert!(fail(2, &["stress"]).contains("--synth"));
    assert!(
        fail(2, &["stress", "--synth", "--modes", "vanilla,fast"]).contains("decoupled-serial")
    );
    assert!(fail(2, &["stress", "--synth", "--memory-limit", "much"]).contains("2GiB"));
    assert!(fail(2, &["stress", "scene.toml", "--assets", "3"]).contains("--assets"));
    assert!(fail(2, &["stress", "--synth", "--agents", "1,two"]).contains("two"));
}
