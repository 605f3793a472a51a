//! Several egos in one world: who ends how, whom traffic sees, and that nothing depends on their
//! order.

use std::path::Path;
use std::sync::Arc;

use crate::frames::worlds::{assert_silent, session};
use decouplegs::drive::generate::{Generator, PlaceOptions};
use decouplegs::drive::other_egos::with_egos;
use decouplegs::drive::score::EpisodeScore;
use decouplegs::episode::{
    Appearance, EgosRenderer, Rollout, Simulation, Site, chosen, drive, drive_egos, replay_egos,
};
use decouplegs::logs::episode_log::{decode, encode};
use decouplegs::planner::{
    Cameras, ConstantVelocity, EpisodeInfo, LaneFollow, Observation, ObservationRequest, Planner,
    PlannerError, images as images_of,
};
use decouplegs::render::{ColorFormat, Outputs};
use decouplegs::scene::scenario::Place;
use decouplegs::scene::{Egos, Episode, EpisodeEnd, Level, Plan, Scenario, VehicleState, Weather};
use decouplegs::session::{HostImages, World, WorldView};

fn street() -> Arc<Site> {
    let place = Place::Street {
        weather: Weather::Clear,
        background: 0,
        agent_splats: 0,
        seed: 1,
    };
    Arc::new(Site::open(&place, Path::new(""), None).unwrap())
}

/// A generated scenario of `level` with `count` egos.
fn scenario(site: &Site, level: Level, count: usize) -> Scenario {
    let options = PlaceOptions::Street {
        background: 1,
        agent_splats: 1,
        seed: 1,
    };
    let generator = Generator::new(&site.lanes, options, &site.asset_sizes).unwrap();
    let scenario = generator.scenario(level, 5, 0).unwrap();
    generator.with_egos(&scenario, count).unwrap()
}

/// Drives all egos with the planners that `planner` has for their names.
fn driven(
    scenario: &Scenario,
    site: &Arc<Site>,
    planner: impl Fn(&str) -> Box<dyn Planner>,
) -> Episode {
    let names = (0..scenario.egos.count()).map(|ego| &scenario.ego_identity(ego).name);
    let mut planners: Vec<Box<dyn Planner>> = names.map(|name| planner(name)).collect();
    let planners = planners
        .iter_mut()
        .map(|planner| &mut **planner as &mut dyn Planner);
    let mut planners: Vec<&mut dyn Planner> = planners.collect();
    drive_egos(
        scenario,
        site,
        None,
        (planners.as_mut_slice(), None),
        &mut (),
    )
    .unwrap()
    .episode
}

fn lane_follow(_: &str) -> Box<dyn Planner> {
    Box::new(LaneFollow::default())
}

/// States of an ego over time.
fn way(episode: &Episode) -> Vec<VehicleState> {
    episode.instants().map(|instant| instant.ego).collect()
}

#[test]
fn two_and_eight_egos_drive_score_and_replay_to_the_bit() {
    let site = street();
    for (level, count) in [(Level::Medium, 2), (Level::Extreme, 8)] {
        let scenario = scenario(&site, level, count);
        let episode = driven(&scenario, &site, lane_follow);
        assert_eq!(episode.egos().len(), count);
        for (number, ego) in episode.egos().enumerate() {
            assert_eq!(ego.head.scenario, scenario.for_ego(number));
            assert!(!ego.steps.is_empty(), "ego {number}");
            let score = EpisodeScore::new(ego);
            assert!((0.0..=1.0).contains(&score.driving_score), "{score:?}");
        }
        let moved_m = |ego: &Episode| {
            let way = way(ego);
            way[0].position_m.distance(way[way.len() - 1].position_m)
        };
        assert!(
            episode.egos().filter(|ego| moved_m(ego) > 20.0).count() >= count / 2,
            "most egos drive"
        );
        let bytes = encode(&episode).unwrap();
        assert_eq!(decode(&bytes).unwrap(), episode, "one log holds all");
        let again = replay_egos(&episode, &site, None, &mut ()).unwrap();
        assert_eq!(again.moved_differently, None);
        assert_eq!(encode(&again.episode).unwrap(), bytes);
        let last = count - 1;
        let turned = episode.clone().with_first(last);
        assert_eq!(way(&turned), way(episode.ego(last)));
        let again = replay_egos(&turned, &site, None, &mut ()).unwrap();
        assert_eq!(again.moved_differently, None, "any ego may be the first");
        let name = &turned.head.scenario.egos.own.name;
        assert_eq!(episode.clone().with_first_named(name), Ok(turned.clone()));
        let error = episode.clone().with_first_named("none").unwrap_err();
        assert!(error.to_string().contains("it has ego, "), "{error}");
        assert_eq!(turned.with_first(last), episode);
    }
}

