//! Parts of NuRec packages beside their splats: ground, photometry, and packages that are written.

use decouplegs_asset::packed_scene::{PackOptions, ground_mesh_ply, pack};
use decouplegs_asset::scene_import::decode_nurec;
use decouplegs_asset::{SceneAgent, SceneFile, inria_ply, open_scene};
use decouplegs_scene::{Pose, Presence, SplatCloud, Trajectory};
use glam::{DQuat, DVec3};

use crate::errors::Errors;
use crate::nurec::{
    State, halves, package, put, put_layer, read, rig, saved, state, tracks, turned, volume,
    with_tracks, zip,
};
use crate::sample::cloud;

#[test]
fn vehicles_stand_on_the_mesh_of_the_package_else_on_its_road() {
    let with = |entries: &[(&str, Vec<u8>)]| {
        let nre_from_world = turned();
        let state = state(&cloud(40, 3), &cloud(30, 1), &nre_from_world);
        let own = [
            ("volume.nurec", with_tracks(state)),
            ("rig_trajectories.json", rig(&nre_from_world)),
            ("sequence_tracks.json", tracks()),
        ];
        zip(&[&own[..], entries].concat())
    };
    let vertices = [[0.0, 0.0, 0.5], [1.0, 0.0, 0.5], [0.0, 1.0, 0.5]];
    let mesh = ground_mesh_ply(&vertices, &[[0, 1, 2]]);
    let bytes = with(&[("mesh_ground.ply", mesh)]);
    let scene = read(&bytes);
    assert!(scene.ground.len() > 8 && scene.ground.iter().all(|point| point.z == 0.5));
    let (_directory, path) = saved(&bytes);
    let loaded = open_scene(&path, 0.0).unwrap();
    assert_eq!(loaded.recording.ground_m, scene.ground);
    // Without a mesh, and with a broken one, the splats of the road, in the world.
    for entries in [&[][..], &[("mesh_ground.ply", b"ply".to_vec())][..]] {
        let scene = read(&with(entries));
        let road = cloud(40, 3);
        let nearest = |point: &DVec3| {
            let means = road
                .means
                .iter()
                .map(|mean| glam::Vec3::from_array(*mean).as_dvec3());
            means
                .map(|mean| mean.distance(*point))
                .fold(f64::INFINITY, f64::min)
        };
        assert!(!scene.ground.is_empty());
        assert!(scene.ground.iter().all(|point| nearest(point) < 0.06));
        let is_said = scene
            .notes
            .iter()
            .any(|note| note.contains("mesh_ground.ply"));
        assert_eq!(is_said, !entries.is_empty());
    }
}

#[test]
fn lidars_of_a_package_are_sensors_of_its_scene() {
    let nre_from_world = turned();
    let mut rig: serde_json::Value = serde_json::from_slice(&rig(&nre_from_world)).unwrap();
    let azimuths: Vec<f64> = (0..90)
        .map(|column| 3.0 - 0.06 * f64::from(column))
        .collect();
    let model = serde_json::json!({
        "spinning_frequency_hz": 10.0,
        "spinning_direction": "cw",
        "row_elevations_rad": [0.2, 0.0, -0.2],
        "column_azimuths_rad": azimuths,
    });
    let at = [
        [1.0, 0.0, 0.0, 1.1],
        [0.0, 1.0, 0.0, 0.2],
        [0.0, 0.0, 1.0, 1.9],
        [0.0, 0.0, 0.0, 1.0],
    ];
    rig["lidar_calibrations"] = serde_json::json!({
        "top@a": {
            "logical_sensor_name": "top", "T_sensor_rig": at,
            "lidar_model": {"type": "row-offset-spinning", "parameters": model},
        },
        "side@a": {"logical_sensor_name": "side", "T_sensor_rig": at},
        "odd@a": {"logical_sensor_name": "odd", "T_sensor_rig": at, "lidar_model": {"beams": 5}},
    });
    let package = zip(&[
        (
            "volume.nurec",
            with_tracks(state(&cloud(40, 3), &cloud(30, 1), &nre_from_world)),
        ),
        ("rig_trajectories.json", rig.to_string().into_bytes()),
        ("sequence_tracks.json", tracks()),
    ]);
    let (folder, path) = saved(&package);
    let loaded = open_scene(&path, 0.0).unwrap();
    let lidars: Vec<_> = loaded.rig.lidars().collect();
    let [top] = lidars[..] else {
        panic!("one LiDAR")
    };
    assert_eq!(
        (top.name.as_str(), top.model.beams().len()),
        ("top", 3 * 90)
    );
    // From the middle of the box, which is at (1.35, 0, 0.75) of the rig.
    let expected = DVec3::new(1.1 - 1.35, 0.2, 1.9 - 0.75);
    assert!(top.rig_from_lidar.translation.distance(expected) < 1e-9);
    let scene = read(&package);
    let notes = scene.notes.join("\n");
    assert!(
        notes.contains("the LiDAR side is left out") && notes.contains("the LiDAR odd is left out")
    );
    let out = folder.path().join("out");
    std::fs::create_dir(&out).unwrap();
    scene.write(&out).unwrap();
    let again = open_scene(&out.join("scene.toml"), 0.0).unwrap();
    assert_eq!(again.rig, loaded.rig);
}

