//! Packages of NuRec. No real one could be had: these are written here, after the public readers
//! and writers that `scene_import::nurec` names.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::PathBuf;

use decouplegs_asset::packed_scene::packed_scene_id;
use decouplegs_asset::scene_import::{ImportedScene, decode_nurec};
use decouplegs_asset::zip::StoredZip;
use decouplegs_asset::{SceneFile, open_scene};
use decouplegs_scene::{Pose, ShFrame, SplatCloud};
use flate2::{Compression, write::GzEncoder};
use glam::{DMat4, DQuat, DVec3};
use half::f16;
use serde_json::json;

use crate::errors::Errors;
use crate::sample::cloud;

/// A value of MessagePack that tests write.
#[derive(Clone)]
pub enum Packed {
    Text(&'static str),
    Sizes(Vec<usize>),
    Bytes(Vec<u8>),
    Map(Vec<(String, Packed)>),
}

impl Packed {
    fn write(&self, out: &mut Vec<u8>) {
        let text = |out: &mut Vec<u8>, text: &str| {
            out.push(0xda);
            out.extend((text.len() as u16).to_be_bytes());
            out.extend(text.as_bytes());
        };
        match self {
            Self::Text(value) => text(out, value),
            Self::Sizes(sizes) => {
                out.push(0xdc);
                out.extend((sizes.len() as u16).to_be_bytes());
                for size in sizes {
                    out.push(0xcf);
                    out.extend((*size as u64).to_be_bytes());
                }
            }
            Self::Bytes(bytes) => {
                out.push(0xc6);
                out.extend((bytes.len() as u32).to_be_bytes());
                out.extend(bytes);
            }
            Self::Map(pairs) => {
                out.push(0xde);
                out.extend((pairs.len() as u16).to_be_bytes());
                for (key, value) in pairs {
                    text(out, key);
                    value.write(out);
                }
            }
        }
    }
}

/// Entries of a state dictionary.
pub type State = BTreeMap<String, Packed>;

pub fn halves(values: impl IntoIterator<Item = f32>) -> Vec<u8> {
    let values = values.into_iter();
    values
        .flat_map(|value| f16::from_f32(value).to_le_bytes())
        .collect()
}

pub fn put(state: &mut State, name: &str, shape: Vec<usize>, bytes: Vec<u8>) {
    state.insert(name.to_owned(), Packed::Bytes(bytes));
    state.insert(format!("{name}.shape"), Packed::Sizes(shape));
}

/// Adds a layer with `times` colors over time, of which the first is the constant one.
pub fn put_layer(state: &mut State, layer: &str, splats: &SplatCloud, times: usize) {
    let n = splats.len();
    let name = |array: &str| format!(".gaussians_nodes.{layer}.{array}");
    let log = |scales: &[f32; 3]| scales.map(f32::ln);
    let logit = |opacity: &f32| (opacity / (1.0 - opacity)).ln();
    let means = halves(splats.means.as_flattened().iter().copied());
    put(state, &name("positions"), vec![n, 3], means);
    let rotations = halves(splats.rotations.as_flattened().iter().map(|q| 2.0 * q));
    put(state, &name("rotations"), vec![n, 4], rotations);
    let scales = halves(splats.scales.iter().flat_map(log));
    put(state, &name("scales"), vec![n, 3], scales);
    let densities = halves(splats.opacities.iter().map(logit));
    put(state, &name("densities"), vec![n, 1], densities);
    let color = |dc: &[f32; 3]| {
        let mut all = vec![0.25; 3 * times];
        all[..3].copy_from_slice(dc);
        all
    };
    let shape = if times > 1 {
        vec![n, times, 3]
    } else {
        vec![n, 3]
    };
    let albedo = halves(splats.sh_dc.iter().flat_map(color));
    put(state, &name("features_albedo"), shape, albedo);
    let rest = |splat: usize| {
        let mut all = splats.rest_of(splat).to_vec();
        all.resize(15, [0.0; 3]);
        all.into_iter().flatten().collect::<Vec<f32>>()
    };
    let specular = halves((0..n).flat_map(rest));
    put(state, &name("features_specular"), vec![n, 45], specular);
    let active = 3i64.to_le_bytes().to_vec();
    put(state, &name("n_active_features"), Vec::new(), active);
}

pub fn volume(state: State) -> Vec<u8> {
    let state = Packed::Map(state.into_iter().collect());
    let data = vec![
        ("version".to_owned(), Packed::Text("0.2.576")),
        ("state_dict".to_owned(), state),
    ];
    let root = Packed::Map(vec![("nre_data".to_owned(), Packed::Map(data))]);
    let mut bytes = Vec::new();
    root.write(&mut bytes);
    gzip(&bytes)
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut zipped = GzEncoder::new(Vec::new(), Compression::fast());
    zipped.write_all(bytes).unwrap();
    zipped.finish().unwrap()
}

pub fn zip(entries: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut zip = StoredZip::new(&mut bytes);
    for (name, content) in entries {
        zip.add(name, content).unwrap();
    }
    zip.finish().unwrap();
    bytes
}

fn rows(pose: &Pose) -> serde_json::Value {
    let matrix = DMat4::from_rotation_translation(pose.rotation, pose.translation).transpose();
    json!(matrix.to_cols_array_2d())
}

/// First pose of the rig and of the tracks, microseconds.
const START_US: u64 = 1_700_000_000_000_000;

pub fn rig(nre_from_world: &Pose) -> Vec<u8> {
    let pose = |x: f64| rows(&Pose::new(DQuat::IDENTITY, DVec3::new(x, 2.0, 0.0)));
    json!({
        "world_to_nre": {"matrix": rows(nre_from_world)},
        "camera_calibrations": {"wide@a": {
            "logical_sensor_name": "wide",
            "T_sensor_rig": rows(&Pose::new(DQuat::IDENTITY, DVec3::new(1.5, 0.0, 1.4))),
            "camera_model": {"type": "opencv-pinhole", "parameters": {
                "resolution": [64, 48], "principal_point": [32.0, 24.0], "focal_length": [50.0, 50.0],
                "shutter_type": "ROLLING_TOP_TO_BOTTOM",
            }},
        }},
        "rig_trajectories": [{
            "T_rig_world_timestamps_us": [START_US, START_US + 2_000_000],
            "T_rig_worlds": [pose(0.0), pose(20.0)],
            "cameras_frame_timestamps_us": {"wide@a": [[START_US, START_US + 30_000]]},
            "rig_bbox": {"centroid": [1.35, 0.0, 0.75], "dim": [4.5, 1.8, 1.5], "rot": [0, 0, 0]},
        }],
    })
    .to_string()
    .into_bytes()
}

pub fn tracks() -> Vec<u8> {
    let at = |x: f64| [x, -3.0, 0.8, 0.0, 0.0, 0.0, 1.0];
    json!({"drive": {"tracks_data": {
        "tracks_id": ["17", "absent/../x"],
        "tracks_label_class": ["automobile", "Pedestrian"],
        "tracks_flags": [["DYNAMIC"], []],
        "tracks_timestamps_us": [
            [START_US, START_US + 2_000_000], [START_US + 500_000, START_US + 1_000_000],
        ],
        "tracks_poses": [[at(5.0), at(25.0)], [at(1.0), at(1.0)]],
    }}})
    .to_string()
    .into_bytes()
}

/// A background, a road and two agents; the splats of the agents are in the frames of their boxes.
pub fn state(of_scene: &SplatCloud, of_agents: &SplatCloud, nre_from_world: &Pose) -> State {
    let mut state = State::new();
    let there = of_scene.clone().placed(nre_from_world, true);
    let half: Vec<u32> = (0..there.len() as u32 / 2).collect();
    let rest: Vec<u32> = (there.len() as u32 / 2..there.len() as u32).collect();
    put_layer(&mut state, "background", &there.select(&half), 4);
    put_layer(&mut state, "road", &there.select(&rest), 1);
    put_layer(&mut state, "dynamic_rigids", of_agents, 1);
    let ids = (0..of_agents.len()).flat_map(|splat| ((splat % 3) as i32).to_le_bytes());
    let name = ".gaussians_nodes.dynamic_rigids.gaussian_cuboid_ids";
    put(&mut state, name, vec![of_agents.len()], ids.collect());
    // Six faces of one texel: x is 0 to 5 tenths.
    let sky = halves((0..6).flat_map(|face| [face as f32 / 10.0, 0.5, 1.5]));
    put(&mut state, ".background.textures", vec![1, 6, 1, 1, 3], sky);
    state
}

/// A volume of `state` with the tracks of its agents.
pub fn with_tracks(state: State) -> Vec<u8> {
    let data = Packed::Map(state.into_iter().collect());
    let mut bytes = Vec::new();
    // {"nre_data": {"state_dict": STATE and "_extra_state": {"obj_track_ids": {...}}}}
    let Packed::Map(mut pairs) = data else {
        unreachable!("a map was made")
    };
    let mut names = vec![0x93];
    for id in ["17", "absent/../x", "unknown"] {
        Packed::Text(id).write(&mut names);
    }
    let pairs_of = |key: &str, value: &[u8]| {
        let mut bytes = vec![0xde, 0, 1];
        bytes.extend([0xda, 0, key.len() as u8]);
        bytes.extend(key.as_bytes());
        bytes.extend(value);
        bytes
    };
    let extra = pairs_of("obj_track_ids", &pairs_of("dynamic_rigids", &names));
    pairs.push(("_extra_state".to_owned(), Packed::Text("replaced below")));
    Packed::Map(vec![(
        "nre_data".to_owned(),
        Packed::Map(vec![("state_dict".to_owned(), Packed::Map(pairs))]),
    )])
    .write(&mut bytes);
    let mut replaced = Vec::new();
    Packed::Text("replaced below").write(&mut replaced);
    let at = bytes.len() - replaced.len();
    assert_eq!(bytes[at..], replaced);
    bytes.truncate(at);
    bytes.extend(extra);
    gzip(&bytes)
}

pub fn turned() -> Pose {
    Pose::new(DQuat::from_rotation_z(0.3), DVec3::new(12.0, -7.5, 1.25))
}

pub fn package(nre_from_world: &Pose) -> Vec<u8> {
    let (scene, agents) = (cloud(40, 3), cloud(30, 1));
    zip(&[
        (
            "volume.nurec",
            with_tracks(state(&scene, &agents, nre_from_world)),
        ),
        ("rig_trajectories.json", rig(nre_from_world)),
        ("sequence_tracks.json", tracks()),
        ("metadata.yaml", b"scene_id: drive-a\nuuid: x\n".to_vec()),
    ])
}

pub fn read(bytes: &[u8]) -> ImportedScene {
    decode_nurec(bytes).unwrap().expect("a NuRec package")
}

#[test]
fn splats_ways_and_cameras_stand_where_they_were_put() {
    for nre_from_world in [Pose::IDENTITY, turned()] {
        let scene = read(&package(&nre_from_world));
        let errors = Errors::between(&cloud(40, 3), &scene.background);
        // Floats of 16 bits: 1/2048 of 40 m and of their own size.
        assert!(errors.mean_m < 0.04 && errors.rest < 2e-3, "{errors:?}");
        assert!(
            errors.opacity < 2e-3 && errors.scale_ln < 5e-3,
            "{errors:?}"
        );
        assert!(errors.angle_rad < 5e-3 && errors.dc < 2e-3, "{errors:?}");

        let names: Vec<&str> = scene.actors.iter().map(|actor| &*actor.name).collect();
        assert_eq!(names, ["17", "absent/../x"]);
        assert_eq!(scene.actor_frame, ShFrame::Canonical);
        let [car, walker] = &scene.actors[..] else {
            panic!("two actors")
        };
        assert_eq!(car.class.as_deref(), Some("car"));
        assert_eq!(walker.class.as_deref(), Some("pedestrian"));
        let own: Vec<u32> = (0..30).step_by(3).collect();
        let errors = Errors::between(&cloud(30, 1).select(&own), &car.splats);
        assert!(errors.mean_m < 0.04 && errors.rest < 2e-3, "{errors:?}");
        let way = car.trajectory.as_ref().unwrap();
        assert!(
            way.at(1.0)
                .translation
                .distance(DVec3::new(15.0, -3.0, 0.8))
                < 1e-9
        );
        assert!(car.present.includes(2.0) && car.present.includes(9.0));
        assert!(walker.present.includes(0.75) && !walker.present.includes(1.5));

        let ego = scene.ego.as_ref().unwrap();
        assert!(
            ego.at(1.0)
                .translation
                .distance(DVec3::new(11.35, 2.0, 0.75))
                < 1e-9
        );
        assert_eq!(scene.ego_height_m, Some(0.75));
        let camera = scene.rig.cameras().next().unwrap();
        let world = ego.at(0.0).then(&camera.rig_from_camera).translation;
        assert!(world.distance(DVec3::new(1.5, 2.0, 1.4)) < 1e-9, "{world}");
        assert!((camera.intrinsics.shutter.readout_s([64, 48]) - 0.03).abs() < 1e-9);
    }
}

#[test]
fn the_sky_is_looked_up_in_the_frame_of_the_splats() {
    for nre_from_world in [Pose::IDENTITY, turned()] {
        let sky = read(&package(&nre_from_world)).sky.unwrap();
        // The direction of each OpenGL face in the frame of the splats, by x_gl = -y, y_gl = z,
        // z_gl = -x.
        let faces = [
            -DVec3::Y,
            DVec3::Y,
            DVec3::Z,
            -DVec3::Z,
            -DVec3::X,
            DVec3::X,
        ];
        for (face, direction) in faces.into_iter().enumerate() {
            let found = sky.color(nre_from_world.rotation.inverse() * direction);
            let expected = [face as f64 / 10.0, 0.5, 1.0];
            let error = (0..3).map(|c| (found[c] - expected[c]).abs());
            assert!(error.fold(0.0, f64::max) < 1e-3, "{face}: {found:?}");
        }
    }
}

#[test]
fn what_is_not_drawn_is_said() {
    let notes = read(&package(&Pose::IDENTITY)).notes.join("\n");
    for expected in ["4 colors over time", "10 splats belong to tracks"] {
        assert!(notes.contains(expected), "{notes}");
    }
}

pub fn saved(bytes: &[u8]) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.usdz");
    std::fs::write(&path, bytes).unwrap();
    (folder, path)
}

