//! Reference drive along a route.

use decouplegs_scene::TrafficLight;

use super::ego_start::EgoStart;
use super::roads::Roads;
use crate::reference_drive::ReferenceDrive;
use crate::route::Route;

/// Duration of the drive from half of the cruise speed, without lights, seconds.
pub(super) fn free_s(route: &Route, cruise_mps: f64) -> f64 {
    ReferenceDrive::new(route.line(), speeds(cruise_mps), &[], &[]).duration_s()
}

/// Duration of the drive with traffic lights that the ego obeys, seconds.
pub(super) fn with_lights(roads: &Roads, start: &EgoStart, lights: &[TrafficLight]) -> f64 {
    let (line, speeds) = (start.route.line(), speeds(start.task.cruise_mps));
    ReferenceDrive::new(line, speeds, &lines(roads, start, lights), &[]).duration_s()
}

fn speeds(cruise_mps: f64) -> [f64; 2] {
    [cruise_mps, 0.5 * cruise_mps]
}

/// Stop lines of traffic lights on the ego's route, meters along it, in order.
fn lines<'a>(
    roads: &Roads,
    start: &EgoStart,
    lights: &'a [TrafficLight],
) -> Vec<(f64, &'a TrafficLight)> {
    let mut lines = Vec::new();
    let mut begin_m = -start.task.start_m;
    for (at, &lane) in start.lanes.iter().enumerate() {
        let id = &roads.map.lanes[lane].id;
        let onward = start.lanes.get(at + 1);
        let onward = onward.map(|&next| roads.map.lanes[next].id.as_str());
        for light in lights {
            let lines_here = light.stop_lines.iter();
            let on_lane = lines_here.filter(|line| line.lane == *id && line.binds(onward));
            lines.extend(on_lane.map(|line| (begin_m + line.at_m, light)));
        }
        begin_m += roads.length_m(lane);
    }
    let length_m = start.route.length_m();
    lines.retain(|(at_m, _)| (0.0..length_m).contains(at_m));
    lines.sort_by(|a, b| a.0.total_cmp(&b.0));
    lines
}
