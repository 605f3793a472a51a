//! Episodes with stop signs: a planner that stands at them, and one that does not.

use std::path::Path;
use std::sync::Arc;

use decouplegs::drive::score::{EpisodeScore, InfractionKind, STOP_SIGN_FACTOR};
use decouplegs::episode::{Site, drive, replay};
use decouplegs::logs::{episode_log, scenario_file};
use decouplegs::planner::{ConstantVelocity, LaneFollow, Planner};
use decouplegs::scene::EpisodeEnd;
use decouplegs::scene::episode::Episode;

const SCENARIO: &str = r#"
version = 1
name = "stop"
seed = 1
duration_s = 40.0
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
[[sign]]
kind = "stop"
lane = "main/forward/1/before"
at_m = 365.2
"#;

fn driven(text: &str, planner: &mut dyn Planner) -> (Arc<Site>, Episode) {
    let scenario = scenario_file::parse(text).unwrap();
    let site = Arc::new(Site::open(&scenario.place, Path::new(""), None).unwrap());
    let driven = drive(&scenario, &site, None, planner, &mut ()).unwrap();
    (site, driven.episode)
}

#[test]
fn one_planner_stands_at_a_stop_sign_and_one_passes_it() {
    let (_, stood) = driven(SCENARIO, &mut LaneFollow::default());
    let score = EpisodeScore::new(&stood);
    assert!(score.success && score.infractions.is_empty(), "{score:?}");
    let line = stood.head.sign_lines[0];
    let stands = stood.instants().any(|instant| {
        let front_m = instant.ego.position_m + instant.ego.ahead() * 2.25;
        instant.ego.speed_mps < 0.1 && (-4.0..0.0).contains(&line.locate(front_m).0)
    });
    assert!(stands);

    let (site, passed) = driven(SCENARIO, &mut ConstantVelocity);
    let score = EpisodeScore::new(&passed);
    assert_eq!(passed.end, EpisodeEnd::RouteDone);
    assert_eq!((score.stop_signs(), score.success), (1, false));
    assert_eq!(score.driving_score, STOP_SIGN_FACTOR);
    let infraction = score.infractions[0];
    assert_eq!(infraction.kind, InfractionKind::StopSign { sign: 0 });
    assert!((infraction.time_s - (45.2 - 2.25) / 8.0).abs() < 0.02);

    let bytes = episode_log::encode(&passed).unwrap();
    let read = episode_log::decode(&bytes).unwrap();
    assert_eq!((EpisodeScore::new(&read), &read), (score, &passed));
    let again = replay(&passed, &site, None, &mut ()).unwrap();
    assert_eq!(again.moved_differently, None);
}

#[test]
fn yield_signs_cost_nothing_and_scenarios_without_signs_have_no_trace() {
    let yields = SCENARIO.replace("kind = \"stop\"", "kind = \"yield\"");
    let (_, episode) = driven(&yields, &mut ConstantVelocity);
    assert_eq!(EpisodeScore::new(&episode).driving_score, 1.0);
    let without = &SCENARIO[..SCENARIO.find("[[sign]]").unwrap()];
    let (_, episode) = driven(without, &mut ConstantVelocity);
    let text = String::from_utf8(episode_log::encode(&episode).unwrap()).unwrap();
    assert!(!text.contains("sign"));
}