#[test]
fn packages_are_opened_wherever_scenes_are() {
    let (folder, path) = saved(&package(&turned()));
    let loaded = open_scene(&path, 0.75).unwrap();
    assert_eq!(loaded.splat_scene.splats.len(), 40 + 20);
    assert_eq!(loaded.plain_agents.len(), 2);
    assert!(loaded.splat_scene.sky_map.is_some());
    assert_eq!(packed_scene_id(&path).as_deref(), Some("drive-a"));
    // Written as a scene file, it is the same scene; a name that is no file's gets a number.
    let out = folder.path().join("out");
    std::fs::create_dir(&out).unwrap();
    let imported = read(&package(&turned()));
    let file: SceneFile = imported.write(&out).unwrap();
    assert_eq!(file.agents[1].name, "absent/../x");
    assert!(out.join("assets/0001.agent.ply").is_file());
    let again = open_scene(&out.join("scene.toml"), 0.75).unwrap();
    assert_eq!(again.ego, loaded.ego);
    let errors = Errors::between(&loaded.splat_scene.splats, &again.splat_scene.splats);
    assert!(errors.mean_m < 1e-5 && errors.opacity < 1e-6, "{errors:?}");
}

#[test]
fn older_packages_have_rig_and_tracks_in_one_file() {
    let (scene, agents) = (cloud(40, 0), cloud(30, 0));
    let part = |bytes: Vec<u8>| -> serde_json::Value { serde_json::from_slice(&bytes).unwrap() };
    let summary = json!({
        "rig_trajectories": part(rig(&Pose::IDENTITY)),
        "sequence_tracks": part(tracks()),
    });
    let found = read(&zip(&[
        (
            "volume.nurec",
            with_tracks(state(&scene, &agents, &Pose::IDENTITY)),
        ),
        ("datasource_summary.json", summary.to_string().into_bytes()),
    ]));
    assert_eq!((found.actors.len(), found.rig.sensors.len()), (2, 1));
}

