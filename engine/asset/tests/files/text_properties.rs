//! Properties over generated cameras and scene files.

use decouplegs_asset::{
    SceneAgent, SceneFile, SceneLidar, SceneLight, SceneRecording, SceneSky, SeenFrom, SkyKind,
    cameras,
};
use decouplegs_scene::light::{
    AmbientOptions, CastingLights, Lamps, RelightOptions, ShadowOptions, Sun,
};
use decouplegs_scene::photometry::{ColorCurve, Response, Vignetting};
use decouplegs_scene::{
    Camera, Fog, Intrinsics, Lens, Photometry, Pose, Presence, RigCamera, Rules, ShFrame, Shutter,
    ShutterDirection, TimedPose, Trajectory, VehicleSize,
};
use glam::{DMat3, DQuat, DVec3, EulerRot};
use proptest::prelude::*;

fn poses() -> impl Strategy<Value = Pose> {
    (
        prop::array::uniform3(-1e6f64..1e6),
        prop::array::uniform3(-3.1f64..3.1),
    )
        .prop_map(|(place, [a, b, c])| {
            Pose::new(
                DQuat::from_euler(EulerRot::ZYX, a, b, c),
                DVec3::from_array(place),
            )
        })
}

fn intrinsics() -> impl Strategy<Value = Intrinsics> {
    (
        1u32..=65_536,
        1u32..=65_536,
        prop::array::uniform4(1.0f64..5000.0),
    )
        .prop_map(
            |(width_px, height_px, [fx_px, fy_px, cx_px, cy_px])| Intrinsics {
                width_px,
                height_px,
                fx_px,
                fy_px,
                cx_px,
                cy_px,
                lens: Lens::Pinhole,
                photometry: Photometry::IDENTITY,
                windshield: None,
                shutter: Shutter::GLOBAL,
            },
        )
}

fn trajectories() -> impl Strategy<Value = Trajectory> {
    prop::collection::vec((0.01f64..5.0, poses()), 1..5).prop_map(|steps| {
        let mut time_s = -3.0;
        let timed = steps.into_iter().map(|(step_s, pose)| {
            time_s += step_s;
            TimedPose { time_s, pose }
        });
        Trajectory::new(timed.collect()).unwrap()
    })
}

fn lights() -> impl Strategy<Value = SceneLight> {
    let shadows = (
        0.0f64..=1.0,
        0.1f64..9.0,
        0.01f64..1.0,
        1e-4f64..1.0,
        0.0f64..=1.0,
    )
        .prop_map(
            |(strength, decay, slab_m, full_directionality, floor)| ShadowOptions {
                strength,
                decay,
                slab_m,
                full_directionality,
                floor,
            },
        );
    (
        prop::option::of("[a-z]{1,8}"),
        (
            any::<bool>(),
            prop::option::of(0.01f64..=1.0),
            any::<bool>(),
        ),
        1.0f64..9.0,
        1.0f64..30.0,
        0.7f64..4.0,
        prop::option::of((shadows, casting_lights())),
    )
        .prop_map(
            |(transfer, relighting, sigma_m, radius_m, spacing_m, shadows)| {
                let (full_effect, ground_albedo, by_normals) = relighting;
                SceneLight {
                    transfer: transfer.filter(|_| !by_normals).map(Into::into),
                    relighting: RelightOptions {
                        full_effect,
                        ground_albedo,
                        by_normals,
                    },
                    ambient: AmbientOptions {
                        sigma_m,
                        radius_m,
                        spacing_m,
                    },
                    shadows: shadows.as_ref().map(|(options, _)| *options),
                    casting: shadows.map_or_else(CastingLights::default, |(_, casting)| casting),
                }
            },
        )
}

fn casting_lights() -> impl Strategy<Value = CastingLights> {
    let place = || (-1e3f64..1e3, -1e3f64..1e3, 0.1f64..20.0).prop_map(DVec3::from);
    let sun = (place(), 0.01f64..0.99).prop_map(|(towards, share)| Sun { towards, share });
    let lamps =
        (prop::collection::vec(place(), 0..4), 1.0f64..90.0).prop_map(|(places, range_m)| Lamps {
            positions: places,
            range_m,
        });
    (prop::option::of(sun), lamps).prop_map(|(sun, lamps)| CastingLights { sun, lamps })
}

fn presences() -> impl Strategy<Value = Presence> {
    prop::collection::vec((0.001f64..5.0, 0.0f64..5.0), 0..4).prop_map(|steps| {
        let mut end_s = -3.0;
        let interval = |(gap_s, duration_s): (f64, f64)| {
            let first_s = end_s + gap_s;
            end_s = first_s + duration_s;
            [first_s, end_s]
        };
        Presence::new(steps.into_iter().map(interval).collect()).unwrap()
    })
}

