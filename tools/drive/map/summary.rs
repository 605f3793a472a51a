//! Statistics of a map and its tracks.

use std::collections::BTreeMap;
use std::fmt::Write;

use decouplegs::asset::maps::length_m;
use decouplegs::scene::{LaneKind, LaneMap, Track};
use glam::DVec3;
use serde_json::{Value, json};

/// The kinds of lanes, in the order of tables and legends.
pub const KINDS: [LaneKind; 5] = [
    LaneKind::Driving,
    LaneKind::Bicycle,
    LaneKind::Walking,
    LaneKind::Parking,
    LaneKind::Other,
];

/// Lanes of one kind.
#[derive(Clone, Copy, Default)]
pub struct KindSummary {
    pub lanes: usize,
    /// Meters of centerline.
    pub length_m: f64,
}

/// A map in numbers.
pub struct MapSummary {
    /// Figures of each kind, in the order of [`KINDS`].
    pub kinds: [KindSummary; 5],
    pub min: DVec3,
    pub max: DVec3,
    /// Lanes whose z is a height.
    with_height: usize,
    /// Lanes with both borders.
    with_borders: usize,
    successors: usize,
    /// Pairs of lanes side by side.
    neighbors: usize,
    /// Lanes that no lane continues in, and those that continue in none.
    first: usize,
    last: usize,
    /// Least and largest, meters per second, and lanes that have one.
    speed_limits_mps: Option<(f64, f64)>,
    with_speed_limit: usize,
}

impl MapSummary {
    /// The numbers of a map, which has lanes.
    pub fn new(map: &LaneMap) -> Self {
        let lanes = &map.lanes;
        let count = |holds: fn(&decouplegs::scene::Lane) -> bool| {
            lanes.iter().filter(|lane| holds(lane)).count()
        };
        let points = lanes
            .iter()
            .flat_map(|lane| lane.centerline.iter().chain(&lane.left).chain(&lane.right));
        let none = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let (min, max) = points.fold(none, |(min, max), point| (min.min(*point), max.max(*point)));
        let limits = || lanes.iter().filter_map(|lane| lane.speed_limit_mps);
        let kind = |kind: LaneKind| {
            let of_kind = lanes.iter().filter(|lane| lane.kind == kind);
            of_kind.fold(KindSummary::default(), |sum, lane| KindSummary {
                lanes: sum.lanes + 1,
                length_m: sum.length_m + length_m(&lane.centerline),
            })
        };
        Self {
            kinds: KINDS.map(kind),
            min,
            max,
            with_height: count(|lane| lane.has_height),
            with_borders: count(|lane| !lane.left.is_empty() && !lane.right.is_empty()),
            successors: lanes.iter().map(|lane| lane.successors.len()).sum(),
            neighbors: count(|lane| lane.right_neighbor.is_some()),
            first: count(|lane| lane.predecessors.is_empty()),
            last: count(|lane| lane.successors.is_empty()),
            speed_limits_mps: limits()
                .min_by(f64::total_cmp)
                .zip(limits().max_by(f64::total_cmp)),
            with_speed_limit: limits().count(),
        }
    }

    pub fn lanes(&self) -> usize {
        self.kinds.iter().map(|kind| kind.lanes).sum()
    }

    pub fn length_m(&self) -> f64 {
        self.kinds.iter().map(|kind| kind.length_m).sum()
    }

