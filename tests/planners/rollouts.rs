//! Episodes that are stepped through from outside, against those that are driven.

use std::path::Path;
use std::sync::Arc;

use decouplegs::drive::generate::{Generator, PlaceOptions};
use decouplegs::drive::score::EpisodeScore;
use decouplegs::episode::{EpisodeMetadata, Rollout, Site, drive};
use decouplegs::planner::{
    ConstantVelocity, EpisodeInfo, LaneFollow, Localization, Observation, ObservationRequest,
    Planner, PlannerError,
};
use decouplegs::scene::plan::PlanPoint;
use decouplegs::scene::scenario::Place;
use decouplegs::scene::{EpisodeEnd, Level, Plan, Scenario, Weather};
use decouplegs::winnable::{MeasuredDifficulty, is_winnable};

fn street() -> Arc<Site> {
    let place = Place::Street {
        weather: Weather::Clear,
        background: 0,
        agent_splats: 0,
        seed: 1,
    };
    Arc::new(Site::open(&place, Path::new(""), None).unwrap())
}

fn scenario(site: &Site, level: Level, seed: u64) -> Scenario {
    let options = PlaceOptions::Street {
        background: 0,
        agent_splats: 0,
        seed: 1,
    };
    Generator::new(&site.lanes, options, &site.asset_sizes)
        .unwrap()
        .scenario(level, seed, 0)
        .unwrap()
}

#[test]
fn scenarios_that_nobody_can_win_are_told_and_have_others_in_their_place() {
    let site = street();
    let options = PlaceOptions::Street {
        background: 0,
        agent_splats: 0,
        seed: 1,
    };
    let generator = Generator::new(&site.lanes, options, &site.asset_sizes).unwrap();
    let (level, seed) = (Level::Hard, 101);
    let is_won = |scenario: &Scenario| is_winnable(scenario, &site).unwrap();
    let scenario = |index: u32, replacement: u32| {
        generator
            .scenario_instead(level, seed, index, replacement)
            .unwrap()
    };
    let lost: Vec<u32> = (0..12)
        .filter(|&index| !is_won(&scenario(index, 0)))
        .collect();
    assert!((1..12).contains(&lost.len()), "{lost:?} of 12");
    let index = lost[0];
    let own = scenario(index, 0);
    assert_eq!(own, generator.scenario(level, seed, index).unwrap());
    let other = (1..20)
        .map(|replacement| scenario(index, replacement))
        .find(is_won)
        .expect("one of twenty can be won");
    assert_eq!((&other.name, other.level), (&own.name, own.level));
    assert_ne!(other.ego, own.ego);
    // The planner has more time now.
    let mut planner = LaneFollow::default();
    let driven = drive(&other, &site, None, &mut planner, &mut ()).unwrap();
    assert!(EpisodeScore::new(&driven.episode).success);
    let measured = MeasuredDifficulty::new(&other, &site).unwrap();
    assert!(measured.won[0] && measured.lost_share() < 1.0);
    let nobody = Scenario {
        agents: vec![],
        ..other.clone()
    };
    let alone = MeasuredDifficulty::new(&nobody, &site).unwrap();
    assert_eq!((alone.reaction_s, alone.interactions), (None, 0.0));
    assert!(measured.interactions > 0.0 && measured.reaction_s.is_some());
    // No time to spare is not enough.
    let finished_s = driven.episode.steps.len() as f64 * other.step_s;
    let tight = Scenario {
        duration_s: finished_s,
        ..other
    };
    assert!(!is_won(&tight));
}

#[test]
fn stepping_through_a_drive_gives_the_same_episode() {
    let site = street();
    for (level, seed) in [(Level::Easy, 3), (Level::Hard, 4)] {
        let scenario = scenario(&site, level, seed);
        let driven = drive(&scenario, &site, None, &mut ConstantVelocity, &mut ())
            .unwrap()
            .episode;
        let crew = EpisodeMetadata {
            planner: driven.head.planner.clone(),
            drawn_by: None,
            agent_driver: None,
        };
        let mut rollout = Rollout::new(&scenario, &site, crew).unwrap();
        for step in &driven.steps {
            assert_eq!(rollout.end(), None);
            assert_eq!(rollout.step(step.plan.clone(), Vec::new(), false), step);
        }
        assert_eq!(rollout.end(), Some(&driven.end));
        assert_eq!(rollout.episode(), &driven);
        let (progress_m, length_m) = rollout.progress_m();
        let completion = rollout.score().route_completion;
        assert!(
            (completion - (progress_m / length_m).min(1.0)).abs() < 1e-6,
            "{completion} and {progress_m} of {length_m} m"
        );
    }
}

