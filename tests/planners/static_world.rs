//! Episodes that end at what does not move: parked cars, the edge of the road, the wrong way.

use std::path::Path;
use std::sync::Arc;

use decouplegs::drive::generate::{Generator, PlaceOptions};
use decouplegs::drive::score::{Conduct, EpisodeScore, OBSTACLE_FACTOR};
use decouplegs::drive::{Obstacles, OrientedBox, Polyline};
use decouplegs::episode::{Site, drive, replay};
use decouplegs::logs::episode_log::{decode, encode};
use decouplegs::planner::{
    ConstantVelocity, EpisodeInfo, Observation, ObservationRequest, Planner, PlannerError,
};
use decouplegs::scene::episode::{Episode, REPLAY_VERSION};
use decouplegs::scene::scenario::Place;
use decouplegs::scene::{EpisodeEnd, Level, ObstacleKind, Plan, PlanPoint, Scenario, Weather};

/// Follows the route at a distance to its right, meters.
struct Beside {
    right_m: f64,
}

impl Planner for Beside {
    fn name(&self) -> String {
        "beside".into()
    }

    fn sees(&self) -> ObservationRequest {
        ObservationRequest {
            privileged: true,
            ..ObservationRequest::default()
        }
    }

    fn begin(&mut self, _info: &EpisodeInfo) -> Result<(), PlannerError> {
        Ok(())
    }

    fn plan(&mut self, observation: &Observation) -> Result<Plan, PlannerError> {
        let known = observation.privileged.expect("it asked for it");
        let line = Polyline::new(known.route_m.iter().map(|point| point.extend(0.0)))
            .expect("a route is a line");
        let foot = line.project(known.ego.position_m);
        let points = (1..=6).map(|half| {
            let time_s = 0.5 * f64::from(half);
            // Over to that side within three seconds.
            let share = (time_s / 3.0).min(1.0);
            let lateral_m = foot.lateral_m + share * (-self.right_m - foot.lateral_m);
            let arc_m = foot.arc_m + 7.0 * time_s;
            let left = glam::DVec2::from_angle(line.heading_at(arc_m)).perp();
            let at_m = line.at(arc_m).truncate() + lateral_m * left;
            PlanPoint {
                time_s,
                position_m: known.ego.to_local(at_m),
            }
        });
        Plan::new(points.collect()).map_err(|error| PlannerError(error.to_string()))
    }
}

fn site() -> Site {
    let place = Place::Street {
        weather: Weather::Clear,
        background: 0,
        agent_splats: 0,
        seed: 1,
    };
    Site::open(&place, Path::new(""), None).unwrap()
}

/// A scenario without other vehicles.
fn alone(site: &Site, seed: u64) -> Scenario {
    let options = PlaceOptions::Street {
        background: 0,
        agent_splats: 0,
        seed: 1,
    };
    let generator = Generator::new(&site.lanes, options, &site.asset_sizes).unwrap();
    let mut scenario = generator.scenario(Level::Easy, seed, 0).unwrap();
    scenario.agents.clear();
    scenario.lights.clear();
    scenario.duration_s = 40.0;
    scenario
}

fn driven(scenario: &Scenario, site: &Arc<Site>, planner: &mut dyn Planner) -> Episode {
    drive(scenario, site, None, planner, &mut ())
        .unwrap()
        .episode
}

#[test]
fn who_drives_beside_its_route_hits_what_stands_there() {
    let site = Arc::new(site());
    let mut kinds = Vec::new();
    for seed in 0..8 {
        let scenario = alone(&site, seed);
        let on_route = driven(&scenario, &site, &mut Beside { right_m: 0.0 });
        assert!(
            !matches!(on_route.end, EpisodeEnd::Obstacle { .. }),
            "seed {seed}: {:?}",
            on_route.end
        );
        let episode = driven(&scenario, &site, &mut Beside { right_m: 5.6 });
        let EpisodeEnd::Obstacle { obstacle } = episode.end else {
            panic!("seed {seed}: {:?}", episode.end);
        };
        kinds.push(obstacle.kind);
        let score = EpisodeScore::new(&episode);
        assert_eq!((score.obstacle_collisions(), score.success), (1, false));
        let off_road = score.layout_infractions() as i32;
        let expected = score.route_completion * OBSTACLE_FACTOR * 0.65_f64.powi(off_road);
        assert!((score.driving_score - expected).abs() < 1e-12);
        let again = replay(&episode, &site, None, &mut ()).unwrap();
        assert_eq!(again.moved_differently, None);
    }
    assert!(kinds.contains(&ObstacleKind::ParkedCar), "{kinds:?}");
}

#[test]
fn who_leaves_the_road_for_good_or_its_route_ends_the_episode() {
    let mut site = site();
    site.obstacles = Arc::new(Obstacles::default());
    let site = Arc::new(site);
    let scenario = alone(&site, 1);
    let episode = driven(&scenario, &site, &mut Beside { right_m: 14.0 });
    assert_eq!(episode.end, EpisodeEnd::OffRoad);
    let last = episode.instants().last().unwrap();
    assert!(last.time_s < 20.0, "{} s", last.time_s);
    // Straight on where the route turns.
    let ends: Vec<EpisodeEnd> = (0..20)
        .map(|seed| driven(&alone(&site, seed), &site, &mut ConstantVelocity).end)
        .collect();
    assert!(ends.contains(&EpisodeEnd::OffRoute), "{ends:?}");
}

