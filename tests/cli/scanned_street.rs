//! A KITTI drive with scans: `import` makes ground and obstacles of them, and `drive` uses both.

use std::f64::consts::TAU;

use decouplegs::asset::{SceneFile, inria_ply, read_ground, read_obstacles, read_splats};
use decouplegs::scene::SplatCloud;
use glam::{DVec2, DVec3};

use super::*;

/// IMU above the road, and the LiDAR in the frame of the IMU, meters.
const IMU_M: f64 = 0.93;
const LIDAR_M: DVec3 = DVec3::new(0.81, -0.32, 0.8);
const SPEED_MPS: f64 = 10.0;
const FRAMES: u32 = 40;
/// Time of a turn, seconds.
const TURN_S: f64 = 0.1034;
/// A post that stands, and where a car stood in the first scans alone.
const POST_M: DVec2 = DVec2::new(20.1, 4.1);
const LEFT_M: DVec2 = DVec2::new(30.1, -5.1);

/// The point `world_m` as a scan of `time_s` has it, whose LiDAR goes along x and turns clockwise
/// from behind, straight ahead at that time.
fn measured(world_m: DVec3, time_s: f64) -> DVec3 {
    let mut at_s = time_s;
    let mut point = DVec3::ZERO;
    for _ in 0..6 {
        point = world_m - LIDAR_M - DVec3::X * SPEED_MPS * at_s;
        at_s = time_s - point.y.atan2(point.x) / TAU * TURN_S;
    }
    point
}

/// Writes the drive of a level car to the east, and splats of its road.
fn write_drive(root: &Path) -> [std::path::PathBuf; 2] {
    let drive = root.join("drive_sync");
    for folder in ["image_02/data", "oxts/data", "velodyne_points/data"] {
        fs::create_dir_all(drive.join(folder)).unwrap();
    }
    for (name, text) in [
        (
            "calib_velo_to_cam.txt",
            "R: 0 -1 0 0 0 -1 1 0 0\nT: 0 -0.08 -0.27\n",
        ),
        (
            "calib_imu_to_velo.txt",
            "R: 1 0 0 0 1 0 0 0 1\nT: -0.81 0.32 -0.8\n",
        ),
        (
            "calib_cam_to_cam.txt",
            "S_rect_02: 124 37\nR_rect_00: 1 0 0 0 1 0 0 0 1\nP_rect_02: 70 0 60 4 0 70 17 0 0 0 1 0\n",
        ),
    ] {
        fs::write(drive.join(name), text).unwrap();
    }
    let degree_m = 49.0_f64.to_radians().cos() * 6_378_137.0 * 1.0_f64.to_radians();
    let mut times = String::new();
    for frame in 0..FRAMES {
        let time_s = 0.1 * f64::from(frame);
        let packet = format!(
            "49.0 {:.13} 112.5 0 0 0",
            8.4 + SPEED_MPS * time_s / degree_m
        );
        fs::write(drive.join(format!("oxts/data/{frame:010}.txt")), packet).unwrap();
        fs::write(drive.join(format!("image_02/data/{frame:010}.png")), b"png").unwrap();
        times += &format!("2011-09-26 13:08:{:012.9}\n", 24.0 + time_s);
        let mut world_m: Vec<DVec3> = (0..120)
            .flat_map(|x| (-40..40).map(move |y| (x, y)))
            .map(|(x, y)| DVec2::new(0.25 * f64::from(x), 0.25 * f64::from(y)))
            .map(|at| (at + DVec2::X * SPEED_MPS * time_s).extend(-IMU_M))
            .collect();
        for (at, stands) in [(POST_M, true), (LEFT_M, frame < 3)] {
            world_m.extend(
                (0..20)
                    .filter(|_| stands)
                    .map(|z| at.extend(0.1 * f64::from(z) - IMU_M)),
            );
        }
        let scan: Vec<u8> = world_m
            .into_iter()
            .flat_map(|point| measured(point, time_s).extend(0.5).to_array())
            .flat_map(|value| (value as f32).to_le_bytes())
            .collect();
        fs::write(
            drive.join(format!("velodyne_points/data/{frame:010}.bin")),
            scan,
        )
        .unwrap();
    }
    fs::write(drive.join("image_02/timestamps.txt"), times).unwrap();
    // Splats that show a road 0.3 m too high: the scans are trusted.
    let places = (0..200).flat_map(|x| (-20..20).map(move |y| (x, y)));
    let means: Vec<[f32; 3]> = places
        .map(|(x, y)| [0.4 * x as f32, 0.4 * y as f32, 0.3 - IMU_M as f32])
        .collect();
    let count = means.len();
    let road = SplatCloud {
        means,
        scales: vec![[0.3, 0.3, 0.01]; count],
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; count],
        opacities: vec![0.9; count],
        sh_dc: vec![[0.0; 3]; count],
        ..SplatCloud::default()
    };
    let splats = root.join("road.ply");
    inria_ply::write(&splats, &road).unwrap();
    [drive, splats]
}

