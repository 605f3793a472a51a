//! A rollout as a simulator's runtime drives it: the same calls in the same order, a hundred steps
//! of ten a second.

use std::collections::HashSet;

use decouplegs::asset::SceneFile;
use decouplegs::scene::{Pose, Trajectory};
use decouplegs_alpasim::wire::common::{Aabb, Empty, PoseAtTime};
use decouplegs_alpasim::wire::physics::PhysicsGroundIntersectionRequest;
use decouplegs_alpasim::wire::physics::physics_ground_intersection_request::{
    EgoData, OtherObject, PosePair,
};
use decouplegs_alpasim::wire::physics::physics_service_client::PhysicsServiceClient;
use decouplegs_alpasim::wire::sensorsim::{ImageFormat, RgbRenderRequest};

use crate::asking::{
    batch, cameras, channel, client, message, object, options, pair, pose, request, serve,
};
use crate::scenes::street;

const STEPS: u64 = 100;
const STEP_US: u64 = 100_000;
const SHUTTER_US: u64 = 20_000;

fn at(way: &Trajectory, time_us: u64) -> Pose {
    way.at(time_us as f64 * 1e-6)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hundred_steps_with_two_and_with_six_cameras() {
    let folder = tempfile::tempdir().unwrap();
    let path = street(folder.path());
    let file = SceneFile::read(&path).unwrap();
    let running = serve(&options(vec![path])).await;
    let mut sensorsim = client(&running).await;
    let mut physics = PhysicsServiceClient::new(channel(&running).await);
    for count in [2, 6] {
        // Once a daemon starts: who is there, and which scenes.
        sensorsim.get_version(Empty {}).await.unwrap();
        physics.get_version(Empty {}).await.unwrap();
        let scenes = sensorsim
            .get_available_scenes(Empty {})
            .await
            .unwrap()
            .into_inner()
            .scene_ids;
        assert!(scenes.contains(&"street".to_owned()));
        // Once a rollout begins: the rig.
        let rig: Vec<_> = cameras(&mut sensorsim, "street")
            .await
            .into_iter()
            .take(count)
            .collect();
        sensorsim.get_available_ego_masks(Empty {}).await.unwrap();
        let ego_way = file.ego.clone().unwrap();
        let mut different = HashSet::new();
        for step in 0..STEPS {
            let (now_us, then_us) = (step * STEP_US, (step + 1) * STEP_US);
            grounded(&mut physics, &file, &ego_way, now_us, then_us).await;
            let shutter_us = [then_us - SHUTTER_US, then_us];
            let requests = rig.iter().map(|camera| {
                let rig_from_camera = pose(&camera.rig_to_camera.unwrap());
                let [start, end] =
                    shutter_us.map(|time_us| at(&ego_way, time_us).then(&rig_from_camera));
                let objects = file.agents.iter().map(|agent| {
                    let [start, end] = shutter_us.map(|time_us| at(&agent.trajectory, time_us));
                    object(&agent.name, &start, &end)
                });
                let asked = RgbRenderRequest {
                    sensor_pose: Some(pair(&start, &end)),
                    frame_start_us: shutter_us[0],
                    frame_end_us: shutter_us[1],
                    dynamic_objects: objects.collect(),
                    resolution_w: 96,
                    resolution_h: 60,
                    ..request("street", camera, &Pose::IDENTITY, ImageFormat::Jpeg)
                };
                (camera.logical_id.clone(), asked)
            });
            let submissions = running.submissions();
            let reply = sensorsim
                .batch_render_rgb(batch(requests))
                .await
                .unwrap()
                .into_inner();
            assert_eq!(running.submissions() - submissions, 1, "step {step}");
            let names: HashSet<_> = reply
                .items
                .iter()
                .map(|item| item.camera_name.clone())
                .collect();
            assert_eq!((names.len(), reply.items.len()), (count, count));
            for item in reply.items {
                assert!(
                    item.success,
                    "step {step}: {}: {}",
                    item.camera_name, item.error_message
                );
                different.insert(item.result.unwrap().image_bytes);
            }
        }
        assert!(
            different.len() > STEPS as usize,
            "{} of {} images differ",
            different.len(),
            STEPS as usize * count
        );
    }
    running.stop().await.unwrap();
}

/// Ground queries of the runtime before each step: the ego's next pose and the others'. Checks that
/// nothing was lost.
async fn grounded(
    physics: &mut PhysicsServiceClient<tonic::transport::Channel>,
    file: &SceneFile,
    ego_way: &Trajectory,
    now_us: u64,
    then_us: u64,
) {
    let aabb = Some(Aabb {
        size_x: 4.5,
        size_y: 1.8,
        size_z: 1.5,
    });
    let timed = |time_us| PoseAtTime {
        pose: Some(message(&at(ego_way, time_us))),
        timestamp_us: time_us,
    };
    let trajectory = decouplegs_alpasim::wire::common::Trajectory {
        poses: vec![timed(now_us), timed(then_us)],
    };
    let other = |way: &Trajectory| {
        let [now_pose, future_pose] =
            [now_us, then_us].map(|time_us| Some(message(&at(way, time_us))));
        OtherObject {
            aabb,
            pose_pair: Some(PosePair {
                now_pose,
                future_pose,
            }),
        }
    };
    let asked = PhysicsGroundIntersectionRequest {
        scene_id: "street".into(),
        now_us,
        future_us: then_us,
        ego_data: Some(EgoData {
            aabb,
            ego_trajectory_aabb: Some(trajectory),
        }),
        other_objects: file
            .agents
            .iter()
            .map(|agent| other(&agent.trajectory))
            .collect(),
    };
    let set = physics
        .ground_intersection(asked)
        .await
        .unwrap()
        .into_inner();
    let poses = set.ego_trajectory_aabb.unwrap().poses;
    assert_eq!(
        (poses.len(), set.ego_status.len(), set.other_poses.len()),
        (2, 2, file.agents.len())
    );
    assert_eq!(
        [poses[0].timestamp_us, poses[1].timestamp_us],
        [now_us, then_us]
    );
    // It was on the ground, and is still.
    for (timed, status) in poses.iter().zip(set.ego_status) {
        let (asked, given) = (at(ego_way, timed.timestamp_us), pose(&timed.pose.unwrap()));
        assert!(
            (given.translation - asked.translation).length() < 0.5,
            "status {status}: {asked:?} became {given:?}"
        );
    }
}
