//! The lanes of a route as one line: one after the other, and from one beside the other by a smooth
//! change.

use std::collections::HashMap;

use decouplegs_scene::LaneMap;
use decouplegs_scene::scenario::EgoTask;
use glam::DVec3;

use crate::polyline::Polyline;

/// Length of a change of lanes where there is room, meters: at 12 m/s two and a half seconds.
const CHANGE_M: f64 = 30.0;
/// Least length of a change of lanes, meters: no car could follow a shorter one.
const CHANGE_M_MIN: f64 = 8.0;
/// Distance between points of the line, meters.
const STRIDE_M: f64 = 1.0;
/// A line of more strides has longer ones: a map may claim any length.
const STRIDES_MAX: f64 = 200_000.0;
/// Number of smoothing passes. Each time rounds corners as a blur of 0.7 m does: joints of coarse
/// lanes become drivable, while a bend of 9 m radius moves by less than 0.08 m.
const SMOOTHINGS: usize = 2;

/// Result of [`join`].
pub(super) struct Joined {
    pub line: Polyline,
    /// Start of each lane along the line, meters, and its index in the map.
    pub lanes: Vec<(f64, usize)>,
    pub has_height: bool,
}

/// One lane of the route.
struct Entry {
    index: usize,
    line: Polyline,
    /// True if the lane lies beside the entry before it, and not behind it.
    beside: bool,
}

/// The line as it grows.
struct Way {
    stride_m: f64,
    points: Vec<DVec3>,
    /// Point at which each lane begins, and the lane's index in the map.
    marks: Vec<(usize, usize)>,
}

pub(super) fn join(map: &LaneMap, task: &EgoTask) -> Result<Joined, String> {
    let entries = entries(map, task)?;
    let id = |entry: &Entry| map.lanes[entry.index].id.clone();
    let (first, last) = (&entries[0], &entries[entries.len() - 1]);
    for (what, at_m, entry) in [("starts", task.start_m, first), ("ends", task.end_m, last)] {
        let length_m = entry.line.length_m();
        if !(0.0..=length_m + STRIDE_M).contains(&at_m) {
            return Err(format!(
                "the route {what} {at_m} m along lane {}; expected 0 to {length_m:.1} m",
                id(entry)
            ));
        }
    }
    let length_m: f64 = entries.iter().map(|entry| entry.line.length_m()).sum();
    let mut way = Way {
        stride_m: STRIDE_M.max(length_m / STRIDES_MAX),
        points: Vec::new(),
        marks: Vec::new(),
    };
    let mut begin = 0;
    while begin < entries.len() {
        let end = (begin + 1..entries.len())
            .find(|&at| !entries[at].beside)
            .unwrap_or(entries.len());
        let from_m = if begin == 0 { task.start_m } else { 0.0 };
        let to_m = if end == entries.len() {
            task.end_m
        } else {
            entries[end - 1].line.length_m()
        };
        way.along_section(map, &entries[begin..end], from_m, to_m)?;
        begin = end;
    }
    let has_height = entries
        .iter()
        .all(|entry| map.lanes[entry.index].has_height);
    let too_short = || {
        format!(
            "the route has no length: it starts and ends on lane {} at {} m",
            id(last),
            task.end_m
        )
    };
    way.finish(has_height).ok_or_else(too_short)
}

/// The lanes that `task` names, each held to be next to the one before it.
fn entries(map: &LaneMap, task: &EgoTask) -> Result<Vec<Entry>, String> {
    let mut indices: HashMap<&str, usize> = HashMap::with_capacity(map.lanes.len());
    for (index, lane) in map.lanes.iter().enumerate() {
        if indices.insert(&lane.id, index).is_some() {
            return Err(format!(
                "lane {} is in the map twice; expected each id once",
                lane.id
            ));
        }
    }
    let mut entries: Vec<Entry> = Vec::new();
    for id in &task.route {
        let Some(&index) = indices.get(id.as_str()) else {
            return Err(format!(
                "the route names lane {id}, which is not among the map's {} lanes",
                map.lanes.len()
            ));
        };
        let lane = &map.lanes[index];
        let Some(line) = Polyline::new(lane.centerline.iter().copied()) else {
            return Err(format!(
                "lane {id} has no centerline that could be driven: fewer than two points, or one not finite"
            ));
        };
        let mut beside = false;
        if let Some(before) = entries.last().map(|entry| entry.index) {
            let from = &map.lanes[before];
            beside = !from.successors.contains(&index);
            let named = |lane: &decouplegs_scene::Lane, other| {
                [lane.left_neighbor, lane.right_neighbor].contains(&Some(other))
            };
            if beside && !named(from, index) && !named(lane, before) {
                return Err(format!(
                    "lane {id} neither follows lane {} of the route nor lies beside it",
                    from.id
                ));
            }
        }
        entries.push(Entry {
            index,
            line,
            beside,
        });
    }
    if entries.is_empty() {
        return Err("the route names no lane; expected at least one".into());
    }
    Ok(entries)
}

