//! Scenario files and logs with several egos.

use decouplegs_logs::episode_log::{EpisodeLog, decode, encode};
use decouplegs_logs::scenario_file::{parse, to_toml};
use decouplegs_scene::episode::EpisodeTick;
use decouplegs_scene::{EgoIdentity, Episode, OtherEgo, VehicleSize, VehicleState};

use crate::episode_logs::small;

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

/// An episode of two egos, of which the first ends a step after the start, and the second two steps
/// later.
fn two() -> Episode {
    let mut first = small();
    let identity = EgoIdentity {
        name: "second".into(),
        ..EgoIdentity::default()
    };
    let task = first.head.scenario.ego.clone();
    let size = task.size;
    first.head.scenario.egos.others = vec![OtherEgo { identity, task }];
    first.head.agent_sizes = vec![VehicleSize::CAR, size];
    let mut second = first.clone();
    second.head.scenario = first.head.scenario.for_ego(1);
    let own = |time_s: f64| VehicleState {
        speed_mps: time_s,
        ..VehicleState::default()
    };
    let see_first = |instant: &mut EpisodeTick| {
        let is_here = instant.time_s <= 0.5;
        instant.agents.push(is_here.then_some(instant.ego));
        instant.ego = own(instant.time_s);
    };
    see_first(&mut second.start);
    let steps = second.steps.iter_mut();
    steps
        .flat_map(|step| &mut step.instants)
        .for_each(see_first);
    first.steps.truncate(1);
    let instants = first.steps.iter_mut().flat_map(|step| &mut step.instants);
    for instant in instants.chain(std::iter::once(&mut first.start)) {
        instant.agents.push(Some(own(instant.time_s)));
    }
    first.others = vec![second];
    first
}

/// Payloads of the lines of a log.
fn payloads(log: &[u8]) -> Vec<String> {
    let text = std::str::from_utf8(log).unwrap();
    text.lines().map(|line| line[17..].to_owned()).collect()
}

/// The log of payloads.
fn sealed(payloads: &[String]) -> Vec<u8> {
    let mut before = "0".repeat(16);
    let mut log = String::new();
    for payload in payloads {
        let hash = xxhash_rust::xxh3::xxh3_64(format!("{before}{payload}").as_bytes());
        before = format!("{hash:016x}");
        log.push_str(&format!("{before} {payload}\n"));
    }
    log.into_bytes()
}

#[test]
fn a_log_of_two_egos_tells_agents_once() {
    let episode = two();
    let bytes = encode(&episode).unwrap();
    assert_eq!(decode(&bytes).unwrap(), episode);
    let lines = payloads(&bytes);
    assert_eq!(sealed(&lines), bytes);
    let begins = [
        "{\"format\":\"decouplegs-episode\",\"version\":4",
        "{\"ego\":1,\"planner\":",
        "{\"step\":0,",
        "{\"ego\":1,\"step\":0,",
        "{\"end\":\"collision\"",
        "{\"ego\":1,\"step\":1,",
        "{\"ego\":1,\"step\":2,",
        "{\"ego\":1,\"end\":{\"end\":\"collision\"",
    ];
    assert_eq!(lines.len(), begins.len());
    for (line, begin) in lines.iter().zip(begins) {
        assert!(line.starts_with(begin), "{line}");
    }
    let agents = "[20.25,0.1,";
    let told = |line: usize| lines[line].contains(agents);
    assert!(told(2) && !told(3), "agents of a moment are told once");
    let alone = payloads(&encode(&small()).unwrap());
    let start = &alone[0][..alone[0].find("\"scenario\"").unwrap()];
    assert!(lines[0].starts_with(start));
}

#[test]
fn a_log_that_is_written_as_it_goes_is_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("two.log");
    let episode = two();
    let mut log = EpisodeLog::create_for(&path, &episode).unwrap();
    let other = &episode.others[0];
    log.append_for(0, &episode.steps[0]).unwrap();
    log.append_for(1, &other.steps[0]).unwrap();
    log.end_for(0, &episode.end).unwrap();
    log.append_for(1, &other.steps[1]).unwrap();
    log.append_for(1, &other.steps[2]).unwrap();
    log.end_for(1, &other.end).unwrap();
    log.close().unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), encode(&episode).unwrap());
    let log = EpisodeLog::create_for(&path, &episode).unwrap();
    let error = log.close().unwrap_err().to_string();
    assert!(error.contains("two.log"), "{error}");
}

#[test]
fn damaged_logs_of_two_egos_are_refused() {
    let bytes = encode(&two()).unwrap();
    let lines = payloads(&bytes);
    for at in 0..bytes.len() {
        let mut broken = bytes.clone();
        broken[at] ^= 1 << (at % 8);
        assert!(decode(&broken).is_err(), "byte {at}");
    }
    for count in 1..lines.len() {
        let told = decode(&sealed(&lines[..count])).unwrap_err().to_string();
        assert!(told.contains("is missing"), "{count} lines: {told}");
    }
    let refused = |lines: &[String]| decode(&sealed(lines)).unwrap_err().to_string();
    for (at, from, to, reason) in [
        (
            1,
            "\"ego\":1",
            "\"ego\":7",
            "line 2: is the head of ego 7; expected ego 1",
        ),
        (3, "\"ego\":1", "\"ego\":9", "line 4: tells of ego 9 of 2"),
        (5, "\"ego\":1,", "", "line 6: follows the end of ego 0"),
        (
            3,
            "[0.25,[0.0,",
            "[0.25,[0.5,",
            "ego 1 is in another world than ego 0 at 0.25 s",
        ),
        (
            3,
            "[0.25,",
            "[0.26,",
            "ego 1 is in another world than ego 0 at 0.26 s",
        ),
    ] {
        let mut lines = lines.clone();
        lines[at] = lines[at].replacen(from, to, 1);
        let told = refused(&lines);
        assert!(told.contains(reason), "{told}");
    }
    for (a, b) in [(1, 2), (2, 3), (4, 5)] {
        let mut lines = lines.clone();
        lines.swap(a, b);
        refused(&lines);
    }
    let mut alone = two();
    alone.others.clear();
    let error = encode(&alone).unwrap_err().to_string();
    assert!(
        error.contains("records of 1 egos; the scenario has 2"),
        "{error}"
    );
    let mut apart = two();
    apart.others[0].start.ego.speed_mps = 3.0;
    let error = encode(&apart).unwrap_err().to_string();
    assert!(error.contains("another world"), "{error}");
}