#[test]
fn all_see_the_same_world() {
    let site = street();
    let scenario = scenario(&site, Level::Extreme, 4);
    let episode = driven(&scenario, &site, lane_follow);
    for (viewer, own) in episode.egos().enumerate() {
        for (other, theirs) in episode.egos().enumerate() {
            for (a, b) in own.instants().zip(theirs.instants()) {
                assert_eq!(a.time_s, b.time_s);
                assert_eq!(a.ego_state(4, viewer, other), Some(b.ego));
                assert_eq!(a.agents, b.agents_for(4, other, viewer));
            }
        }
    }
    let simulation = Simulation::new(&scenario, &site).unwrap();
    let others = simulation.view(2).privileged().agents.len();
    assert_eq!(
        others,
        scenario.agent_count(),
        "a planner is told of the others"
    );
}

#[test]
fn the_order_of_egos_changes_no_drive() {
    let site = street();
    let scenario = scenario(&site, Level::Hard, 4);
    let slow = |name: &str| -> Box<dyn Planner> {
        match name.ends_with('2') || name == "ego" {
            true => Box::new(ConstantVelocity),
            false => Box::new(LaneFollow::default()),
        }
    };
    let by_name = |episode: &Episode| {
        let ways = episode.egos().map(|ego| {
            let name = ego.head.scenario.egos.own.name.clone();
            (
                name,
                way(ego),
                ego.steps.clone().len(),
                EpisodeScore::new(ego).driving_score,
            )
        });
        let mut ways: Vec<_> = ways.collect();
        ways.sort_by(|a, b| a.0.cmp(&b.0));
        ways
    };
    let first = by_name(&driven(&scenario, &site, slow));
    let mut turned = scenario.for_ego(3);
    turned.egos.others.reverse();
    assert_ne!(turned, scenario);
    assert_eq!(by_name(&driven(&turned, &site, slow)), first);
}

/// A scenario of two egos on one lane of the street, the second `gap_m` ahead.
fn one_behind_the_other(site: &Site, gap_m: f64, speeds_mps: [f64; 2]) -> Scenario {
    let mut scenario = scenario(site, Level::Medium, 2);
    scenario.agents.clear();
    scenario.pedestrians.clear();
    scenario.lights.clear();
    let other = &mut scenario.egos.others[0];
    scenario.ego.speed_mps = speeds_mps[0];
    other.task = scenario.ego.clone();
    other.task.speed_mps = speeds_mps[1];
    other.task.start_m = scenario.ego.start_m + gap_m;
    scenario
}

#[test]
fn egos_that_touch_both_end_and_both_are_scored() {
    let site = street();
    let scenario = one_behind_the_other(&site, 12.0, [10.0, 1.0]);
    let episode = driven(&scenario, &site, |_| Box::new(ConstantVelocity));
    for (number, ego) in episode.egos().enumerate() {
        assert_eq!(ego.end, EpisodeEnd::Collision { agent: 0 }, "ego {number}");
    }
    let [behind, ahead] = [0, 1].map(|ego| EpisodeScore::new(episode.ego(ego)));
    assert_eq!(behind.infractions.len(), 1);
    assert!(behind.infractions[0].at_fault(), "it drove into the other");
    assert_eq!(ahead.infractions.len(), 1);
    assert!(!ahead.infractions[0].at_fault(), "it was hit from behind");
    let name = |ego: usize| episode.ego(ego).head.scenario.agent(0).0;
    assert_eq!(
        (name(0), name(1)),
        (scenario.ego_identity(1).name.as_str(), "ego")
    );
}

