//! A street in one weather, with its cars ready to be put back into it.

use anyhow::{Context, Result};
use decouplegs::asset::{LoadedAgent, LoadedLight, LoadedScene};
use decouplegs::scene::light::{AmbientOptions, RelightOptions, ShadowOptions};
use decouplegs::scene::{
    AgentPlacement, Camera, Intrinsics, LightTransfer, Pose, Presence, ShFrame, SplatCloud,
    SplatScene, TimedPose, Trajectory,
};
use decouplegs::synth::street::{Street, StreetOptions, Weather};

use glam::DVec3;

use super::cars::Cars;
use crate::arguments::Size;

/// Moments that are examined in each part of the drive.
const STEPS: u32 = 20;
/// A car whose middle is nearer is hardly in the image, meters.
const NEAR_M: f64 = 3.0;

/// Street into which the cars are reinserted.
pub struct ReinsertionStreet {
    pub options: StreetOptions,
    pub street: Street,
    /// The background as it was captured empty, compressed cars that drive as they truly do, and
    /// the light.
    pub loaded: LoadedScene,
    /// Permutation from the street's order of background splats to the order used here.
    order: Vec<u32>,
}

/// A street with its true cars at one moment, uncompressed.
pub struct Truth {
    pub splat_scene: SplatScene,
    /// The cars as the street lights them, in the order of the originals.
    pub cars: Vec<SplatCloud>,
}

impl ReinsertionStreet {
    /// The street of `options` with `cars` in its light, which `light` brings to colors with
    /// `relighting`, seen by the first `cameras_used` cameras.
    pub fn set(
        options: &StreetOptions,
        cars: &Cars,
        (light, relighting): (&LightTransfer, RelightOptions),
        size: Size,
        cameras_used: usize,
    ) -> Result<Self> {
        let mut street = Street::generate(options);
        let background = std::mem::take(&mut street.background);
        let order = background.spatial_order();
        let mut rig = street.rig.clone();
        rig.sensors.truncate(cameras_used);
        for camera in rig.cameras_mut() {
            camera.intrinsics = camera.intrinsics.resized(size.width_px, size.height_px);
        }
        let agents = street
            .agents
            .iter()
            .zip(&street.agent_trajectories)
            .enumerate()
            .map(|(at, (agent, way))| {
                Ok(LoadedAgent {
                    name: agent.name.clone(),
                    asset: agent.asset,
                    instance: u16::try_from(at + 1).context("there are more than 65535 agents")?,
                    sh_frame: ShFrame::Canonical,
                    trajectory: trajectory(way.iter().copied())?,
                    present: Presence::ALWAYS,
                })
            });
        let splat_scene = SplatScene {
            sky: street.sky,
            ..SplatScene::from_splats(background.select(&order))
        };
        let loaded = LoadedScene {
            assets: cars.coded.clone(),
            agents: agents.collect::<Result<_>>()?,
            rig,
            ego: trajectory(street.ego.iter().copied())?,
            light: Some(LoadedLight {
                transfer: Some(light.clone()),
                relighting,
                ambient: AmbientOptions::default(),
                shadows: Some(ShadowOptions::default()),
                casting: street.casting.clone(),
            }),
            ..LoadedScene::of_world(splat_scene)
        };
        Ok(Self {
            options: *options,
            street,
            loaded,
            order,
        })
    }

    pub fn weather(&self) -> Weather {
        self.options.weather
    }

    /// Moments with most cars in sight, one for each of `count` equal parts of the drive, seconds.
    pub fn moments_s(&self, count: u32) -> Vec<f64> {
        let (start_s, end_s) = (self.loaded.ego.start_s(), self.loaded.ego.end_s());
        let part_s = (end_s - start_s) / f64::from(count);
        let best = |part: u32| {
            let step = |step: u32| {
                start_s + (f64::from(part) + (f64::from(step) + 0.5) / f64::from(STEPS)) * part_s
            };
            (0..STEPS)
                .map(step)
                .max_by(|a, b| self.in_sight(*a).total_cmp(&self.in_sight(*b)))
                .unwrap_or(start_s)
        };
        (0..count).map(best).collect()
    }

    /// Visibility of cars at `time_s` without occlusion: the sum of their solid angles up to a
    /// factor.
    fn in_sight(&self, time_s: f64) -> f64 {
        let cameras = self.cameras(time_s);
        let positions = self
            .loaded
            .agents
            .iter()
            .map(|agent| agent.trajectory.at(time_s).translation);
        let seen = |position: DVec3| {
            let of = |camera: &Camera| {
                let at = camera.world_from_camera.inverse().transform(position);
                let Intrinsics {
                    width_px,
                    height_px,
                    ..
                } = camera.intrinsics;
                let inside = camera.intrinsics.project(at).is_some_and(|pixel| {
                    (0.0..f64::from(width_px)).contains(&pixel.x)
                        && (0.0..f64::from(height_px)).contains(&pixel.y)
                });
                if at.z > NEAR_M && inside {
                    at.length_squared().recip()
                } else {
                    0.0
                }
            };
            cameras.iter().map(of).sum::<f64>()
        };
        positions.map(seen).sum()
    }

    pub fn cameras(&self, time_s: f64) -> Vec<Camera> {
        self.loaded.rig.at(&self.loaded.ego.at(time_s))
    }

    /// Ground truth at `time_s`.
    pub fn truth(&self, cars: &Cars, time_s: f64) -> Truth {
        let agents = &self.loaded.agents;
        let placements: Vec<AgentPlacement> = (self.street.agents.iter().zip(agents))
            .map(|(placed, agent)| AgentPlacement {
                world_from_agent: agent.trajectory.at(time_s),
                ..placed.clone()
            })
            .collect();
        let lit = Street::lit(&self.options, &placements);
        let clouds: Vec<SplatCloud> = lit
            .cars
            .iter()
            .zip(&placements)
            .map(|(cloud, placed)| cloud.select(&cars.orders[placed.asset]))
            .collect();
        let mut splat_scene = SplatScene {
            splats: lit.background.select(&self.order),
            ..self.loaded.splat_scene.clone()
        };
        for ((cloud, placed), agent) in clouds.iter().zip(&placements).zip(agents) {
            splat_scene.bake_instance(
                cloud,
                &placed.world_from_agent,
                ShFrame::Canonical,
                agent.instance,
            );
        }
        Truth {
            splat_scene,
            cars: clouds,
        }
    }

    /// Scene in which agents drive as `ways` say.
    pub fn driven(&self, ways: &[Trajectory]) -> LoadedScene {
        let mut loaded = self.loaded.clone();
        loaded
            .agents
            .iter_mut()
            .zip(ways)
            .for_each(|(agent, way)| agent.trajectory = way.clone());
        loaded
    }
}

/// The way through `knots` (seconds, world from box).
pub fn trajectory(knots: impl Iterator<Item = (f64, Pose)>) -> Result<Trajectory> {
    let poses = knots
        .map(|(time_s, pose)| TimedPose { time_s, pose })
        .collect();
    Trajectory::new(poses).map_err(anyhow::Error::msg)
}