impl Way {
    /// Lanes side by side, from `from_m` along the first to `to_m` along the last. All changes
    /// share the room that there is.
    fn along_section(
        &mut self,
        map: &LaneMap,
        section: &[Entry],
        from_m: f64,
        to_m: f64,
    ) -> Result<(), String> {
        let (mut arc_m, last) = (from_m, section.len() - 1);
        let end = section[last].line.at(to_m).truncate();
        self.marks.push((self.points.len(), section[0].index));
        for (at, pair) in section.windows(2).enumerate() {
            let (here, there) = (&pair[0].line, &pair[1].line);
            let beside_m = |arc_m: f64| there.project(here.at(arc_m).truncate()).arc_m;
            let there_end_m = if at + 1 == last {
                to_m
            } else {
                there.project(end).arc_m
            };
            let room_m = (here.project(end).arc_m - arc_m).min(there_end_m - beside_m(arc_m));
            let slot_m = room_m / (last - at) as f64;
            let change_m = slot_m.min(CHANGE_M);
            if change_m < CHANGE_M_MIN {
                let ids = pair
                    .iter()
                    .map(|entry| map.lanes[entry.index].id.as_str())
                    .collect::<Vec<_>>();
                return Err(format!(
                    "the route changes from lane {} to lane {} with {slot_m:.1} m of room; expected at least {CHANGE_M_MIN} m",
                    ids[0], ids[1]
                ));
            }
            let begin_m = arc_m + 0.5 * (slot_m - change_m);
            self.along(here, arc_m, begin_m);
            let steps = (change_m / self.stride_m).ceil() as usize;
            for step in 1..=steps {
                if step == steps.div_ceil(2) {
                    self.marks.push((self.points.len(), pair[1].index));
                }
                let share = step as f64 / steps as f64;
                let from = begin_m + share * change_m;
                self.points
                    .push(here.at(from).lerp(there.at(beside_m(from)), blend(share)));
            }
            arc_m = beside_m(begin_m + change_m);
        }
        self.along(&section[last].line, arc_m, to_m);
        Ok(())
    }

    /// Points on `line`, both ends with them; none where the ends are in the wrong order.
    fn along(&mut self, line: &Polyline, from_m: f64, to_m: f64) {
        let steps = ((to_m - from_m) / self.stride_m).ceil().max(0.0) as usize;
        for step in 0..=steps {
            let share = step as f64 / steps.max(1) as f64;
            self.points
                .push(line.at(from_m + share * (to_m - from_m).max(0.0)));
        }
    }

    /// The line through the points at even distances, its corners rounded.
    fn finish(self, has_height: bool) -> Option<Joined> {
        let mut arc_m = 0.0;
        let mut arcs_m = vec![0.0];
        arcs_m.extend(self.points.windows(2).map(|pair| {
            arc_m += pair[0].truncate().distance(pair[1].truncate());
            arc_m
        }));
        let raw = Polyline::new(self.points)?;
        let steps = (raw.length_m() / self.stride_m).ceil().max(1.0) as usize;
        let mut even: Vec<DVec3> = (0..=steps)
            .map(|step| raw.at(raw.length_m() * step as f64 / steps as f64))
            .collect();
        for _ in 0..SMOOTHINGS {
            let before = even.clone();
            for (point, around) in even[1..].iter_mut().zip(before.windows(3)) {
                *point = 0.5 * around[1] + 0.25 * (around[0] + around[2]);
            }
        }
        let line = Polyline::new(even)?;
        // Rounding corners shortens the line by little, and evenly enough for saying where a lane
        // begins.
        let shrink = line.length_m() / raw.length_m();
        let lanes = self
            .marks
            .iter()
            .map(|&(point, index)| (arcs_m[point.min(arcs_m.len() - 1)] * shrink, index))
            .collect();
        Some(Joined {
            line,
            lanes,
            has_height,
        })
    }
}

/// Smooth step from 0 to 1 with neither speed nor acceleration across at both ends (the quintic of
/// least jerk: Flash and Hogan, "The coordination of arm movements", 1985).
fn blend(share: f64) -> f64 {
    share.powi(3) * (10.0 + share * (6.0 * share - 15.0))
}
