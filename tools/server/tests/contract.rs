//! Every call under every name of its service.

use std::collections::HashSet;

use decouplegs::scene::Pose;
use decouplegs_alpasim::wire::common::{Aabb, AvailableScenesReturn, Empty, VersionId};
use decouplegs_alpasim::wire::physics::physics_ground_intersection_request::{
    OtherObject, PosePair,
};
use decouplegs_alpasim::wire::physics::{
    PhysicsGroundIntersectionRequest, PhysicsGroundIntersectionReturn,
};
use decouplegs_alpasim::wire::sensorsim::{
    AggregatedRenderRequest, AggregatedRenderReturn, AvailableCamerasRequest,
    AvailableCamerasReturn, AvailableEgoMasksReturn, AvailableTrajectoriesRequest,
    AvailableTrajectoriesReturn, BatchRgbRenderReturn, ImageFormat, LidarRenderRequest,
    LidarRenderReturn, LoadedScenesReturn, RgbRenderRequest, RgbRenderReturn,
};
use decouplegs_server::names::{PHYSICS, PHYSICS_ALSO, SENSORSIM, SENSORSIM_ALSO};
use decouplegs_server::running::Running;
use glam::DVec3;
use tonic::client::Grpc;
use tonic::transport::Channel;
use tonic::{Code, Request, Status};
use tonic_prost::ProstCodec;

use crate::asking::{
    batch, cameras, channel, client, message, object, options, png, pose, request, serve,
};
use crate::scenes::{marked, street};

/// One call by the full name of service and method.
async fn call<A, B>(channel: &Channel, service: &str, method: &str, asked: A) -> Result<B, Status>
where
    A: prost::Message + Send + Sync + 'static,
    B: prost::Message + Default + Send + Sync + 'static,
{
    let mut grpc = Grpc::new(channel.clone()).max_decoding_message_size(64 << 20);
    grpc.ready().await.expect("the server is there");
    let path = format!("/{service}/{method}").parse().unwrap();
    let codec: ProstCodec<A, B> = ProstCodec::default();
    grpc.unary(Request::new(asked), path, codec)
        .await
        .map(tonic::Response::into_inner)
}

#[tokio::test(flavor = "multi_thread")]
async fn every_call_is_answered_under_every_name() {
    let folder = tempfile::tempdir().unwrap();
    let running = serve(&options(vec![street(folder.path()), marked(folder.path())])).await;
    let (channel, mut own) = (channel(&running).await, client(&running).await);
    let rig = cameras(&mut own, "street").await;
    let level = Pose::from_yaw(0.0, DVec3::new(0.0, 0.0, 0.8));
    for service in [SENSORSIM].into_iter().chain(SENSORSIM_ALSO) {
        let version: VersionId = call(&channel, service, "get_version", Empty {})
            .await
            .unwrap();
        assert!(
            version.version_id.starts_with("decouplegs-server ")
                && version.grpc_api_version.is_some()
        );
        let scenes: AvailableScenesReturn =
            call(&channel, service, "get_available_scenes", Empty {})
                .await
                .unwrap();
        assert_eq!(scenes.scene_ids, ["marked", "street"]);
        let asked = AvailableCamerasRequest {
            scene_id: "street".into(),
        };
        let found: AvailableCamerasReturn = call(&channel, service, "get_available_cameras", asked)
            .await
            .unwrap();
        assert_eq!(
            (found.available_cameras.len(), &found.available_cameras),
            (6, &rig)
        );
        let asked = AvailableTrajectoriesRequest {
            scene_id: "street".into(),
        };
        let ways: AvailableTrajectoriesReturn =
            call(&channel, service, "get_available_trajectories", asked)
                .await
                .unwrap();
        let way = ways.available_trajectories[0].trajectory.as_ref().unwrap();
        assert!(way.poses.len() > 1 && way.poses.is_sorted_by_key(|timed| timed.timestamp_us));
        let masks: AvailableEgoMasksReturn =
            call(&channel, service, "get_available_ego_masks", Empty {})
                .await
                .unwrap();
        assert!(masks.ego_mask_metadata.is_empty());
        let image = request("street", &rig[0], &level, ImageFormat::Png);
        let drawn: RgbRenderReturn = call(&channel, service, "render_rgb", image.clone())
            .await
            .unwrap();
        assert_eq!(png(&drawn.image_bytes).0, [160, 100]);
        let asked = AggregatedRenderRequest {
            rgb_requests: vec![image.clone(), image.clone()],
            ..Default::default()
        };
        let both: AggregatedRenderReturn = call(&channel, service, "render_aggregated", asked)
            .await
            .unwrap();
        assert_eq!(
            both.rgb_returns,
            [drawn.clone(), drawn.clone()],
            "the same request is the same image"
        );
        let asked = batch([("a".to_owned(), image.clone()), ("b".to_owned(), image)]);
        let named: BatchRgbRenderReturn = call(&channel, service, "batch_render_rgb", asked)
            .await
            .unwrap();
        for (item, name) in named.items.iter().zip(["a", "b"]) {
            assert!(
                item.success && item.camera_name == name && item.result.as_ref() == Some(&drawn),
                "{}",
                item.error_message
            );
        }
        let loaded: LoadedScenesReturn = call(&channel, service, "get_loaded_scenes", Empty {})
            .await
            .unwrap();
        assert_eq!(
            (loaded.scenes[0].scene_id.as_str(), loaded.scenes.len()),
            ("street", 1)
        );
        let lidar: Result<LidarRenderReturn, _> = call(
            &channel,
            service,
            "render_lidar",
            LidarRenderRequest::default(),
        )
        .await;
        let refused = lidar.unwrap_err();
        assert!(refused.message().starts_with("scene_id"), "{refused}");
        for unknown in ["edit_assets", "get_dynamic_objects", "shut_down"] {
            let refused: Result<Empty, _> = call(&channel, service, unknown, Empty {}).await;
            assert_eq!(
                refused.unwrap_err().code(),
                Code::Unimplemented,
                "{unknown}"
            );
        }
    }
    ground_under_every_name(&channel).await;
    running.stop().await.unwrap();
}

