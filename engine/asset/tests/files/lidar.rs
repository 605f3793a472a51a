//! Models of LiDARs.

use std::f64::consts::TAU;
use std::path::Path;

use decouplegs_asset::{lidar_file, lidar_names, read_lidar};
use decouplegs_scene::lidar::{BEAMS_MAX, LidarPattern, Spin};
use glam::DVec3;
use proptest::prelude::*;

const SEED: &str = include_str!("../../fuzz/seeds/lidar/vlp32c.toml");

#[test]
fn sensors_that_come_with_the_program_are_read() {
    for (name, rings, columns, [top_deg, bottom_deg]) in [
        ("at128", 128, 1200, [12.9, -12.5]),
        ("hdl32e", 32, 1084, [10.67, -30.67]),
        ("hdl64e", 64, 2083, [2.0, -24.33]),
        ("hdl64e_kitti", 64, 2083, [2.40, -23.64]),
        ("pandar128", 128, 3600, [15.0, -25.0]),
        ("pandar64", 64, 1800, [14.882, -24.897]),
        ("vlp32c", 32, 1800, [15.0, -25.0]),
        ("xt32", 32, 2000, [15.0, -16.0]),
    ] {
        assert!(lidar_names().contains(&name));
        let model = read_lidar(Path::new(name)).unwrap();
        assert_eq!((model.rings(), model.columns()), (rings, columns), "{name}");
        let beams = model.beams();
        assert_eq!(beams.len(), rings * columns);
        let elevation_deg = |beam: usize| beams[beam].direction.z.asin().to_degrees();
        assert!((elevation_deg(0) - top_deg).abs() < 1e-9, "{name}");
        assert!(
            (elevation_deg(rings - 1) - bottom_deg).abs() < 1e-9,
            "{name}"
        );
        // Seen from above these turn clockwise: the azimuth falls.
        let next = beams[0].direction.cross(beams[rings].direction);
        assert!(next.z < 0.0, "{name}");
    }
}

#[test]
fn each_beam_has_one_cell_and_neighbors_are_near() {
    for name in lidar_names() {
        let model = read_lidar(Path::new(name)).unwrap();
        let (beams, cells) = (model.beams(), model.cells());
        let mut seen = vec![0; beams.len()];
        for column in cells.beams.chunks(cells.rows) {
            let there: Vec<DVec3> = (column.iter())
                .filter_map(|&beam| beams.get(beam as usize))
                .map(|beam| beam.direction)
                .collect();
            let azimuth = |d: &DVec3| d.y.atan2(d.x);
            for pair in there.windows(2) {
                let apart = (azimuth(&pair[0]) - azimuth(&pair[1])).rem_euclid(TAU);
                let step = TAU / model.columns() as f64;
                assert!(apart.min(TAU - apart) < 1.01 * step, "{name}");
            }
            for &beam in column.iter().filter(|&&beam| (beam as usize) < beams.len()) {
                seen[beam as usize] += 1;
            }
        }
        assert!(seen.iter().all(|count| *count == 1), "{name}");
    }
}

#[test]
fn parameters_of_ncore_are_a_model() {
    let json = r#"{"spinning_frequency_hz": 20.0, "spinning_direction": "ccw", "n_rows": 2, "n_columns": 4,
        "row_elevations_rad": [0.1, -0.2], "row_azimuth_offsets_rad": [0.02, -0.01],
        "column_azimuths_rad": [3.0, -1.7123889803846899, -0.14159265358979312, 1.4292036732051034]}"#;
    let model = lidar_file::decode(json.as_bytes()).unwrap();
    let LidarPattern::Spinning {
        spin, field_rad, ..
    } = model.pattern
    else {
        panic!("it spins")
    };
    assert_eq!((spin, model.sweep_s), (Spin::CounterClockwise, 0.05));
    assert!((field_rad - TAU).abs() < 1e-9);
    let last = model.beams()[7];
    assert!((last.time_s - 0.05).abs() < 1e-12, "c / (N - 1)");
    assert!((last.direction.y.atan2(last.direction.x) - 1.4192036732051034).abs() < 1e-9);
    let uneven = json.replace("-1.7123889803846899", "-1.6");
    let error = lidar_file::decode(uneven.as_bytes()).unwrap_err();
    assert!(error.to_string().contains("column 1"), "{error}");
}

#[test]
fn faults_of_models_are_named() {
    for (from, to, reason) in [
        (
            "15.0, 10.333,",
            "10.0, 10.333,",
            "row 1 has elevation 10.333",
        ),
        ("columns = 1800", "columns = 1", "at least 2 columns"),
        ("columns = 1800", "columns = 4000000000", "at most"),
        (
            "range_m = [0.5, 200.0]",
            "range_m = [5, 2]",
            "0 <= least < greatest",
        ),
        ("rate_hz = 10.0", "rate_hz = 0.0", "a sweep takes inf s"),
        (
            "direction = \"cw\"",
            "direction = \"up\"",
            "expected cw or ccw",
        ),
        ("row_ids = [", "row_ids = [1,", "row_ids has 33 values"),
        ("field_deg = 360.0", "field_deg = 400.0", "at most 360"),
        (
            "field_deg = 360.0",
            "field_deg = 1e-9",
            "expected offsets of fewer columns",
        ),
        ("rate_hz", "rays = []\nrate_hz", "both rays and"),
        ("name =", "nam =", "nam"),
    ] {
        let text = SEED.replacen(from, to, 1);
        assert_ne!(text, SEED);
        let error = lidar_file::decode(text.as_bytes()).unwrap_err();
        assert!(error.to_string().contains(reason), "{to}: {error}");
    }
}

proptest! {
    #[test]
    fn hostile_models_are_errors(bytes in prop::collection::vec(any::<u8>(), 0..200), at in 0..SEED.len()) {
        let _ = lidar_file::decode(&bytes);
        let mut mutated = SEED.as_bytes().to_vec();
        mutated.splice(at..(at + 3).min(SEED.len()), bytes.iter().take(5).copied());
        if let Ok(model) = lidar_file::decode(&mutated) {
            prop_assert!(model.beams().len() <= BEAMS_MAX);
            prop_assert!(model.cells().beams.len() <= 4 * BEAMS_MAX);
        }
    }
}
