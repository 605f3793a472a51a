//! The TOML form of a scene file: what serde sees, and how a [`SceneFile`] is written in it.

use std::fmt;

use decouplegs_scene::light::{AmbientOptions, Lamps, ShadowOptions};
use decouplegs_scene::rules::LIDAR_DILATION_RAD;
use decouplegs_scene::{Intrinsics, Pose, RigCamera, Rules, ShFrame, TimedPose, Trajectory};
use glam::{DMat3, DQuat};
use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use toml::Spanned;

use super::lens::LensForm;
use super::lens::WindshieldForm;
use super::lidar::LidarForm;
use super::photometry::PhotometryForm;
use super::recording::RecordingForm;
use super::shutter::ShutterForm;
use super::{SceneAgent, SceneFile, SceneLight, VERSION};
use crate::SkyKind;

/// Tables keep their place in the text so that a complaint can name its line.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SceneForm {
    pub(super) version: u32,
    #[serde(default)]
    pub(super) origin: [f64; 3],
    pub(super) background: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) ego_height_m: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) recording: Option<Spanned<RecordingForm>>,
    #[serde(default = "black_sky")]
    pub(super) sky: Spanned<SkyForm>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) photometry: Option<Spanned<PhotometryForm>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) fog: Option<Spanned<FogForm>>,
    #[serde(default = "default_rules")]
    pub(super) rules: Spanned<RulesForm>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) rig: Vec<Spanned<CameraForm>>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) lidar: Vec<Spanned<LidarForm>>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) ego: Vec<Spanned<TimedPoseForm>>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) agent: Vec<Spanned<AgentForm>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) light: Option<Spanned<LightForm>>,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FogForm {
    pub(super) extinction_per_m: f64,
    pub(super) color: [f64; 3],
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) sky_range_m: Option<f64>,
}

/// One color, or a table of an image.
#[derive(Serialize)]
#[serde(untagged)]
pub(super) enum SkyForm {
    Color([f32; 3]),
    Map(SkyMapForm),
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SkyMapForm {
    pub(super) kind: SkyKindForm,
    pub(super) file: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) world_from_sky: Option<[[f64; 3]; 3]>,
    #[serde(default)]
    pub(super) clamp: bool,
    #[serde(default)]
    pub(super) clamp_splats: bool,
}

#[derive(Clone, Copy, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum SkyKindForm {
    Cube,
    Equirect,
    Npz,
}

// By hand: an untagged enum could not say what is wrong in the table.
impl<'de> Deserialize<'de> for SkyForm {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ColorOrTable;

        impl<'de> Visitor<'de> for ColorOrTable {
            type Value = SkyForm;

            fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
                out.write_str("three numbers, display RGB, or a table with 'kind' and 'file'")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, values: A) -> Result<SkyForm, A::Error> {
                let values = SeqAccessDeserializer::new(values);
                Deserialize::deserialize(values).map(SkyForm::Color)
            }

            fn visit_map<A: MapAccess<'de>>(self, values: A) -> Result<SkyForm, A::Error> {
                let values = MapAccessDeserializer::new(values);
                Deserialize::deserialize(values).map(SkyForm::Map)
            }
        }

        deserializer.deserialize_any(ColorOrTable)
    }
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LightForm {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) transfer: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) full_effect: Option<bool>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) by_normals: Option<bool>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) ground_albedo: Option<f64>,
    pub(super) sigma_m: Option<f64>,
    pub(super) radius_m: Option<f64>,
    pub(super) spacing_m: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) shadows: Option<Spanned<ShadowForm>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) sun: Option<Spanned<SunForm>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) lamps: Option<Spanned<LampsForm>>,
}

#[derive(Clone, Copy, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SunForm {
    pub(super) towards: [f64; 3],
    pub(super) share: f64,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LampsForm {
    pub(super) places: Vec<[f64; 3]>,
    pub(super) range_m: Option<f64>,
}

#[derive(Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ShadowForm {
    pub(super) strength: Option<f64>,
    pub(super) decay: Option<f64>,
    pub(super) slab_m: Option<f64>,
    pub(super) full_directionality: Option<f64>,
    pub(super) floor: Option<f64>,
}

