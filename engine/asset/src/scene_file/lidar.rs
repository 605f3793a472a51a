//! The `[[lidar]]` tables of a scene file.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use decouplegs_scene::{Pose, RigLidar};
use serde::{Deserialize, Serialize};
use toml::Spanned;

use super::files::SceneFiles;
use super::form::wxyz;
use crate::lidar_file::{is_built_in, read_from, read_lidar};
use crate::toml_text::Checker;
use crate::{AssetError, SceneError};

/// LiDARs of a scene file at most.
const LIDARS_MAX: usize = 64;

/// A LiDAR of a scene file.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneLidar {
    /// Names the sweep; unique in the rig.
    pub name: String,
    /// Model: one of [`crate::lidar_names`], or a file, a path relative to the scene file.
    pub sensor: PathBuf,
    /// Pose on the vehicle.
    pub rig_from_lidar: Pose,
}

impl SceneLidar {
    /// The file of the model; `None` where the model comes with the program.
    pub(crate) fn file_mut(&mut self) -> Option<&mut PathBuf> {
        (!is_built_in(&self.sensor)).then_some(&mut self.sensor)
    }

    /// The LiDAR with its model, read from `files` unless it comes with the program.
    pub(super) fn load(&self, files: &dyn SceneFiles) -> Result<RigLidar, AssetError> {
        let model = match is_built_in(&self.sensor) {
            true => read_lidar(&self.sensor)?,
            false => read_from(&files.bytes(&self.sensor)?, &files.path(&self.sensor))?,
        };
        Ok(RigLidar {
            name: self.name.clone(),
            model: Arc::new(model),
            rig_from_lidar: self.rig_from_lidar,
        })
    }
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LidarForm {
    name: String,
    sensor: String,
    position_m: [f64; 3],
    #[serde(skip_serializing_if = "Option::is_none")]
    rotation_wxyz: Option<[f64; 4]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    yaw_rad: Option<f64>,
}

impl LidarForm {
    /// The form of `lidar`; `path` makes text of its model.
    pub(super) fn from_lidar(
        lidar: &SceneLidar,
        path: impl Fn(&Path) -> Result<String, String>,
    ) -> Result<Self, String> {
        Ok(Self {
            name: lidar.name.clone(),
            sensor: path(&lidar.sensor)?,
            position_m: lidar.rig_from_lidar.translation.to_array(),
            rotation_wxyz: Some(wxyz(lidar.rig_from_lidar.rotation)),
            yaw_rad: None,
        })
    }
}

impl Checker<'_> {
    /// The LiDARs of `forms`, whose names differ from `names` and one another.
    pub(super) fn lidars<'n>(
        &self,
        forms: &'n [Spanned<LidarForm>],
        names: &mut HashSet<&'n str>,
    ) -> Result<Vec<SceneLidar>, SceneError> {
        let lidar = |(index, form): (usize, &'n Spanned<LidarForm>)| {
            let (span, form, table) = (form.span(), form.get_ref(), format!("lidar[{index}]"));
            self.check_file_name(names, &form.name, &span, &table)?;
            if index >= LIDARS_MAX {
                let reason = format!("{} LiDARs; expected at most {LIDARS_MAX}", forms.len());
                return Err(self.error(&span, &table, "name", reason));
            }
            let LidarForm {
                position_m,
                rotation_wxyz,
                yaw_rad,
                ..
            } = *form;
            Ok(SceneLidar {
                name: form.name.clone(),
                sensor: form.sensor.as_str().into(),
                rig_from_lidar: self.pose(position_m, rotation_wxyz, yaw_rad, &span, &table)?,
            })
        };
        forms.iter().enumerate().map(lidar).collect()
    }
}