#[test]
fn volumes_of_any_name_stand_where_their_stage_puts_them() {
    let splats = cloud(40, 3);
    let world_from_volume = turned();
    let volume_of = |splats: &SplatCloud| {
        let mut state = State::new();
        put_layer(&mut state, "gaussians", splats, 1);
        volume(state)
    };
    let there = splats.clone().placed(&world_from_volume.inverse(), true);
    let half = |at: std::ops::Range<u32>| volume_of(&there.select(&at.collect::<Vec<_>>()));
    let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| world_from_volume.rotation * axis);
    let t = world_from_volume.translation;
    let rows = [(x, 0), (y, 0), (z, 0), (t, 1)]
        .map(|(row, last)| format!("({}, {}, {}, {last})", row.x, row.y, row.z));
    let stage = format!(
        "#usda 1.0\ndef Volume \"gauss\"\n{{\n    custom bool omni:nurec:isNuRecVolume = 1\n    matrix4d xformOp:transform = ( {} )\n}}\n",
        rows.join(", ")
    );
    let bytes = zip(&[
        ("default.usda", b"#usda 1.0\n".to_vec()),
        ("part_1.nurec", half(0..20)),
        ("part_2.nurec", half(20..40)),
        ("gauss.usda", stage.into_bytes()),
    ]);
    let found = read(&bytes);
    let errors = Errors::between(&splats, &found.background);
    assert!(errors.mean_m < 0.04 && errors.rest < 4e-3, "{errors:?}");
    assert!(
        errors.angle_rad < 5e-3 && errors.scale_ln < 5e-3,
        "{errors:?}"
    );
}

/// A package whose volume has arrays of PPISP for `cameras` cameras and three images.
fn package_with_ppisp(cameras: usize, response: f32) -> Vec<u8> {
    let mut state = state(&cloud(40, 3), &cloud(30, 1), &Pose::IDENTITY);
    let name = |array: &str| format!(".post_processings.0.ppisp.{array}_params");
    let of = |count: usize, value: f32| halves(vec![value; count]);
    put(
        &mut state,
        &name("exposure"),
        vec![3],
        halves([0.5, 0.25, -0.25]),
    );
    put(&mut state, &name("color"), vec![3, 8], of(24, 0.0));
    let vignetting = of(15 * cameras, 0.0);
    put(
        &mut state,
        &name("vignetting"),
        vec![cameras, 3, 5],
        vignetting,
    );
    put(
        &mut state,
        &name("crf"),
        vec![cameras, 3, 4],
        of(12 * cameras, response),
    );
    let metadata = b"scene_id: a\nsensors:\n  camera_ids:\n  - other\n  - wide\n  lidar_ids: []\n";
    zip(&[
        ("volume.nurec", with_tracks(state)),
        ("rig_trajectories.json", rig(&Pose::IDENTITY)),
        ("sequence_tracks.json", tracks()),
        ("metadata.yaml", metadata.to_vec()),
    ])
}

