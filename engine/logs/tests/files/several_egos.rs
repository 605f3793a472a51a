//! Scenario files with several egos.

use decouplegs_logs::scenario_file::{parse, to_toml};

/// A scenario on the street, with `egos` behind its place.
fn with_egos(egos: &str) -> String {
    format!(
        "version = 1\nname = \"a\"\nseed = 1\n[place.street]\nweather = \"clear\"\nbackground = 9\nagent_splats = 8\n\
         seed = 1\n{egos}\n[[agent]]\nname = \"taxi\"\nasset = 0\nlane = \"2\"\nat_m = 3\nspeed_mps = 4\n"
    )
}

fn ego(table: &str, keys: &str) -> String {
    format!(
        "{table}\nroute = [\"1\"]\nstart_m = 0\nend_m = 9\nspeed_mps = 1\ncruise_mps = 2\n{keys}"
    )
}

#[test]
fn egos_have_names_looks_and_planners() {
    let first = ego("[ego]", "");
    let second = ego(
        "[[other_ego]]",
        "name = \"second\"\nasset = 3\nplanner = \"vision\"\nstart_pose = [1.0, 2.0, 0.5]\n",
    );
    let scenario = parse(&with_egos(&format!("{first}{second}"))).unwrap();
    assert_eq!(scenario.egos.count(), 2);
    assert_eq!(scenario.ego_identity(0).name, "ego");
    let other = scenario.ego_identity(1);
    assert_eq!((other.name.as_str(), other.asset), ("second", 3));
    assert_eq!(other.planner.as_deref(), Some("vision"));
    assert_eq!(scenario.ego_task(1).start_pose, Some([1.0, 2.0, 0.5]));
    assert_eq!(scenario.agent_count(), 2);
    assert_eq!(scenario.agent(1).0, "second");
    let other = scenario.for_ego(1);
    assert_eq!((other.agent(0).0, other.agent(1).0), ("taxi", "ego"));
    assert_eq!(other.ego, *scenario.ego_task(1));
    assert_eq!(other.for_ego(1), scenario);
    assert_eq!(
        parse(&to_toml(&scenario).unwrap()).as_ref(),
        Ok(&scenario),
        "what is written is read"
    );
}

#[test]
fn a_file_of_one_ego_has_no_key_of_several() {
    let text = to_toml(&parse(&with_egos(&ego("[ego]", ""))).unwrap()).unwrap();
    let table = text.split("[ego]").nth(1).unwrap();
    assert!(table.starts_with("\nroute = "), "{text}");
    assert!(!text.contains("other_ego"), "{text}");
}

#[test]
fn faults_of_other_egos_name_table_key_and_reason() {
    let first = ego("[ego]", "");
    let other = |keys: &str| ego("[[other_ego]]", keys);
    let refused = |others: &str| {
        let text = with_egos(&format!("{first}{others}"));
        parse(&text).unwrap_err().to_string()
    };
    let many: String = (0..8)
        .map(|number| other(&format!("name = \"ego_{number}\"\n")))
        .collect();
    for (others, parts) in [
        (
            many,
            ["other_ego[7].name", "9 egos with [ego]; expected at most 8"],
        ),
        (other(""), ["other_ego[0].name", "'ego' is taken"]),
        (
            other("name = \"taxi\"\n"),
            ["agent[0].name", "'taxi' is taken"],
        ),
        (
            other("name = \"a b\"\n"),
            ["other_ego[0].name", "'a b' names files"],
        ),
        (
            other("name = \"b\"\nplanner = \"exec:rm -r x\"\n"),
            [
                "other_ego[0].planner",
                "expected constant-velocity, lane-follow, vision",
            ],
        ),
        (
            other("name = \"b\"\nasset = 70000\n"),
            ["other_ego[0].asset", "70000 is out of range"],
        ),
        (
            other("name = \"b\"\n").replace("end_m = 9", "end_m = 0"),
            ["other_ego[0].end_m", "0 m does not lie beyond the start"],
        ),
    ] {
        let error = refused(&others);
        assert!(parts.iter().all(|part| error.contains(part)), "{error}");
    }
}
