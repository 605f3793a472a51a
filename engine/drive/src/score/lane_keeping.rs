//! Keeping of the lane.

use decouplegs_scene::Episode;
use decouplegs_scene::episode::EpisodeTick;

/// Way beyond an edge up to which the ego is within its lane, meters: markings are as wide.
const EDGE_M: f64 = 0.15;
/// Change of the offset between two moments from which the ego is on another lane, meters.
const JUMP_M: f64 = 1.5;
/// Time that a change of lanes may take, seconds.
const CHANGE_S: f64 = 8.0;

/// Time and way that the ego drove over an edge of its lane without changing lanes. A change takes
/// up to 8 s over the edge; what is longer counts. Junctions, and places without a lane, do not
/// count.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LaneKeeping {
    /// Time over an edge, seconds.
    pub over_edge_s: f64,
    /// Way driven over an edge, meters.
    pub over_edge_m: f64,
    /// Number of times.
    pub excursions: usize,
    /// Time on lanes outside of junctions, seconds.
    pub on_lanes_s: f64,
}

impl LaneKeeping {
    /// Figures of `episode`; `None` where its log does not tell of the edges of lanes.
    #[must_use]
    pub(super) fn new(episode: &Episode) -> Option<Self> {
        let instants: Vec<&EpisodeTick> = episode.instants().collect();
        let half_m = 0.5 * episode.head.scenario.ego.size.width_m;
        let mut found = Self::default();
        let mut over = Excursion::default();
        for pair in instants.windows(2) {
            let (before, now) = (pair[0].road?, pair[1].road?);
            let step_s = pair[1].time_s - pair[0].time_s;
            let Some(lane) = now.lane.filter(|_| !now.in_junction) else {
                over.end(&mut found);
                continue;
            };
            found.on_lanes_s += step_s;
            let beyond_m = lane.lateral_m.abs() + half_m - lane.half_width_m;
            let jumps = |from_m: f64| (lane.lateral_m - from_m).abs() > JUMP_M;
            if beyond_m > EDGE_M {
                over.time_s += step_s;
                over.way_m += pair[0].ego.position_m.distance(pair[1].ego.position_m);
                over.changes |= before.lane.is_some_and(|lane| jumps(lane.lateral_m));
            } else {
                over.end(&mut found);
            }
        }
        over.end(&mut found);
        instants.first()?.road.map(|_| found)
    }

    /// Share of the time on lanes in which the lane was kept, 0 to 1.
    #[must_use]
    pub fn kept_share(&self) -> f64 {
        match self.on_lanes_s > 0.0 {
            true => 1.0 - self.over_edge_s / self.on_lanes_s,
            false => 1.0,
        }
    }
}

/// Time over an edge that is not over yet.
#[derive(Default)]
struct Excursion {
    time_s: f64,
    way_m: f64,
    /// True if the ego came onto another lane in it.
    changes: bool,
}

impl Excursion {
    /// Adds it to `found`, and begins anew.
    fn end(&mut self, found: &mut LaneKeeping) {
        let over = std::mem::take(self);
        let free_s = if over.changes { CHANGE_S } else { 0.0 };
        if over.time_s > free_s {
            let share = (over.time_s - free_s) / over.time_s;
            found.over_edge_s += share * over.time_s;
            found.over_edge_m += share * over.way_m;
            found.excursions += 1;
        }
    }
}
