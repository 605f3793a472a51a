//! Inputs of planners other than images: motion, navigation, localization, privileged state.

use decouplegs_scene::episode::{EpisodeTick, StopLineRecord};
use decouplegs_scene::{VehicleSize, VehicleState};

use super::EgoView;
use crate::planner::{
    EgoMotion, KnownAgent, Localization, LocatedEgo, Navigation, Privileged, Turn,
};

impl EgoView<'_> {
    /// Ego motion as the vehicle knows it.
    #[must_use]
    pub fn motion(&self) -> EgoMotion {
        let state = self.ego().state();
        EgoMotion {
            speed_mps: state.speed_mps,
            acceleration_mps2: state.acceleration_mps2,
            steer_rad: self.ego().steer_rad(),
            yaw_rate_radps: self.ego().yaw_rate_radps(),
        }
    }

    /// Navigation instructions.
    #[must_use]
    pub fn guidance(&self) -> Navigation {
        let (progress_m, cruise_mps) = (self.progress_m(), self.task().cruise_mps);
        match self.route().next_turn(progress_m) {
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
                distance_m: self.route().length_m() - progress_m,
                cruise_mps,
                ..Navigation::default()
            },
        }
    }

    /// Pose of the ego after each sub-step of `driven`, the last of which is now, and the route
    /// ahead. On a map without heights, the route is as high as the ground below the ego.
    #[must_use]
    pub fn localization(&self, driven: &[EpisodeTick]) -> Localization {
        let (route, size) = (self.route(), &self.task().size);
        let vehicle = self.simulation.vehicle_of(self.index);
        let at_m = |tick: &EpisodeTick| {
            let foot = route.project(tick.ego.position_m, self.progress_m());
            foot.arc_m
        };
        let route_z_m = |along_m: f64| route.has_height().then(|| route.pose_at(along_m).0.z);
        let located = |tick: &EpisodeTick| {
            let near_z_m =
                route_z_m(at_m(tick)).unwrap_or_else(|| self.simulation.near_z_m(vehicle));
            LocatedEgo {
                time_s: tick.time_s,
                pose: self
                    .recorded_pose(tick.time_s)
                    .unwrap_or_else(|| self.simulation.site.pose_of(&tick.ego, size, near_z_m)),
                state: tick.ego,
                motion: EgoMotion {
                    speed_mps: tick.ego.speed_mps,
                    acceleration_mps2: tick.ego.acceleration_mps2,
                    steer_rad: tick.steer_rad,
                    yaw_rate_radps: self.ego().yaw_rate_at(tick.ego.speed_mps, tick.steer_rad),
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
        let simulation = self.simulation;
        let agents = simulation.agents_for(self.index);
        let sizes = self.agent_sizes();
        let known = |(index, (state, &size)): (usize, (&Option<VehicleState>, &VehicleSize))| {
            Some(KnownAgent {
                kind: simulation.scenario.agent(index).1,
                state: (*state)?,
                size,
            })
        };
        let color = |line: &StopLineRecord| {
            let lights = simulation.lights();
            lights.color_at(line.index, simulation.time_s())
        };
        let signs = &simulation.signs;
        Privileged {
            ego: self.ego().state(),
            ego_size: self.task().size,
            route_m: self.route_m(),
            agents: agents
                .iter()
                .zip(&sizes)
                .enumerate()
                .filter_map(known)
                .collect(),
            stop_lines: self.stop_lines().map(|line| (*line, color(line))).collect(),
            signs: signs
                .lines()
                .iter()
                .map(|line| (line.record, signs.kind(line.record.index)))
                .collect(),
        }
    }
}
