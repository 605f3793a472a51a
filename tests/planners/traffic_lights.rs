//! Episodes with traffic lights: planners that obey them, and planners that do not.

use std::path::Path;
use std::sync::Arc;

use decouplegs::drive::score::{EpisodeScore, InfractionKind, RED_LIGHT_FACTOR};
use decouplegs::episode::{Site, drive, replay};
use decouplegs::logs::{episode_log, scenario_file};
use decouplegs::planner::{ConstantVelocity, LaneFollow, Planner};
use decouplegs::scene::episode::Episode;
use decouplegs::scene::{EpisodeEnd, Scenario};

const SCENARIO: &str = r#"
version = 1
name = "red"
seed = 1
duration_s = 30.0
[place.street]
weather = "clear"
background = 1
agent_splats = 1
seed = 1
[ego]
route = ["main/forward/1/before", "main/forward/1/straight", "main/forward/1/after"]
start_m = 320.0
end_m = 60.0
speed_mps = 8.0
cruise_mps = 10.0
[[light]]
name = "main"
stop_lines = [["main/forward/0/before", 365.2], ["main/forward/1/before", 365.2]]
phases = [["red", 12.0], ["green", 12.0], ["yellow", 3.0]]
"#;

fn driven(scenario: &Scenario, planner: &mut dyn Planner) -> (Arc<Site>, Episode) {
    let site = Arc::new(Site::open(&scenario.place, Path::new(""), None).unwrap());
    let driven = drive(scenario, &site, None, planner, &mut ()).unwrap();
    (site, driven.episode)
}

#[test]
fn one_planner_waits_at_red_and_one_runs_it() {
    let scenario = scenario_file::parse(SCENARIO).unwrap();
    let (_, waited) = driven(&scenario, &mut LaneFollow::default());
    let score = EpisodeScore::new(&waited);
    assert!(score.success && score.infractions.is_empty());
    // It waited with its front before the line until 12 s.
    let line = waited.head.stop_lines[1];
    for instant in waited.instants().filter(|instant| instant.time_s < 12.0) {
        let front_m = instant.ego.position_m + instant.ego.ahead() * 2.25;
        assert!(line.locate(front_m).0 < 0.0, "at {} s", instant.time_s);
    }

    let (site, ran) = driven(&scenario, &mut ConstantVelocity);
    let score = EpisodeScore::new(&ran);
    assert_eq!(ran.end, EpisodeEnd::RouteDone);
    assert_eq!((score.red_lights(), score.success), (1, false));
    assert_eq!(score.driving_score, RED_LIGHT_FACTOR);
    // 45.2 m less half a car at 8 m/s.
    let infraction = score.infractions[0];
    assert_eq!(infraction.kind, InfractionKind::RedLight { light: 0 });
    assert!((infraction.time_s - (45.2 - 2.25) / 8.0).abs() < 0.02);

    let bytes = episode_log::encode(&ran).unwrap();
    let read = episode_log::decode(&bytes).unwrap();
    assert_eq!((EpisodeScore::new(&read), &read), (score, &ran));
    let again = replay(&ran, &site, None, &mut ()).unwrap();
    assert_eq!(again.moved_differently, None);
}

#[test]
fn a_scenario_without_lights_leaves_no_trace_of_them() {
    let without = &SCENARIO[..SCENARIO.find("[[light]]").unwrap()];
    let scenario = scenario_file::parse(without).unwrap();
    let (_, episode) = driven(&scenario, &mut ConstantVelocity);
    assert!(episode.head.stop_lines.is_empty());
    assert_eq!(EpisodeScore::new(&episode).driving_score, 1.0);
    let text = String::from_utf8(episode_log::encode(&episode).unwrap()).unwrap();
    assert!(!text.contains("stop_lines") && !text.contains("[[light]]"));
}
