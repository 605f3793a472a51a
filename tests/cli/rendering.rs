//! `render` and `bench` on small scenes.

use super::*;

#[test]
fn the_reference_draws_each_camera_into_a_file_of_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let street = folder.path().join("street");
    small_street(&street);
    let scene = street.join("scene.toml");
    let [own, given] = ["own", "given"].map(|name| folder.path().join(name));
    let sheet = folder.path().join("sheet.png");
    succeed(&[
        "render",
        text(&scene),
        "--reference",
        "--format",
        "npy",
        "--out",
        text(&own),
        "--contact-sheet",
        text(&sheet),
    ]);
    // The rig where the ego starts is what transforms.json holds: the same images, to the bit.
    let cameras = street.join("transforms.json");
    succeed(&[
        "render",
        text(&scene),
        "--reference",
        "--format",
        "npy",
        "--out",
        text(&given),
        "--cameras",
        text(&cameras),
    ]);
    let mut names: Vec<_> = fs::read_dir(&own)
        .unwrap()
        .map(|entry| entry.unwrap().file_name())
        .collect();
    names.sort();
    assert_eq!(names.len(), 6, "{names:?}");
    for name in &names {
        let difference = json(&[
            "compare",
            text(&own.join(name)),
            text(&given.join(name)),
            "--json",
        ]);
        assert!(
            difference["max_abs"].as_f64().unwrap() < 1e-4,
            "{name:?}: {difference}"
        );
    }
    let sheet_size = fs::read(&sheet).unwrap()[16..24].to_vec();
    assert_eq!(
        sheet_size,
        [0, 0, 0, 8 + 3 * (48 + 8), 0, 0, 0, 8 + 2 * (27 + 8)],
        "three columns and two rows of 48x27"
    );

    // The comparison can fail: two cameras see different things.
    let [a, b] = [own.join(&names[0]), own.join(&names[1])];
    let image = folder.path().join("difference.png");
    let difference = json(&[
        "compare",
        text(&a),
        text(&b),
        "--json",
        "--difference",
        text(&image),
    ]);
    assert!(
        difference["psnr_db"].as_f64().unwrap() < 40.0,
        "{difference}"
    );
    assert!(image.exists());
    let said = fail(1, &["compare", text(&a), text(&sheet)]);
    assert!(
        said.contains("48x27"),
        "sizes that differ are named: {said}"
    );
}

/// The definition of NuRec's renderer is another one, which `compare` tells in decibels.
#[test]
fn splats_along_rays_are_near_their_footprints_and_not_the_same() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let scene = folder.path().join("scene.toml");
    let render = |name: &str, more: &[&str]| {
        let out = folder.path().join(name);
        let always = [
            "render",
            text(&scene),
            "--format",
            "npy",
            "--out",
            text(&out),
        ];
        succeed(&[&always, more].concat());
        out
    };
    let rays = render("rays", &["--reference", "--along-rays"]);
    let footprints = render("footprints", &["--rules", "nurec"]);
    for entry in fs::read_dir(&rays).unwrap() {
        let name = entry.unwrap().file_name();
        let [rays, footprints] = [&rays, &footprints].map(|folder| folder.join(&name));
        let difference = json(&["compare", text(&footprints), text(&rays), "--json"]);
        let psnr_db = difference["psnr_db"].as_f64().unwrap();
        assert!((18.0..70.0).contains(&psnr_db), "{name:?}: {difference}");
    }
    let alone = ["render", text(&scene), "--along-rays", "--out", text(&rays)];
    assert!(fail(2, &alone).contains("--reference"));
}