#[test]
fn an_ego_follows_another_without_touching_it() {
    let site = street();
    let scenario = one_behind_the_other(&site, 25.0, [8.0, 2.0]);
    let planner = |name: &str| -> Box<dyn Planner> {
        match name {
            "ego" => Box::new(LaneFollow::default()),
            _ => Box::new(ConstantVelocity),
        }
    };
    let episode = driven(&scenario, &site, planner);
    let has_hit = matches!(episode.end, EpisodeEnd::Collision { .. });
    assert!(!has_hit, "{:?}", episode.end);
    let alone = Scenario {
        egos: Egos::default(),
        ..scenario.clone()
    };
    let alone = drive(&alone, &site, None, &mut LaneFollow::default(), &mut ()).unwrap();
    // After 5 s.
    let at_m = |episode: &Episode| way(episode)[50].position_m;
    let ahead_m = at_m(&alone.episode).distance(at_m(&episode));
    assert!(ahead_m > 10.0, "alone it comes {ahead_m} m farther");
}

#[test]
fn traffic_sees_every_ego_and_none_that_has_left() {
    let site = street();
    let mut scenario = scenario(&site, Level::Medium, 2);
    // The other ego stands before a vehicle of the traffic.
    let mut follower = scenario.agents[0].clone();
    follower.behaviors.clear();
    follower.changes_lanes = false;
    (follower.speed_mps, follower.cruise_mps) = (6.0, None);
    scenario.pedestrians.clear();
    scenario.lights.clear();
    let other = &mut scenario.egos.others[0];
    (follower.lane, follower.at_m) = (other.task.route[0].clone(), other.task.start_m - 20.0);
    other.task.speed_mps = 0.0;
    scenario.agents = vec![follower];
    if scenario.agents[0].at_m < 5.0 {
        scenario.agents[0].at_m = 5.0;
        scenario.egos.others[0].task.start_m = 25.0;
    }
    let stands = |name: &str| -> Box<dyn Planner> {
        match name {
            "ego" => Box::new(ConstantVelocity),
            _ => Box::new(Stands { fails_after: None }),
        }
    };
    let behind_m = |episode: &Episode| {
        let other = episode.ego(1);
        let agents = other.instants().filter_map(|instant| {
            let agent = instant.agents[0]?;
            Some(agent.to_local(instant.ego.position_m).x)
        });
        agents.collect::<Vec<f64>>()
    };
    let gaps_m = behind_m(&driven(&scenario, &site, stands));
    let least_m = gaps_m.iter().copied().fold(f64::INFINITY, f64::min);
    assert!(least_m > 4.0, "the follower came within {least_m} m");
    let fails = |name: &str| -> Box<dyn Planner> {
        match name {
            "ego" => Box::new(Stands { fails_after: None }),
            _ => Box::new(Stands {
                fails_after: Some(2),
            }),
        }
    };
    let episode = driven(&scenario, &site, fails);
    let (first, other) = (episode.ego(0), episode.ego(1));
    assert!(matches!(&other.end, EpisodeEnd::Planner { reason } if reason == "enough"));
    assert_eq!(other.steps.len(), 2);
    let seen = |step: usize| first.steps[step].instants[0].agents[1].is_some();
    assert!(seen(1) && !seen(2), "an ego that has ended has left");
    assert_eq!(first.end, EpisodeEnd::Time, "the other drives on");
    let place_m = other.instants().last().unwrap().ego.position_m;
    let passed = first.instants().any(|instant| {
        let agent = instant.agents[0];
        agent.is_some_and(|agent| agent.to_local(place_m).x < -5.0)
    });
    assert!(passed, "and traffic goes on over its place");
}