#[derive(Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RulesForm {
    pub(super) name: Option<String>,
    pub(super) antialias: Option<bool>,
    pub(super) near_m: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) lidar_dilation_rad: Option<f64>,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CameraForm {
    pub(super) name: String,
    pub(super) width_px: u32,
    pub(super) height_px: u32,
    /// May be left out where the lens is f-theta, which does without.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) fx_px: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) fy_px: Option<f64>,
    pub(super) cx_px: f64,
    pub(super) cy_px: f64,
    pub(super) position_m: [f64; 3],
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) rotation_wxyz: Option<[f64; 4]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) look: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) lens: Option<LensForm>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) photometry: Option<PhotometryForm>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) shutter: Option<ShutterForm>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) windshield: Option<WindshieldForm>,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TimedPoseForm {
    pub(super) time_s: f64,
    pub(super) position_m: [f64; 3],
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) rotation_wxyz: Option<[f64; 4]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) yaw_rad: Option<f64>,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct AgentForm {
    pub(super) name: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) class: Option<String>,
    pub(super) asset: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) sh_frame: Option<ShFrameForm>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) position_m: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) rotation_wxyz: Option<[f64; 4]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) yaw_rad: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) present: Option<Vec<[f64; 2]>>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) trajectory: Vec<Spanned<TimedPoseForm>>,
}

#[derive(Clone, Copy, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum ShFrameForm {
    Canonical,
    World,
}

fn black_sky() -> Spanned<SkyForm> {
    spanless(SkyForm::Color([0.0; 3]))
}

fn default_rules() -> Spanned<RulesForm> {
    spanless(RulesForm::default())
}

fn spanless<T>(value: T) -> Spanned<T> {
    Spanned::new(0..0, value)
}

/// Writes a scene.
pub(super) fn to_toml(scene: &SceneFile) -> Result<String, String> {
    let path = |path: &std::path::Path| {
        path.to_str().map(str::to_owned).ok_or_else(|| {
            format!(
                "the path {} is not Unicode, which TOML needs",
                path.display()
            )
        })
    };
    let agents = scene
        .agents
        .iter()
        .map(|agent| Ok(spanless(agent_form(agent, path(&agent.asset)?))));
    let lidars = scene.lidars.iter();
    let lidars = lidars.map(|lidar| Ok(spanless(LidarForm::from_lidar(lidar, path)?)));
    let form = SceneForm {
        version: VERSION,
        origin: scene.origin.to_array(),
        background: path(&scene.background)?,
        sky: spanless(sky_form(scene, path)?),
        photometry: PhotometryForm::from_photometry(&scene.photometry).map(spanless),
        fog: scene.fog.map(|fog| {
            spanless(FogForm {
                extinction_per_m: fog.extinction_per_m,
                color: fog.color,
                sky_range_m: Some(fog.sky_range_m),
            })
        }),
        rules: spanless(rules_form(&scene.rules)?),
        rig: scene
            .rig
            .cameras()
            .map(|camera| spanless(camera_form(camera)))
            .collect(),
        lidar: lidars.collect::<Result<_, String>>()?,
        ego: scene.ego.as_ref().map(timed_pose_forms).unwrap_or_default(),
        ego_height_m: scene.ego_height_m,
        recording: RecordingForm::from_recording(&scene.recording, path)?.map(spanless),
        agent: agents.collect::<Result<_, String>>()?,
        light: scene
            .light
            .as_ref()
            .map(|light| light_form(light, path))
            .transpose()?,
    };
    toml::to_string(&form).map_err(|error| error.to_string())
}

fn sky_form(
    scene: &SceneFile,
    path: impl Fn(&std::path::Path) -> Result<String, String>,
) -> Result<SkyForm, String> {
    let Some(sky) = &scene.sky_map else {
        return Ok(SkyForm::Color(scene.sky));
    };
    let rows = sky.world_from_sky.transpose().to_cols_array_2d();
    Ok(SkyForm::Map(SkyMapForm {
        kind: match sky.kind {
            SkyKind::Cube => SkyKindForm::Cube,
            SkyKind::Equirect => SkyKindForm::Equirect,
            SkyKind::Npz => SkyKindForm::Npz,
        },
        file: path(&sky.file)?,
        world_from_sky: (sky.world_from_sky != DMat3::IDENTITY).then_some(rows),
        clamp: sky.clamps,
        clamp_splats: sky.clamps_splats,
    }))
}

