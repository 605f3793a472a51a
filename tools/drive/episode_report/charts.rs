//! Plots of an episode over time. Infractions are marked in all of them.

use decouplegs::drive::score::{
    TTC_HORIZON_S, lateral_accelerations, plan_errors, times_to_collision,
};
use decouplegs::scene::VehicleState;
use decouplegs::scene::episode::Episode;

use super::Scored;
use crate::page::Figure;
use crate::plot::{Axis, Plot, Series};

/// Distances are cut here, meters: beyond, nothing happens.
const APART_MAX_M: f64 = 30.0;
const INFRACTION: usize = 3;

/// Points over time under a name.
type Named = (&'static str, usize, Vec<(f64, f64)>);

/// All plots of an episode with a score.
pub fn figures<'a>(scored: &'a Scored, episode: &'a Episode) -> impl Iterator<Item = Figure> {
    [
        ("speed", "m/s, m", speeds(episode)),
        ("acceleration", "m/s²", accelerations(episode)),
        ("time to collision", "seconds", collision_times(episode)),
        ("steering, to the left", "degrees", steering(episode)),
        ("plan error", "meters", errors(episode)),
    ]
    .into_iter()
    .chain(seen(scored))
    .map(|(what, unit, series)| Figure::flexible_svg(&over_time(scored, what, unit, series)))
}

fn over_time(scored: &Scored, what: &str, unit: &str, named: Vec<Named>) -> String {
    let values = || {
        named
            .iter()
            .flat_map(|(.., points)| points)
            .map(|point| point.1)
    };
    let (low, high) = (values().fold(0.0, f64::min), values().fold(1.0, f64::max));
    let marks = scored
        .score
        .infractions
        .iter()
        .map(|mark| Series::guide(INFRACTION, vec![(mark.time_s, low), (mark.time_s, high)]));
    let curves = named
        .iter()
        .map(|(name, color, points)| Series::curve(*name, *color, points.clone()));
    let plot = Plot {
        title: &format!("{}: {what}", scored.name()),
        x: Axis::linear("seconds"),
        y: Axis {
            from_zero: low == 0.0,
            ..Axis::linear(unit)
        },
        series: curves.chain(marks).collect(),
    };
    plot.to_svg()
}

/// Speeds of the ego and of the vehicle nearest to it, and the distance between their middles.
fn speeds(episode: &Episode) -> Vec<Named> {
    let (mut ego, mut nearest, mut apart) = (Vec::new(), Vec::new(), Vec::new());
    for instant in episode.instants() {
        ego.push((instant.time_s, instant.ego.speed_mps));
        let distance_m = |other: &VehicleState| other.position_m.distance(instant.ego.position_m);
        let other = instant
            .agents
            .iter()
            .flatten()
            .min_by(|a, b| distance_m(a).total_cmp(&distance_m(b)));
        nearest.extend(other.map(|other| (instant.time_s, other.speed_mps)));
        apart.extend(other.map(|other| (instant.time_s, distance_m(other).min(APART_MAX_M))));
    }
    vec![
        ("ego, m/s", 0, ego),
        ("nearest vehicle, m/s", 7, nearest),
        ("distance to it, m", 2, apart),
    ]
}

fn accelerations(episode: &Episode) -> Vec<Named> {
    let along = episode.instants();
    let along = along.map(|instant| (instant.time_s, instant.ego.acceleration_mps2));
    vec![
        ("along", 0, along.collect()),
        ("to the left", 2, lateral_accelerations(episode)),
    ]
}

/// Times beyond the horizon are cut: a gap in the curve would be joined.
fn collision_times(episode: &Episode) -> Vec<Named> {
    let least = times_to_collision(episode).into_iter();
    let points = least.map(|(time_s, closest)| {
        (
            time_s,
            closest.map_or(TTC_HORIZON_S, |closest| closest.ttc_s),
        )
    });
    vec![("to an agent", 0, points.collect())]
}

fn steering(episode: &Episode) -> Vec<Named> {
    let points = episode.instants();
    let points = points.map(|instant| (instant.time_s, instant.steer_rad.to_degrees()));
    vec![("front wheels", 0, points.collect())]
}

/// Opacity and support of a captured place; nothing for one that is not captured.
fn seen(scored: &Scored) -> Option<(&'static str, &'static str, Vec<Named>)> {
    let steps = &scored.seen.steps;
    let opacity = steps.iter().filter_map(|step| {
        let (opacity, _) = step.opacity.as_ref()?;
        Some((step.time_s, f64::from(*opacity)))
    });
    let support = steps
        .iter()
        .map(|step| (step.time_s, f64::from(u8::from(step.is_supported))));
    let series = vec![
        ("opacity of the lower half", 0, opacity.collect()),
        ("seen from here", 2, support.collect()),
    ];
    (!steps.is_empty()).then_some(("what was seen", "0 to 1", series))
}

fn errors(episode: &Episode) -> Vec<Named> {
    vec![("planned and driven", 0, plan_errors(episode))]
}
