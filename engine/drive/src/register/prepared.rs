//! A track made ready for its lanes to be chosen.

use decouplegs_scene::Track;
use glam::DVec2;

use super::RegisterOptions;
use super::route::Waypoint;
use super::smooth::{Smoothed, smooth};
use crate::planar::PlanarTransform;

/// Distance between waypoints, meters: closer ones tell nothing more of a lane.
const WAYPOINT_M: f64 = 1.0;

/// A track, smoothed, and the points of it that lanes are chosen by.
pub struct Prepared<'a> {
    pub track: &'a Track,
    pub smoothed: Smoothed,
    pub waypoints: Vec<Waypoint>,
    /// Meters between its waypoints, added up.
    pub traveled_m: f64,
}

impl<'a> Prepared<'a> {
    pub fn new(options: &RegisterOptions) -> impl Fn(&'a Track) -> Result<Self, String> {
        let options = *options;
        move |track| {
            track.check()?;
            let smoothed = smooth(track, options.noise_m);
            let half_height = 0.5 * track.dims_m.unwrap_or(options.dims_m)[2];
            let mut waypoints: Vec<Waypoint> = Vec::new();
            for (index, &position) in smoothed.positions.iter().enumerate() {
                let far = waypoints
                    .last()
                    .is_none_or(|last| last.position.distance(position) >= WAYPOINT_M);
                if far && !smoothed.outliers[index] {
                    let ground_z_m = track.points[index].z_m.map(|z_m| z_m - half_height);
                    waypoints.push(Waypoint {
                        index,
                        position,
                        heading_rad: 0.0,
                        ground_z_m,
                    });
                }
            }
            let positions: Vec<DVec2> =
                waypoints.iter().map(|waypoint| waypoint.position).collect();
            let last = positions.len().saturating_sub(1);
            for (at, waypoint) in waypoints.iter_mut().enumerate() {
                // Over four steps where there are so many: two neighbors a meter apart point
                // anywhere.
                let way = positions[(at + 2).min(last)] - positions[at.saturating_sub(2)];
                waypoint.heading_rad = way.to_angle();
            }
            let traveled_m = positions
                .windows(2)
                .map(|pair| pair[0].distance(pair[1]))
                .sum();
            Ok(Self {
                track,
                smoothed,
                waypoints,
                traveled_m,
            })
        }
    }

    /// Waypoints after `motion`.
    pub fn moved(&self, motion: &PlanarTransform) -> Vec<Waypoint> {
        let moved = |waypoint: &Waypoint| Waypoint {
            position: motion.apply(waypoint.position),
            heading_rad: waypoint.heading_rad + motion.yaw_rad,
            ..*waypoint
        };
        self.waypoints.iter().map(moved).collect()
    }

    /// The middle of its waypoints.
    pub fn middle(&self) -> DVec2 {
        let first = self
            .waypoints
            .first()
            .map_or(DVec2::ZERO, |waypoint| waypoint.position);
        let sum: DVec2 = self
            .waypoints
            .iter()
            .map(|waypoint| waypoint.position - first)
            .sum();
        first + sum / self.waypoints.len().max(1) as f64
    }

    /// Time of each waypoint, seconds.
    pub fn times_s(&self) -> Vec<f64> {
        self.waypoints
            .iter()
            .map(|waypoint| self.track.points[waypoint.index].time_s)
            .collect()
    }
}