/// Command that imports `drive` with its `splats` to `out`.
fn import<'a>(drive: &'a Path, splats: &'a Path, out: &'a Path) -> [&'a str; 7] {
    [
        "import",
        "kitti",
        text(drive),
        "--splats",
        text(splats),
        "--out",
        text(out),
    ]
}

#[test]
fn scans_tell_the_ground_and_what_stands_beside_the_way() {
    let root = tempfile::tempdir().unwrap();
    let [drive, splats] = write_drive(root.path());
    let out = root.path().join("street");
    let said = succeed(&import(&drive, &splats, &out));
    assert!(said.contains("scans      38: ground at"), "{said}");
    let scene = SceneFile::read(&out.join("scene.toml")).unwrap();
    assert_eq!(scene.recording.ground, Some("ground.ply".into()));
    assert_eq!(scene.recording.obstacles, Some("obstacles.json".into()));
    // The middle of the vehicle is 0.17 m below the IMU.
    let height_m = scene.ego_height_m.unwrap();
    assert!((height_m - (IMU_M - 0.1715)).abs() < 0.01, "{height_m}");
    let ground = read_ground(&out.join("ground.ply")).unwrap();
    assert!(ground.len() > 5000, "{}", ground.len());
    for point in &ground {
        assert!((point.z + IMU_M).abs() < 0.01, "{point}");
    }
    // Where it is, although the vehicle went on by a meter in each turn.
    let obstacles = read_obstacles(&out.join("obstacles.json")).unwrap();
    assert_eq!(obstacles.len(), 1, "{obstacles:?}");
    let off_m = obstacles[0].center_m.distance(POST_M);
    assert!(off_m < 0.25, "{off_m}: {obstacles:?}");
    // The site of a drive has them: `map` counts what stands there.
    let (map, scene) = (out.join("lanes.json"), out.join("scene.toml"));
    let said = succeed(&["map", text(&map), "--scene", text(&scene)]);
    assert!(said.contains("1 obstacle"), "{said}");
}

#[test]
fn haze_above_the_road_goes_and_the_rest_stays() {
    let root = tempfile::tempdir().unwrap();
    let [drive, splats] = write_drive(root.path());
    let (out, clear) = (root.path().join("street"), root.path().join("clear"));
    succeed(&import(&drive, &splats, &out));
    fs::create_dir(&clear).unwrap();
    let (scene, new) = (out.join("scene.toml"), clear.join("scene.toml"));
    let edit = ["edit", text(&scene), "--out", text(&new), "--remove-haze"];
    let said = succeed(&edit);
    // All splats of the road are 0.3 m too high: those near the way are gone, 0.4 m apart.
    let left = read_splats(&clear.join("background_clear.ply")).unwrap();
    let is_near =
        |mean: &[f32; 3]| (6.0..38.5).contains(&mean[0]) && mean[1] > -1.9 && mean[1] < 1.3;
    assert!(!left.means.iter().any(is_near), "{said}");
    assert!(
        left.len() > 6000 && left.len() < 7600,
        "{}: {said}",
        left.len()
    );
    assert!(
        said.contains("hovered within 2 m of the way and are gone"),
        "{said}"
    );
    // What the scene names is still there, and nothing that exists is replaced.
    succeed(&["inspect", text(&new)]);
    let again = [&edit[..], &["--force"]].concat();
    assert!(fail(1, &again).contains("background_clear.ply exists"));
    // A scene without a way does not know where its road was free.
    let mut bare = SceneFile::read(&scene).unwrap();
    bare.ego = None;
    bare.recording = Default::default();
    let bare_file = out.join("bare.toml");
    bare.write(&bare_file).unwrap();
    let said = fail(
        1,
        &[
            "edit",
            text(&bare_file),
            "--out",
            text(&out.join("x.toml")),
            "--remove-haze",
        ],
    );
    assert!(said.contains("[[ego]]"), "{said}");
}

#[test]
fn a_broken_scan_is_named_and_nothing_is_left() {
    let root = tempfile::tempdir().unwrap();
    let [drive, splats] = write_drive(root.path());
    let out = root.path().join("street");
    let broken = drive.join("velodyne_points/data/0000000007.bin");
    fs::write(&broken, b"xyz").unwrap();
    let said = fail(
        1,
        &[
            "import",
            "kitti",
            text(&drive),
            "--splats",
            text(&splats),
            "--out",
            text(&out),
        ],
    );
    assert!(said.contains("0000000007.bin"), "{said}");
    assert!(!out.exists());
}
