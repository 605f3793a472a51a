//! Planners that do not use images, whose images are drawn while the next step is driven.

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
    uses_readings: bool,
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

    fn uses_readings(&self) -> bool {
        self.uses_readings
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
fn planners_that_use_no_readings_drive_the_same_episode_with_the_same_images() {
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
    // The larger ones have pieces of more than one block.
    let rig = |size_px| chosen(&site.loaded.rig, &cameras, Some(size_px)).unwrap();
    let rigs = [[64, 36], [640, 420], [9, 6]].map(rig);
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
    let cases = [
        (0, 1, None),
        (0, 3, None),
        (0, 1, Some(4)),
        (0, 1, Some(0)),
        (1, 1, None),
        (2, 1, None),
    ];
    for (size, every, fails_at) in cases {
        let driven = |uses_readings: bool| {
            let batch = session.batch_renderer();
            let mut renderer = ObservationRenderer::new(batch, &scene, rigs[size].clone(), every);
            let mut planner = Watching {
                inner: LaneFollow::default(),
                uses_readings,
                fails_at,
                seen: 0,
            };
            let mut noted = Noted::default();
            // Again with one renderer: nothing of an episode is left over in it. Nothing
            // observes it the first time: images are only hashed if the planner does not use them
            // either.
            let unwatched = drive(&short, &site, Some(&mut renderer), &mut planner, &mut ());
            let unwatched = unwatched.unwrap().episode;
            let watched = drive(&short, &site, Some(&mut renderer), &mut planner, &mut noted);
            let watched = watched.unwrap();
            let failed = usize::from(fails_at.is_some());
            assert_eq!(watched.times.len(), noted.0.len() + failed);
            assert_eq!(watched.episode, unwatched);
            (watched.episode, noted.0, planner.seen)
        };
        let ((episode, steps, seen), (waited, waited_steps, waited_seen)) =
            (driven(false), driven(true));
        assert_eq!(episode, waited);
        assert!(steps == waited_steps, "other images, or in another order");
        assert_eq!(seen, 0, "no readings are given");
        let drawn = steps
            .iter()
            .filter(|(_, images)| !images.is_empty())
            .count();
        let failed = usize::from(fails_at.is_some());
        assert_eq!(waited_seen, 2 * 2 * (drawn + failed));
        assert_eq!(drawn, steps.len().div_ceil(every as usize));
        let hashed = steps.iter().map(|(step, _)| step.readings.len());
        assert_eq!(hashed.sum::<usize>(), 2 * drawn);
    }
    assert_silent(&session);
}
