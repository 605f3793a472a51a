//! The vehicle ahead over time: from one sighting to the next its distance and speed are filtered
//! (an alpha-beta filter; Kalata, "The tracking index", 1984).

use super::obstacle::Sighting;

/// Log odds above which something new is taken for a vehicle.
const NEW_SCORE: f64 = 1.0;
/// Log odds above which it is the vehicle that was seen before.
const KNOWN_SCORE: f64 = -1.0;
/// Largest distance of a sighting from where the known vehicle was expected, as a share of the
/// distance, and meters.
const GATE: (f64, f64) = (0.2, 2.0);
/// Sightings this far beyond the first above the threshold may still be the same vehicle's better
/// one, as a share of the distance.
const SAME_SHARE: f64 = 0.15;
/// Time without a sighting after which a vehicle is forgotten, seconds.
const FORGET_S: f64 = 1.6;
/// A vehicle nearer than this hides its own foot below the image and is remembered for longer,
/// meters along the way.
const UNDER_IMAGE_M: f64 = 6.0;
/// Time after which a vehicle nearer than that is forgotten, seconds.
const FORGET_NEAR_S: f64 = 4.0;
/// Largest speed of a vehicle, meters per second.
const SPEED_MPS_MAX: f64 = 30.0;
/// Assumed speed of a newly seen obstacle, as a share of the ego's speed.
const SPEED_SHARE: f64 = 0.6;

/// The vehicle ahead.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Lead {
    /// Position of its rear, meters along the path from beside the middle of the ego.
    pub arc_m: f64,
    pub speed_mps: f64,
    sightings: u32,
    unseen_s: f64,
}

impl Lead {
    /// Prediction after `dt_s` in which the ego drove `driven_m`.
    fn moved(self, driven_m: f64, dt_s: f64) -> Self {
        let arc_m = (self.arc_m + self.speed_mps * dt_s - driven_m).max(0.5);
        Self {
            arc_m,
            unseen_s: self.unseen_s + dt_s,
            ..self
        }
    }

    /// Update after a detection at `arc_m`.
    fn seen_at(self, arc_m: f64, dt_s: f64) -> Self {
        let (near, rate) = if self.sightings < 2 {
            (0.8, 0.6)
        } else {
            (0.55, 0.3)
        };
        let residual_m = arc_m - self.arc_m;
        let speed_mps =
            (self.speed_mps + rate * residual_m / dt_s.max(0.1)).clamp(0.0, SPEED_MPS_MAX);
        Self {
            arc_m: self.arc_m + near * residual_m,
            speed_mps,
            sightings: self.sightings + 1,
            unseen_s: 0.0,
        }
    }

    fn is_forgotten(&self) -> bool {
        self.unseen_s
            > if self.arc_m < UNDER_IMAGE_M {
                FORGET_NEAR_S
            } else {
                FORGET_S
            }
    }
}

/// Motion of the ego since the last image.
#[derive(Clone, Copy, Debug)]
pub(super) struct Elapsed {
    pub driven_m: f64,
    pub dt_s: f64,
    pub speed_mps: f64,
}

/// The vehicle ahead, from the one that was known and what the image shows now.
pub(super) fn track(
    known: Option<Lead>,
    elapsed: &Elapsed,
    sightings: &[Sighting],
) -> Option<Lead> {
    let known = known.map(|lead| lead.moved(elapsed.driven_m, elapsed.dt_s));
    let fresh = nearest(sightings, NEW_SCORE, |_| true);
    let Some(lead) = known else {
        return fresh.map(|sighting| new_lead(sighting, elapsed));
    };
    let gate_m = GATE.0 * lead.arc_m + GATE.1;
    let again = best(sightings, KNOWN_SCORE, |sighting| {
        (sighting.arc_m - lead.arc_m).abs() < gate_m
    });
    match (again, fresh) {
        // Another vehicle came between.
        (_, Some(fresh)) if fresh.arc_m < lead.arc_m - gate_m => Some(new_lead(fresh, elapsed)),
        (Some(again), _) => Some(lead.seen_at(again.arc_m, elapsed.dt_s)),
        (None, Some(fresh)) => Some(new_lead(fresh, elapsed)),
        (None, None) => (!lead.is_forgotten()).then_some(lead),
    }
}

fn new_lead(sighting: Sighting, elapsed: &Elapsed) -> Lead {
    Lead {
        arc_m: sighting.arc_m,
        speed_mps: SPEED_SHARE * elapsed.speed_mps,
        sightings: 1,
        unseen_s: 0.0,
    }
}

/// The nearest thing above a threshold: the best of the sightings that begin with the first one
/// there.
fn nearest(
    sightings: &[Sighting],
    score_min: f64,
    accept: impl Fn(&Sighting) -> bool,
) -> Option<Sighting> {
    let first = sightings
        .iter()
        .find(|sighting| sighting.score > score_min && accept(sighting))?;
    let until_m = first.arc_m * (1.0 + SAME_SHARE);
    best(sightings, score_min, |sighting| {
        (first.arc_m..until_m).contains(&sighting.arc_m) && accept(sighting)
    })
}

fn best(
    sightings: &[Sighting],
    score_min: f64,
    accept: impl Fn(&Sighting) -> bool,
) -> Option<Sighting> {
    let good = sightings
        .iter()
        .filter(|sighting| sighting.score > score_min && accept(sighting));
    good.copied().max_by(|a, b| a.score.total_cmp(&b.score))
}