/// 3dgrut exports one layer, `gaussians`, and neither rig nor tracks.
#[test]
fn a_volume_alone_is_a_background() {
    let mut state = State::new();
    put_layer(&mut state, "gaussians", &cloud(50, 2), 1);
    let (_folder, path) = saved(&zip(&[
        ("a.nurec", Vec::new()),
        ("volume.nurec", volume(state)),
    ]));
    let loaded = open_scene(&path, 0.0).unwrap();
    assert_eq!(loaded.splat_scene.splats.len(), 50);
    assert_eq!(loaded.splat_scene.splats.sh_degree, 2);
    assert_eq!(loaded.rig.cameras().count(), 0);
}

#[test]
fn hostile_packages_get_a_sentence() {
    let good = || {
        let mut state = State::new();
        put_layer(&mut state, "gaussians", &cloud(5, 1), 1);
        state
    };
    let refused = |state: State| {
        let bytes = zip(&[("volume.nurec", volume(state))]);
        decode_nurec(&bytes).unwrap_err().to_string()
    };
    let key = |array: &str| format!(".gaussians_nodes.gaussians.{array}");
    type Change = fn(&mut State, String);
    let changes: [(&str, &str, Change); 6] = [
        ("positions", "wants numbers of 2 bytes", |state, key| {
            state.insert(key + ".shape", Packed::Sizes(vec![1 << 31, 3]));
        }),
        ("positions", "wants numbers of 2 bytes", |state, key| {
            state.insert(key + ".shape", Packed::Sizes(vec![1 << 62, 1 << 62]));
        }),
        ("scales", "has no '", |state, key| {
            state.remove(&key);
        }),
        ("scales", "4 rows for 5 positions", |state, key| {
            put(state, &key, vec![4, 3], halves([0.0; 12]));
        }),
        ("features_specular", "expected [N, 45]", |state, key| {
            put(state, &key, vec![5, 44], halves([0.0; 220]));
        }),
        (
            "gaussian_cuboid_ids",
            "belongs to track -1",
            |state, key| {
                let ids = [-1i32; 5].into_iter().flat_map(i32::to_le_bytes);
                put(state, &key, vec![5], ids.collect());
            },
        ),
    ];
    for (array, expected, change) in changes {
        let mut state = good();
        change(&mut state, key(array));
        let error = refused(state);
        assert!(error.contains(expected), "{array}: {error}");
    }
    let none = refused(State::new());
    assert!(none.contains("no layer"), "{none}");
    // A bomb: 200 MB of zeros in 200 kB.
    let bomb = gzip(&vec![0xc0; 200 << 20]);
    let bytes = zip(&[("volume.nurec", bomb)]);
    assert!(decode_nurec(&bytes).is_err());
    let mut nil = vec![0xc6, 0x0c, 0, 0, 0];
    nil.resize(200 << 20, 0);
    let error = decode_nurec(&zip(&[("volume.nurec", gzip(&nil))])).unwrap_err();
    assert!(
        error.to_string().contains("unpacks to more than"),
        "{error}"
    );
    // Cut anywhere, or with any byte of its texts changed.
    let whole = package(&turned());
    for end in (0..whole.len()).step_by(97) {
        let _ = decode_nurec(&whole[..end]);
    }
    let texts = [rig(&Pose::IDENTITY), tracks()];
    for (name, text) in ["rig_trajectories.json", "sequence_tracks.json"]
        .iter()
        .zip(texts)
    {
        for at in (0..text.len()).step_by(7) {
            let mut text = text.clone();
            text[at] = b'9';
            let bytes = zip(&[("volume.nurec", volume(good())), (name, text)]);
            let _ = decode_nurec(&bytes);
        }
    }
}
