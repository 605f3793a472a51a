//! `decouplegs edit` and `render --layer`, on a small street.

use std::path::PathBuf;

use decouplegs::asset::SceneFile;
use decouplegs::render::Image;
use glam::DVec3;

use super::*;

/// A street, and a folder of its own for the edited scene.
fn site(folder: &Path) -> (PathBuf, PathBuf) {
    let street = folder.join("street");
    small_street(&street);
    small_asset(&folder.join("ball.safetensors"));
    let edited = folder.join("edited");
    fs::create_dir(&edited).unwrap();
    (street.join("scene.toml"), edited.join("new.toml"))
}

/// A cut changes nothing as long as the agent stays, and leaves the place when it is moved.
#[test]
fn an_agent_is_cut_out_of_the_background() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, new) = site(folder.path());
    let before = SceneFile::read(&scene).unwrap();
    // A street whose first car is part of the background: its world at the start, baked.
    let baked = folder.path().join("street/baked.toml");
    let car = &before.agents[0];
    let pose = car.trajectory.at(0.0);
    let plain = SceneFile {
        background: "world.ply".into(),
        agents: Vec::new(),
        ..before.clone()
    };
    plain.write(&baked).unwrap();
    let yaw_deg = pose.heading_rad().to_degrees();
    let at = pose.translation;
    let cut = format!("car={},{},{},{yaw_deg},6,3,2.5", at.x, at.y, at.z);
    let said = succeed(&["edit", text(&baked), "--out", text(&new), "--cut", &cut]);
    assert!(
        said.contains("car: ") && said.contains("1 agents, 0 before"),
        "{said}"
    );
    let edited = SceneFile::read(&new).unwrap();
    assert_eq!(edited.agents[0].asset, PathBuf::from("car.ply"));
    let images = |scene: &Path, out: &str| {
        let out = folder.path().join(out);
        succeed(&[
            "render",
            text(scene),
            "--size",
            "96x54",
            "--out",
            text(&out),
        ]);
        Image::read(&out.join("front.png")).unwrap()
    };
    let (whole, stays) = (images(&baked, "whole"), images(&new, "stays"));
    let off = |a: &Image, b: &Image| {
        let pairs = a.rgb.iter().flatten().zip(b.rgb.iter().flatten());
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    };
    // The asset is stored in another frame, in 32 bits.
    assert!(
        off(&whole, &stays) <= 2.5 / 255.0,
        "{}",
        off(&whole, &stays)
    );
    // Nothing that exists is replaced, and a box without splats is no agent.
    let again = new.with_file_name("again.toml");
    for (out, taken) in [(&new, text(&new)), (&again, "car.ply")] {
        let words = ["edit", text(&baked), "--out", text(out), "--cut", &cut];
        let said = fail(1, &words);
        assert!(said.contains(&format!("{taken} exists")), "{said}");
    }
    assert!(!again.exists());
    let empty = folder.path().join("edited/empty.toml");
    let nowhere = "car=0,0,500,0,4,2,2";
    let said = fail(
        1,
        &[
            "edit",
            text(&baked),
            "--out",
            text(&empty),
            "--cut",
            nowhere,
        ],
    );
    assert!(said.contains("0 splats in the box of car"), "{said}");
    assert!(!empty.exists());
}