fn shutters() -> impl Strategy<Value = (ShutterDirection, f64)> {
    let direction = prop::sample::select(ShutterDirection::ALL.to_vec());
    (direction, 1u32..=1_000_000).prop_map(|(direction, us)| (direction, f64::from(us) / 1e6))
}

fn photometries() -> impl Strategy<Value = Photometry> {
    let three = || prop::array::uniform3(-2.0f64..2.0);
    let vignetting = (
        prop::array::uniform3(prop::array::uniform2(-100.0f64..5000.0)),
        any::<bool>(),
        prop::array::uniform2(0.1f64..5000.0),
        prop::array::uniform3(three()),
    )
        .prop_map(|(center_px, is_one, radius_px, rgb)| Vignetting {
            center_px: if is_one { [center_px[0]; 3] } else { center_px },
            radius_px,
            rgb,
        });
    let positive = || prop::array::uniform3(0.01f64..5.0);
    let centers = prop::array::uniform3(0.01f64..0.99);
    let response =
        (positive(), positive(), positive(), centers).prop_map(|(toe, shoulder, gamma, center)| {
            Response {
                toe,
                shoulder,
                gamma,
                center,
            }
        });
    (
        -32.0f64..=32.0,
        any::<bool>(),
        prop::option::of(vignetting),
        prop::array::uniform3(prop::array::uniform4(-2.0f64..2.0)),
        prop::array::uniform3(0.01f64..5.0),
        prop::option::of(prop::array::uniform3(three())),
        prop::option::of(response),
    )
        .prop_map(
            |(exposure_ev, is_linear, vignetting, matrix, gamma, balance, response)| Photometry {
                exposure_ev,
                curve: if is_linear {
                    ColorCurve::Linear
                } else {
                    ColorCurve::Display
                },
                vignetting,
                balance,
                matrix,
                gamma,
                response,
            },
        )
}

fn fogs() -> impl Strategy<Value = Fog> {
    let colors = prop::array::uniform3(0.0f64..1.0);
    (0.0f64..1.0, colors, 0.0f64..1e5).prop_map(|(extinction_per_m, color, sky_range_m)| Fog {
        extinction_per_m,
        color,
        sky_range_m,
    })
}

fn skies() -> impl Strategy<Value = SceneSky> {
    (
        "[a-z]{1,8}",
        0..SkyKind::ALL.len(),
        any::<[bool; 2]>(),
        poses(),
    )
        .prop_map(|(file, kind, [clamps, clamps_splats], pose)| {
            let kind = SkyKind::ALL[kind];
            SceneSky {
                world_from_sky: DMat3::from_quat(pose.rotation),
                clamps,
                clamps_splats,
                ..SceneSky::new(file, kind)
            }
        })
}

fn scenes() -> impl Strategy<Value = SceneFile> {
    let agent = (prop::option::of(any::<bool>()), trajectories(), presences());
    (
        (
            prop::array::uniform3(-1e7f64..1e7),
            prop::array::uniform3(0.0f32..1.0),
        ),
        (0usize..3, any::<bool>(), 0.001f64..1.0, 1e-5f64..1e-2),
        (
            prop::collection::vec((intrinsics(), poses()), 0..4),
            prop::collection::vec(("[a-z]{1,8}", poses()), 0..3),
        ),
        prop::option::of(trajectories()),
        prop::collection::vec(agent, 0..4),
        "[a-z\"\\\\\u{e9}# ]{1,12}",
        prop::option::of(lights()),
        (
            prop::option::of(photometries()),
            shutters(),
            prop::option::of(skies()),
            prop::option::of(fogs()),
        ),
    )
        .prop_map(
            |(
                (origin, sky),
                (rules, antialias, near_m, lidar_dilation_rad),
                (cameras, lidars),
                ego,
                agents,
                name,
                light,
                (photometry, (direction, readout_s), sky_map, fog),
            )| {
                let rig_camera =
                    |(i, (intrinsics, rig_from_camera)): (usize, (Intrinsics, Pose))| RigCamera {
                        name: format!("c{i}"),
                        intrinsics: Intrinsics {
                            photometry: photometry.unwrap_or_default(),
                            shutter: Shutter::new(
                                direction,
                                readout_s,
                                [intrinsics.width_px, intrinsics.height_px],
                            ),
                            ..intrinsics
                        },
                        rig_from_camera,
                    };
                let scene_lidar =
                    |(i, (sensor, rig_from_lidar)): (usize, (String, Pose))| SceneLidar {
                        name: format!("l{i}"),
                        sensor: sensor.into(),
                        rig_from_lidar,
                    };
                let scene_agent = |(i, (is_world, trajectory, present)): (
                    usize,
                    (Option<bool>, Trajectory, Presence),
                )| SceneAgent {
                    name: format!("{name}{i}"),
                    class: is_world.map(|_| name.clone()),
                    asset: format!("{name}.ply").into(),
                    sh_frame: is_world.map(|is_world| {
                        if is_world {
                            ShFrame::World
                        } else {
                            ShFrame::Canonical
                        }
                    }),
                    trajectory,
                    present,
                };
                SceneFile {
                    fog,
                    photometry: Photometry {
                        vignetting: None,
                        ..photometry.unwrap_or_default()
                    },
                    origin: DVec3::from_array(origin),
                    background: format!("{name}.spz").into(),
                    sky: if sky_map.is_some() { [0.0; 3] } else { sky },
                    rules: Rules {
                        antialias,
                        near_m,
                        lidar_dilation_rad,
                        ..Rules::by_name(Rules::NAMES[rules]).unwrap()
                    },
                    rig: cameras.into_iter().enumerate().map(rig_camera).collect(),
                    lidars: lidars.into_iter().enumerate().map(scene_lidar).collect(),
                    ego_height_m: ego.is_some().then_some(readout_s),
                    recording: SceneRecording {
                        ground: (agents.len() % 3 == 1).then(|| "ground.ply".into()),
                        obstacles: (agents.len() % 3 == 2).then(|| "obstacles.json".into()),
                        // The name of a file may be the word for no file.
                        seen_from: match agents.len() % 4 {
                            0 => None,
                            1 => Some(SeenFrom::Everywhere),
                            2 => Some(SeenFrom::Cameras(format!("{name}.json").into())),
                            _ => Some(SeenFrom::Cameras("./everywhere".into())),
                        },
                        vehicle_size: antialias.then_some(VehicleSize::CAR),
                    },
                    ego,
                    agents: agents.into_iter().enumerate().map(scene_agent).collect(),
                    light,
                    sky_map,
                }
            },
        )
}

