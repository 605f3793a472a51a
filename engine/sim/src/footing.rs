//! The ground below agents, and their wheels on it.

use std::path::{Path, PathBuf};

use decouplegs_asset::{
    AssetError, SceneFile, coded_asset, read_coded, read_placed_splats, read_splats,
};
use decouplegs_drive::register::grounding::set_on_ground;
use decouplegs_drive::{Ground, GroundGuides, GroundOptions, Survey};
use decouplegs_scene::{Invalid, TimedPose, Trajectory};

/// An asset that has no size.
#[derive(Debug, thiserror::Error)]
pub enum FootingError {
    /// The file.
    #[error(transparent)]
    Asset(#[from] AssetError),
    /// No splat with a finite mean.
    #[error("{} has no splats that could stand somewhere", .0.display())]
    Empty(PathBuf),
}

/// The ground that agents are set on.
pub struct Footing {
    ground: Ground,
}

/// A trajectory set on the ground.
pub struct Grounded {
    /// Poses with the wheels on the ground.
    pub trajectory: Trajectory,
    /// Poses that have ground below them; the others are as they were.
    pub grounded: usize,
    /// Farthest that a pose was raised or lowered, meters; lowered is below zero.
    pub raised_max_m: f64,
}

/// The ground of the background of `scene`, whose paths are relative to `directory`, guided by its
/// survey and the way of its ego.
///
/// # Errors
/// Returns an error if the file cannot be read.
pub fn ground_of(scene: &SceneFile, directory: &Path) -> Result<Ground, AssetError> {
    let background = read_placed_splats(&directory.join(&scene.background))?;
    let survey = Survey::from_points(scene.read_ground(directory, &background)?);
    let (cloud, origin) = (background.cloud, scene.origin + background.origin);
    let ground = Ground::new(&cloud, origin, &GroundOptions::default());
    let mut guides = match &scene.ego {
        Some(ego) => GroundGuides::for_way(ego.poses(), scene.ego_height_m),
        None if survey.is_some() => GroundGuides::default(),
        None => return Ok(ground),
    };
    guides.survey = survey.as_ref();
    Ok(ground.guided(&cloud, guides))
}

/// Length, width and height of the asset at `path`, meters: as a compressed one says, or of the box
/// about the means of its splats.
///
/// # Errors
/// Returns an error if the file cannot be read, or has no splats.
pub fn dims_of(path: &Path) -> Result<[f64; 3], FootingError> {
    if coded_asset::has_extension(path) {
        return Ok(read_coded(path)?.cloud.dims_m.map(f64::from));
    }
    let cloud = read_splats(path)?;
    let dims_m = cloud
        .bounds()
        .half_extent()
        .map(|half_m| 2.0 * f64::from(half_m));
    if !dims_m.iter().all(|side_m| side_m.is_finite()) {
        return Err(FootingError::Empty(path.to_owned()));
    }
    Ok(dims_m)
}

impl Footing {
    /// The ground of the background of `scene`, whose paths are relative to `directory`.
    ///
    /// # Errors
    /// Returns an error if the file cannot be read.
    pub fn open(scene: &SceneFile, directory: &Path) -> Result<Self, AssetError> {
        let ground = ground_of(scene, directory)?;
        Ok(Self { ground })
    }

    /// A sentence where heights may be wrong, because splats show the road poorly.
    #[must_use]
    pub fn warning(&self) -> Option<String> {
        self.ground.quality()?.warning()
    }

    /// `trajectory` with the wheels of a box of `dims_m` on the ground at each pose: the heading
    /// stays, and the position from above.
    ///
    /// # Errors
    /// Returns an error if the poses are no trajectory.
    pub fn under(&self, trajectory: &Trajectory, dims_m: [f64; 3]) -> Result<Grounded, Invalid> {
        let (mut grounded, mut raised_max_m) = (0, 0f64);
        let mut set = |timed: &TimedPose| {
            let Some((_, pose)) = set_on_ground(&self.ground, &timed.pose, dims_m) else {
                return *timed;
            };
            grounded += 1;
            let raised_m = pose.translation.z - timed.pose.translation.z;
            if raised_m.abs() > raised_max_m.abs() {
                raised_max_m = raised_m;
            }
            TimedPose { pose, ..*timed }
        };
        let poses = trajectory.poses().iter().map(&mut set).collect();
        let trajectory = Trajectory::new(poses)?;
        Ok(Grounded {
            trajectory,
            grounded,
            raised_max_m,
        })
    }
}

#[cfg(test)]
mod tests {
    use decouplegs_drive::register::grounding::corners;
    use decouplegs_scene::{Pose, SplatCloud};
    use glam::{DVec2, DVec3};

    use super::*;

    /// A slope that rises by 5 % towards x, 30 m long, of discs at every quarter of a meter.
    fn slope() -> Footing {
        let positions: Vec<(f32, f32)> = (-60..60)
            .flat_map(|x| (-16..16).map(move |y| (0.25 * x as f32, 0.25 * y as f32)))
            .collect();
        let count = positions.len();
        let cloud = SplatCloud {
            means: positions.iter().map(|(x, y)| [*x, *y, 0.05 * x]).collect(),
            scales: vec![[0.2, 0.2, 0.005]; count],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; count],
            opacities: vec![0.9; count],
            sh_degree: 0,
            sh_dc: vec![[0.0; 3]; count],
            sh_rest: vec![],
        };
        Footing {
            ground: Ground::new(
                &cloud,
                DVec3::new(500.0, 800.0, 90.0),
                &GroundOptions::default(),
            ),
        }
    }

    #[test]
    fn wheels_stand_on_a_slope_however_far_they_were_from_it() {
        let (footing, dims_m) = (slope(), [4.4, 1.8, 1.5]);
        for z_m in [0.3, 1.4, 40.0] {
            let floating =
                Trajectory::standing(Pose::from_yaw(2.0, DVec3::new(503.0, 801.0, 90.0 + z_m)));
            let set = footing.under(&floating, dims_m).unwrap();
            let pose = set.trajectory.poses()[0].pose;
            assert_eq!(
                (set.grounded, pose.translation.truncate()),
                (1, DVec2::new(503.0, 801.0))
            );
            assert!((pose.heading_rad() - 2.0).abs() < 1e-9);
            for corner in corners(dims_m) {
                let wheel = pose.transform(corner.extend(-0.5 * dims_m[2]))
                    - DVec3::new(500.0, 800.0, 90.0);
                assert!((wheel.z - 0.05 * wheel.x).abs() < 0.01, "{z_m}: {wheel}");
            }
            assert!((set.raised_max_m - (pose.translation.z - 90.0 - z_m)).abs() < 1e-12);
        }
    }

    #[test]
    fn where_no_ground_is_the_pose_stays() {
        let away = Trajectory::standing(Pose::from_yaw(0.0, DVec3::new(900.0, 801.0, 90.0)));
        let set = slope().under(&away, [4.4, 1.8, 1.5]).unwrap();
        assert_eq!((set.grounded, set.trajectory), (0, away));
    }
}
