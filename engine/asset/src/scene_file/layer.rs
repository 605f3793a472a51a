//! A scene taken apart: its background alone, or its agents alone ("Scene Decoupling" in the
//! DecoupleGS paper's supplement).

use std::borrow::Cow;

use decouplegs_scene::{Fog, Photometry, SplatScene};

use super::LoadedScene;

/// Selection of the parts of a scene that are rendered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Layer {
    /// Background, agents and their shadows.
    #[default]
    All,
    /// The scene as if no agent had ever been there: without them and without their shadows.
    Background,
    /// The agents over nothing, in the light that the whole background throws on them. The sky is
    /// black and lets through, so that color is premultiplied by alpha.
    Agents,
}

impl LoadedScene {
    /// Number of splats of the background: they come before those of agents.
    pub(super) fn background_splats(&self) -> usize {
        let instances = &self.splat_scene.instance_from_splat;
        let first_of_agents = instances.iter().position(|&id| id != 0);
        first_of_agents.unwrap_or(self.splat_scene.splats.len())
    }

    /// [`SplatScene::normals`], and none where the background is no longer that of its file.
    #[must_use]
    pub fn normals(&self) -> &[[f32; 3]] {
        let normals = self.splat_scene.normals.as_slice();
        match normals.len() == self.background_splats() {
            true => normals,
            false => &[],
        }
    }

    /// Part of [`LoadedScene::splat_scene`] that belongs to `layer`: its background, its agents of
    /// plain splats, or both.
    #[must_use]
    pub fn standing(&self, layer: Layer) -> Cow<'_, SplatScene> {
        match layer {
            Layer::All => Cow::Borrowed(&self.splat_scene),
            Layer::Background | Layer::Agents => Cow::Owned(only(&self.splat_scene, layer)),
        }
    }

    /// [`LoadedScene::baked`], and of that what belongs to `layer`: the definition of the layer's
    /// image.
    #[must_use]
    pub fn baked_layer(&self, time_s: f64, layer: Layer) -> SplatScene {
        match layer {
            Layer::All => self.baked(time_s),
            // Not of the baked world: shadows lie there.
            Layer::Background => only(&self.splat_scene, layer),
            Layer::Agents => only(&self.baked(time_s), layer),
        }
    }
}

/// The part of `splat_scene` that belongs to `layer`, in the order it had.
fn only(splat_scene: &SplatScene, layer: Layer) -> SplatScene {
    let of_agents = |splat: &u32| {
        splat_scene
            .instance_from_splat
            .get(*splat as usize)
            .is_some_and(|id| *id != 0)
    };
    let splats = 0..splat_scene.splats.len() as u32;
    if layer == Layer::Background {
        let kept: Vec<u32> = splats.filter(|splat| !of_agents(splat)).collect();
        return SplatScene {
            splats: splat_scene.splats.select(&kept),
            instance_from_splat: Vec::new(),
            // The background is in front: its indices stay.
            sky_splats: splat_scene.sky_splats.clone(),
            normals: splat_scene.normals.clone(),
            sky_map: splat_scene.sky_map.clone(),
            ..*splat_scene
        };
    }
    let kept: Vec<u32> = splats.filter(of_agents).collect();
    SplatScene {
        splats: splat_scene.splats.select(&kept),
        instance_from_splat: kept
            .iter()
            .map(|splat| splat_scene.instance_from_splat[*splat as usize])
            .collect(),
        sky: [0.0; 3],
        sky_map: None,
        sky_splats: Vec::new(),
        normals: Vec::new(),
        // Images of the layer are laid over others before colors are calibrated.
        photometry: Photometry::IDENTITY,
        // Fog is in front of the agents; behind them it belongs to the background.
        fog: splat_scene.fog.map(|fog| Fog {
            sky_range_m: 0.0,
            ..fog
        }),
        ..*splat_scene
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs_scene::{Pose, Rules, ShFrame, SplatCloud};
    use glam::DVec3;

    fn splats(xs: &[f32]) -> SplatCloud {
        SplatCloud {
            means: xs.iter().map(|x| [*x, 0.0, 0.0]).collect(),
            scales: vec![[0.1; 3]; xs.len()],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; xs.len()],
            opacities: vec![0.9; xs.len()],
            sh_degree: 0,
            sh_dc: vec![[0.3; 3]; xs.len()],
            sh_rest: vec![],
        }
    }

    #[test]
    fn layers_part_the_splats_of_a_world_and_keep_their_order() {
        let of = |xs: &[f32]| SplatScene {
            origin: DVec3::new(4.5e6, 0.0, 0.0),
            sky: [0.2, 0.3, 0.4],
            rules: Rules::INRIA,
            fog: Some(Fog::new(0.01, [0.5; 3])),
            ..SplatScene::from_splats(splats(xs))
        };
        let background = of(&[3.0, 1.0, 2.0]);
        let mut splat_scene = background.clone();
        for (instance, x) in [(1, 10.0), (4, 20.0)] {
            splat_scene.bake_instance(
                &splats(&[x, x + 1.0]),
                &Pose {
                    translation: splat_scene.origin,
                    ..Pose::IDENTITY
                },
                ShFrame::World,
                instance,
            );
        }
        assert_eq!(only(&splat_scene, Layer::Background), background);
        let agents = only(&splat_scene, Layer::Agents);
        assert_eq!(agents.instance_from_splat, [1, 1, 4, 4]);
        assert_eq!(agents.splats.means, splat_scene.splats.means[3..]);
        assert_eq!(
            (agents.sky, agents.origin, agents.rules),
            ([0.0; 3], splat_scene.origin, splat_scene.rules)
        );
        let fog = agents.fog.unwrap();
        assert_eq!(
            (fog.extinction_per_m, fog.left(fog.sky_range_m)),
            (0.01, 1.0)
        );
        assert_eq!(only(&background, Layer::Background), background);
        assert!(only(&background, Layer::Agents).splats.is_empty());
    }
}