#[test]
fn cameras_have_the_photometry_of_the_package() {
    let scene = read(&package_with_ppisp(2, 0.0));
    let camera = scene.rig.cameras().next().unwrap();
    let found = camera.intrinsics.photometry;
    // The camera `wide` is the second of two, and which images are its own is not known: the mean
    // of all.
    assert!((found.exposure_ev - 0.5 / 3.0).abs() < 1e-3, "{found:?}");
    let [toe, center] = [0.3 + 2f64.ln(), 0.5];
    let response = found.response.unwrap();
    assert!((response.toe[1] - toe).abs() < 1e-6, "{response:?}");
    assert!((response.center[2] - center).abs() < 1e-6, "{response:?}");
    assert_eq!(found.vignetting.unwrap().center_px, [[32.0, 24.0]; 3]);
    assert!(
        !scene.notes.iter().any(|note| note.contains("PPISP")),
        "{:?}",
        scene.notes
    );
    // Arrays for other cameras than there are: said, and not applied.
    let scene = read(&package_with_ppisp(5, 0.0));
    let camera = scene.rig.cameras().next().unwrap();
    assert!(camera.intrinsics.photometry.is_identity());
    assert!(
        scene.notes.iter().any(|note| note.contains("PPISP")),
        "{:?}",
        scene.notes
    );
    // Numbers that are none get a sentence.
    let said = decode_nurec(&package_with_ppisp(2, f32::NAN))
        .unwrap_err()
        .to_string();
    assert!(said.contains("PPISP") && said.contains("wide"), "{said}");
}

#[test]
fn a_scene_is_written_in_the_form_and_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (scene, agents) = (cloud(40, 3), cloud(30, 1));
    inria_ply::write(&at("background.ply"), &scene).unwrap();
    inria_ply::write(&at("car.ply"), &agents).unwrap();
    let (_package_folder, package) = saved(&package(&Pose::IDENTITY));
    let way = open_scene(&package, 0.0).unwrap().ego;
    let origin = DVec3::new(5000.0, -300.0, 40.0);
    let car = Pose::new(
        DQuat::from_rotation_z(0.5),
        origin + DVec3::new(3.0, 4.0, 0.7),
    );
    let file = SceneFile {
        origin,
        sky: [0.25, 0.5, 0.75],
        ego: Some(way),
        agents: ["near", "absent", "far"]
            .map(|name| SceneAgent {
                name: name.into(),
                class: Some("truck".into()),
                asset: "car.ply".into(),
                sh_frame: None,
                trajectory: Trajectory::standing(car),
                present: match name {
                    "absent" => Presence::new(vec![[900.0, 901.0]]).unwrap(),
                    _ => Presence::ALWAYS,
                },
            })
            .into(),
        ..SceneFile::of_background("background.ply")
    };
    let options = PackOptions {
        as_nurec: true,
        ..PackOptions::new("drive")
    };
    let out = at("drive.usdz");
    let summary = pack(&file, folder.path(), &options, &out).unwrap();
    assert!(
        !summary
            .entries
            .iter()
            .any(|name| name.starts_with("decouplegs/"))
    );
    assert!(summary.position_step_m.is_some_and(|step_m| step_m > 0.0));
    let found = read(&std::fs::read(&out).unwrap());
    let errors = Errors::between(&scene, &found.background);
    assert!(errors.mean_m < 0.04 && errors.rest < 2e-3, "{errors:?}");
    assert!(
        errors.opacity < 2e-3 && errors.scale_ln < 5e-3,
        "{errors:?}"
    );
    assert!(errors.angle_rad < 5e-3 && errors.dc < 2e-3, "{errors:?}");
    let names: Vec<&str> = found.actors.iter().map(|actor| &*actor.name).collect();
    assert_eq!(
        names,
        ["near", "far"],
        "one that never is there has no track"
    );
    for actor in &found.actors {
        let errors = Errors::between(&agents, &actor.splats);
        assert!(errors.mean_m < 0.04 && errors.rest < 2e-3, "{errors:?}");
        let pose = actor.trajectory.as_ref().unwrap().at(1.0);
        assert!(pose.translation.distance(DVec3::new(3.0, 4.0, 0.7)) < 1e-6);
        assert_eq!(actor.class.as_deref(), Some("truck"));
    }
    let sky = found.sky.unwrap();
    for direction in [DVec3::X, -DVec3::Y, DVec3::new(1.0, 2.0, 3.0)] {
        assert_eq!(sky.color(direction), [0.25, 0.5, 0.75]);
    }
}
