//! Agents of a frame: which of them some camera may see, at which level of detail, and the rig as
//! each of them sees it.
//!
//! Nothing of an agent is turned: each camera is moved into the agent's frame instead, in f64,
//! which is one record an agent and camera where turning a codebook would be 512 entries. Shapes,
//! colors and depth keys come out the same.

pub(crate) mod relit;
pub(crate) mod staged_agents;

use bytemuck::Zeroable;
use decouplegs_scene::light::Shading;
use decouplegs_scene::{Camera, ColorTransfer, GroundShadow, Invalid, Motion, Pose, ShFrame};
use glam::{DMat3, DVec3, Vec3};

use crate::RenderError;
use crate::asset_pool::{Asset, AssetId, AssetPool, PoolBuffers};
use crate::layout::{
    AgentRecord, CameraRecord, RelightRecord, ShadingRecord, View, check_motion, exposed_within_s,
};
use crate::resident_splats::ResidentSplats;
use crate::stages::AgentCounts;
use crate::twins;

/// Something that stands in the world for one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Agent {
    /// Asset of the agent.
    pub asset: AssetId,
    /// Pose, f64 world coordinates, at the time 0 of the shutters.
    pub world_from_agent: Pose,
    /// Motion while images are exposed; rolling shutters show it.
    pub motion: Motion,
    /// Frame of the asset's colors; `None`: as the asset says.
    pub sh_frame: Option<ShFrame>,
    /// The id it has in instance images; 0 is the background's.
    pub instance: u16,
    /// Effect of the surrounding light on its colors, in the frame of these; `None`: none.
    pub relight: Option<ColorTransfer>,
    /// Light on its splats by their normals, after [`Agent::relight`]; `None`: none.
    pub shading: Option<Shading>,
    /// Cameras of the frame that may see it, a bit each, the first lowest: worlds that share a
    /// background are cameras that see different agents.
    pub cameras: u32,
}

impl Agent {
    /// An agent as its asset shows it, for all cameras.
    #[must_use]
    pub fn new(asset: AssetId, world_from_agent: Pose, instance: u16) -> Self {
        Self {
            asset,
            world_from_agent,
            motion: Motion::REST,
            sh_frame: None,
            instance,
            relight: None,
            shading: None,
            cameras: u32::MAX,
        }
    }

    /// Agent in the light that its asset was captured in.
    #[must_use]
    pub fn unlit(&self) -> Self {
        Self {
            relight: None,
            shading: None,
            ..*self
        }
    }
}

/// Agents of a frame, and shadows on the ground of its background.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FrameAgents {
    /// Agents, in the order in which equal depths are drawn.
    pub agents: Vec<Agent>,
    /// Shadows. They multiply, and need not be those of agents that are drawn.
    pub shadows: Vec<GroundShadow>,
    /// Cameras that see each shadow, a bit each, as in [`Agent::cameras`]; empty: all see all.
    pub shadow_cameras: Vec<u32>,
}

/// A frame without agents.
static NO_AGENTS: FrameAgents = FrameAgents {
    agents: Vec::new(),
    shadows: Vec::new(),
    shadow_cameras: Vec::new(),
};

impl FrameAgents {
    /// `agents` without shadows.
    #[must_use]
    pub fn new(agents: impl Into<Vec<Agent>>) -> Self {
        Self {
            agents: agents.into(),
            ..Self::default()
        }
    }

    /// Appends `others`, which only the cameras of the bits in `cameras` see, with their shadows.
    /// All shadows that were there before must have been added in this way.
    pub fn add_for_cameras(&mut self, others: Self, cameras: u32) {
        let masked = |agent: Agent| Agent { cameras, ..agent };
        self.agents.extend(others.agents.into_iter().map(masked));
        self.shadows.extend(others.shadows);
        self.shadow_cameras.resize(self.shadows.len(), cameras);
    }

    /// True if some agent, in view or not, is relit.
    pub(crate) fn relights(&self) -> bool {
        self.agents.iter().any(|agent| agent.relight.is_some())
    }