#[test]
fn a_scene_is_edited_into_another_folder_and_left_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, new) = site(folder.path());
    let (bytes, before) = (fs::read(&scene).unwrap(), SceneFile::read(&scene).unwrap());
    let [first, second] = [0, 1].map(|at| before.agents[at].name.clone());
    let ball = folder.path().join("ball.safetensors");
    let (add, shift) = (
        format!("ball={},12.5,-3,0.75,90", text(&ball)),
        format!("{second}=5,-3.5"),
    );
    let said = succeed(&[
        "edit",
        text(&scene),
        "--out",
        text(&new),
        "--remove",
        &first,
        "--add",
        &add,
        "--shift",
        &shift,
        "--move",
        "ball=-10,4.5,0.75,-90",
        "--present",
        "ball=0,2.5,4,6",
    ]);
    assert!(said.contains("new.toml: 2 agents, 2 before"), "{said}");
    assert_eq!(
        fs::read(&scene).unwrap(),
        bytes,
        "the scene is left as it is"
    );
    let edited = SceneFile::read(&new).unwrap();
    let names: Vec<&str> = edited
        .agents
        .iter()
        .map(|agent| agent.name.as_str())
        .collect();
    assert_eq!(names, [second.as_str(), "ball"]);
    let times_s = edited.agents[1].present.intervals_s();
    assert_eq!(times_s, [[0.0, 2.5], [4.0, 6.0]]);
    assert!(
        succeed(&["inspect", text(&new)]).contains("present 0.0 s to 2.5 s and 4.0 s to 6.0 s")
    );
    let begins = edited.agents[1].trajectory.poses()[0].pose;
    assert_eq!(begins.translation, DVec3::new(-10.0, 4.5, 0.75));
    assert!(
        (begins.rotation * DVec3::X + DVec3::Y).length() < 1e-12,
        "its nose points against y"
    );
    for (old, new) in before.agents[1]
        .trajectory
        .poses()
        .iter()
        .zip(edited.agents[0].trajectory.poses())
    {
        let seen = old.pose.inverse().transform(new.pose.translation);
        assert!(
            (seen - DVec3::new(5.0, -3.5, 0.0)).length() < 1e-9,
            "{seen}"
        );
    }
    // Every file that it names is found from where it lies now.
    assert_eq!(json(&["inspect", text(&new), "--json"])["splats"], 4303);
    assert_eq!(
        fs::read_dir(new.parent().unwrap()).unwrap().count(),
        1,
        "no temporary file is left"
    );
}

#[test]
fn agents_are_set_on_the_ground_that_was_captured() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, new) = site(folder.path());
    // Splats enough for a closed road.
    let street = folder.path().join("dense");
    let sizes = [
        "--background",
        "60000",
        "--agents",
        "2",
        "--agent-splats",
        "300",
        "--degree",
        "0",
        "--size",
        "48x27",
    ];
    succeed(&[&["synth", "street", "--out", text(&street)][..], &sizes].concat());
    let dense = street.join("scene.toml");
    let before = SceneFile::read(&dense).unwrap();
    let (name, stands) = (
        &before.agents[0].name,
        before.agents[0].trajectory.poses()[0].pose.translation,
    );
    let lifted = format!("{name}={},{},{},0", stands.x, stands.y, stands.z + 0.6);
    let said = succeed(&[
        "edit",
        text(&dense),
        "--out",
        text(&new),
        "--move",
        &lifted,
        "--ground",
    ]);
    assert!(
        said.contains(&format!("{name}: ")) && said.contains("on the ground"),
        "{said}"
    );
    let edited = SceneFile::read(&new).unwrap();
    for timed in edited.agents[0].trajectory.poses() {
        let z_m = timed.pose.translation.z;
        assert!(
            (z_m - stands.z).abs() < 0.12,
            "at {} s its middle is at {z_m} m, and was truly at {} m",
            timed.time_s,
            stands.z
        );
    }
    let away = folder.path().join("edited/away.toml");
    let far = format!("{name}=9000,9000,0.7,0");
    let said = fail(
        1,
        &[
            "edit",
            text(&dense),
            "--out",
            text(&away),
            "--move",
            &far,
            "--ground",
        ],
    );
    assert!(
        said.contains("no ground below") && said.contains(name.as_str()) && !away.exists(),
        "{said}"
    );
    assert!(scene.exists());
}