#[test]
fn an_episode_steered_by_hand_is_one_of_plans() {
    let site = street();
    let scenario = scenario(&site, Level::Easy, 3);
    let mut rollout = Rollout::new(&scenario, &site, EpisodeMetadata::default()).unwrap();
    let mut standing = 0;
    while rollout.end().is_none() {
        let plan = rollout
            .simulation()
            .view(0)
            .ego()
            .plan_under(0.0, -3.0, 2.0)
            .unwrap();
        let step = rollout.step(plan, Vec::new(), false);
        standing += usize::from(step.instants.last().unwrap().ego.speed_mps == 0.0);
    }
    assert_eq!(rollout.next_step(), scenario.steps());
    assert!(standing > 20, "it brakes and stands: {standing}");
    // What was recorded, and nothing else, is driven again.
    let episode = rollout.into_episode();
    assert_eq!(episode.end, EpisodeEnd::Time);
    let again = decouplegs::episode::replay(&episode, &site, None, &mut ()).unwrap();
    assert_eq!(again.moved_differently, None);
}

/// Planner that follows its route by its localization alone, and records each localization.
#[derive(Default)]
struct ByRoute {
    told: Vec<Localization>,
}

impl Planner for ByRoute {
    fn name(&self) -> String {
        "by route".into()
    }

    fn sees(&self) -> ObservationRequest {
        ObservationRequest {
            localization: true,
            ..ObservationRequest::default()
        }
    }

    fn begin(&mut self, _info: &EpisodeInfo) -> Result<(), PlannerError> {
        Ok(())
    }

    fn plan(&mut self, observation: &Observation) -> Result<Plan, PlannerError> {
        let localization = observation.localization.expect("it was asked for").clone();
        let now = *localization.now();
        // A point of the route per half a second: 8 m/s.
        let ahead = localization.route_m.iter().skip(1);
        let points = ahead.zip(1..).map(|(point, number)| PlanPoint {
            time_s: 0.5 * f64::from(number),
            position_m: now.state.to_local(point.truncate()),
        });
        let plan = Plan::new(points.collect()).unwrap_or_else(|_| Plan::standing());
        self.told.push(localization);
        Ok(plan)
    }
}

#[test]
fn localization_leads_along_the_route_and_tells_every_moment_once() {
    let site = street();
    let scenario = Scenario {
        agents: vec![],
        lights: vec![],
        ..scenario(&site, Level::Easy, 3)
    };
    let mut planner = ByRoute::default();
    let driven = drive(&scenario, &site, None, &mut planner, &mut ()).unwrap();
    let episode = driven.episode;
    assert!(episode.head.planner.localization && !episode.head.planner.privileged);
    // The last points of the route are nearer than a plan reaches.
    assert!(episode.steps.len() > 10, "{:?}", episode.end);
    let told: Vec<_> = planner.told.iter().flat_map(|told| &told.path).collect();
    for (located, tick) in told.iter().zip(episode.instants()) {
        assert_eq!((located.time_s, located.state), (tick.time_s, tick.ego));
        let turned = located.pose.heading_rad() - tick.ego.yaw_rad;
        assert!(turned.sin().abs() < 1e-9);
        let above_m = located.pose.translation.z - 0.5 * scenario.ego.size.height_m;
        assert!(above_m.abs() < 0.3, "{above_m} m above the street");
        assert_eq!(located.motion.speed_mps, tick.ego.speed_mps);
    }
    let steps = episode.steps.len();
    let before_last: usize = episode.steps[..steps - 1]
        .iter()
        .map(|step| step.instants.len())
        .sum();
    assert_eq!(told.len(), 1 + before_last);
    for told in &planner.told {
        let route_m = &told.route_m;
        assert!(route_m.len() <= Localization::WAYPOINTS);
        let beside_m = route_m[0].truncate().distance(told.now().state.position_m);
        assert!(beside_m < 2.0, "{beside_m} m from the ego");
        for pair in route_m.windows(2) {
            let apart_m = pair[0].distance(pair[1]);
            assert!(
                apart_m > 3.5 && apart_m < Localization::SPACING_M + 1e-6,
                "{apart_m}"
            );
        }
    }
    let counts: Vec<usize> = planner.told.iter().map(|told| told.route_m.len()).collect();
    assert_eq!(counts[0], Localization::WAYPOINTS);
    assert!(counts.is_sorted_by(|a, b| a >= b) && counts[steps - 1] < Localization::WAYPOINTS);
}
