//! Checks the TOML form of a scene file and makes a [`SceneFile`] of it; every complaint names its
//! line and key.

use std::collections::HashSet;
use std::ops::Range;

use decouplegs_scene::{
    Fog, Intrinsics, Lens, Photometry, Pose, Presence, Rig, RigCamera, Rules, ShFrame, Shutter,
    SkyMap, TimedPose, Trajectory,
};
use glam::{DMat3, DQuat, DVec3};
use toml::Spanned;

use super::form::{
    AgentForm, CameraForm, FogForm, RulesForm, SceneForm, ShFrameForm, SkyForm, SkyKindForm,
    TimedPoseForm,
};
use super::lens::LensForm;
use super::lens::WindshieldForm;
use super::photometry::PhotometryForm;
use super::recording::RecordingForm;
use super::{SceneAgent, SceneFile, SceneRecording, SceneSky, VERSION};
use crate::toml_text::{Checker, syntax_error};
use crate::{SceneError, SkyKind};

/// Ids that agents can have: 16 bits, of which 0 is the background.
const AGENTS_MAX: usize = 65_535;

/// No recording vehicle's origin is higher above the road, meters.
const EGO_HEIGHT_MAX_M: f64 = 10.0;

/// Reads and checks `text`.
pub(super) fn parse(text: &str) -> Result<SceneFile, SceneError> {
    let form: SceneForm = toml::from_str(text).map_err(|error| syntax_error(text, &error))?;
    let checker = Checker { text };
    let top = 0..0;
    if form.version != VERSION {
        let reason = format!(
            "{} is not read; this program reads version {VERSION}",
            form.version
        );
        return Err(checker.error(&top, "", "version", reason));
    }
    if !form.origin.iter().all(|x| x.is_finite()) {
        return Err(checker.error(&top, "", "origin", "must be finite"));
    }
    let (sky, sky_map) = checker.sky(&form.sky)?;
    let ego = if form.ego.is_empty() {
        None
    } else {
        Some(checker.trajectory(&form.ego, "ego")?)
    };
    if !form
        .ego_height_m
        .is_none_or(|height_m| (0.0..=EGO_HEIGHT_MAX_M).contains(&height_m))
    {
        let reason = format!("must be 0 to {EGO_HEIGHT_MAX_M} meters above the road");
        return Err(checker.error(&top, "", "ego_height_m", reason));
    }
    let mut names = HashSet::new();
    let cameras = checker.cameras(&form.rig, &mut names)?;
    Ok(SceneFile {
        origin: DVec3::from_array(form.origin),
        background: form.background.into(),
        sky,
        sky_map,
        photometry: checker.photometry(form.photometry.as_ref())?,
        fog: form.fog.as_ref().map(|fog| checker.fog(fog)).transpose()?,
        rules: checker.rules(&form.rules)?,
        rig: Rig::from_iter(cameras),
        lidars: checker.lidars(&form.lidar, &mut names)?,
        ego,
        ego_height_m: form.ego_height_m,
        recording: form
            .recording
            .as_ref()
            .map_or(Ok(SceneRecording::default()), |form| {
                RecordingForm::checked(form, &checker)
            })?,
        agents: checker.agents(&form.agent)?,
        light: form
            .light
            .as_ref()
            .map(|light| checker.light(light))
            .transpose()?,
    })
}

