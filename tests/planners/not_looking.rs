//! Planners that look at no images, whose images are drawn while the next step is driven.

use std::path::Path;
use std::sync::Arc;

use decouplegs::drive::generate::{Generator, PlaceOptions};
use decouplegs::episode::{
    Appearance, EpisodeError, EpisodeObserver, ObservationRenderer, Site, chosen, drive,
};
use decouplegs::planner::{
    Cameras, EpisodeInfo, LaneFollow, Observation, ObservationRequest, Planner, PlannerError,
    Reading, images,
};
use decouplegs::render::{ColorFormat, Outputs};
use decouplegs::scene::scenario::Place;
use decouplegs::scene::{EpisodeStep, Level, Plan, Scenario, Weather};

use crate::frames::worlds::{assert_silent, session};

/// A planner that does what another does, and fails at a step. It is given its readings or not.
struct Watching<P> {
    inner: P,
    looks: bool,
    fails_at: Option<u32>,
    seen: usize,
}

impl<P: Planner> Planner for Watching<P> {
    fn name(&self) -> String {
        "watching".into()
    }

    fn sees(&self) -> ObservationRequest {
        self.inner.sees()
    }

    fn looks(&self) -> bool {
        self.looks
    }

    fn begin(&mut self, info: &EpisodeInfo) -> Result<(), PlannerError> {
        self.inner.begin(info)
    }

    fn plan(&mut self, observation: &Observation) -> Result<Plan, PlannerError> {
        self.seen += observation.readings.len();
        if self.fails_at == Some(observation.step) {
            return Err(PlannerError("it fails here".into()));
        }
        self.inner.plan(observation)
    }
}

/// Steps in the order in which they were observed, with the bytes of their readings.
#[derive(Default)]
struct Noted(Vec<(EpisodeStep, Vec<Vec<u8>>)>);

impl EpisodeObserver for Noted {
    fn step(&mut self, step: &EpisodeStep, readings: &[Reading]) -> Result<(), EpisodeError> {
        let images = images(readings).map(|frame| frame.rgba.to_vec());
        self.0.push((step.clone(), images.collect()));
        Ok(())
    }
}

#[test]
fn who_does_not_look_gets_the_episode_of_who_does_with_the_same_images() {
    let place = Place::Street {
        weather: Weather::Clear,
        background: 2_000,
        agent_splats: 100,
        seed: 1,
    };
    let appearance = Appearance::default();
    let site = Arc::new(Site::open(&place, Path::new(""), Some(&appearance)).unwrap());
    let session = session(Outputs {
        color: ColorFormat::U8,
        ..Outputs::default()
    });
    let scene = site.add_to(&session).unwrap();
    let cameras = Cameras::Named(vec!["front".into(), "back".into()]);
    let rig = chosen(&site.loaded.rig, &cameras, Some([64, 36])).unwrap();
    let options = PlaceOptions::Street {
        background: 0,
        agent_splats: 0,
        seed: 1,
    };
    let generator = Generator::new(&site.lanes, options, &site.asset_sizes).unwrap();
    let scenario = generator.scenario(Level::Easy, 3, 0).unwrap();
    let short = Scenario {
        step_s: 0.1,
        duration_s: 1.0,
        ..scenario
    };
    for (every, fails_at) in [(1, None), (3, None), (1, Some(4)), (1, Some(0))] {
        let driven = |looks: bool| {
            let batch = session.batch_renderer();
            let mut renderer = ObservationRenderer::new(batch, &scene, rig.clone(), every);
            let mut planner = Watching {
                inner: LaneFollow::default(),
                looks,
                fails_at,
                seen: 0,
            };
            let mut noted = Noted::default();
            // Twice with one renderer: nothing of an episode is left over in it.
            let mut last = None;
            for _ in 0..2 {
                noted = Noted::default();
                let renderer = Some(&mut renderer);
                let driven = drive(&short, &site, renderer, &mut planner, &mut noted).unwrap();
                assert_eq!(
                    driven.times.len(),
                    noted.0.len() + usize::from(fails_at.is_some())
                );
                last = Some(driven.episode);
            }
            (last.unwrap(), noted.0, planner.seen)
        };
        let ((episode, steps, seen), (looked, looked_steps, looked_seen)) =
            (driven(false), driven(true));
        assert_eq!(episode, looked);
        assert!(steps == looked_steps, "other images, or in another order");
        assert_eq!(seen, 0, "nobody looked");
        let drawn = steps
            .iter()
            .filter(|(_, images)| !images.is_empty())
            .count();
        let failed = usize::from(fails_at.is_some());
        assert_eq!(looked_seen, 2 * 2 * (drawn + failed));
        assert_eq!(drawn, steps.len().div_ceil(every as usize));
        let hashed = steps.iter().map(|(step, _)| step.readings.len());
        assert_eq!(hashed.sum::<usize>(), 2 * drawn);
    }
    assert_silent(&session);
}
