//! Sweeps from the server are those of a session in this process, to the byte.

use decouplegs::asset::lidar_names;
use decouplegs::open_movable_scene;
use decouplegs::scene::lidar::{PointFrame, ReturnMode, ReturnOptions};
use decouplegs::scene::{Motion, Pose, RigLidar};
use decouplegs::session::{Session, SessionOptions, World};
use decouplegs_alpasim::wire::lidar::lidar_client::LidarClient;
use decouplegs_alpasim::wire::lidar::{AvailableLidarsRequest, SweepRequest};
use decouplegs_alpasim::wire::sensorsim::sensorsim_service_client::SensorsimServiceClient;
use decouplegs_alpasim::wire::sensorsim::{
    AggregatedRenderRequest, LidarDeviceType, LidarRenderRequest, LidarSpec, PosePair,
};
use decouplegs_server::running::Running;
use glam::DVec3;
use tonic::Code;
use tonic::transport::Channel;

use crate::asking::{channel, client, message, object, options, pair, pose, serve};
use crate::scenes::street;

/// Bytes of `values`, little-endian.
fn bytes<const N: usize>(values: impl Iterator<Item = [u8; N]>) -> Vec<u8> {
    values.flatten().collect()
}

fn lidar_request(sensor_pose: PosePair) -> LidarRenderRequest {
    LidarRenderRequest {
        scene_id: "street".into(),
        lidar_config: Some(LidarSpec {
            lidar_type: LidarDeviceType::At128.into(),
        }),
        frame_start_us: 1_000_000,
        frame_end_us: 1_100_000,
        sensor_pose: Some(sensor_pose),
        dynamic_objects: Vec::new(),
    }
}

async fn lidar_client(running: &Running) -> LidarClient<Channel> {
    LidarClient::new(channel(running).await).max_decoding_message_size(64 << 20)
}

#[tokio::test(flavor = "multi_thread")]
async fn the_server_and_a_session_trace_the_same_points() {
    let folder = tempfile::tempdir().unwrap();
    let path = street(folder.path());
    let session = Session::open(&SessionOptions::default()).expect("a device");
    let loaded = open_movable_scene(&path).unwrap().0;
    let scene = session.add_scene(&loaded).unwrap();
    let mut world = World::new(&scene);
    let mut placed = world.agents()[0].placed;
    let name = world.agents()[0].name.clone();
    let running = serve(&options(vec![path])).await;
    let mut lidars = lidar_client(&running).await;

    let asked = AvailableLidarsRequest {
        scene_id: "street".into(),
    };
    let there = lidars.get_available_lidars(asked).await.unwrap();
    let there = there.into_inner().available_lidars;
    let ids: Vec<&str> = there.iter().map(|lidar| &*lidar.logical_id).collect();
    let mut expected = vec!["roof"];
    expected.extend(lidar_names());
    assert_eq!(ids, expected);
    let roof: RigLidar = scene.rig().lidars().next().unwrap().clone();
    let mounted = pose(&there[0].rig_to_lidar.unwrap());
    assert!((mounted.translation - roof.rig_from_lidar.translation).length() < 1e-6);
    assert_eq!((there[0].sensor.as_str(), there[0].rings), ("xt32", 32));

    // A turning sensor among a moving car, through messages of 32-bit floats.
    let (start, end) = (
        Pose::from_yaw(0.0, DVec3::new(1.0, 0.5, 1.9)),
        Pose::from_yaw(0.05, DVec3::new(2.5, 0.5, 1.9)),
    );
    let car = [12.0, 13.0].map(|x| {
        let at = Pose::from_yaw(0.25, DVec3::new(x, 1.5, 0.75));
        pose(&message(&at))
    });
    let sent = pair(&start, &end);
    let request = SweepRequest {
        scene_id: "street".into(),
        logical_id: "roof".into(),
        frame_start_us: 1_000_000,
        frame_end_us: 1_100_000,
        sensor_pose: Some(sent),
        dynamic_objects: vec![object(&name, &car[0], &car[1])],
        returns: "strongest".into(),
        opacity_threshold: 0.25,
        seed: 3,
        frame: "local".into(),
    };
    let served = lidars.render_sweep(request.clone()).await.unwrap();
    let served = served.into_inner();

    let [start, end] = [sent.start_pose, sent.end_pose].map(|sent| pose(&sent.unwrap()));
    let sweep_s = roof.model.sweep_s;
    let own = RigLidar {
        rig_from_lidar: Pose::IDENTITY,
        ..roof
    };
    let lidar = own.sweep_from(&start, &Motion::between(&start, &end, sweep_s));
    (placed.pose, placed.motion) = Pose::halfway(&car[0], &car[1], sweep_s);
    world.set_agents([(name, placed)]).unwrap();
    let mut renderer = session.batch_renderer();
    let traced = renderer
        .trace(&world, &lidar, 0.5 * sweep_s, ReturnMode::Strongest)
        .unwrap();
    let sweep = traced.returns(&ReturnOptions {
        mode: ReturnMode::Strongest,
        opacity_min: 0.25,
        seed: 3,
    });
    let points = sweep.points(PointFrame::World);
    assert_eq!(served.num_points as usize, points.len());
    assert!(points.len() > 10_000, "{} points", points.len());
    let ranges = points
        .iter()
        .map(|point| point.measured.range_m.to_le_bytes());
    assert!(served.point_ranges_buffer == bytes(ranges));
    let places = points
        .iter()
        .flat_map(|point| point.position_m.as_vec3().to_array());
    assert!(served.point_xyzs_buffer == bytes(places.map(f32::to_le_bytes)));
    let rings = points.iter().map(|point| point.beam.ring.to_le_bytes());
    assert!(served.point_ring_ids_buffer == bytes(rings));
    let instances = points
        .iter()
        .map(|point| point.measured.instance.to_le_bytes());
    assert!(served.point_instance_ids_buffer == bytes(instances));
    let on_car = points
        .iter()
        .filter(|point| point.measured.instance == 1)
        .count();
    assert!(on_car > 20, "{on_car} points on the car");
    let other = SweepRequest {
        seed: 4,
        returns: "median".into(),
        ..request.clone()
    };
    let other = lidars.render_sweep(other).await.unwrap().into_inner();
    assert!(
        other.point_ranges_buffer != served.point_ranges_buffer,
        "the mode counts"
    );

    by_kind(&running, &request).await;
    nonsense_is_refused(&running, &request).await;
    running.stop().await.unwrap();
}

