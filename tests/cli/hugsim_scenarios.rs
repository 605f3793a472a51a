//! Scenarios of HUGSIM in a captured scene.

use decouplegs::asset::SceneFile;
use decouplegs::logs::read_episode_log;
use glam::{DVec2, DVec3};

use super::*;

/// A scenario whose vehicles are `entries` of its `plan_list`.
fn yaml(entries: &[String]) -> String {
    let list: String = entries.iter().map(|entry| format!("- {entry}\n")).collect();
    format!(
        "mode: hard_00\nplan_list:\n{list}load_HD_map: false\nstart_euler: [0.0, 0.0, 0.0]\nstart_ab: [0.0, 2.0]\nstart_velo: 1\nstart_steer: 0\nscene_name: scene-0001\niteration: 30000\n"
    )
}

#[test]
fn vehicles_drive_as_their_planners_say() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let scene_file = folder.path().join("scene.toml");
    let scene = SceneFile::read(&scene_file).unwrap();
    let moving = scene
        .agents
        .iter()
        .find(|agent| {
            let way = &agent.trajectory;
            way.at(way.start_s())
                .translation
                .distance(way.at(way.end_s()).translation)
                > 5.0
        })
        .expect("the street has a car that drives");
    let entries = [
        "[2.0, 30.0, -0.3, 0.1, 3.0, car_a, ConstantPlanner, {}]".to_owned(),
        format!(
            "[0, 0, -0.3, 0, 0, car_b, UnicyclePlanner, {{uc_id: {}, speed: 0.5}}]",
            moving.name
        ),
        "[-3.0, 20.0, -0.3, 0.0, 5.0, car_c, AttackPlanner, {pred_steps: 20, ATTACK_FREQ: 3, best_k: 1}]"
            .to_owned(),
    ];
    let scenario = folder.path().join("scene-0001-hard-00.yaml");
    fs::write(&scenario, yaml(&entries)).unwrap();
    let (run, map) = (folder.path().join("run"), folder.path().join("lanes.json"));
    let drive = |out: &Path| {
        let arguments = [
            "drive",
            text(&scenario),
            "--scene",
            text(&scene_file),
            "--map",
            text(&map),
            "--planner",
            "constant-velocity",
            "--render",
            "off",
            "--out",
            text(out),
        ];
        succeed(&arguments);
        let log = out.join("logs/scene-0001-hard_00.log");
        (fs::read(&log).unwrap(), read_episode_log(&log).unwrap())
    };
    let (bytes, episode) = drive(&run);
    assert!(
        drive(&folder.path().join("again")).0 == bytes,
        "drives repeat"
    );
    assert_eq!(
        episode.head.scenario.level.map(|level| level.name()),
        Some("hard")
    );

    // Seen from the first front camera, which looks ahead.
    let ego = scene.ego.as_ref().unwrap();
    let start = ego.at(ego.start_s());
    let front = scene.rig.cameras().next().unwrap();
    let camera = start.then(&front.rig_from_camera);
    let ahead = (camera.rotation * DVec3::Z).truncate().normalize();
    let from = camera.translation.truncate();
    let seen = |right_m: f64, ahead_m: f64| from + ahead_m * ahead - right_m * ahead.perp();
    for tick in episode.instants() {
        let agents = &tick.agents;
        let constant = agents[0].as_ref().unwrap();
        let to_the_left = DVec2::from_angle(0.1).rotate(ahead);
        let expected = seen(2.0, 30.0) + 3.0 * tick.time_s * to_the_left;
        let off_m = constant.position_m.distance(expected);
        assert!(off_m < 1e-6, "{} s: {off_m} m", tick.time_s);
        let way = &moving.trajectory;
        let then = way
            .at(way.start_s() + 0.5 * tick.time_s)
            .translation
            .truncate();
        let off_m = agents[1].as_ref().unwrap().position_m.distance(then);
        assert!(off_m < 0.05, "{} s: {off_m} m", tick.time_s);
    }
    // The attack comes nearer than it would straight on.
    let nearest = |of: &dyn Fn(f64, DVec2) -> DVec2| {
        episode
            .instants()
            .map(|tick| {
                let own = tick.agents[2].as_ref().unwrap().position_m;
                of(tick.time_s, own).distance(tick.ego.position_m)
            })
            .fold(f64::INFINITY, f64::min)
    };
    let attacks_m = nearest(&|_, own| own);
    let passes_m = nearest(&|time_s, _| seen(-3.0, 20.0) + 5.0 * time_s * ahead);
    assert!(
        attacks_m < 0.5 * passes_m,
        "{attacks_m} m instead of {passes_m} m"
    );
}

#[test]
fn what_is_missing_is_named() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let (scene, map) = (
        folder.path().join("scene.toml"),
        folder.path().join("lanes.json"),
    );
    let scenario = folder.path().join("a.yaml");
    let drive = |more: &[&str]| {
        let run = tempfile::tempdir_in(folder.path()).unwrap();
        let mut arguments = vec!["drive", text(&scenario), "--planner", "lane-follow"];
        arguments.extend(["--render", "off", "--out", text(run.path())]);
        arguments.extend(more);
        fail(1, &arguments)
    };
    fs::write(&scenario, yaml(&[])).unwrap();
    let said = drive(&[]);
    assert!(
        said.contains("name the scene that it was made for with --scene"),
        "{said}"
    );
    let place = ["--scene", text(&scene), "--map", text(&map)];
    let entry = "[0, 0, 0, 0, 0, car, UnicyclePlanner, {uc_id: nobody}]".to_owned();
    fs::write(&scenario, yaml(&[entry])).unwrap();
    let said = drive(&place);
    assert!(
        said.contains("\"nobody\" did, which the scene does not have"),
        "{said}"
    );
    fs::write(&scenario, "plan_list: 3").unwrap();
    let said = drive(&place);
    assert!(
        said.contains("a.yaml") && said.contains("plan_list"),
        "{said}"
    );
}