#[test]
fn the_gpu_draws_what_the_reference_draws() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let scene = folder.path().join("scene.toml");
    let rule_sets: [&[&str]; 4] = [
        &[],
        &["--rules", "nurec"],
        &["--rules", "gsplat15", "--antialias"],
        &["--rules", "inria", "--size", "37x29"],
    ];
    for (at, rules) in rule_sets.into_iter().enumerate() {
        let [gpu, truth] = ["gpu", "truth"].map(|name| folder.path().join(format!("{name}{at}")));
        let render = |out: &Path, more: &[&str]| {
            let always = [
                "render",
                text(&scene),
                "--format",
                "npy",
                "--out",
                text(out),
            ];
            succeed(&[&always, rules, more].concat())
        };
        let listed = render(&gpu, &[]);
        render(&truth, &["--reference"]);
        let names: Vec<_> = fs::read_dir(&truth)
            .unwrap()
            .map(|entry| entry.unwrap().file_name())
            .collect();
        assert_eq!((names.len(), listed.lines().count()), (6, 6), "{listed}");
        for name in names {
            assert!(
                listed.contains(text(&gpu.join(&name))),
                "{name:?} is not among the files listed: {listed}"
            );
            let difference = json(&[
                "compare",
                text(&gpu.join(&name)),
                text(&truth.join(&name)),
                "--json",
            ]);
            // The exact mode's bound of error at equal rules; null stands for no error at all.
            let psnr_db = difference["psnr_db"].as_f64().unwrap_or(f64::INFINITY);
            assert!(psnr_db >= 95.0, "{name:?}, {rules:?}: {difference}");
        }
    }
}

#[test]
fn png_and_exr_hold_the_same_image_and_nothing_is_drawn_on_what_is_no_terminal() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let scene = folder.path().join("scene.toml");
    let out = folder.path().join("out");
    for format in ["png", "exr"] {
        let output = decouplegs(&[
            "render",
            text(&scene),
            "--format",
            format,
            "--force",
            "--out",
            text(&out),
        ]);
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{said}");
        // The device; and on a slow machine, what is done every other second. No bar, which needs a
        // terminal.
        let is_plain = !said.contains(['\r', '\u{1b}'])
            && said
                .lines()
                .skip(1)
                .all(|line| line.starts_with("images: "));
        assert!(said.starts_with("on ") && is_plain, "{said:?}");
    }
    assert_eq!(
        fs::read_dir(&out).unwrap().count(),
        12,
        "six images twice, and no temporary file"
    );
    let difference = json(&[
        "compare",
        text(&out.join("front.png")),
        text(&out.join("front.exr")),
        "--json",
    ]);
    // Half a level of 8 bits, which no channel of this street exceeds by clamping.
    let max_abs = difference["max_abs"].as_f64().unwrap();
    assert!(max_abs > 0.001 && max_abs <= 0.5001 / 255.0, "{difference}");
}

/// Folder with the images of `scene`, floats, drawn with `more` options.
fn drawn(scene: &Path, name: &str, more: &[&str]) -> std::path::PathBuf {
    let out = scene.with_file_name(name);
    let common = [
        "render",
        text(scene),
        "--format",
        "npy",
        "--out",
        text(&out),
    ];
    succeed(&[&common[..], more].concat());
    out
}

#[test]
fn compact_storage_is_asked_for_and_changes_less_than_a_step_of_a_byte() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let scene = folder.path().join("scene.toml");
    let [default, exact, compact] = [
        drawn(&scene, "default", &[]),
        drawn(&scene, "exact", &["--storage", "exact"]),
        drawn(&scene, "compact", &["--storage", "compact"]),
    ];
    let mut differ = 0;
    for entry in fs::read_dir(&default).unwrap() {
        let name = entry.unwrap().file_name();
        let [default, exact, compact] =
            [&default, &exact, &compact].map(|folder| folder.join(&name));
        assert!(
            fs::read(&default).unwrap() == fs::read(&exact).unwrap(),
            "{name:?}"
        );
        let difference = json(&["compare", text(&exact), text(&compact), "--json"]);
        let max_abs = difference["max_abs"].as_f64().unwrap();
        assert!(max_abs < 1.0 / 255.0, "{difference}");
        differ += usize::from(fs::read(&exact).unwrap() != fs::read(&compact).unwrap());
    }
    assert!(differ > 0, "nothing was rounded");
    let said = succeed(
        &[
            &["bench", text(&scene), "--frames", "1", "--warm-up", "1"][..],
            &["--storage", "compact"],
        ]
        .concat(),
    );
    assert!(
        said.contains("in compact storage (56 bytes each)"),
        "{said}"
    );
    let refused = ["render", text(&scene), "--out", text(folder.path())];
    let refused = |more: &[&str]| fail(2, &[&refused[..], more].concat());
    assert!(refused(&["--storage", "half"]).contains("exact"));
    assert!(refused(&["--storage", "compact", "--reference"]).contains("--reference"));
}