/// The same sensor by its kind, alone and aggregated, in its frame at the end of the sweep.
async fn by_kind(running: &Running, request: &SweepRequest) {
    let mut lidars = lidar_client(running).await;
    let mut sensorsim = client(running).await;
    let asked = lidar_request(request.sensor_pose.unwrap());
    let alone = sensorsim
        .render_lidar(asked.clone())
        .await
        .unwrap()
        .into_inner();
    let at128 = SweepRequest {
        logical_id: "at128".into(),
        dynamic_objects: Vec::new(),
        returns: String::new(),
        opacity_threshold: 0.0,
        frame: "end".into(),
        ..request.clone()
    };
    let named = lidars.render_sweep(at128).await.unwrap().into_inner();
    assert!(alone.point_xyzs_buffer == named.point_xyzs_buffer);
    assert!(alone.point_ring_ids_buffer == named.point_ring_ids_buffer);
    // More points than lists and buffers together can hold in 4 MiB.
    assert!(alone.num_points > 104_857, "{} points", alone.num_points);
    assert!(alone.point_xyzs.is_empty() && alone.point_intensities.is_empty());
    assert!(alone.point_ring_ids.is_empty());
    listed_where_few(&mut sensorsim, &asked).await;
    let both = AggregatedRenderRequest {
        lidar_requests: vec![asked.clone(), asked],
        ..Default::default()
    };
    let both = sensorsim
        .render_aggregated(both)
        .await
        .unwrap()
        .into_inner();
    assert!(both.lidar_returns == [alone.clone(), alone]);
}

/// Lists and buffers hold the same where there are few points: from a sensor high above the street.
async fn listed_where_few(
    sensorsim: &mut SensorsimServiceClient<Channel>,
    asked: &LidarRenderRequest,
) {
    let above = Pose::from_yaw(0.0, DVec3::new(1.0, 0.5, 25.0));
    let asked = LidarRenderRequest {
        sensor_pose: Some(pair(&above, &above)),
        ..asked.clone()
    };
    let few = sensorsim.render_lidar(asked).await.unwrap().into_inner();
    let counts = [
        few.point_xyzs.len() / 3,
        few.point_intensities.len(),
        few.point_ring_ids.len(),
    ];
    assert!(few.num_points > 100, "{} points", few.num_points);
    assert_eq!(counts, [few.num_points as usize; 3]);
    assert!(bytes(few.point_xyzs.iter().map(|x| x.to_le_bytes())) == few.point_xyzs_buffer);
}

async fn nonsense_is_refused(running: &Running, request: &SweepRequest) {
    let mut lidars = lidar_client(running).await;
    let asked = || request.clone();
    let (no, none) = (|| "no".to_owned(), f32::NAN);
    for (field, code, spoilt) in [
        (
            "scene_id",
            Code::NotFound,
            SweepRequest {
                scene_id: no(),
                ..asked()
            },
        ),
        (
            "logical_id",
            Code::NotFound,
            SweepRequest {
                logical_id: no(),
                ..asked()
            },
        ),
        (
            "sensor_pose is missing",
            Code::InvalidArgument,
            SweepRequest {
                sensor_pose: None,
                ..asked()
            },
        ),
        (
            "frame_end_us",
            Code::InvalidArgument,
            SweepRequest {
                frame_end_us: 1,
                ..asked()
            },
        ),
        (
            "returns",
            Code::InvalidArgument,
            SweepRequest {
                returns: no(),
                ..asked()
            },
        ),
        (
            "opacity_threshold",
            Code::InvalidArgument,
            SweepRequest {
                opacity_threshold: none,
                ..asked()
            },
        ),
        (
            "frame",
            Code::InvalidArgument,
            SweepRequest {
                frame: no(),
                ..asked()
            },
        ),
    ] {
        let status = lidars.render_sweep(spoilt).await.unwrap_err();
        assert!(
            status.code() == code && status.message().starts_with(field),
            "{status}"
        );
    }
    let mut sensorsim = client(running).await;
    let mut spoilt = lidar_request(request.sensor_pose.unwrap());
    spoilt.lidar_config = Some(LidarSpec { lidar_type: 9 });
    let both = AggregatedRenderRequest {
        lidar_requests: vec![spoilt],
        ..Default::default()
    };
    let status = sensorsim.render_aggregated(both).await.unwrap_err();
    assert!(
        status
            .message()
            .starts_with("lidar_requests[0].lidar_config"),
        "{status}"
    );
}
