//! `realism scene` and `lidar --compare`: scenes beside what they were made of.

use decouplegs::asset::SceneFile;
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
    let value = found.and_then(|gap| gap["value"].as_f64());
    value.unwrap_or_else(|| panic!("no value of {name}: {gaps:#?}"))
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

/// Writes `points` (x, y, z and a fourth number of each, f32) as a scan taken at `at_m`.
fn write_scan(path: &Path, points: &[u8], at_m: glam::DVec3) {
    let header = |descr: &str, shape: &str| {
        let text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n");
        let length = (text.len() as u16).to_le_bytes();
        [&b"\x93NUMPY\x01\x00"[..], &length, text.as_bytes()].concat()
    };
    let shape = format!("({}, 4)", points.len() / 16);
    let glam::DVec3 { x, y, z } = at_m;
    let pose = [
        1.0, 0.0, 0.0, x, 0.0, 1.0, 0.0, y, 0.0, 0.0, 1.0, z, 0.0, 0.0, 0.0, 1.0,
    ];
    let pose: Vec<u8> = pose
        .iter()
        .flat_map(|value: &f64| value.to_le_bytes())
        .collect();
    let mut bytes = Vec::new();
    let mut zip = StoredZip::new(&mut bytes);
    zip.add(
        "points.npy",
        &[header("<f4", &shape), points.to_vec()].concat(),
    )
    .unwrap();
    zip.add(
        "world_from_lidar.npy",
        &[header("<f8", "(4, 4)"), pose].concat(),
    )
    .unwrap();
    zip.finish().unwrap();
    fs::write(path, bytes).unwrap();
}

/// Points of a sensor's rings on a plane that lies `z_m` above the sensor, four f32 each.
fn rings_on(z_m: f64) -> Vec<u8> {
    let rings = (3..26).flat_map(|ring| (0..360).map(move |column| (ring, column)));
    let point = |(ring, column): (i32, i32)| {
        let around = f64::from(column).to_radians();
        let range_m = -z_m / f64::from(ring).to_radians().tan();
        [range_m * around.cos(), range_m * around.sin(), z_m, 0.0].map(|value| value as f32)
    };
    rings.flat_map(point).flat_map(f32::to_le_bytes).collect()
}

/// A detector of bright cells of 8 pixels, written by a Python that has onnx and onnxruntime; its
/// path, or `None` where there is no such Python.
fn bright_cells(folder: &Path) -> Option<std::path::PathBuf> {
    let script = r#"
import sys
import numpy as np, onnx, onnxruntime
from onnx import helper, numpy_helper
weights = {"gray": np.full((1, 3, 1, 1), 20.0, np.float32), "bias": np.array([-20.0], np.float32)}
grid = np.mgrid[:8, :12][::-1].reshape(2, -1) * 8.0 + 4.0
weights["boxes"] = np.concatenate([grid, np.full((2, 96), 8.0)])[None].astype(np.float32)
weights["shape"] = np.array([1, 1, 96])
nodes = [
    helper.make_node("AveragePool", ["images"], ["cells"], kernel_shape=[8, 8], strides=[8, 8]),
    helper.make_node("Conv", ["cells", "gray", "bias"], ["light"]),
    helper.make_node("Sigmoid", ["light"], ["score"]),
    helper.make_node("Reshape", ["score", "shape"], ["scores"]),
    helper.make_node("Concat", ["boxes", "scores"], ["output0"], axis=1),
]
value = lambda name, shape: helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, shape)
parts = [numpy_helper.from_array(array, name) for name, array in weights.items()]
graph = helper.make_graph(nodes, "bright", [value("images", [1, 3, 64, 96])], [value("output0", [1, 5, 96])], parts)
onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8), sys.argv[1])
"#;
    let python = std::env::var("DECOUPLEGS_PYTHON").unwrap_or_else(|_| "python3".into());
    let model = folder.join("bright.onnx");
    let ran = Command::new(&python)
        .args(["-c", script, text(&model)])
        .output();
    let is_written = ran.is_ok_and(|output| output.status.success());
    if !is_written {
        println!(
            "skipped: {python} has no onnx and onnxruntime; set DECOUPLEGS_PYTHON to one that has"
        );
    }
    is_written.then_some(model)
}