#[test]
fn an_edit_that_cannot_be_is_told_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, new) = site(folder.path());
    let name = SceneFile::read(&scene).unwrap().agents[0].name.clone();
    let run = |code: i32, more: &[&str]| {
        fail(
            code,
            &[&["edit", text(&scene), "--out", text(&new)], more].concat(),
        )
    };
    let said = run(1, &["--remove", "nobody"]);
    assert!(
        said.contains("\"nobody\"") && said.contains(&name),
        "{said}"
    );
    assert!(
        run(
            1,
            &["--remove", &name, "--move", &format!("{name}=1,2,3,4")]
        )
        .contains(&name)
    );
    assert!(
        run(1, &["--swap", &format!("{name}=absent.safetensors")]).contains("absent.safetensors")
    );
    assert!(run(2, &["--move", "car=1,2"]).contains("NAME=X,Y,Z,YAW_DEG"));
    assert!(!new.exists());
    let before = fs::read(&scene).unwrap();
    let said = fail(
        1,
        &[
            "edit",
            text(&scene),
            "--out",
            text(&scene),
            "--remove",
            &name,
        ],
    );
    assert!(
        said.contains("is read and would be replaced") && fs::read(&scene).unwrap() == before,
        "{said}"
    );
    let nowhere = folder.path().join("absent/new.toml");
    assert!(
        fail(
            1,
            &[
                "edit",
                text(&scene),
                "--out",
                text(&nowhere),
                "--remove",
                &name
            ]
        )
        .contains("absent")
    );
}

#[test]
fn layers_are_drawn_by_name_and_agents_let_through_what_is_behind() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, new) = site(folder.path());
    let before = SceneFile::read(&scene).unwrap();
    let ego = before.ego.unwrap().at(0.0);
    let at = ego.transform(DVec3::new(8.0, 0.0, 0.0));
    let car = &before.agents[0].name;
    succeed(&[
        "edit",
        text(&scene),
        "--out",
        text(&new),
        "--move",
        &format!("{car}={},{},{},30", at.x, at.y, at.z),
    ]);
    let front = |layer: &str, format: &str, more: &[&str]| {
        let out = folder
            .path()
            .join(format!("{layer}-{format}-{}", more.len()));
        // By these rules each pixel stops by itself: pixels beside an agent only know where it
        // moves the cuts of their list. That changes rounding by less than 4e-5; whole lists are
        // equal to the last bit (`frames::editing`).
        let always = [
            "render",
            text(&new),
            "--layer",
            layer,
            "--rules",
            "gsplat15",
            "--format",
            format,
            "--out",
            text(&out),
        ];
        succeed(&[&always, more].concat());
        Image::read(&out.join(format!("front.{format}"))).unwrap()
    };
    let [all, background, agents] =
        ["all", "background", "agents"].map(|layer| front(layer, "npy", &[]));
    assert!(all != background && agents != background);
    let covered = agents.alpha.iter().filter(|alpha| **alpha > 0.5).count();
    let free = (0..agents.alpha.len()).filter(|at| agents.alpha[*at] == 0.0);
    assert!(covered > 20, "{covered} pixels show the car");
    let apart = |at: usize| {
        all.rgb[at]
            .iter()
            .zip(background.rgb[at])
            .fold(0f32, |worst, (a, b)| worst.max((a - b).abs()))
    };
    assert!(
        free.clone().count() > 100 && free.clone().all(|at| apart(at) <= 4e-5),
        "{:?}",
        free.map(apart).fold(0.0, f32::max)
    );
    let png = front("agents", "png", &[]);
    for at in 0..png.alpha.len() {
        assert!((png.alpha[at] - agents.alpha[at]).abs() <= 0.5001 / 255.0);
        if agents.alpha[at] > 0.0 {
            let straight = agents.rgb[at]
                .map(|premultiplied| (premultiplied / agents.alpha[at]).clamp(0.0, 1.0));
            assert!(
                straight
                    .iter()
                    .zip(png.rgb[at])
                    .all(|(a, b)| (a - b).abs() <= 0.5001 / 255.0),
                "{at}"
            );
        }
    }
    let truth = front("agents", "npy", &["--reference"]);
    let worst = truth
        .rgb
        .as_flattened()
        .iter()
        .zip(agents.rgb.as_flattened())
        .fold(0f32, |worst, (a, b)| worst.max((a - b).abs()));
    assert!(worst <= 0.01, "{worst}");
    assert!(
        fail(2, &["render", text(&new), "--layer", "cars", "--out", "x"]).contains("background")
    );
}