    /// True if some agent, in view or not, is shaded by normals.
    pub(crate) fn shades(&self) -> bool {
        self.agents.iter().any(|agent| agent.shading.is_some())
    }

    /// Checks the shadows.
    fn check_shadows(&self) -> Result<(), RenderError> {
        assert!(
            self.shadow_cameras.is_empty() || self.shadow_cameras.len() == self.shadows.len(),
            "{} shadows, and cameras for {}",
            self.shadows.len(),
            self.shadow_cameras.len()
        );
        self.shadows
            .iter()
            .enumerate()
            .try_for_each(|(index, shadow)| {
                shadow
                    .check()
                    .map_err(|reason| RenderError::Shadow { index, reason })
            })
    }
}

/// Splats of a frame: a background, and agents that may change with every frame.
#[derive(Clone, Copy)]
pub struct FrameSplats<'a> {
    pub(crate) background: &'a ResidentSplats,
    /// Assets that agents show; `None`: there are no agents.
    pub(crate) pool: Option<&'a AssetPool>,
    pub(crate) agents: &'a FrameAgents,
}

impl<'a> From<&'a ResidentSplats> for FrameSplats<'a> {
    fn from(background: &'a ResidentSplats) -> Self {
        Self {
            background,
            pool: None,
            agents: &NO_AGENTS,
        }
    }
}

impl<'a> FrameSplats<'a> {
    /// A background with agents, whose assets are in `pool`.
    #[must_use]
    pub fn with_agents(
        background: &'a ResidentSplats,
        pool: &'a AssetPool,
        agents: &'a FrameAgents,
    ) -> Self {
        Self {
            background,
            pool: Some(pool),
            agents,
        }
    }

    /// Checks that the motions of `cameras` and agents can be projected during exposures, and up to
    /// `interval_s` before and after the moment.
    pub(crate) fn check_motions(
        &self,
        cameras: &[Camera],
        interval_s: f64,
    ) -> Result<(), RenderError> {
        let within_s = |camera: &Camera| exposed_within_s(camera).max(interval_s);
        for camera in cameras {
            check_motion(&camera.motion, within_s(camera)).map_err(|reason| {
                RenderError::View(Invalid::new(format!("camera {}: {reason}", camera.name)))
            })?;
        }
        let longest_s = cameras.iter().map(within_s).fold(0.0, f64::max);
        for agent in &self.agents.agents {
            check_motion(&agent.motion, longest_s).map_err(|reason| RenderError::AgentMotion {
                instance: agent.instance,
                reason,
            })?;
        }
        Ok(())
    }

    /// No mean that is drawn is farther from the world's origin, meters.
    pub(crate) fn distance_max_m(&self) -> Result<f64, RenderError> {
        self.agents.check_shadows()?;
        let mut distance_max_m = self.background.distance_max_m;
        let Some(pool) = self.pool else {
            return Ok(distance_max_m);
        };
        for agent in &self.agents.agents {
            let pose = &agent.world_from_agent;
            if !(pose.translation.is_finite()
                && pose.rotation.is_finite()
                && pose.rotation.length_squared() > 1e-12)
            {
                return Err(RenderError::AgentPose {
                    instance: agent.instance,
                    pose: format!("{pose:?}"),
                });
            }
            let transfer_at_fault = agent.relight.is_some_and(|light| {
                light
                    .gain
                    .iter()
                    .chain(&light.offset)
                    .flatten()
                    .any(|number| !number.is_finite())
            });
            let shading = agent.shading.as_ref().map(ShadingRecord::new);
            if transfer_at_fault || shading.is_some_and(|record| !record.is_finite()) {
                return Err(RenderError::AgentLight {
                    instance: agent.instance,
                });
            }
            distance_max_m = distance_max_m.max(
                (pose.translation - self.background.origin).length()
                    + pool.asset(agent.asset)?.distance_max_m(),
            );
        }
        Ok(distance_max_m)
    }
}

