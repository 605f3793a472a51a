//! Inputs of planners other than images: motion, navigation, localization, privileged state.

use decouplegs_scene::episode::EpisodeTick;

use super::Simulation;
use crate::planner::{
    EgoMotion, KnownAgent, Localization, LocatedEgo, Navigation, Privileged, Turn,
};

impl Simulation {
    /// Ego motion as the vehicle knows it.
    #[must_use]
    pub fn motion(&self) -> EgoMotion {
        let state = self.ego.state();
        EgoMotion {
            speed_mps: state.speed_mps,
            acceleration_mps2: state.acceleration_mps2,
            steer_rad: self.ego.steer_rad(),
            yaw_rate_radps: self.ego.yaw_rate_radps(),
        }
    }

    /// Navigation instructions.
    #[must_use]
    pub fn guidance(&self) -> Navigation {
        let (progress_m, cruise_mps) = (self.progress.progress_m(), self.scenario.ego.cruise_mps);
        match self.route.next_turn(progress_m) {
            Some(turn) => Navigation {
                turn: if turn.angle_rad > 0.0 {
                    Turn::Left
                } else {
                    Turn::Right
                },
                distance_m: turn.begin_m - progress_m,
                angle_rad: turn.angle_rad,
                length_m: turn.end_m - turn.begin_m,
                cruise_mps,
            },
            None => Navigation {
                distance_m: self.route.length_m() - progress_m,
                cruise_mps,
                ..Navigation::default()
            },
        }
    }

    /// Pose of the ego after each sub-step of `driven`, the last of which is now, and the route
    /// ahead. On a map without heights, the route is as high as the ground below the ego.
    #[must_use]
    pub fn localization(&self, driven: &[EpisodeTick]) -> Localization {
        let (route, size) = (&self.route, &self.scenario.ego.size);
        let at_m = |tick: &EpisodeTick| {
            let foot = route.project(tick.ego.position_m, self.progress.progress_m());
            foot.arc_m
        };
        let route_z_m = |along_m: f64| route.has_height().then(|| route.pose_at(along_m).0.z);
        let located = |tick: &EpisodeTick| {
            let near_z_m = route_z_m(at_m(tick)).unwrap_or_else(|| self.near_z_m(0));
            LocatedEgo {
                time_s: tick.time_s,
                pose: self
                    .recorded_pose(tick.time_s)
                    .unwrap_or_else(|| self.site.pose_of(&tick.ego, size, near_z_m)),
                state: tick.ego,
                motion: EgoMotion {
                    speed_mps: tick.ego.speed_mps,
                    acceleration_mps2: tick.ego.acceleration_mps2,
                    steer_rad: tick.steer_rad,
                    yaw_rate_radps: self.ego.yaw_rate_at(tick.ego.speed_mps, tick.steer_rad),
                },
            }
        };
        let path: Vec<LocatedEgo> = driven.iter().map(located).collect();
        let below_m = |located: &LocatedEgo| located.pose.translation.z - 0.5 * size.height_m;
        let ground_z_m = path.last().map_or(0.0, below_m);
        let from_m = driven.last().map_or(0.0, at_m);
        let along_m = (0..Localization::WAYPOINTS)
            .map(|index| from_m + index as f64 * Localization::SPACING_M)
            .take_while(|&along_m| along_m <= route.length_m());
        let waypoint = |along_m: f64| {
            let place_m = route.pose_at(along_m).0.truncate();
            place_m.extend(route_z_m(along_m).unwrap_or(ground_z_m))
        };
        Localization {
            path,
            route_m: along_m.map(waypoint).collect(),
        }
    }

    /// Privileged state, which no camera shows.
    #[must_use]
    pub fn privileged(&self) -> Privileged {
        Privileged {
            ego: self.ego.state(),
            ego_size: self.scenario.ego.size,
            route_m: self.route_m(),
            agents: self
                .traffic
                .states()
                .iter()
                .zip(&self.agent_sizes)
                .enumerate()
                .filter_map(|(index, (state, &size))| {
                    Some(KnownAgent {
                        kind: self.scenario.agent(index).1,
                        state: (*state)?,
                        size,
                    })
                })
                .collect(),
            stop_lines: self
                .stop_lines()
                .map(|&line| (line, self.lights().color_at(line.index, self.time_s())))
                .collect(),
            signs: self
                .signs
                .lines()
                .iter()
                .map(|line| (line.record, self.signs.kind(line.record.index)))
                .collect(),
        }
    }
}