    pub fn to_text(&self) -> String {
        let mut text = format!("\n  {:<10}{:>8}{:>14}\n", "kind", "lanes", "centerline");
        let row = |name: &str, kind: KindSummary| {
            format!("  {name:<10}{:>8}{:>12.1} m\n", kind.lanes, kind.length_m)
        };
        for (kind, found) in KINDS
            .iter()
            .zip(self.kinds)
            .filter(|(_, found)| found.lanes > 0)
        {
            text += &row(kind.name(), found);
        }
        text += &row(
            "all",
            KindSummary {
                lanes: self.lanes(),
                length_m: self.length_m(),
            },
        );
        text.push('\n');
        let all = self.lanes();
        for (axis, name) in ["bounds x", "bounds y", "bounds z"].iter().enumerate() {
            let (min, max) = (self.min[axis], self.max[axis]);
            let known = if axis < 2 || self.with_height > 0 {
                ""
            } else {
                " (no lane has a height)"
            };
            let _ = writeln!(
                text,
                "  {name:<14}{min:.2} to {max:.2} m, {:.2} m{known}",
                max - min
            );
        }
        let _ = writeln!(
            text,
            "  {:<14}known to {} of {all} lanes",
            "heights", self.with_height
        );
        let _ = writeln!(
            text,
            "  {:<14}known to {} of {all} lanes",
            "borders", self.with_borders
        );
        let _ = writeln!(
            text,
            "  {:<14}{} from lane to lane, {} side by side; {} lanes start and {} end without one",
            "links", self.successors, self.neighbors, self.first, self.last
        );
        match self.speed_limits_mps {
            None => text += &format!("  {:<14}known to no lane\n", "speed limits"),
            Some((least, most)) => {
                let _ = writeln!(
                    text,
                    "  {:<14}known to {} of {all} lanes, {least:.2} to {most:.2} m/s",
                    "speed limits", self.with_speed_limit
                );
            }
        }
        text
    }

    pub fn to_json(&self) -> Value {
        let kinds = KINDS.iter().zip(self.kinds);
        let kinds = kinds.map(|(kind, found)| {
            (
                kind.name().to_owned(),
                json!({"lanes": found.lanes, "length_m": found.length_m}),
            )
        });
        json!({
            "lanes": self.lanes(),
            "length_m": self.length_m(),
            "kinds": kinds.collect::<serde_json::Map<_, _>>(),
            "bounds_m": {"min": self.min.to_array(), "max": self.max.to_array()},
            "with_height": self.with_height,
            "with_borders": self.with_borders,
            "successors": self.successors,
            "neighbors": self.neighbors,
            "without_predecessor": self.first,
            "without_successor": self.last,
            "with_speed_limit": self.with_speed_limit,
            "speed_limits_mps": self.speed_limits_mps.map(|(least, most)| [least, most]),
        })
    }
}

/// Tracks in numbers.
pub struct TrackSummary {
    /// Tracks of each class.
    classes: BTreeMap<String, usize>,
    points: usize,
    start_s: f64,
    end_s: f64,
    /// Points within the bounds of the map, from above.
    within: usize,
}

impl TrackSummary {
    pub fn new(tracks: &[Track], map: &MapSummary) -> Self {
        let mut classes = BTreeMap::new();
        tracks
            .iter()
            .for_each(|track| *classes.entry(track.class.clone()).or_insert(0) += 1);
        let points = || tracks.iter().flat_map(|track| &track.points);
        let times_s = points().map(|point| point.time_s);
        let (start_s, end_s) = times_s
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(start, end), time| {
                (start.min(time), end.max(time))
            });
        let (min, max) = (map.min.truncate(), map.max.truncate());
        let within = points()
            .filter(|point| point.position_m.clamp(min, max) == point.position_m)
            .count();
        Self {
            classes,
            points: points().count(),
            start_s,
            end_s,
            within,
        }
    }

    pub fn to_text(&self) -> String {
        let control_free = |text: &str| text.replace(char::is_control, "?");
        let classes: Vec<String> = self
            .classes
            .iter()
            .map(|(class, count)| format!("{count} {}", control_free(class)))
            .collect();
        let count: usize = self.classes.values().sum();
        format!(
            "\n  {:<14}{count} ({}), {:.2} to {:.2} s\n  {:<14}{}, {} of them within the bounds of the map\n",
            "tracks",
            classes.join(", "),
            self.start_s,
            self.end_s,
            "points",
            self.points,
            self.within
        )
    }

    pub fn to_json(&self) -> Value {
        json!({
            "tracks": self.classes.values().sum::<usize>(),
            "classes": self.classes,
            "points": self.points,
            "points_within_bounds": self.within,
            "start_s": self.start_s,
            "end_s": self.end_s,
        })
    }
}