impl Checker<'_> {
    fn sky(&self, form: &Spanned<SkyForm>) -> Result<([f32; 3], Option<SceneSky>), SceneError> {
        let map = match form.get_ref() {
            SkyForm::Color(color) => {
                if !color.iter().all(|value| value.is_finite()) {
                    return Err(self.error(&(0..0), "", "sky", "must be finite"));
                }
                return Ok((*color, None));
            }
            SkyForm::Map(map) => map,
        };
        let kind = match map.kind {
            SkyKindForm::Cube => SkyKind::Cube,
            SkyKindForm::Equirect => SkyKind::Equirect,
            SkyKindForm::Npz => SkyKind::Npz,
        };
        let mut sky = SceneSky::new(map.file.as_str(), kind);
        (sky.clamps, sky.clamps_splats) = (map.clamp, map.clamp_splats);
        if let Some(rows) = map.world_from_sky {
            sky.world_from_sky = DMat3::from_cols_array_2d(&rows).transpose();
        }
        SkyMap::check_frame(sky.world_from_sky)
            .map_err(|reason| self.error(&form.span(), "sky", "world_from_sky", reason))?;
        Ok(([0.0; 3], Some(sky)))
    }

    /// The calibration of a scene. Scenes have no pixels: vignetting belongs to a camera.
    fn photometry(&self, form: Option<&Spanned<PhotometryForm>>) -> Result<Photometry, SceneError> {
        let Some(form) = form else {
            return Ok(Photometry::IDENTITY);
        };
        let photometry = form.get_ref().photometry();
        let checked = match photometry.vignetting {
            Some(_) => Err("vignetting belongs to a camera: state it in a [[rig]] table".into()),
            None => photometry.check(),
        };
        match checked {
            Ok(()) => Ok(photometry),
            Err(reason) => Err(self.error(&form.span(), "", "photometry", reason)),
        }
    }

    fn fog(&self, form: &Spanned<FogForm>) -> Result<Fog, SceneError> {
        let own = form.get_ref();
        let mut fog = Fog::new(own.extinction_per_m, own.color);
        fog.sky_range_m = own.sky_range_m.unwrap_or(fog.sky_range_m);
        match fog.check() {
            Ok(()) => Ok(fog),
            Err(reason) => Err(self.error(&form.span(), "", "fog", reason)),
        }
    }

    fn rules(&self, form: &Spanned<RulesForm>) -> Result<Rules, SceneError> {
        let (span, form) = (form.span(), form.get_ref());
        let name = form.name.as_deref().unwrap_or("default");
        let rules = Rules::by_name(name).ok_or_else(|| {
            self.error(
                &span,
                "rules",
                "name",
                format!("'{name}' is unknown; there are {}", Rules::NAMES.join(", ")),
            )
        })?;
        let near_m = form.near_m.unwrap_or(rules.near_m);
        if !(near_m.is_finite() && near_m > 0.0) {
            return Err(self.error(
                &span,
                "rules",
                "near_m",
                format!("{near_m} must be finite and positive"),
            ));
        }
        let lidar_dilation_rad = form.lidar_dilation_rad.unwrap_or(rules.lidar_dilation_rad);
        if !(1e-6..=0.1).contains(&lidar_dilation_rad) {
            let reason = format!("{lidar_dilation_rad} must be from 0.000001 to 0.1");
            return Err(self.error(&span, "rules", "lidar_dilation_rad", reason));
        }
        Ok(Rules {
            lidar_dilation_rad,
            antialias: form.antialias.unwrap_or(rules.antialias),
            near_m,
            ..rules
        })
    }

    pub(super) fn cameras<'n>(
        &self,
        forms: &'n [Spanned<CameraForm>],
        names: &mut HashSet<&'n str>,
    ) -> Result<Vec<RigCamera>, SceneError> {
        let mut cameras = Vec::with_capacity(forms.len());
        for (index, form) in forms.iter().enumerate() {
            let (span, form, table) = (form.span(), form.get_ref(), format!("rig[{index}]"));
            self.check_file_name(names, &form.name, &span, &table)?;
            let lens = form.lens.as_ref().map_or(Ok(Lens::Pinhole), LensForm::lens);
            let lens = lens.map_err(|reason| self.error(&span, &table, "lens", reason))?;
            let focal_px = |given: Option<f64>, axis: usize, field: &str| match (given, &lens) {
                (Some(focal_px), _) => Ok(focal_px),
                (None, Lens::FTheta(lens)) => Ok(lens.center_focal_px()[axis]),
                (None, _) => {
                    Err(self.error(&span, &table, field, format!("missing field '{field}'")))
                }
            };
            let photometry = form
                .photometry
                .as_ref()
                .map_or(Photometry::IDENTITY, PhotometryForm::photometry);
            photometry
                .check()
                .map_err(|reason| self.error(&span, &table, "photometry", reason))?;
            let shutter = form
                .shutter
                .as_ref()
                .map_or(Ok(Shutter::GLOBAL), |shutter| {
                    shutter.shutter([form.width_px, form.height_px])
                });
            let shutter = shutter.map_err(|reason| self.error(&span, &table, "shutter", reason))?;
            let windshield = form.windshield.as_ref().map(WindshieldForm::windshield);
            let windshield = windshield
                .transpose()
                .map_err(|reason| self.error(&span, &table, "windshield", reason))?;
            let intrinsics = Intrinsics {
                width_px: form.width_px,
                height_px: form.height_px,
                fx_px: focal_px(form.fx_px, 0, "fx_px")?,
                fy_px: focal_px(form.fy_px, 1, "fy_px")?,
                cx_px: form.cx_px,
                cy_px: form.cy_px,
                lens,
                windshield,
                photometry,
                shutter,
            };
            intrinsics.check().map_err(|reason| {
                self.error(&span, &table, intrinsics_field(&intrinsics), reason)
            })?;
            let rig_from_camera = self.camera_pose(form, &span, &table)?;
            cameras.push(RigCamera {
                name: form.name.clone(),
                intrinsics,
                rig_from_camera,
            });
        }
        Ok(cameras)
    }

    fn camera_pose(
        &self,
        form: &CameraForm,
        span: &Range<usize>,
        table: &str,
    ) -> Result<Pose, SceneError> {
        match (form.rotation_wxyz, form.look) {
            (Some(_), None) => self.pose(form.position_m, form.rotation_wxyz, None, span, table),
            (None, Some(look)) => {
                let eye = self.position(form.position_m, span, table)?;
                let direction = DVec3::from_array(look)
                    .try_normalize()
                    .filter(|direction| direction.is_finite());
                direction
                    .and_then(|direction| Pose::look_at(DVec3::ZERO, direction, DVec3::Z))
                    .map_or_else(
                        || {
                            Err(self.error(
                                span,
                                table,
                                "look",
                                format!("{look:?} is no direction that leaves the vertical"),
                            ))
                        },
                        |pose| {
                            Ok(Pose {
                                translation: eye,
                                ..pose
                            })
                        },
                    )
            }
            _ => Err(self.error(
                span,
                table,
                "rotation_wxyz",
                "give either 'rotation_wxyz' or 'look'",
            )),
        }
    }

    fn agents(&self, forms: &[Spanned<AgentForm>]) -> Result<Vec<SceneAgent>, SceneError> {
        if let Some(first) = forms.get(AGENTS_MAX) {
            let reason = format!("{} agents; at most {AGENTS_MAX} have an id", forms.len());
            return Err(self.error(
                &first.span(),
                &format!("agent[{AGENTS_MAX}]"),
                "name",
                reason,
            ));
        }
        let mut names = HashSet::new();
        let mut agents = Vec::with_capacity(forms.len());
        for (index, form) in forms.iter().enumerate() {
            let (span, form, table) = (form.span(), form.get_ref(), format!("agent[{index}]"));
            self.check_name(&mut names, &form.name, &span, &table)?;
            if form.class.as_ref().is_some_and(String::is_empty) {
                let reason = "empty; leave it out for an agent of unknown class";
                return Err(self.error(&span, &table, "class", reason));
            }
            let trajectory = match (form.position_m, form.trajectory.as_slice()) {
                (Some(position_m), []) => Trajectory::standing(self.pose(
                    position_m,
                    form.rotation_wxyz,
                    form.yaw_rad,
                    &span,
                    &table,
                )?),
                (None, poses @ [_, ..])
                    if form.rotation_wxyz.is_none() && form.yaw_rad.is_none() =>
                {
                    self.trajectory(poses, &format!("{table}.trajectory"))?
                }
                _ => {
                    return Err(self.error(
                        &span,
                        &table,
                        "position_m",
                        "give either one pose or a 'trajectory' of poses",
                    ));
                }
            };
            let sh_frame = form.sh_frame.map(|sh_frame| match sh_frame {
                ShFrameForm::Canonical => ShFrame::Canonical,
                ShFrameForm::World => ShFrame::World,
            });
            agents.push(SceneAgent {
                name: form.name.clone(),
                class: form.class.clone(),
                asset: form.asset.clone().into(),
                sh_frame,
                trajectory,
                present: self.presence(form.present.as_ref(), &span, &table)?,
            });
        }
        Ok(agents)
    }

    fn presence(
        &self,
        intervals_s: Option<&Vec<[f64; 2]>>,
        span: &Range<usize>,
        table: &str,
    ) -> Result<Presence, SceneError> {
        let Some(intervals_s) = intervals_s else {
            return Ok(Presence::ALWAYS);
        };
        if intervals_s.is_empty() {
            let reason = "no interval; leave 'present' out for an agent that is always there, and the agent for one that never is";
            return Err(self.error(span, table, "present", reason));
        }
        Presence::new(intervals_s.clone())
            .map_err(|reason| self.error(span, table, "present", reason))
    }

    fn trajectory(
        &self,
        forms: &[Spanned<TimedPoseForm>],
        table: &str,
    ) -> Result<Trajectory, SceneError> {
        let mut poses: Vec<TimedPose> = Vec::with_capacity(forms.len());
        for (index, form) in forms.iter().enumerate() {
            let (span, form, table) = (form.span(), form.get_ref(), format!("{table}[{index}]"));
            if !form.time_s.is_finite()
                || poses.last().is_some_and(|last| form.time_s <= last.time_s)
            {
                let reason = format!(
                    "{} must be finite and later than the pose before",
                    form.time_s
                );
                return Err(self.error(&span, &table, "time_s", reason));
            }
            let pose = self.pose(
                form.position_m,
                form.rotation_wxyz,
                form.yaw_rad,
                &span,
                &table,
            )?;
            poses.push(TimedPose {
                time_s: form.time_s,
                pose,
            });
        }
        let start = forms.first().map_or(0..0, Spanned::span);
        Trajectory::new(poses).map_err(|reason| self.error(&start, table, "time_s", reason))
    }

    pub(super) fn pose(
        &self,
        position_m: [f64; 3],
        rotation_wxyz: Option<[f64; 4]>,
        yaw_rad: Option<f64>,
        span: &Range<usize>,
        table: &str,
    ) -> Result<Pose, SceneError> {
        let translation = self.position(position_m, span, table)?;
        match (rotation_wxyz, yaw_rad) {
            (Some([w, x, y, z]), None) => {
                let rotation = DQuat::from_xyzw(x, y, z, w);
                // A file may round its quaternions; one that is far from unit length is another
                // thing in this place.
                if !rotation.is_finite() || (rotation.length() - 1.0).abs() > 1e-3 {
                    let reason = format!("[{w}, {x}, {y}, {z}] is no unit quaternion");
                    return Err(self.error(span, table, "rotation_wxyz", reason));
                }
                Ok(Pose {
                    rotation: unit(rotation),
                    translation,
                })
            }
            (None, Some(yaw_rad)) if yaw_rad.is_finite() => {
                Ok(Pose::from_yaw(yaw_rad, translation))
            }
            (None, Some(yaw_rad)) => {
                Err(self.error(span, table, "yaw_rad", format!("{yaw_rad} must be finite")))
            }
            (None, None) => Ok(Pose {
                translation,
                ..Pose::IDENTITY
            }),
            (Some(_), Some(_)) => Err(self.error(
                span,
                table,
                "yaw_rad",
                "give either 'rotation_wxyz' or 'yaw_rad'",
            )),
        }
    }

    fn position(
        &self,
        position_m: [f64; 3],
        span: &Range<usize>,
        table: &str,
    ) -> Result<DVec3, SceneError> {
        let position = DVec3::from_array(position_m);
        if position.is_finite() {
            Ok(position)
        } else {
            Err(self.error(span, table, "position_m", "must be finite"))
        }
    }

    /// [`Checker::check_name`], of what also names a file.
    pub(super) fn check_file_name<'n>(
        &self,
        names: &mut HashSet<&'n str>,
        name: &'n str,
        span: &Range<usize>,
        table: &str,
    ) -> Result<(), SceneError> {
        self.check_name(names, name, span, table)?;
        if name.contains(['/', '\\', '\0']) || name.starts_with('.') {
            let reason = format!("'{name}' names an image file: no slash, no leading dot");
            return Err(self.error(span, table, "name", reason));
        }
        Ok(())
    }

    fn check_name<'n>(
        &self,
        names: &mut HashSet<&'n str>,
        name: &'n str,
        span: &Range<usize>,
        table: &str,
    ) -> Result<(), SceneError> {
        if name.is_empty() {
            return Err(self.error(span, table, "name", "must not be empty"));
        }
        if !names.insert(name) {
            return Err(self.error(
                span,
                table,
                "name",
                format!("'{name}' is taken; names must differ"),
            ));
        }
        Ok(())
    }
}

/// The field that a complaint begins with.
pub(super) fn field_of(reason: &str) -> &str {
    reason.split(' ').next().unwrap_or_default()
}

/// `rotation` at unit length; one that already has it keeps its bits, so that writing and reading
/// changes nothing.
fn unit(rotation: DQuat) -> DQuat {
    if (rotation.length_squared() - 1.0).abs() < 1e-14 {
        rotation
    } else {
        rotation.normalize()
    }
}

/// The field that [`Intrinsics::check`] complains of.
fn intrinsics_field(intrinsics: &Intrinsics) -> &'static str {
    let focal_is_good = |focal_px: f64| focal_px.is_finite() && focal_px > 0.0;
    match intrinsics {
        k if !(1..=65_536).contains(&k.width_px) => "width_px",
        k if !(1..=65_536).contains(&k.height_px) => "height_px",
        k if !focal_is_good(k.fx_px) => "fx_px",
        k if !focal_is_good(k.fy_px) => "fy_px",
        k if !k.cx_px.is_finite() => "cx_px",
        k if !k.cy_px.is_finite() => "cy_px",
        _ => "lens",
    }
}
