//! `realism scene` and `lidar --compare`: scenes beside what they were made of.

use decouplegs::asset::zip::StoredZip;
use serde_json::json;

use super::recording::write_recording;
use super::*;

/// A street, views along its way, and images of the background from there in the folder `images`.
fn photographed(folder: &Path) -> [std::path::PathBuf; 3] {
    let street = folder.join("street");
    small_street(&street);
    let (background, images) = (street.join("background.ply"), folder.join("images"));
    let views = write_recording(&street, 3);
    succeed(&[
        "render",
        text(&background),
        "--cameras",
        text(&views),
        "--out",
        text(&images),
    ]);
    [background, views, images]
}

fn gap(report: &Value, name: &str) -> f64 {
    let gaps = report["gaps"].as_array().unwrap();
    let found = gaps.iter().find(|gap| gap["name"] == name);
    found.unwrap()["value"].as_f64().unwrap()
}

#[test]
fn photographs_are_found_again_and_a_gain_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let [background, views, images] = photographed(folder.path());
    let realism = |out: &str, more: &[&str]| {
        let out = folder.path().join(out);
        let command = [
            "realism",
            "scene",
            text(&background),
            "--photographs",
            text(&images),
            "--out",
            text(&out),
        ];
        let printed = succeed(&[&command[..], more].concat());
        let report = fs::read_to_string(out.join("realism.json")).unwrap();
        let page = fs::read_to_string(out.join("realism.html")).unwrap();
        assert!(printed.contains("realism.html") && page.contains("One number per gap"));
        (serde_json::from_str::<Value>(&report).unwrap(), printed)
    };
    let views = ["--views", text(&views)];
    let (own, printed) = realism("own", &views);
    assert_eq!((&own["views"], &own["photographs"]), (&json!(6), &json!(6)));
    // What 8 bits leave.
    assert!(
        gap(&own, "PSNR, dB") > 50.0 && gap(&own, "SSIM") > 0.995,
        "{printed}"
    );
    assert!(printed.contains("not measured: ranges"), "{printed}");

    // A photograph of another exposure, as a JPEG.
    let name = "images_000000_2";
    let png = images.join(format!("{name}.png"));
    let mut photograph = image::open(&png).unwrap().into_rgb8();
    for value in photograph.iter_mut() {
        *value = (0.7 * f32::from(*value)) as u8;
    }
    fs::remove_file(&png).unwrap();
    photograph.save(images.join(format!("{name}.jpg"))).unwrap();
    let held_out = folder.path().join("held_out.txt");
    fs::write(&held_out, format!("{name}.jpg\n")).unwrap();
    let chosen = [&views[..], &["--held-out", text(&held_out)]].concat();
    let (darker, _) = realism("darker", &chosen);
    assert_eq!(darker["photographs"], 1);
    let gain = darker["images"][0]["difference"]["gain"][1]
        .as_f64()
        .unwrap();
    assert!((gain - 0.7).abs() < 0.02, "{gain}");
    let psnr_db = gap(&darker, "PSNR, dB");
    let gained_db = gap(&darker, "PSNR after one gain per image and channel, dB");
    assert!(
        psnr_db < 25.0 && gained_db > psnr_db + 5.0,
        "{psnr_db} {gained_db}"
    );

    let refused = |more: &[&str], says: &str| {
        let out = folder.path().join("refused");
        let command = [
            "realism",
            "scene",
            text(&background),
            "--photographs",
            text(&images),
            "--out",
            text(&out),
        ];
        let said = fail(1, &[&command[..], more].concat());
        assert!(said.contains(says), "{said}");
    };
    refused(&[], "does not name the views of its photographs");
    fs::write(&held_out, "another\n").unwrap();
    refused(&chosen, "no photograph of a view named another");
    let said = fail(
        1,
        &[
            "realism",
            "scene",
            text(&background),
            "--photographs",
            text(&images),
            "--out",
            text(folder.path()),
        ],
    );
    assert!(said.contains("exists already"), "{said}");
    image::GrayImage::new(96, 54)
        .save(images.join(format!("{name}_mask.png")))
        .unwrap();
    refused(&views, "its mask leaves no pixel");
}

#[test]
fn a_scan_of_the_scene_has_no_errors_and_a_moved_one_has() {
    let folder = tempfile::tempdir().unwrap();
    let street = folder.path().join("street");
    small_street(&street);
    let (background, out) = (street.join("background.ply"), folder.path().join("out"));
    let sensor = folder.path().join("small.toml");
    let model = "name = \"small\"\nrow_elevations_deg = [2.0, -2.0, -6.0, -12.0]\ncolumns = 180\nrate_hz = 10.0\nrange_m = [0.5, 100.0]\n";
    fs::write(&sensor, model).unwrap();
    let sweep = [
        "lidar",
        text(&background),
        "--sensor",
        text(&sensor),
        "--mount",
        "2,0.5,1.8",
        "--format",
        "kitti",
        "--out",
        text(&out),
    ];
    succeed(&sweep);
    let scan = out.join("small_000000.bin");
    let out_of = ["--force", "--out", text(&out), "--compare"];
    let compare = [&["lidar", text(&background)][..], &out_of].concat();
    let said = fail(1, &[&compare[..], &[text(&scan)]].concat());
    assert!(
        said.contains("does not tell where its sensor was"),
        "{said}"
    );

    let points = fs::read(&scan).unwrap();
    let archive = |name: &str, z_m: f64| {
        let header = |descr: &str, shape: &str| {
            let text =
                format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n");
            let length = (text.len() as u16).to_le_bytes();
            [&b"\x93NUMPY\x01\x00"[..], &length, text.as_bytes()].concat()
        };
        let shape = format!("({}, 4)", points.len() / 16);
        let pose = [
            1.0, 0.0, 0.0, 2.0, 0.0, 1.0, 0.0, 0.5, 0.0, 0.0, 1.0, z_m, 0.0, 0.0, 0.0, 1.0,
        ];
        let pose: Vec<u8> = pose
            .iter()
            .flat_map(|value: &f64| value.to_le_bytes())
            .collect();
        let mut bytes = Vec::new();
        let mut zip = StoredZip::new(&mut bytes);
        zip.add(
            "points.npy",
            &[header("<f4", &shape), points.clone()].concat(),
        )
        .unwrap();
        zip.add(
            "world_from_lidar.npy",
            &[header("<f8", "(4, 4)"), pose].concat(),
        )
        .unwrap();
        zip.finish().unwrap();
        let path = folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        path
    };
    let compared = |scan: &Path| {
        succeed(&[&compare[..], &[text(scan)]].concat());
        let stem = scan.file_stem().unwrap().to_str().unwrap();
        assert!(out.join(format!("{stem}_compared.png")).is_file());
        let report = fs::read_to_string(out.join(format!("{stem}_compared.json"))).unwrap();
        serde_json::from_str::<Value>(&report).unwrap()["all"].clone()
    };
    let same = compared(&archive("same.npz", 1.8));
    assert!(same["median_m"].as_f64().unwrap() < 0.001, "{same}");
    assert!(same["missing"].as_f64().unwrap() < 0.02, "{same}");
    let moved = compared(&archive("moved.npz", 2.3));
    assert!(moved["median_m"].as_f64().unwrap() > 0.1, "{moved}");
}