#[test]
fn rigs_of_all_egos_are_drawn_in_one_world_as_each_alone() {
    let place = Place::Street {
        weather: Weather::Clear,
        background: 3000,
        agent_splats: 300,
        seed: 1,
    };
    let appearance = Appearance {
        only_cars: true,
        ..Appearance::default()
    };
    let site = Arc::new(Site::open(&place, Path::new(""), Some(&appearance)).unwrap());
    let mut scenario = one_behind_the_other(&site, 9.0, [2.0, 2.0]);
    scenario.place = place;
    let session = session(Outputs {
        color: ColorFormat::U8,
        ..Outputs::default()
    });
    let scene = site.add_to(&session).unwrap();
    let size_px = Some([64, 36]);
    let rig = chosen(&site.loaded.rig, &Cameras::All, size_px).unwrap();
    let rigs = vec![rig.clone(), rig.clone()];
    let mut together = EgosRenderer::new(session.batch_renderer(), &scene, rigs, 1);
    let simulation = Simulation::new(&scenario, &site).unwrap();
    together.draw(&simulation, 0).unwrap();
    let mut alone = session.batch_renderer();
    let mut images = HostImages::default();
    let mut world = World::empty(&scene);
    for ego in 0..2 {
        let view = simulation.view(ego);
        let (pose, motion) = view.show(&mut world).unwrap();
        let shown: Vec<&str> = (world.agents().iter())
            .map(|agent| agent.name.as_str())
            .collect();
        let other = &scenario.ego_identity(1 - ego).name;
        assert_eq!(
            shown,
            [other.as_str()],
            "ego {ego} sees the other, not itself"
        );
        let cameras = rig.moving_at(&pose, &motion);
        let view = WorldView {
            world: &world,
            cameras: &cameras,
        };
        alone.draw(&[view], &mut images).unwrap();
        let readings = together.readings(ego);
        assert_eq!(readings.len(), 6);
        for (camera, frame) in images_of(&readings).enumerate() {
            assert!(
                frame.rgba == images.rgba(0, camera),
                "ego {ego}, camera {camera}"
            );
        }
        assert_eq!(together.hashes(ego).len(), 6);
        let empty = WorldView {
            world: &World::empty(&scene),
            cameras: &cameras,
        };
        alone.draw(&[empty], &mut images).unwrap();
        let differs = (0..6).any(|camera| {
            let drawn = images_of(&readings).nth(camera).unwrap();
            drawn.rgba != images.rgba(0, camera)
        });
        assert!(differs, "the other ego is in an image of ego {ego}");
    }
    assert_silent(&session);
}

/// Planner that stands, and fails after some steps.
struct Stands {
    fails_after: Option<u32>,
}

impl Planner for Stands {
    fn name(&self) -> String {
        "stands".into()
    }

    fn sees(&self) -> ObservationRequest {
        ObservationRequest::default()
    }

    fn begin(&mut self, _: &EpisodeInfo) -> Result<(), PlannerError> {
        Ok(())
    }

    fn plan(&mut self, observation: &Observation) -> Result<Plan, PlannerError> {
        match self.fails_after {
            Some(after) if observation.step >= after => Err(PlannerError("enough".into())),
            _ => Ok(plan_to_stand()),
        }
    }
}

fn plan_to_stand() -> Plan {
    let point = decouplegs::scene::plan::PlanPoint {
        time_s: 0.5,
        position_m: glam::DVec2::ZERO,
    };
    Plan::new(vec![point]).unwrap()
}

#[test]
fn scenarios_of_several_egos_that_do_not_fit_are_refused() {
    let site = street();
    let good = scenario(&site, Level::Medium, 2);
    let refused = |scenario: &Scenario| Simulation::new(scenario, &site).err().unwrap().to_string();
    let mut one_in_another = good.clone();
    one_in_another.egos.others[0].task = good.ego.clone();
    let error = refused(&one_in_another);
    assert!(error.contains("ego ego starts where ego "), "{error}");
    let mut lost = good.clone();
    lost.egos.others[0].task.route = vec!["nowhere".into()];
    let error = refused(&lost);
    assert!(
        error.contains("nowhere") && error.contains(&good.egos.others[0].identity.name),
        "{error}"
    );
    let metadata = Default::default();
    let error = Rollout::new(&good, &site, metadata)
        .err()
        .unwrap()
        .to_string();
    assert!(error.contains("2 egos, and 1 planners"), "{error}");
    let easy = with_egos(&good, &site.lanes, 100, &|_| f64::INFINITY)
        .err()
        .unwrap()
        .to_string();
    assert!(
        easy.contains("expected fewer egos or more traffic"),
        "{easy}"
    );
}