/// The agents of a frame as the device is told of them.
#[derive(Clone)]
pub(crate) struct AgentList {
    pub pool: PoolBuffers,
    /// Records of the agents that some camera may see.
    pub records: Vec<AgentRecord>,
    /// `[agent][camera]`.
    pub cameras: Vec<CameraRecord>,
    /// Counts of the lists, padding included.
    pub counts: AgentCounts,
    /// Agents that some camera may see.
    pub agents: usize,
    /// Splats of the levels of detail that were chosen.
    pub splats: usize,
    /// The agents that are to be relit, as indices in [`AgentList::records`]: their asset and
    /// light.
    pub relights: Vec<(usize, AssetId, RelightRecord)>,
    /// Light on those that are shaded by normals.
    pub shadings: Vec<ShadingRecord>,
}

impl AgentList {
    /// The agents of `splats` for `cameras`, which `view` is made of; levels of detail are as
    /// coarse as `level_pitch_px` lets neighboring splats be apart, the finest where it is `None`.
    ///
    /// `None` where no camera can see an agent.
    pub fn new(
        splats: &FrameSplats<'_>,
        cameras: &[Camera],
        view: &View,
        near_m: f32,
        level_pitch_px: Option<f64>,
    ) -> Result<Option<Self>, RenderError> {
        let Some(pool) = splats.pool else {
            return Ok(None);
        };
        let mut list = Self::empty(pool, cameras.len());
        for agent in &splats.agents.agents {
            let asset = pool.asset(agent.asset)?;
            let records = view.cameras.iter().zip(cameras);
            let origin = splats.background.origin;
            let may_see = |index: usize| agent.cameras >> index & 1 == 1;
            // Records of cameras that may not see it are never read.
            let moved = |(index, (record, camera)): (usize, (&CameraRecord, &Camera))| {
                if may_see(index) {
                    record
                        .moved_into(camera, origin, &agent.world_from_agent)
                        .moving(camera, &agent.motion)
                } else {
                    CameraRecord::zeroed()
                }
            };
            let seen_by: Vec<CameraRecord> = records.enumerate().map(moved).collect();
            let reached = |index: usize| {
                let lens = twins::lens::lens_of(&view.lenses, index);
                let (whole, camera) = (&asset.whole, &seen_by[index]);
                may_see(index)
                    && twins::cluster_overlaps_any_lens(
                        &twins::rolling::swept(whole, camera),
                        camera,
                        lens,
                        near_m,
                    )
            };
            let mask = (0..seen_by.len()).fold(0u32, |mask, index| {
                mask | u32::from(reached(index)) << index
            });
            if mask == 0 {
                continue;
            }
            let level = level_pitch_px.map_or(0, |pitch_px| {
                level_for(asset, &seen_by, mask, near_m, pitch_px)
            });
            list.push(agent, asset, level, mask, seen_by);
        }
        Ok((list.counts.clusters > 0).then(|| list.padded()))
    }

    /// The agents of `splats` at the finest level of detail, seen by all sectors of a sweep. Their
    /// poses are those at the start of the sweep; sectors have them at `times_s`. `None` where
    /// there are none.
    pub fn of_sweep(
        splats: &FrameSplats<'_>,
        sectors: &[Camera],
        times_s: &[f64],
        view: &View,
    ) -> Result<Option<Self>, RenderError> {
        let Some(pool) = splats.pool else {
            return Ok(None);
        };
        let mut list = Self::empty(pool, sectors.len());
        let all = u32::MAX >> (32 - sectors.len());
        for agent in &splats.agents.agents {
            let seen_by = |index: usize| {
                let pose = agent.world_from_agent.moved(&agent.motion, times_s[index]);
                let (record, sector) = (&view.cameras[index], &sectors[index]);
                record
                    .moved_into(sector, splats.background.origin, &pose)
                    .moving(sector, &agent.motion)
            };
            let seen_by = (0..sectors.len()).map(seen_by).collect();
            list.push(&agent.unlit(), pool.asset(agent.asset)?, 0, all, seen_by);
        }
        Ok((list.counts.clusters > 0).then(|| list.padded()))
    }