fn light_form(
    light: &SceneLight,
    path: impl Fn(&std::path::Path) -> Result<String, String>,
) -> Result<Spanned<LightForm>, String> {
    let AmbientOptions {
        sigma_m,
        radius_m,
        spacing_m,
    } = light.ambient;
    let lamps = &light.casting.lamps;
    let shadows = |shadows: ShadowOptions| ShadowForm {
        strength: Some(shadows.strength),
        decay: Some(shadows.decay),
        slab_m: Some(shadows.slab_m),
        full_directionality: Some(shadows.full_directionality),
        floor: Some(shadows.floor),
    };
    Ok(spanless(LightForm {
        transfer: light.transfer.as_deref().map(path).transpose()?,
        full_effect: light.relighting.full_effect.then_some(true),
        ground_albedo: light.relighting.ground_albedo,
        by_normals: light.relighting.by_normals.then_some(true),
        sigma_m: Some(sigma_m),
        radius_m: Some(radius_m),
        spacing_m: Some(spacing_m),
        shadows: light.shadows.map(|options| spanless(shadows(options))),
        sun: light.casting.sun.map(|sun| {
            spanless(SunForm {
                towards: sun.towards.to_array(),
                share: sun.share,
            })
        }),
        lamps: (*lamps != Lamps::default()).then(|| {
            spanless(LampsForm {
                places: lamps
                    .positions
                    .iter()
                    .map(|place| place.to_array())
                    .collect(),
                range_m: Some(lamps.range_m),
            })
        }),
    }))
}

/// The rules as a name and what departs from it.
fn rules_form(rules: &Rules) -> Result<RulesForm, String> {
    let named = |name: &&str| {
        Rules::by_name(name).is_some_and(|base| {
            Rules {
                antialias: rules.antialias,
                near_m: rules.near_m,
                lidar_dilation_rad: rules.lidar_dilation_rad,
                ..base
            } == *rules
        })
    };
    let name = Rules::NAMES
        .iter()
        .find(|name| Rules::by_name(name) == Some(*rules))
        .or_else(|| Rules::NAMES.iter().find(|n| named(n)));
    let name = name.ok_or_else(|| {
        format!(
            "rules {rules:?} have no name; a scene file holds one of {}",
            Rules::NAMES.join(", ")
        )
    })?;
    Ok(RulesForm {
        name: Some((*name).to_owned()),
        antialias: Some(rules.antialias),
        near_m: Some(rules.near_m),
        lidar_dilation_rad: (rules.lidar_dilation_rad != LIDAR_DILATION_RAD)
            .then_some(rules.lidar_dilation_rad),
    })
}

pub(super) fn camera_form(camera: &RigCamera) -> CameraForm {
    let Intrinsics {
        width_px,
        height_px,
        fx_px,
        fy_px,
        cx_px,
        cy_px,
        lens,
        windshield,
        photometry,
        shutter,
    } = camera.intrinsics;
    let Pose {
        rotation,
        translation,
    } = camera.rig_from_camera;
    CameraForm {
        name: camera.name.clone(),
        width_px,
        height_px,
        fx_px: Some(fx_px),
        fy_px: Some(fy_px),
        cx_px,
        cy_px,
        position_m: translation.to_array(),
        rotation_wxyz: Some(wxyz(rotation)),
        look: None,
        lens: LensForm::from_lens(&lens),
        photometry: PhotometryForm::from_photometry(&photometry),
        shutter: ShutterForm::from_shutter(&shutter, [width_px, height_px]),
        windshield: windshield.as_ref().map(WindshieldForm::from_windshield),
    }
}

fn agent_form(agent: &SceneAgent, asset: String) -> AgentForm {
    let sh_frame = agent.sh_frame.map(|sh_frame| match sh_frame {
        ShFrame::Canonical => ShFrameForm::Canonical,
        ShFrame::World => ShFrameForm::World,
    });
    let standing = match agent.trajectory.poses() {
        [only] if only.time_s == 0.0 => Some(only.pose),
        _ => None,
    };
    AgentForm {
        name: agent.name.clone(),
        class: agent.class.clone(),
        asset,
        sh_frame,
        position_m: standing.map(|pose| pose.translation.to_array()),
        rotation_wxyz: standing.map(|pose| wxyz(pose.rotation)),
        yaw_rad: None,
        present: match agent.present.intervals_s() {
            [] => None,
            intervals_s => Some(intervals_s.to_vec()),
        },
        trajectory: if standing.is_some() {
            Vec::new()
        } else {
            timed_pose_forms(&agent.trajectory)
        },
    }
}

fn timed_pose_forms(trajectory: &Trajectory) -> Vec<Spanned<TimedPoseForm>> {
    let form = |timed: &TimedPose| TimedPoseForm {
        time_s: timed.time_s,
        position_m: timed.pose.translation.to_array(),
        rotation_wxyz: Some(wxyz(timed.pose.rotation)),
        yaw_rad: None,
    };
    trajectory
        .poses()
        .iter()
        .map(|timed| spanless(form(timed)))
        .collect()
}

pub(super) fn wxyz(rotation: DQuat) -> [f64; 4] {
    [rotation.w, rotation.x, rotation.y, rotation.z]
}
