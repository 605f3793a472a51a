//! `decouplegs compress`, small.

use std::path::PathBuf;

use super::*;

/// Splats of a car in a folder of its own.
fn small_car(folder: &Path, splats: &str) -> PathBuf {
    let sizes = [
        "--background",
        "10",
        "--agents",
        "1",
        "--agent-splats",
        splats,
        "--degree",
        "1",
    ];
    succeed(
        &[
            ["synth", "street", "--out", text(folder), "--seed", "5"].as_slice(),
            &sizes,
        ]
        .concat(),
    );
    folder.join("assets/car_00.ply")
}

/// The arguments to compress `car` to `out` by a few small views.
fn small_compression<'a>(car: &'a Path, out: &'a Path, more: &[&'a str]) -> Vec<&'a str> {
    let sizes = [
        "--views",
        "4",
        "--view-size",
        "32",
        "--colors",
        "24",
        "--shapes",
        "12",
    ];
    [
        ["compress", text(car), "--out", text(out)].as_slice(),
        &sizes,
        more,
    ]
    .concat()
}

/// Names in `folder`, hidden files too, sorted.
fn names_in(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

#[test]
fn a_car_is_compressed_described_and_decompressed() {
    let folder = tempfile::tempdir().unwrap();
    let car = small_car(folder.path(), "400");
    let [asset, decoded] = ["car.safetensors", "decoded.ply"].map(|name| folder.path().join(name));
    let said = succeed(&small_compression(&car, &asset, &["--keep", "0.5"]));
    let file_bytes = fs::metadata(&asset).unwrap().len();
    for part in [
        text(&asset),
        "200 of 400 splats kept",
        "12 shapes, 24 colors",
        &format!("{file_bytes} bytes"),
    ] {
        assert!(said.contains(part), "{part}: {said}");
    }
    let described = json(&["inspect", text(&asset), "--json"]);
    assert_eq!(
        (
            &described["splats"],
            &described["sh_frame"],
            &described["levels"][0]
        ),
        (&200.into(), &"canonical".into(), &200.into())
    );
    let message = succeed(&["inspect", text(&asset)]);
    for part in [
        "car_00.ply",
        "keep = 0.5",
        "seed = 1",
        "views = 4",
        "view_size = 32",
    ] {
        assert!(message.contains(part), "{part}: {message}");
    }

    succeed(&["decompress", text(&asset), "--out", text(&decoded)]);
    let [before, after] = [&car, &decoded].map(|path| json(&["inspect", text(path), "--json"]));
    assert_eq!(
        (&after["splats"], &after["sh_degree"]),
        (&200.into(), &1.into())
    );
    for (end, axis) in [
        ("min", 0),
        ("min", 1),
        ("min", 2),
        ("max", 0),
        ("max", 1),
        ("max", 2),
    ] {
        let [before_m, after_m] =
            [&before, &after].map(|said| said["bounds"][end][axis].as_f64().unwrap());
        // Means may only leave the car's box by a step of its 16 bits; what is dropped makes it
        // smaller.
        let beyond_m = if end == "min" {
            before_m - after_m
        } else {
            after_m - before_m
        };
        assert!(
            beyond_m < 1e-3 && beyond_m > -1.0,
            "{end} of axis {axis}: {before_m} m became {after_m} m"
        );
    }
}

#[test]
fn a_seed_decides_the_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let car = small_car(folder.path(), "400");
    let compressed = |name: &str, seed: &str| {
        let out = folder.path().join(name);
        succeed(&small_compression(&car, &out, &["--seed", seed]));
        fs::read(out).unwrap()
    };
    let first = compressed("first.safetensors", "7");
    assert!(
        first == compressed("again.safetensors", "7"),
        "the same seed gave other bytes"
    );
    // The header names the seed: what stands behind it has to differ, too.
    let other = compressed("other.safetensors", "8");
    let header_end = 8 + u64::from_le_bytes(first[..8].try_into().unwrap()) as usize;
    assert!(
        first[header_end..] != other[header_end..],
        "another seed gave the same tensors"
    );
}

