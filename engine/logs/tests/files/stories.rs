//! Stories of scenario files.

use decouplegs_logs::scenario_file;

const SCENARIO: &str = r#"
version = 1
name = "a"
seed = 1
[place.roads]
map = "m.xodr"
background = 9
agent_splats = 8
[ego]
route = ["1"]
start_m = 0
end_m = 9
speed_mps = 1
cruise_mps = 2
"#;

/// Found by fuzzing: a story without actors was not written.
#[test]
fn stories_without_actors_are_written() {
    for line in ["ego_center_m = 1.4", r#"variables = [["n", "1"]]"#] {
        let text = format!("{SCENARIO}[story]\n{line}\n");
        let scenario = scenario_file::parse(&text).unwrap();
        let written = scenario_file::to_toml(&scenario).unwrap();
        assert_eq!(scenario_file::parse(&written).unwrap(), scenario, "{line}");
    }
    let plain = scenario_file::parse(SCENARIO).unwrap();
    assert!(!scenario_file::to_toml(&plain).unwrap().contains("story"));
}
