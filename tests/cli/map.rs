//! `decouplegs map`: tables, JSON and images of small maps.

use decouplegs::scene::EpisodeEnd;

use super::*;

/// Two lanes that follow each other, with heights, and a walkway of a centerline alone beside them.
const LANES: &str = r#"{"version": 1, "lanes": [
 {"id": "a", "centerline": [[0, 0, 1], [30, 0, 1]], "left": [[0, 2, 1], [30, 2, 1]], "right": [[0, -2, 1], [30, -2, 1]],
  "successors": ["b<"], "right_neighbor": "walk", "speed_limit_mps": 8},
 {"id": "b<", "centerline": [[30, 0, 1], [60, 10, 2]], "left": [[30, 2, 1], [60, 12, 2]], "right": [[30, -2, 1], [60, 8, 2]]},
 {"id": "walk", "kind": "walking", "centerline": [[0, -4], [30, -4]], "left_neighbor": "a"}
]}"#;

const TRACKS: &str = "t,id,class,x,y,yaw,l,w\n0,v1,car,2,0,0,4.5,1.9\n1,v1,car,12,0,0,4.5,1.9\n0,p,pedestrian,5,-4,,,\n0,far,truck,900,0,,,\n";

fn written(folder: &Path, name: &str, content: &str) -> std::path::PathBuf {
    let path = folder.join(name);
    fs::write(&path, content).unwrap();
    path
}

#[test]
fn a_map_is_described_in_words_and_in_json() {
    let folder = tempfile::tempdir().unwrap();
    let map = written(folder.path(), "lanes.json", LANES);
    let said = succeed(&["map", text(&map)]);
    for part in [
        "driving          2        61.6 m",
        "walking          1        30.0 m",
        "all              3        91.6 m",
    ] {
        assert!(said.contains(part), "{part}: {said}");
    }
    for part in [
        "0.00 to 60.00 m",
        "known to 2 of 3 lanes",
        "1 from lane to lane, 1 side by side",
        "8.00 to 8.00 m/s",
    ] {
        assert!(said.contains(part), "{part}: {said}");
    }
    let value = json(&["map", text(&map), "--json"]);
    assert_eq!(
        (
            &value["lanes"],
            &value["kinds"]["driving"]["lanes"],
            &value["with_height"]
        ),
        (&3.into(), &2.into(), &2.into())
    );
    assert_eq!(
        (
            &value["successors"],
            &value["without_successor"],
            &value["tracks"]
        ),
        (&1.into(), &2.into(), &Value::Null)
    );
    assert_eq!(value["bounds_m"]["max"], Value::from(vec![60.0, 12.0, 2.0]));
}

#[test]
fn an_image_shows_lanes_and_tracks() {
    let folder = tempfile::tempdir().unwrap();
    let map = written(folder.path(), "lanes & more.json", LANES);
    let tracks = written(folder.path(), "tracks.csv", TRACKS);
    let image = folder.path().join("map.svg");
    let draw = |more: &[&str]| {
        let always = ["map", text(&map), "--force", "--svg", text(&image)];
        let said = succeed(&[&always, more].concat());
        (said, fs::read_to_string(&image).unwrap())
    };
    let (_, svg) = draw(&[]);
    assert!(
        svg.starts_with("<svg ")
            && svg.ends_with("</svg>\n")
            && svg.contains("lanes &amp; more.json"),
        "{svg}"
    );
    let count = |svg: &str, part: &str| svg.matches(part).count();
    // Each in the map and in the legend: two surfaces of driving lanes, one band of a walkway.
    assert_eq!(
        (
            count(&svg, "class=\"lane driving\""),
            count(&svg, "class=\"wide walking\"")
        ),
        (3, 1)
    );
    assert!(
        svg.contains("<title>b&lt; (driving)</title>")
            && count(&svg, "class=\"track\"") == 0
            && !svg.contains("NaN")
    );
    let (said, svg) = draw(&["--tracks", text(&tracks)]);
    assert!(
        said.contains("3 (1 car, 1 pedestrian, 1 truck), 0.00 to 1.00 s")
            && said.contains("4, 3 of them within"),
        "{said}"
    );
    assert_eq!(
        count(&svg, "class=\"body\""),
        6,
        "three in the map and three in the legend"
    );
    let value = json(&["map", text(&map), "--json", "--tracks", text(&tracks)]);
    assert_eq!(
        (
            &value["tracks"]["tracks"],
            &value["tracks"]["points_within_bounds"]
        ),
        (&3.into(), &3.into())
    );
}

