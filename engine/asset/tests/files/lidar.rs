//! Models of LiDARs, and files of their points.

use std::f64::consts::TAU;
use std::path::Path;
use std::sync::Arc;

use decouplegs_asset::point_cloud::{FIELDS, McapSweeps, POINT_FIELDS, PointFormat, encode};
use decouplegs_asset::{lidar_file, lidar_names, read_lidar};
use decouplegs_scene::lidar::{BEAMS_MAX, LidarPattern, LidarPoint, LidarReturn, PointFrame, Spin};
use decouplegs_scene::{Lidar, LidarModel, LidarSweep, Motion, Pose};
use glam::{DQuat, DVec3};
use proptest::prelude::*;

const SEED: &str = include_str!("../../fuzz/seeds/lidar/vlp32c.toml");

#[test]
fn sensors_that_come_with_the_program_are_read() {
    for (name, rings, columns, [top_deg, bottom_deg]) in [
        ("at128", 128, 1200, [12.9, -12.5]),
        ("hdl32e", 32, 1084, [10.67, -30.67]),
        ("hdl64e", 64, 2083, [2.0, -24.33]),
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

/// Two points of a sensor that drives at 10 m/s.
fn points(frame: PointFrame) -> Vec<LidarPoint> {
    let model: LidarModel = lidar_file::decode(SEED.as_bytes()).unwrap();
    let lidar = Lidar {
        name: "roof".into(),
        rig_from_lidar: Pose::new(DQuat::IDENTITY, DVec3::new(0.0, 0.0, 2.0)),
        world_from_rig: Pose::new(DQuat::IDENTITY, DVec3::new(100.0, 0.0, 0.0)),
        motion: Motion {
            velocity_mps: DVec3::X * 10.0,
            ..Motion::REST
        },
        model: Arc::new(model),
    };
    let found = |beam: u32, range_m: f32| LidarReturn {
        beam,
        range_m,
        intensity: 0.5,
        instance: 3,
        number: 1,
        count: 1,
    };
    let beams = lidar.model.beams();
    let returns = vec![found(11, 10.0), found(900 * 32 + 11, 20.0)];
    let sweep = LidarSweep {
        lidar,
        beams: beams.into(),
        returns,
    };
    sweep.points(frame)
}

#[test]
fn frames_compensate_the_motion_of_the_vehicle_alone() {
    // Row 11 is level; its azimuth is 1.4 degrees to the left of the column's.
    let [raw, start, end, world] = [
        PointFrame::Raw,
        PointFrame::Start,
        PointFrame::End,
        PointFrame::World,
    ]
    .map(|frame| points(frame)[1].position_m);
    let fired_s = 900.5 / 1800.0 * 0.1;
    assert!((raw.length() - 20.0).abs() < 1e-9);
    assert!((start - raw - DVec3::X * (10.0 * fired_s)).length() < 1e-9);
    assert!((end - start + DVec3::X).length() < 1e-9);
    assert!((world - start - DVec3::new(100.0, 0.0, 2.0)).length() < 1e-9);
    let ego = points(PointFrame::EgoAt(0.1))[1].position_m;
    assert!((ego - end - DVec3::Z * 2.0).length() < 1e-9);
}

#[test]
fn files_hold_the_layouts_of_their_formats() {
    let points = points(PointFrame::End);
    let of = |format| encode(format, &points, 32, &["a comment".to_owned()]).unwrap();
    let floats = |bytes: &[u8]| -> Vec<f32> {
        let (words, rest) = bytes.as_chunks::<4>();
        assert!(rest.is_empty());
        words.iter().map(|word| f32::from_le_bytes(*word)).collect()
    };
    let [x, y, z] = points[1].position_m.as_vec3().to_array();
    assert_eq!(floats(&of(PointFormat::Kitti))[4..], [x, y, z, 0.5]);
    // Row 11 from the highest is row 20 from the lowest.
    assert_eq!(
        floats(&of(PointFormat::NuScenes))[5..],
        [-y, x, z, 127.5, 20.0]
    );
    let pcd = of(PointFormat::Pcd);
    let header = pcd.windows(12).position(|w| w == b"DATA binary\n").unwrap() + 12;
    let ply = of(PointFormat::Ply);
    let end = ply.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    let npy = of(PointFormat::Npy);
    assert!(npy.starts_with(b"\x93NUMPY"));
    assert_eq!(pcd[header..], ply[end..]);
    assert_eq!(pcd[header..], npy[npy.len() - 72..]);
    assert_eq!(floats(&pcd[header + 36..header + 56]), [x, y, z, 0.5, 20.0]);
    assert_eq!(FIELDS.len(), 12);
    assert!(of(PointFormat::Argoverse2).starts_with(b"ARROW1"));
    let mut sweeps = McapSweeps::new("/lidar/roof", "end").unwrap();
    sweeps.add(5_000_000_007, &points).unwrap();
    let bytes = sweeps.finish().unwrap();
    let messages: Vec<_> = mcap::MessageStream::new(&bytes).unwrap().collect();
    let [Ok(message)] = &messages[..] else {
        panic!("{messages:?}")
    };
    assert_eq!(message.log_time, 5_000_000_007);
    assert_eq!(
        message.channel.schema.as_ref().unwrap().name,
        "sensor_msgs/msg/PointCloud2"
    );
    // The points come last but for is_dense.
    let data = &message.data[message.data.len() - 65..];
    assert_eq!(floats(&data[32..44]), [x, y, z]);
    assert_eq!(data[44..46], [128, 1]);
    assert_eq!(data[46..48], 11u16.to_le_bytes());
    assert_eq!(
        POINT_FIELDS.map(|(_, offset, _)| offset),
        [0, 4, 8, 12, 13, 14, 16, 20, 24, 28]
    );
}