#[test]
fn what_cannot_be_compressed_is_refused_and_nothing_is_left_behind() {
    let folder = tempfile::tempdir().unwrap();
    let car = small_car(folder.path(), "60");
    let [absent, out, clear] =
        ["absent.ply", "car.safetensors", "clear.splat"].map(|name| folder.path().join(name));
    // A mean, scales, a color without opacity and a rotation: twenty splats that show nothing.
    let splat = [
        bytes(&[0f32, 0.0, 0.0, 0.1, 0.1, 0.1], f32::to_le_bytes),
        vec![200, 100, 50, 0, 255, 128, 128, 128],
    ]
    .concat();
    fs::write(&clear, splat.repeat(20)).unwrap();
    let lone = folder.path().join("no such folder/car.safetensors");
    let taken = folder.path().join("taken.safetensors");
    fs::create_dir(&taken).unwrap();
    let before = names_in(folder.path());

    assert!(fail(1, &small_compression(&absent, &out, &[])).contains("absent.ply"));
    assert!(
        fail(1, &small_compression(&clear, &out, &[])).contains("20 have an opacity below 1/255")
    );
    assert!(fail(1, &small_compression(&car, &lone, &[])).contains("there is no folder"));
    assert!(fail(1, &small_compression(&car, &taken, &[])).contains("it is a folder"));
    assert!(
        fail(
            1,
            &small_compression(&car, &out, &["--report", text(&clear)])
        )
        .contains("expected the name of a folder")
    );
    assert!(
        fail(2, &small_compression(&car, &out, &["--keep", "2"]))
            .contains("at most 1, found \"2\"")
    );
    assert!(
        fail(
            2,
            &small_compression(&car, &out, &["--keep", "0.5", "--tau", "0.1"])
        )
        .contains("--tau")
    );
    assert!(
        fail(
            2,
            &[
                "compress",
                text(&car),
                "--out",
                text(&out),
                "--colors",
                "5000"
            ]
        )
        .contains("5000")
    );
    assert!(fail(2, &["compress", text(&car), "--out", "car.ply"]).contains(".safetensors"));
    assert_eq!(names_in(folder.path()), before);
    assert_eq!(names_in(&taken), [""; 0]);
}

#[test]
fn a_report_shows_what_was_lost() {
    let folder = tempfile::tempdir().unwrap();
    let car = small_car(folder.path(), "60");
    let [asset, report] = ["car.safetensors", "report"].map(|name| folder.path().join(name));
    let said = succeed(&small_compression(
        &car,
        &asset,
        &["--report", text(&report), "--report-views", "1"],
    ));
    assert!(said.contains(text(&report.join("report.html"))), "{said}");
    assert_eq!(names_in(&report), ["report.html", "report.json"]);
    let figures: Value =
        serde_json::from_slice(&fs::read(report.join("report.json")).unwrap()).unwrap();
    assert_eq!(figures["stored_bytes"], fs::metadata(&asset).unwrap().len());
    let psnr_db = |trial: &Value| trial["scores"]["close"]["psnr_db"].as_f64();
    assert!(psnr_db(&figures["asset"]).unwrap() > 20.0, "{figures}");
    let pruned = figures["pruned_only"].as_array().unwrap();
    let (most, least) = (
        psnr_db(&pruned[1]).unwrap_or(f64::INFINITY),
        psnr_db(&pruned[5]).unwrap(),
    );
    assert!(
        least < most,
        "fewer splats show more loss: {least} dB and {most} dB"
    );
    let page = fs::read_to_string(report.join("report.html")).unwrap();
    stress::assert_page_stands_alone(&page);
    for part in [
        "car_00.ply",
        "around, only pruned",
        "Distortion of colors",
        "data:image/png;base64,",
        "prefers-color-scheme: dark",
    ] {
        assert!(page.contains(part), "{part}");
    }
    assert_eq!(
        (
            page.matches("<svg").count(),
            page.matches("</html>").count(),
            page.matches("<img").count()
        ),
        (4, 1, 9)
    );
}
