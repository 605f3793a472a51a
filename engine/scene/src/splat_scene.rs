//! A scene of splats to be drawn: a background, the agents placed in it, its sky and its rules.

use std::borrow::Cow;
use std::sync::Arc;

use crate::{Fog, Intrinsics, Invalid, Photometry, Pose, Rules, SkyMap, SplatCloud};
use glam::DVec3;

/// Frame of an asset's spherical harmonics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ShFrame {
    /// Colors in the asset's own frame: they turn with the object (object captures).
    #[default]
    Canonical,
    /// Colors in the world's frame: trained in place, as HUGSIM and drivestudio export. Such an
    /// asset must not be turned.
    World,
}

/// An agent in a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct AgentPlacement {
    /// Names the agent in reports.
    pub name: String,
    /// Index of its asset in the list that the agent is placed with.
    pub asset: usize,
    /// Pose, f64 world coordinates.
    pub world_from_agent: Pose,
    /// Frame of the asset's colors.
    pub sh_frame: ShFrame,
}

/// Splats and surroundings at one moment: everything that an image depends on besides the camera.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SplatScene {
    /// All splats, background first, then agents in order; means are relative to
    /// [`SplatScene::origin`].
    pub splats: SplatCloud,
    /// The instance each splat belongs to: 0 the background, `k` the `k`-th agent. Empty where
    /// there is only background.
    pub instance_from_splat: Vec<u16>,
    /// Indices of splats that show the sky, ascending: cameras see them, LiDARs do not.
    pub sky_splats: Vec<u32>,
    /// Normals that the file of the background stores, unit vectors of either sign in world axes,
    /// one per splat of it; zero where a splat has none. Empty where the file has none.
    pub normals: Vec<[f32; 3]>,
    /// World coordinates of the point that means are relative to, f64 meters: UTM-sized worlds keep
    /// their millimeters.
    pub origin: DVec3,
    /// Color where transmittance is left, display-referred RGB. Not used where there is a
    /// [`SplatScene::sky_map`].
    pub sky: [f32; 3],
    /// Colors where transmittance is left, by direction. `None`: [`SplatScene::sky`] in all
    /// directions.
    pub sky_map: Option<Arc<SkyMap>>,
    /// Photometric calibration of cameras that have none of their own.
    pub photometry: Photometry,
    /// Fog between the cameras and everything else. `None`: clear air.
    pub fog: Option<Fog>,
    /// Image formation rules.
    pub rules: Rules,
}

impl SplatScene {
    /// A scene of background only, its origin at zero, a black sky and the default rules.
    #[must_use]
    pub fn from_splats(splats: SplatCloud) -> Self {
        Self {
            splats,
            ..Self::default()
        }
    }

    /// The scene as LiDARs meet it: without the splats that show the sky.
    #[must_use]
    pub fn without_sky_splats(&self) -> Cow<'_, Self> {
        if self.sky_splats.is_empty() {
            return Cow::Borrowed(self);
        }
        let is_kept = |splat: &u32| self.sky_splats.binary_search(splat).is_err();
        let kept: Vec<u32> = (0..self.splats.len() as u32).filter(is_kept).collect();
        let instances = &self.instance_from_splat;
        let instances = kept
            .iter()
            .filter_map(|splat| instances.get(*splat as usize));
        Cow::Owned(Self {
            splats: self.splats.select(&kept),
            instance_from_splat: instances.copied().collect(),
            sky_splats: Vec::new(),
            normals: Vec::new(),
            ..self.clone()
        })
    }

    /// Photometric calibration of images of this scene: that of `intrinsics`, or that of the scene
    /// where it is the identity.
    #[must_use]
    pub fn photometry_of(&self, intrinsics: &Intrinsics) -> Photometry {
        intrinsics.photometry.or(self.photometry)
    }

    /// Adds `agent`, showing `asset`, as world-space splats with the id that follows the last one.
    /// It is returned.
    ///
    /// # Errors
    /// Returns an error if the 65,535 instances that an id can name are used up.
    pub fn bake_agent(
        &mut self,
        asset: &SplatCloud,
        agent: &AgentPlacement,
    ) -> Result<u16, Invalid> {
        let last = self.instance_from_splat.last().copied().unwrap_or(0);
        let instance = last.checked_add(1).ok_or_else(|| {
            Invalid::new(format!(
                "agent {}: more than 65535 agents in one scene",
                agent.name
            ))
        })?;
        self.bake_instance(asset, &agent.world_from_agent, agent.sh_frame, instance);
        Ok(instance)
    }

    /// Adds `asset`, standing at `world_from_agent`, as world-space splats that belong to
    /// `instance`.
    pub fn bake_instance(
        &mut self,
        asset: &SplatCloud,
        world_from_agent: &Pose,
        sh_frame: ShFrame,
        instance: u16,
    ) {
        let relative = Pose {
            translation: world_from_agent.translation - self.origin,
            ..*world_from_agent
        };
        if self.instance_from_splat.is_empty() {
            self.instance_from_splat.resize(self.splats.len(), 0);
        }
        self.splats.append(
            &asset
                .clone()
                .placed(&relative, sh_frame == ShFrame::Canonical),
        );
        self.instance_from_splat.resize(self.splats.len(), instance);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_shows_the_sky_is_left_out_and_all_else_stays() {
        let mut splat_scene = SplatScene {
            sky_splats: vec![0, 2],
            instance_from_splat: vec![0, 0, 0, 7],
            ..SplatScene::from_splats(SplatCloud::with_degree(0))
        };
        splat_scene.splats = SplatCloud {
            means: vec![[0.0; 3], [1.0; 3], [2.0; 3], [3.0; 3]],
            scales: vec![[0.1; 3]; 4],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; 4],
            opacities: vec![1.0; 4],
            sh_degree: 0,
            sh_dc: vec![[0.0; 3]; 4],
            sh_rest: vec![],
        };
        let left = splat_scene.without_sky_splats();
        assert_eq!(left.splats.means, [[1.0; 3], [3.0; 3]]);
        assert_eq!(left.instance_from_splat, [0, 7]);
        assert_eq!(*left.without_sky_splats(), *left);
    }

    #[test]
    fn agents_come_behind_the_background_with_ids_from_one() {
        let one = SplatCloud {
            means: vec![[1.0, 0.0, 0.0]],
            scales: vec![[0.1; 3]],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]],
            opacities: vec![1.0],
            sh_degree: 0,
            sh_dc: vec![[0.0; 3]],
            sh_rest: vec![],
        };
        let mut splat_scene = SplatScene {
            origin: DVec3::new(4.5e6, 0.0, 0.0),
            ..SplatScene::from_splats(one.clone())
        };
        for x in [0.0, 10.0] {
            let agent = AgentPlacement {
                name: "car".into(),
                asset: 0,
                world_from_agent: Pose::from_yaw(
                    std::f64::consts::FRAC_PI_2,
                    splat_scene.origin + DVec3::X * x,
                ),
                sh_frame: ShFrame::Canonical,
            };
            splat_scene.bake_agent(&one, &agent).unwrap();
        }
        assert_eq!(splat_scene.instance_from_splat, [0, 1, 2]);
        let mut mixed = splat_scene.clone();
        mixed.bake_instance(&one, &Pose::IDENTITY, ShFrame::World, 9);
        assert_eq!(mixed.instance_from_splat, [0, 1, 2, 9]);
        assert!(
            (splat_scene.splats.means[2][0] - 10.0).abs() < 1e-6
                && (splat_scene.splats.means[2][1] - 1.0).abs() < 1e-6
        );
    }
}