    /// No agents yet, for a frame of `cameras`.
    fn empty(pool: &AssetPool, cameras: usize) -> Self {
        Self {
            pool: pool.buffers().clone(),
            records: Vec::new(),
            cameras: Vec::new(),
            counts: AgentCounts {
                cameras,
                ..AgentCounts::default()
            },
            agents: 0,
            splats: 0,
            relights: Vec::new(),
            shadings: Vec::new(),
        }
    }

    /// Rounds the counts up by at most an eighth or to 8, so that frames that see nearly as many
    /// have equal commands, which are recorded once. Agents that are added come after all clusters,
    /// and clusters that are added have no splats.
    fn padded(mut self) -> Self {
        let up = |count: usize| count.next_multiple_of((count / 16).next_power_of_two().max(8));
        let AgentCounts {
            agents,
            cameras,
            clusters,
            shadings,
        } = &mut self.counts;
        (*agents, *clusters) = (up(*agents), up(*clusters));
        *shadings = match self.shadings.len() {
            0 => 0,
            count => up(count),
        };
        self.shadings.resize(*shadings, ShadingRecord::default());
        let none = AgentRecord {
            first_cluster: u32::MAX,
            ..AgentRecord::default()
        };
        self.records.resize(*agents, none);
        self.cameras
            .resize(*agents * *cameras, CameraRecord::zeroed());
        self
    }

    fn push(
        &mut self,
        agent: &Agent,
        asset: &Asset,
        level: usize,
        mask: u32,
        seen_by: Vec<CameraRecord>,
    ) {
        let rotation = DMat3::from_quat(agent.world_from_agent.rotation.normalize()).transpose();
        let row = |column: DVec3| column.as_vec3().to_array();
        self.records.push(AgentRecord {
            row_x: row(rotation.x_axis),
            row_y: row(rotation.y_axis),
            row_z: row(rotation.z_axis),
            first_cluster: self.counts.clusters as u32,
            cameras: mask,
            instance: agent.instance.into(),
            colors_in_world: u32::from(agent.sh_frame.unwrap_or(asset.sh_frame) == ShFrame::World),
            colors_relit: u32::from(agent.relight.is_some()),
            shading: match agent.shading {
                Some(_) => self.shadings.len() as u32 + 1,
                None => 0,
            },
            dc_residual_gain: agent.relight.map_or([1.0; 3], |light| light.gain[0]),
            velocity_mps: agent.motion.velocity_mps.as_vec3().to_array(),
            turn_rad_per_s: agent.motion.turn_rad_per_s.as_vec3().to_array(),
            ..asset.record(level)
        });
        if let Some(light) = &agent.relight {
            let (first, colors) = asset.colors();
            let relight = RelightRecord::new(light, asset.sh_degree, first, colors);
            self.relights
                .push((self.records.len() - 1, agent.asset, relight));
        }
        self.shadings
            .extend(agent.shading.as_ref().map(ShadingRecord::new));
        self.cameras.extend(seen_by);
        self.agents += 1;
        self.counts.agents += 1;
        self.counts.clusters += asset.levels[level].cluster_count();
        self.splats += self.records[self.records.len() - 1].splat_count as usize;
    }
}

/// The coarsest level of detail whose splats are at most `pitch_px` apart in every image that shows
/// them.
fn level_for(
    asset: &Asset,
    seen_by: &[CameraRecord],
    mask: u32,
    near_m: f32,
    pitch_px: f64,
) -> usize {
    let half_diagonal_m = Vec3::from_array(asset.whole.half_extent_m).length();
    let px_per_m = seen_by
        .iter()
        .enumerate()
        .filter(|(i, _)| mask >> i & 1 == 1)
        .map(|(_, camera)| {
            let center = twins::projection::from_camera_m(asset.whole.center_m, camera);
            let nearest_m =
                (Vec3::from_array(camera.row_z).dot(center) - half_diagonal_m).max(near_m);
            f64::from(camera.focal_px[0].max(camera.focal_px[1]) / nearest_m)
        });
    let px_per_m = px_per_m.fold(0.0, f64::max);
    asset
        .levels
        .iter()
        .rposition(|level| level.pitch_m * px_per_m <= pitch_px)
        .unwrap_or(0)
}
