//! Scans that a scene is compared with.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::{Context, Result};
use decouplegs::asset::{LoadedScene, Scan, read_scan};
use decouplegs::scene::Pose;

/// A file of a scan, and the time at which the scene's LiDAR was where it was taken.
#[derive(Clone, Debug, PartialEq)]
pub struct ScanFile {
    pub path: PathBuf,
    /// Seconds; `None` where the file tells the pose, or the scene begins there.
    pub time_s: Option<f64>,
}

impl FromStr for ScanFile {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let Some((path, time)) = text.rsplit_once('@') else {
            return Ok(Self {
                path: text.into(),
                time_s: None,
            });
        };
        match time.parse::<f64>() {
            Ok(time_s) if time_s.is_finite() && !path.is_empty() => Ok(Self {
                path: path.into(),
                time_s: Some(time_s),
            }),
            _ => Err(format!("expected FILE or FILE@SECONDS, found {text:?}")),
        }
    }
}

impl ScanFile {
    /// The scan, and the pose of its sensor: that of the file, otherwise that of the first LiDAR of
    /// `loaded` at the time asked for.
    ///
    /// # Errors
    /// Returns an error if the file is no scan, or neither tells the pose.
    pub fn read(&self, loaded: &LoadedScene) -> Result<(Scan, Pose)> {
        let scan = read_scan(&self.path)?;
        let pose = match (self.time_s, scan.world_from_lidar) {
            (None, Some(pose)) => pose,
            (time_s, _) => {
                let lidar = loaded
                    .rig
                    .lidars()
                    .next()
                    .with_context(|| no_pose(&self.path))?;
                let time_s = time_s.unwrap_or(loaded.ego.start_s());
                loaded.ego.at(time_s).then(&lidar.rig_from_lidar)
            }
        };
        Ok((scan, pose))
    }

    /// Name without folder and ending.
    pub fn name(&self) -> String {
        let stem = self.path.file_stem().unwrap_or_default().to_string_lossy();
        stem.trim_end_matches(".pcd").to_owned()
    }
}

fn no_pose(path: &Path) -> String {
    format!(
        "{} does not tell where its sensor was, and the scene has no LiDAR: give the scene file a [[lidar]], or the scan as .npz with world_from_lidar",
        path.display()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scans_are_named_with_their_times() {
        let parse = |text: &str| text.parse::<ScanFile>();
        let plain = parse("a/000001.pcd.bin").unwrap();
        assert_eq!((plain.time_s, plain.name().as_str()), (None, "000001"));
        assert_eq!(parse("b.bin@2.5").unwrap().time_s, Some(2.5));
        assert!(parse("b.bin@x").is_err() && parse("@1").is_err());
    }
}
