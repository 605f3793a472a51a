//! Points of sweeps, and files of them.

use std::path::Path;
use std::sync::Arc;

use decouplegs_asset::read_lidar;
use decouplegs_recording::point_cloud::{FIELDS, McapSweeps, POINT_FIELDS, PointFormat, encode};
use decouplegs_scene::lidar::{LidarPoint, LidarReturn, PointFrame};
use decouplegs_scene::{Lidar, LidarModel, LidarSweep, Motion, Pose};
use glam::{DQuat, DVec3};

/// Two points of a sensor that drives at 10 m/s.
fn points(frame: PointFrame) -> Vec<LidarPoint> {
    let model: LidarModel = read_lidar(Path::new("vlp32c")).unwrap();
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