#[test]
fn backgrounds_are_drawn_with_fewer_splats_where_that_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let scene = folder.path().join("scene.toml");
    // From outside: the few nodes of this street hold the whole of it, and the rig.
    let around = |name: &str, more: &[&str]| {
        let out = drawn(&scene, name, &[&["--orbit", "1"][..], more].concat());
        fs::read(out.join("orbit_000.npy")).unwrap()
    };
    let default = around("default", &[]);
    let zero = around("zero", &["--background-pitch", "0"]);
    let coarse = around("coarse", &["--background-pitch", "50"]);
    assert!(default == zero, "a limit of 0 draws the finest level");
    assert!(default != coarse, "no splats were merged");
    let said = succeed(
        &[
            &["bench", text(&scene), "--frames", "1", "--warm-up", "1"][..],
            &["--background-pitch", "50"],
        ]
        .concat(),
    );
    assert!(
        said.contains("fewer where they lie at most 50 px apart"),
        "{said}"
    );
    let refused = ["render", text(&scene), "--out", text(folder.path())];
    let refused = |more: &[&str]| fail(2, &[&refused[..], more].concat());
    assert!(refused(&["--background-pitch", "far"]).contains("pixels"));
    assert!(refused(&["--background-pitch", "1", "--reference"]).contains("--reference"));
}

#[test]
fn a_bench_reports_time_memory_and_error() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let report = folder.path().join("bench.json");
    let scene = folder.path().join("scene.toml");
    let said = succeed(&[
        "bench",
        text(&scene),
        "--frames",
        "3",
        "--warm-up",
        "1",
        "--cameras-used",
        "2",
        "--error-cameras",
        "2",
        "--json",
        text(&report),
    ]);
    for word in [
        "images/s",
        "48x27",
        "4600 splats",
        "2 cameras",
        "rgba8",
        "3 frames after 1",
        "MiB on the device",
        "against f64",
        "all of front_left",
        "without the worst 100",
    ] {
        assert!(said.contains(word), "{word}: {said}");
    }
    let widest = said.lines().map(|line| line.matches('#').count()).max();
    assert_eq!(
        widest,
        Some(30),
        "the longest stage has the longest bar: {said}"
    );
    let report: Value = serde_json::from_slice(&fs::read(&report).unwrap()).unwrap();
    assert_eq!(
        (&report["cameras"], &report["frames"], &report["splats"]),
        (&2.into(), &3.into(), &4600.into())
    );
    let frame_ms = report["frame_gpu_ms"]["median"].as_f64().unwrap();
    let stages = report["stages"].as_array().unwrap();
    assert!(frame_ms > 0.0 && stages.len() > 3, "{report}");
    assert!(report["memory_bytes"]["total"].as_u64().unwrap() > 0);
    assert!(
        report["error"]["difference"]["max_abs"].as_f64().unwrap() <= 0.01,
        "{report}"
    );
    let images = report["error"]["images"].as_array().unwrap();
    assert_eq!(images.len(), 2);
    for image in images {
        let (difference, flips) = (&image["difference"], &image["flips"]);
        assert!(difference["psnr_db"].as_f64().unwrap() >= 95.0, "{image}");
        assert!(
            flips["psnr_without_db"].as_f64().unwrap() >= 100.0,
            "{image}"
        );
        assert!(flips["share"].as_f64().unwrap() < 0.01, "{image}");
    }
    assert!(
        report["outputs"]["color"] == "U8"
            && report["rules"] == "default"
            && report["frames_redrawn"] == 0,
        "{report}"
    );
    let more = [
        "--frames",
        "1",
        "--warm-up",
        "0",
        "--color",
        "f32",
        "--planes",
        "depth,instance",
        "--size",
        "64x48",
        "--rules",
        "inria",
    ];
    let said = succeed(&[&["bench", text(&scene)][..], &more].concat());
    assert!(
        said.contains("f32, depth, instance")
            && said.contains("64x48")
            && said.contains("rules inria"),
        "{said}"
    );
    assert!(fail(1, &["bench", text(&scene), "--cameras-used", "7"]).contains("6 cameras"));
    let too_many = ["--cameras-used", "2", "--error-cameras", "3"];
    assert!(fail(1, &[&["bench", text(&scene)][..], &too_many].concat()).contains("2 cameras"));
}
