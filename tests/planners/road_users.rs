//! Episodes with trucks, buses, cyclists and pedestrians.

use std::path::Path;
use std::sync::Arc;

use decouplegs::drive::generate::{Generator, PlaceOptions};
use decouplegs::drive::score::EpisodeScore;
use decouplegs::episode::{Appearance, Site, drive, replay};
use decouplegs::logs::{episode_log, scenario_file};
use decouplegs::planner::{ConstantVelocity, LaneFollow, Planner};
use decouplegs::scene::episode::Episode;
use decouplegs::scene::scenario::Place;
use decouplegs::scene::{EpisodeEnd, Level, RoadUser, Scenario, Weather};

const SCENARIO: &str = r#"
version = 1
name = "steps_out"
seed = 1
duration_s = 30.0
[place.street]
weather = "clear"
background = 1
agent_splats = 1
seed = 1
[ego]
route = ["main/forward/0/before"]
start_m = 240.0
end_m = 340.0
speed_mps = 8.0
cruise_mps = 8.0
[[agent]]
name = "bus"
kind = "bus"
asset = 0
size_m = [11.0, 2.5, 3.1]
lane = "main/forward/1/before"
at_m = 250.0
speed_mps = 5.0
changes_lanes = false
"#;

/// A pedestrian whom an ego that keeps its speed meets on its lane, 60 m ahead.
const PEDESTRIAN: &str = r#"
[[pedestrian]]
name = "walker"
asset = 2
path_m = [[-40.0, 9.0], [-40.0, -9.0]]
near_ego_m = 65.0
waits_for_gap = false
"#;

fn driven(text: &str, planner: &mut dyn Planner) -> (Arc<Site>, Episode) {
    let scenario = scenario_file::parse(text).unwrap();
    let site = Arc::new(Site::open(&scenario.place, Path::new(""), None).unwrap());
    let driven = drive(&scenario, &site, None, planner, &mut ()).unwrap();
    (site, driven.episode)
}

#[test]
fn one_planner_stops_for_a_pedestrian_and_one_does_not() {
    let text = format!("{SCENARIO}{PEDESTRIAN}");
    let (_, stopped) = driven(&text, &mut LaneFollow::default());
    let score = EpisodeScore::new(&stopped);
    assert!(score.success && score.collisions() == 0, "{score:?}");

    let (site, hit) = driven(&text, &mut ConstantVelocity);
    assert_eq!(hit.end, EpisodeEnd::Collision { agent: 1 });
    assert_eq!(
        hit.head.scenario.agent(1),
        ("walker", RoadUser::Pedestrian, 2)
    );
    let score = EpisodeScore::new(&hit);
    assert_eq!(score.pedestrian_collisions(), 1);
    assert!(score.driving_score < 0.5);

    let bytes = episode_log::encode(&hit).unwrap();
    let read = episode_log::decode(&bytes).unwrap();
    assert_eq!((EpisodeScore::new(&read), &read), (score, &hit));
    let again = replay(&hit, &site, None, &mut ()).unwrap();
    assert_eq!(again.moved_differently, None);
}

#[test]
fn a_scenario_with_cars_alone_leaves_no_trace_of_others() {
    let (_, episode) = driven(
        &SCENARIO.replace("kind = \"bus\"\n", ""),
        &mut ConstantVelocity,
    );
    let text = String::from_utf8(episode_log::encode(&episode).unwrap()).unwrap();
    assert!(!text.contains("pedestrian") && !text.contains("kind = "));
}

#[test]
fn generated_scenarios_have_other_road_users_where_they_are_asked_for() {
    let options = || PlaceOptions::Street {
        background: 1,
        agent_splats: 1,
        seed: 1,
    };
    let place = Place::Street {
        weather: Weather::Clear,
        background: 0,
        agent_splats: 0,
        seed: 1,
    };
    let site = Site::open(&place, Path::new(""), None).unwrap();
    let generator = |mixed: bool| {
        let cars = Generator::new(&site.lanes, options(), &site.asset_sizes).unwrap();
        if !mixed {
            return cars;
        }
        let obstacles = site.obstacles.clone();
        cars.with_road_users(&site.road_users, obstacles).unwrap()
    };
    let (mixed, cars) = (generator(true), generator(false));
    let mut kinds = [0; RoadUser::ALL.len()];
    for (level, walkers) in Level::ALL.into_iter().zip([0..=1, 1..=2, 2..=3, 3..=4]) {
        for index in 0..12 {
            let plain = cars.scenario(level, 3, index).unwrap();
            assert!(plain.pedestrians.is_empty());
            assert!(plain.agents.iter().all(|agent| agent.kind == RoadUser::Car));

            let scenario = mixed.scenario(level, 3, index).unwrap();
            check(&scenario, &site);
            // Where houses and parked cars leave room for them.
            assert!(scenario.pedestrians.len() <= *walkers.end());
            for agent in 0..scenario.agent_count() {
                kinds[scenario.agent(agent).1 as usize] += 1;
            }
        }
    }
    println!("{kinds:?}");
    assert!(kinds.iter().all(|&count| count >= 10), "{kinds:?}");
    assert!(kinds[0] > kinds[1..].iter().sum(), "{kinds:?}");
}

#[test]
fn a_place_of_cars_alone_has_the_same_cars_and_signals() {
    let place = Place::Street {
        weather: Weather::Clear,
        background: 100,
        agent_splats: 64,
        seed: 1,
    };
    let site = |only_cars| {
        let appearance = Appearance {
            only_cars,
            ..Appearance::default()
        };
        Site::open(&place, Path::new(""), Some(&appearance)).unwrap()
    };
    let (cars, all) = (site(true), site(false));
    let left_out = all.loaded.assets.len() - cars.loaded.assets.len();
    assert_eq!(left_out, all.road_users.len());
    assert!(all.loaded.assets.starts_with(&cars.loaded.assets));
    let mut scenario = scenario_file::parse(&format!("{SCENARIO}{PEDESTRIAN}")).unwrap();
    assert!(!scenario.has_only_cars());
    scenario.agents[0].kind = RoadUser::Car;
    assert!(!scenario.has_only_cars());
    scenario.pedestrians.clear();
    assert!(scenario.has_only_cars());
}

/// Vehicles have the sizes of their assets; pedestrians stand beside the road and hit nothing.
fn check(scenario: &Scenario, site: &Site) {
    let text = scenario_file::to_toml(scenario).unwrap();
    assert_eq!(scenario_file::parse(&text).unwrap(), *scenario);
    for agent in scenario
        .agents
        .iter()
        .filter(|agent| agent.kind != RoadUser::Car)
    {
        let is_its = |asset: &decouplegs::drive::generate::RoadUserAsset| {
            (asset.kind, asset.asset, asset.size) == (agent.kind, agent.asset, agent.size)
        };
        assert!(site.road_users.iter().any(is_its), "{agent:?}");
    }
    for walker in &scenario.pedestrians {
        for end_m in [walker.path_m[0], walker.path_m[walker.path_m.len() - 1]] {
            assert!(
                !site.surface.contains(end_m),
                "{}: {walker:?}",
                scenario.name
            );
        }
    }
}