async fn ground_under_every_name(channel: &Channel) {
    let aabb = Aabb {
        size_x: 4.5,
        size_y: 1.8,
        size_z: 1.5,
    };
    // On the street, half a meter in the air.
    let floating = message(&Pose::from_yaw(0.0, DVec3::new(5.0, 0.0, 1.25)));
    let pose_pair = Some(PosePair {
        now_pose: Some(floating),
        future_pose: Some(floating),
    });
    let other_objects = vec![OtherObject {
        aabb: Some(aabb),
        pose_pair,
    }];
    let asked = PhysicsGroundIntersectionRequest {
        scene_id: "street".into(),
        other_objects,
        ..Default::default()
    };
    for service in [PHYSICS].into_iter().chain(PHYSICS_ALSO) {
        let _: VersionId = call(channel, service, "get_version", Empty {})
            .await
            .unwrap();
        let scenes: AvailableScenesReturn =
            call(channel, service, "get_available_scenes", Empty {})
                .await
                .unwrap();
        assert_eq!(scenes.scene_ids, ["marked", "street"]);
        let set: PhysicsGroundIntersectionReturn =
            call(channel, service, "ground_intersection", asked.clone())
                .await
                .unwrap();
        let place = set.other_poses[0].pose.unwrap().vec.unwrap();
        assert_eq!(
            (set.other_poses.len(), set.other_poses[0].status),
            (1, 0),
            "{set:?}"
        );
        assert!(
            (place.z - 0.75).abs() < 0.1 && place.x == 5.0 && place.y == 0.0,
            "{place:?}"
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_batch_is_one_submission_and_every_name_comes_back_once() {
    let folder = tempfile::tempdir().unwrap();
    let running = serve(&options(vec![street(folder.path())])).await;
    let mut client = client(&running).await;
    let rig = cameras(&mut client, "street").await;
    let level = Pose::from_yaw(0.0, DVec3::new(0.0, 0.0, 0.8));
    let named = |format| {
        rig.iter().map(move |camera| {
            (
                camera.logical_id.clone(),
                request("street", camera, &level, format),
            )
        })
    };
    for format in [
        ImageFormat::Png,
        ImageFormat::Jpeg,
        ImageFormat::RgbUint8Planar,
    ] {
        let before = running.submissions();
        let reply = client
            .batch_render_rgb(batch(named(format)))
            .await
            .unwrap()
            .into_inner();
        assert_eq!(running.submissions() - before, 1, "{format:?}");
        let names: HashSet<_> = reply
            .items
            .iter()
            .map(|item| item.camera_name.clone())
            .collect();
        assert_eq!((reply.items.len(), names.len()), (6, 6));
        for item in &reply.items {
            let bytes = &item.result.as_ref().unwrap().image_bytes;
            let is_right = match format {
                ImageFormat::Png => png(bytes).0 == [160, 100],
                ImageFormat::Jpeg => {
                    bytes.starts_with(&[0xff, 0xd8]) && bytes.ends_with(&[0xff, 0xd9])
                }
                _ => bytes.len() == 3 * 160 * 100 && bytes.iter().any(|byte| *byte != bytes[0]),
            };
            assert!(
                item.success && item.error_message.is_empty() && is_right,
                "{} {format:?}",
                item.camera_name
            );
        }
    }
    cameras_with_different_objects_share_a_submission(&running, named(ImageFormat::Png)).await;
    // A camera that cannot be drawn takes none of the others with it.
    let mut asked = batch(named(ImageFormat::Png));
    asked.items[2].request.as_mut().unwrap().image_format = ImageFormat::Av1.into();
    asked.items[3].request.as_mut().unwrap().scene_id = "nowhere".into();
    let reply = client.batch_render_rgb(asked).await.unwrap().into_inner();
    for (index, item) in reply.items.iter().enumerate() {
        assert_eq!(
            (item.success, item.result.is_some()),
            (![2, 3].contains(&index), ![2, 3].contains(&index))
        );
    }
    assert!(
        reply.items[2].error_message.contains("AV1")
            && reply.items[3].error_message.contains("nowhere")
    );
    running.stop().await.unwrap();
}

/// Every second camera lists a car, at a place of its own: each image is that of its request alone.
async fn cameras_with_different_objects_share_a_submission(
    running: &Running,
    requests: impl Iterator<Item = (String, RgbRenderRequest)>,
) {
    let mut client = client(running).await;
    let requests: Vec<_> = requests
        .enumerate()
        .map(|(index, (name, mut request))| {
            if index % 2 == 0 {
                let sensor = request.sensor_pose.as_ref().unwrap().start_pose.unwrap();
                let ahead = pose(&sensor).transform(DVec3::Z * (8.0 + index as f64));
                let place = Pose::from_yaw(0.3 * index as f64, ahead);
                request.dynamic_objects = vec![object("car_000", &place, &place)];
            }
            (name, request)
        })
        .collect();
    let before = running.submissions();
    let reply = client.batch_render_rgb(batch(requests.clone())).await;
    assert_eq!(running.submissions() - before, 1);
    let mut without = 0;
    for (item, (_, request)) in reply.unwrap().into_inner().items.iter().zip(requests) {
        let together = item.result.as_ref().unwrap().image_bytes.clone();
        let plain = RgbRenderRequest {
            dynamic_objects: Vec::new(),
            ..request.clone()
        };
        let alone = client.render_rgb(request).await.unwrap().into_inner();
        assert_eq!(together, alone.image_bytes, "{}", item.camera_name);
        let plain = client.render_rgb(plain).await.unwrap().into_inner();
        without += usize::from(plain.image_bytes == together);
    }
    assert_eq!(without, 3, "every second camera sees a car");
}

#[tokio::test(flavor = "multi_thread")]
async fn agents_that_are_listed_are_seen_and_unknown_ones_change_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let running = serve(&options(vec![street(folder.path())])).await;
    let mut client = client(&running).await;
    let rig = cameras(&mut client, "street").await;
    let level = Pose::from_yaw(0.0, DVec3::new(0.0, 0.0, 0.8));
    let ahead = Pose::from_yaw(0.3, DVec3::new(9.0, 0.0, 0.8));
    let mut image_with = async |names: &[&str]| {
        let mut asked = request("street", &rig[0], &level, ImageFormat::Png);
        asked.dynamic_objects = names
            .iter()
            .map(|name| object(name, &ahead, &ahead))
            .collect();
        client
            .render_rgb(asked)
            .await
            .unwrap()
            .into_inner()
            .image_bytes
    };
    let names = decouplegs::asset::SceneFile::read(&folder.path().join("street/scene.toml"))
        .unwrap()
        .agents;
    let (coded, plain) = (names[0].name.as_str(), names[1].name.as_str());
    let empty = image_with(&[]).await;
    assert_ne!(empty, image_with(&[coded]).await);
    assert_ne!(
        empty,
        image_with(&[plain]).await,
        "agents of plain splat files move too"
    );
    assert_eq!(empty, image_with(&["nobody"]).await);
    running.stop().await.unwrap();
}
