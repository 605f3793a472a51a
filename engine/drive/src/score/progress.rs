//! Progress of an ego along its route.

use decouplegs_scene::{Episode, EpisodeEnd};
use glam::DVec2;

use crate::polyline::Polyline;

/// Largest distance from the route at which progress along it counts, meters: about two lanes.
const OFF_ROUTE_M: f64 = 8.0;
/// Factor on the driven distance up to which progress is searched ahead: corners may be cut.
const SEARCH_FACTOR: f64 = 2.0;
/// Further distance that is searched, meters. A route that comes near itself does not make the ego
/// jump along it.
const SEARCH_M: f64 = 10.0;

/// Progress of a vehicle along a route, moment by moment.
#[derive(Clone, Debug)]
pub struct RouteProgress {
    route: Polyline,
    progress_m: f64,
    /// Driven since it last got on.
    driven_m: f64,
    last_m: DVec2,
}

impl RouteProgress {
    /// Starts at the start of the line through `route_m`, for a vehicle that stands at `start_m`;
    /// `None` where it is no line.
    #[must_use]
    pub fn new(route_m: &[DVec2], start_m: DVec2) -> Option<Self> {
        let route = Polyline::new(route_m.iter().map(|point| point.extend(0.0)))?;
        Some(Self {
            route,
            progress_m: 0.0,
            driven_m: 0.0,
            last_m: start_m,
        })
    }

    /// The vehicle is at `position_m` now.
    pub fn advance(&mut self, position_m: DVec2) {
        self.driven_m += position_m.distance(self.last_m);
        self.last_m = position_m;
        let ahead_m = self.progress_m + SEARCH_FACTOR * self.driven_m + SEARCH_M;
        let foot = self
            .route
            .project_within(position_m, self.progress_m, ahead_m);
        if foot.distance_m <= OFF_ROUTE_M && foot.arc_m >= self.progress_m {
            (self.progress_m, self.driven_m) = (foot.arc_m, 0.0);
        }
    }

    /// Meters along the route where it had come farthest.
    #[must_use]
    pub fn progress_m(&self) -> f64 {
        self.progress_m
    }

    /// True at the end of the route.
    #[must_use]
    pub fn is_done(&self) -> bool {
        self.progress_m >= self.route.length_m()
    }
}

/// Meters of the route behind the ego where it had come farthest, and all of them; `None` where the
/// route is no line.
pub(super) fn driven_m(episode: &Episode) -> Option<(f64, f64)> {
    let start_m = episode.start.ego.position_m;
    let mut progress = RouteProgress::new(&episode.head.route_m, start_m)?;
    episode
        .instants()
        .for_each(|instant| progress.advance(instant.ego.position_m));
    Some((progress.progress_m, progress.route.length_m()))
}

/// Share of the route behind the ego where it had come farthest: 1 exactly where the episode ended
/// with the route done.
pub(super) fn route_completion(episode: &Episode) -> f64 {
    if episode.end == EpisodeEnd::RouteDone {
        return 1.0;
    }
    // An ego at the very end that was not done is not done.
    driven_m(episode).map_or(0.0, |(driven_m, length_m)| {
        (driven_m / length_m).clamp(0.0, 1.0 - f64::EPSILON)
    })
}