#[test]
fn what_is_no_map_is_refused_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let image = folder.path().join("map.svg");
    let refused = |name: &str, content: &str| {
        let path = written(folder.path(), name, content);
        fail(1, &["map", text(&path), "--svg", text(&image)])
    };
    assert!(
        refused("page.osm", "<html/>").contains("page.osm: XML of another kind; expected a map")
    );
    assert!(
        refused("empty.json", "{\"lanes\": []}")
            .contains("empty.json: not a readable lane JSON file")
    );
    assert!(refused("cut.xodr", "<OpenDRIVE><road").contains("cut.xodr"));
    let map = written(folder.path(), "lanes.json", LANES);
    let tracks = written(folder.path(), "tracks.csv", "t,id,x,y\n0,a,1,\n");
    let said = fail(
        1,
        &[
            "map",
            text(&map),
            "--svg",
            text(&image),
            "--tracks",
            text(&tracks),
        ],
    );
    assert!(
        said.contains("tracks.csv") && said.contains("line 2, 'y'"),
        "{said}"
    );
    assert!(!image.exists());
}

/// The obstacles of a captured scene are written, drawn, edited and driven among.
#[test]
fn obstacles_of_a_captured_scene_are_edited() {
    let folder = tempfile::tempdir().unwrap();
    let street = folder.path().join("street");
    let sizes = [
        "--background",
        "40000",
        "--agents",
        "1",
        "--agent-splats",
        "300",
    ];
    let rest = [
        "--degree",
        "0",
        "--seed",
        "5",
        "--size",
        "48x27",
        "--out",
        text(&street),
    ];
    succeed(&[["synth", "street"].as_slice(), &sizes, &rest].concat());
    let [scene, lanes] = ["scene.toml", "lanes.json"].map(|name| street.join(name));
    let [file, svg] = ["obstacles.json", "map.svg"].map(|name| folder.path().join(name));
    let outputs = ["--obstacles", text(&file), "--svg", text(&svg)];
    let described = succeed(
        &[
            &["map", text(&lanes), "--scene", text(&scene)][..],
            &outputs,
        ]
        .concat(),
    );
    let found = decouplegs::asset::read_obstacles(&file).unwrap();
    assert!(found.len() > 20, "{} obstacles", found.len());
    assert!(described.contains(&format!("{} obstacles beside the lanes", found.len())));
    let drawn = fs::read_to_string(&svg).unwrap();
    // One more is in the legend.
    assert_eq!(drawn.matches("class=\"obstacle\"").count(), found.len() + 1);

    // The same file drives as the scene itself; a wall across the road ends the episode.
    let run = |name: &str, more: &[&str]| {
        let out = folder.path().join(name);
        let words = [
            "drive",
            "--level",
            "easy",
            "--episodes",
            "1",
            "--seed",
            "3",
            "--planner",
            "constant-velocity",
        ];
        let place = [
            "--map",
            text(&lanes),
            "--scene",
            text(&scene),
            "--render",
            "off",
            "--out",
            text(&out),
        ];
        succeed(&[&words[..], &place, more].concat());
        decouplegs::logs::read_episode_log(&out.join("logs/easy_0000.log")).unwrap()
    };
    let with = |text: &str| fs::write(&file, text).unwrap();
    let own = run("own", &[]);
    let same = run("same", &["--obstacles", text(&file)]);
    assert_eq!((&own.steps, &own.end), (&same.steps, &same.end));
    let passed_m = own.instants().last().unwrap().ego.position_m;
    with(&format!(
        "{{\"version\": 1, \"obstacles\": [{{\"center_m\": [{}, {}], \"length_m\": 1, \"width_m\": 1}}]}}",
        passed_m.x, passed_m.y
    ));
    let hit = run("hit", &["--obstacles", text(&file)]);
    assert!(
        matches!(hit.end, EpisodeEnd::Obstacle { .. }),
        "{:?}",
        hit.end
    );
    assert!(
        !matches!(own.end, EpisodeEnd::Obstacle { .. }),
        "{:?}",
        own.end
    );
    with(
        "{\"version\": 1, \"obstacles\": [{\"center_m\": [0, 0], \"length_m\": -1, \"width_m\": 1}]}",
    );
    let out = folder.path().join("none");
    let words = [
        "drive",
        "--level",
        "easy",
        "--planner",
        "constant-velocity",
        "--render",
        "off",
    ];
    let place = [
        "--map",
        text(&lanes),
        "--scene",
        text(&scene),
        "--obstacles",
        text(&file),
        "--out",
        text(&out),
    ];
    let said = fail(1, &[&words[..], &place].concat());
    assert!(
        said.contains("obstacles.json") && said.contains("obstacle 0"),
        "{said}"
    );
}