#[test]
fn a_scene_is_told_whole() {
    let folder = tempfile::tempdir().unwrap();
    let scene = recording::imported(folder.path(), 50);
    let [file, lanes, views] =
        ["scene.toml", "lanes.json", "cameras.json"].map(|name| scene.join(name));
    let images = folder.path().join("images");
    let few = folder.path().join("few.json");
    let mut cameras: Value = serde_json::from_str(&fs::read_to_string(&views).unwrap()).unwrap();
    cameras["frames"].as_array_mut().unwrap().truncate(6);
    fs::write(&few, cameras.to_string()).unwrap();
    let render = [
        "render",
        text(&file),
        "--cameras",
        text(&few),
        "--out",
        text(&images),
    ];
    succeed(&render);
    let recorded = SceneFile::read(&file).unwrap();
    let at_m = recorded.ego.as_ref().unwrap().at(1.0).translation + glam::DVec3::Z;
    let road_z_m = at_m.z - 1.0 - recorded.ego_height_m.unwrap();
    let scan = folder.path().join("scan.npz");
    write_scan(&scan, &rings_on(road_z_m - at_m.z), at_m);
    let realism = |out: &str, more: &[&str]| {
        let out = folder.path().join(out);
        let what = [
            "realism",
            "scene",
            text(&file),
            "--photographs",
            text(&images),
        ];
        let how = [
            "--planner",
            "vision",
            "--map",
            text(&lanes),
            "--scan",
            text(&scan),
        ];
        let printed = succeed(&[&what[..], &how, more, &["--out", text(&out)]].concat());
        let report = fs::read_to_string(out.join("realism.json")).unwrap();
        (serde_json::from_str::<Value>(&report).unwrap(), printed)
    };
    let detector = bright_cells(folder.path());
    let asked = match &detector {
        Some(model) => vec!["--detector", text(model)],
        None => Vec::new(),
    };
    let (same, printed) = realism("same", &asked);
    let distance = "plans by vision, distance after 3 s (FDE), m";
    assert_eq!(gap(&same, distance), 0.0, "{printed}");
    assert_eq!(same["plans"]["pairs"].as_array().unwrap().len(), 3);
    let corners_m = |report: &Value| {
        let errors = report["road"]["corners_m"].as_array().unwrap();
        let sum: f64 = errors.iter().map(|error| error.as_f64().unwrap()).sum();
        assert!(errors.len() >= 8, "{report:#}");
        sum / errors.len() as f64
    };
    let right_m = corners_m(&same);
    assert!(right_m.abs() < 0.15, "{right_m} {printed}");
    let roll = gap(&same, "roll of the vehicle, RMS error, degrees");
    assert!(roll < 2.0, "{printed}");
    assert!(!printed.contains("not measured: the ground"), "{printed}");
    let found = "detections in photographs found in rendered images";
    if detector.is_some() {
        assert!(gap(&same, "detections in photographs") > 0.0, "{printed}");
        assert_eq!(gap(&same, found), 1.0, "{printed}");
        assert!(
            gap(
                &same,
                "detections in photographs found in half-size photographs"
            ) > 0.5
        );
    }

    // Photographs of a night: nothing is found, and the planner sees no road. The scan of a road
    // that lies 0.3 m lower.
    for entry in fs::read_dir(&images).unwrap() {
        let path = entry.unwrap().path();
        let mut photograph = image::open(&path).unwrap().into_rgb8();
        photograph.iter_mut().for_each(|value| *value /= 8);
        photograph.save(&path).unwrap();
    }
    write_scan(&scan, &rings_on(road_z_m - 0.3 - at_m.z), at_m);
    let (night, printed) = realism("night", &asked);
    assert!(gap(&night, distance) > 0.0, "{printed}");
    let lower_m = corners_m(&night) - right_m;
    assert!((lower_m - 0.3).abs() < 0.02, "{lower_m} {printed}");
    if detector.is_some() {
        assert_eq!(gap(&night, "detections in photographs"), 0.0, "{printed}");
    }
    // A model that is none is refused before anything is drawn.
    let none = folder.path().join("none.onnx");
    fs::write(&none, "no model").unwrap();
    if detector.is_some() {
        let out = folder.path().join("no");
        let photographs = ["--photographs", text(&images), "--out", text(&out)];
        let what = ["realism", "scene", text(&file), "--detector", text(&none)];
        let said = fail(1, &[&what[..], &photographs].concat());
        assert!(said.contains("no model that onnxruntime runs"), "{said}");
        assert!(!out.exists());
    }
    let said = fail(
        1,
        &[
            "realism",
            "scene",
            text(&file),
            "--photographs",
            text(&images),
            "--planner",
            "lane-follow",
            "--out",
            text(&folder.path().join("no")),
        ],
    );
    assert!(said.contains("asks for more than images"), "{said}");
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
        let path = folder.path().join(name);
        write_scan(&path, &points, glam::DVec3::new(2.0, 0.5, z_m));
        path
    };
    let compared = |scan: &Path| {
        succeed(&[&compare[..], &[text(scan)]].concat());
        let stem = scan.file_stem().unwrap().to_str().unwrap();
        assert!(out.join(format!("{stem}_compared.png")).is_file());
        let report = fs::read_to_string(out.join(format!("{stem}_compared.json"))).unwrap();
        serde_json::from_str::<Value>(&report).unwrap()
    };
    let same = compared(&archive("same.npz", 1.8));
    assert!(same["empty_beams"].is_null(), "the sensor is not known");
    let same = &same["all"];
    assert!(same["median_m"].as_f64().unwrap() < 0.001, "{same}");
    assert!(same["missing"].as_f64().unwrap() < 0.02, "{same}");
    let moved = &compared(&archive("moved.npz", 2.3))["all"];
    assert!(moved["median_m"].as_f64().unwrap() > 0.1, "{moved}");

    // Beams that met nothing meet nothing again; those of points that were taken out do.
    let empty = |name: &str, kept: &dyn Fn(usize) -> bool| {
        let kept = points
            .chunks_exact(16)
            .enumerate()
            .filter(|(at, _)| kept(*at));
        let some: Vec<u8> = kept.flat_map(|(_, point)| point.to_vec()).collect();
        let path = folder.path().join(name);
        write_scan(&path, &some, glam::DVec3::new(2.0, 0.5, 1.8));
        let by_name = ["--sensor", text(&sensor), text(&path)];
        let words = [
            &compare[..compare.len() - 1],
            &by_name[..2],
            &["--compare", by_name[2]],
        ];
        let said = succeed(&words.concat());
        assert!(
            said.contains("beams without a return in the scan"),
            "{said}"
        );
        let report = path.file_stem().unwrap().to_str().unwrap();
        let report = fs::read_to_string(out.join(format!("{report}_compared.json"))).unwrap();
        let report: Value = serde_json::from_str(&report).unwrap();
        ["beams", "extra"].map(|key| report["empty_beams"][key].as_u64().unwrap())
    };
    let [beams, extra] = empty("whole.npz", &|_| true);
    assert!(extra <= beams / 20, "{extra} of {beams}");
    let taken = points.len() as u64 / 160;
    let [more, found] = empty("holes.npz", &|at| at % 10 != 0);
    assert!(
        more >= beams + taken - taken / 10,
        "{more}, {beams}, {taken}"
    );
    assert!(
        found >= extra + taken - taken / 5,
        "{found}, {extra}, {taken}"
    );
}
