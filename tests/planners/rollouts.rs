//! Episodes that are stepped through from outside, against those that are driven.

use std::path::Path;
use std::sync::Arc;

use decouplegs::drive::generate::{Generator, PlaceOptions};
use decouplegs::episode::{EpisodeMetadata, Rollout, Site, drive};
use decouplegs::planner::ConstantVelocity;
use decouplegs::scene::scenario::Place;
use decouplegs::scene::{EpisodeEnd, Level, Scenario, Weather};

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