#[test]
fn who_drives_in_the_oncoming_lane_is_charged_and_who_keeps_its_route_is_not() {
    let mut site = site();
    site.obstacles = Arc::new(Obstacles::default());
    let site = Arc::new(site);
    let mut charged = 0;
    for seed in 0..8 {
        let scenario = alone(&site, seed);
        let on_route = driven(&scenario, &site, &mut Beside { right_m: 0.0 });
        assert_eq!(EpisodeScore::new(&on_route).wrong_ways(), 0, "seed {seed}");
        let episode = driven(&scenario, &site, &mut Beside { right_m: -7.0 });
        let score = EpisodeScore::new(&episode);
        charged += u32::from(score.wrong_ways() > 0);
        assert!(score.wrong_ways() == 0 || score.driving_score <= 0.5);
        let again = replay(&episode, &site, None, &mut ()).unwrap();
        assert_eq!(again.moved_differently, None);
    }
    assert!(charged >= 4, "{charged} of 8");
}

#[test]
fn the_road_ends_thirty_centimeters_beyond_its_edge() {
    let mut site = site();
    site.obstacles = Arc::new(Obstacles::default());
    let site = Arc::new(site);
    let scenario = alone(&site, 1);
    let (mut within, mut beyond) = (0, 0);
    for step in 0..40 {
        let mut planner = Beside {
            right_m: 0.2 * f64::from(step),
        };
        let episode = driven(&scenario, &site, &mut planner);
        for instant in episode.instants() {
            let outline = OrientedBox::for_vehicle(&instant.ego, &scenario.ego.size);
            let held = |slack_m: f64| site.surface.holds_box(&outline, slack_m);
            within += u32::from(instant.on_road && !held(0.2));
            beyond += u32::from(!instant.on_road);
            assert!(
                !held(0.29) || instant.on_road,
                "{} s, {} m to the right",
                instant.time_s,
                planner.right_m
            );
            assert!(held(0.31) || !instant.on_road, "{} s", instant.time_s);
        }
    }
    assert!(within > 0 && beyond > 0, "{within} within, {beyond} beyond");
}

#[test]
fn logs_of_other_traffic_are_not_driven_again() {
    let site = Arc::new(site());
    let mut episode = driven(&alone(&site, 1), &site, &mut Beside { right_m: 0.0 });
    episode.head.log_version = REPLAY_VERSION - 1;
    let error = replay(&episode, &site, None, &mut ()).err().unwrap();
    assert!(error.to_string().contains("score it"), "{error}");
}

#[test]
fn logs_of_version_3_are_driven_again_and_score_as_before() {
    let site = Arc::new(site());
    let episode = driven(&alone(&site, 1), &site, &mut Beside { right_m: 0.0 });
    assert!(episode.instants().all(|instant| instant.road.is_some()));
    let mut old = episode.clone().in_version(REPLAY_VERSION);
    // A file tells of a place that can be seen.
    old.head.scenario.place = Place::Street {
        weather: Weather::Clear,
        background: 1000,
        agent_splats: 1000,
        seed: 1,
    };
    assert_eq!(decode(&encode(&old).unwrap()).unwrap(), old);
    let again = replay(&old, &site, None, &mut ()).unwrap();
    assert_eq!(again.moved_differently, None);
    assert_eq!(
        (&again.episode.steps, &again.episode.end),
        (&old.steps, &old.end)
    );
    assert_eq!(EpisodeScore::new(&old), EpisodeScore::new(&episode));
    // One that moved differently is told.
    let mut other = old;
    other.steps[1].instants[0].ego.speed_mps += 0.1;
    let again = replay(&other, &site, None, &mut ()).unwrap();
    assert!(again.moved_differently.is_some());
}

#[test]
fn who_keeps_its_route_breaks_no_rule_and_who_drives_over_the_edge_is_told() {
    let site = Arc::new(site());
    for seed in 0..4 {
        let scenario = alone(&site, seed);
        let kept = driven(&scenario, &site, &mut Beside { right_m: 0.0 });
        let conduct = Conduct::new(&kept, &EpisodeScore::new(&kept));
        assert_eq!(conduct.breaches, [], "seed {seed}");
        let keeping = conduct.lane_keeping.unwrap();
        assert!(keeping.over_edge_s < 1.0, "seed {seed}: {keeping:?}");
        assert!(conduct.reference.share > 0.4, "seed {seed}: {conduct:?}");
        let beside = driven(&scenario, &site, &mut Beside { right_m: -1.4 });
        let conduct = Conduct::new(&beside, &EpisodeScore::new(&beside));
        let keeping = conduct.lane_keeping.unwrap();
        assert!(keeping.over_edge_s > 2.0, "seed {seed}: {keeping:?}");
    }
}