/// True if `camera` is `intrinsics` at `pose`, up to rounding.
fn is_camera(camera: &Camera, intrinsics: &Intrinsics, pose: &Pose) -> bool {
    let Pose {
        rotation,
        translation,
    } = camera.world_from_camera;
    let axes = DMat3::from_quat(rotation);
    camera.intrinsics == *intrinsics
        && translation == pose.translation
        && axes.abs_diff_eq(DMat3::from_quat(pose.rotation), 1e-12)
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_scene_file_reads_back_as_it_was_written(scene in scenes()) {
        let text = scene.to_toml().unwrap();
        let back = SceneFile::parse(&text);
        prop_assert_eq!(back.as_ref(), Ok(&scene), "{}", text);
    }

    #[test]
    fn inria_cameras_are_where_their_file_says(intrinsics in intrinsics(), pose in poses()) {
        // The form has no principal point: it is the middle.
        let (width, height) = (intrinsics.width_px, intrinsics.height_px);
        let intrinsics = Intrinsics { cx_px: 0.5 * f64::from(width), cy_px: 0.5 * f64::from(height), ..intrinsics };
        let rows = DMat3::from_quat(pose.rotation).transpose().to_cols_array_2d();
        let file = serde_json::json!([{
            "id": 7, "img_name": "a", "width": width, "height": height, "fx": intrinsics.fx_px, "fy": intrinsics.fy_px,
            "position": pose.translation.to_array(), "rotation": rows,
        }]);
        let cameras = cameras::decode(file.to_string().as_bytes(), None).unwrap();
        prop_assert!(cameras.len() == 1 && is_camera(&cameras[0], &intrinsics, &pose), "{cameras:?}");
    }

    #[test]
    fn nerfstudio_cameras_are_where_their_file_says(intrinsics in intrinsics(), pose in poses(), in_frame in any::<bool>()) {
        // OpenGL axes: y and z of the camera point the other way.
        let axes = DMat3::from_quat(pose.rotation);
        let row = |i: usize| [axes.x_axis[i], -axes.y_axis[i], -axes.z_axis[i], pose.translation[i]];
        let mut frame = serde_json::json!({"file_path": "a.png", "transform_matrix": [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]});
        let mut lens = serde_json::json!({
            "w": intrinsics.width_px, "h": intrinsics.height_px, "fl_x": intrinsics.fx_px, "fl_y": intrinsics.fy_px,
            "cx": intrinsics.cx_px, "cy": intrinsics.cy_px, "k1": 0, "p2": 0.0,
        });
        let owner = if in_frame { &mut frame } else { &mut serde_json::json!({}) };
        owner.as_object_mut().unwrap().append(lens.as_object_mut().unwrap());
        let mut file = if in_frame { serde_json::json!({}) } else { owner.clone() };
        file["frames"] = serde_json::json!([frame]);
        let cameras = cameras::decode(file.to_string().as_bytes(), None).unwrap();
        prop_assert!(cameras.len() == 1 && is_camera(&cameras[0], &intrinsics, &pose), "{cameras:?}");
    }
}
