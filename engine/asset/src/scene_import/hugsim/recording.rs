//! Recording that a scene of HUGSIM was trained on: cameras, the path of the ego, boxes of actors.

use std::collections::{BTreeMap, HashMap};

use decouplegs_scene::{
    Intrinsics, Lane, LaneMap, Pose, Presence, Rig, RigCamera, SplatCloud, TimedPose, Trajectory,
};
use glam::{DMat3, DQuat, DVec3};
use serde::Deserialize;

use super::{ImportedScene, TURN, is_plain};
use crate::DecodeError;

/// Most cameras: each is sought among all images.
const CAMERAS_MAX: usize = 1000;
/// Moments closer than this are one, seconds.
const SAME_TIME_S: f64 = 1e-3;
/// Height of the first camera where no ground is below it, meters.
const HEIGHT_M: f64 = 1.5;
/// Poses at which the height above the ground is measured, and splats of the ground that count.
const HEIGHT_SAMPLES: usize = 16;
const HEIGHT_RADIUS_M: f64 = 1.5;
/// Width of the lane along the recording, and the shortest distance between its points, meters.
const LANE_WIDTH_M: f64 = 3.5;
const LANE_STEP_M: f64 = 1.0;
/// Name of the lane along the recording.
const LANE: &str = "recorded";

/// The part of `meta_data.json` that is read.
#[derive(Deserialize)]
struct MetadataForm {
    frames: Vec<FrameForm>,
}

/// One image of one camera.
#[derive(Deserialize)]
struct FrameForm {
    #[serde(default)]
    rgb_path: String,
    camtoworld: Vec<Vec<f64>>,
    intrinsics: Vec<Vec<f64>>,
    width: u32,
    height: u32,
    timestamp: Option<f64>,
    #[serde(default)]
    dynamics: BTreeMap<String, Vec<Vec<f64>>>,
}

/// View of one training image.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct View {
    /// Camera, an index of [`Recording::views`]' rig.
    pub(super) camera: usize,
    /// Time of the image, seconds after the first.
    time_s: f64,
    /// Pose of the camera in the source's world.
    pub(super) source_from_camera: Pose,
}

/// Trajectory of an actor.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ActorTrack {
    /// Poses of the source's box in our world.
    pub(super) trajectory: Trajectory,
    /// Times of the frames that have it.
    pub(super) present: Presence,
}

/// Recording, in the axes of our world but for the views.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Recording {
    cameras: Vec<(String, Intrinsics)>,
    views: Vec<View>,
    tracks: BTreeMap<String, ActorTrack>,
}

impl Recording {
    /// Reads `meta_data.json`. Frames without times are `frame_rate_hz` apart per camera.
    ///
    /// # Errors
    /// Names the frame at fault.
    pub(super) fn decode(bytes: &[u8], frame_rate_hz: f64) -> Result<Self, DecodeError> {
        let form: MetadataForm = serde_json::from_slice(bytes)
            .map_err(|error| malformed(format!("it is not HUGSIM's metadata: {error}")))?;
        if form.frames.is_empty() {
            return Err(malformed("it has no frames".into()));
        }
        let first_s = form
            .frames
            .iter()
            .filter_map(|frame| frame.timestamp)
            .reduce(f64::min)
            .unwrap_or(0.0);
        let mut cameras = Cameras::default();
        let mut taken = HashMap::new();
        let mut views = Vec::new();
        let mut boxes: BTreeMap<String, Vec<TimedPose>> = BTreeMap::new();
        for (index, frame) in form.frames.iter().enumerate() {
            let at = |error: DecodeError| malformed(format!("frame {index}: {error}"));
            let name = name_of(frame, &mut taken);
            let (camera, before) = cameras.next_image(frame, &name).map_err(at)?;
            let time_s = match frame.timestamp {
                Some(time_s) => time_s - first_s,
                None => before as f64 / frame_rate_hz,
            };
            let source_from_camera = pose_of(&frame.camtoworld, "camtoworld").map_err(at)?;
            for (id, matrix) in &frame.dynamics {
                let pose = in_our_world(&pose_of(matrix, "dynamics").map_err(at)?);
                let poses = boxes.entry(id.clone()).or_default();
                poses.push(TimedPose { time_s, pose });
            }
            views.push(View {
                camera,
                time_s,
                source_from_camera,
            });
        }
        let times_s = moments(views.iter().map(|view| view.time_s).collect())?;
        let tracks = boxes
            .into_iter()
            .map(|(id, poses)| Ok((id, track_of(poses, &times_s)?)))
            .collect::<Result<_, DecodeError>>()?;
        Ok(Self {
            cameras: cameras.all,
            views,
            tracks,
        })
    }

    /// Trajectory of the actor called `id`.
    pub(super) fn track(&self, id: &str) -> Option<&ActorTrack> {
        self.tracks.get(id)
    }

    /// Training images, in the order of the file.
    pub(super) fn views(&self) -> &[View] {
        &self.views
    }

    /// Adds the cameras, the ego's trajectory and a lane along it to `scene`.
    ///
    /// The rig stands on the ground below the first camera, which is taken to be level: x is that
    /// camera's forward direction.
    ///
    /// # Errors
    /// Returns an error if intrinsics make no image.
    pub(super) fn place_ego(
        &self,
        ground: Option<&SplatCloud>,
        scene: &mut ImportedScene,
    ) -> Result<(), DecodeError> {
        let first = self.views[0].camera;
        let ahead: Vec<&View> = self.in_time(first);
        let height_m = match ground.and_then(|ground| height_m(&ahead, ground)) {
            Some(height_m) => height_m,
            None => {
                scene.notes.push(format!(
                    "no ground lies below the first camera: its height is taken as {HEIGHT_M} m"
                ));
                HEIGHT_M
            }
        };
        let rig_from_first = Pose::new(DQuat::from_mat3(&TURN), DVec3::Z * height_m);
        let first_from_rig = rig_from_first.inverse();
        let mut poses: Vec<TimedPose> = Vec::new();
        for view in ahead {
            let pose = world_from(view).then(&first_from_rig);
            if poses
                .last()
                .is_none_or(|last| view.time_s - last.time_s > SAME_TIME_S)
            {
                let time_s = view.time_s;
                poses.push(TimedPose { time_s, pose });
            }
        }
        let ego =
            Trajectory::new(poses).map_err(|reason| malformed(format!("the ego: {reason}")))?;
        scene.rig = self.rig(&ego)?;
        scene.lanes = lane_along(&ego);
        scene.notes.push(format!(
            "the rig stands {height_m:.2} m below the camera '{}'; {} cameras, {} images of {:.1} s",
            self.cameras[first].0,
            self.cameras.len(),
            self.views.len(),
            ego.end_s() - ego.start_s()
        ));
        scene.ego = Some(ego);
        Ok(())
    }

    /// Views of `camera`, by their times.
    fn in_time(&self, camera: usize) -> Vec<&View> {
        let mut views: Vec<&View> = self.views.iter().filter(|v| v.camera == camera).collect();
        views.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        views
    }

    /// Cameras on the vehicle whose trajectory is `ego`: each as it stood in the image that was
    /// taken closest to one of the first camera's.
    fn rig(&self, ego: &Trajectory) -> Result<Rig, DecodeError> {
        let mut cameras = Vec::new();
        for (camera, (name, intrinsics)) in self.cameras.iter().enumerate() {
            let off_s = |view: &View| {
                let next = ego
                    .poses()
                    .partition_point(|timed| timed.time_s < view.time_s);
                let near = ego.poses()[next.saturating_sub(1)..].iter().take(2);
                near.map(|timed| (timed.time_s - view.time_s).abs())
                    .fold(f64::INFINITY, f64::min)
            };
            let views = self.views.iter().filter(|view| view.camera == camera);
            let Some(view) = views.min_by(|a, b| off_s(a).total_cmp(&off_s(b))) else {
                continue;
            };
            intrinsics
                .check()
                .map_err(|reason| malformed(format!("camera '{name}': {reason}")))?;
            cameras.push(RigCamera {
                name: name.clone(),
                intrinsics: *intrinsics,
                rig_from_camera: ego.at(view.time_s).inverse().then(&world_from(view)),
            });
        }
        Ok(Rig::from_iter(cameras))
    }
}

/// Name of the frame's camera: the folder of its images. Images of one folder at the same time come
/// from different cameras: the second is named `NAME_2`, the third `NAME_3`.
fn name_of(frame: &FrameForm, taken: &mut HashMap<(String, u64), usize>) -> String {
    let folder = frame.rgb_path.rsplit(['/', '\\']).nth(1);
    let name = folder
        .filter(|name| is_plain(name) && *name != "images")
        .unwrap_or("camera");
    let Some(time_s) = frame.timestamp else {
        return name.to_owned();
    };
    let before = taken
        .entry((name.to_owned(), time_s.to_bits()))
        .or_default();
    *before += 1;
    match *before {
        1 => name.to_owned(),
        number => format!("{name}_{number}"),
    }
}

/// Cameras of the frames that were read.
#[derive(Default)]
struct Cameras {
    all: Vec<(String, Intrinsics)>,
    /// Indices in `all`.
    by_name: HashMap<String, usize>,
    /// Images of each camera.
    images: Vec<usize>,
}

impl Cameras {
    /// Index of the camera `name`, which is added if it is new, and its images before `frame`.
    fn next_image(&mut self, frame: &FrameForm, name: &str) -> Result<(usize, usize), DecodeError> {
        let camera = match self.by_name.get(name) {
            Some(&known) => known,
            None if self.all.len() == CAMERAS_MAX => {
                return Err(malformed(format!(
                    "more than {CAMERAS_MAX} cameras; expected those of a vehicle, each with its folder of images in 'rgb_path'"
                )));
            }
            None => {
                self.all.push((name.to_owned(), intrinsics_of(frame)?));
                self.by_name.insert(name.to_owned(), self.images.len());
                self.images.push(0);
                self.images.len() - 1
            }
        };
        self.images[camera] += 1;
        Ok((camera, self.images[camera] - 1))
    }
}

/// Intrinsics of the camera of `frame`.
fn intrinsics_of(frame: &FrameForm) -> Result<Intrinsics, DecodeError> {
    let entry = |row: usize, column: usize| {
        let value = frame.intrinsics.get(row).and_then(|row| row.get(column));
        value.copied().ok_or_else(|| {
            malformed("'intrinsics' is no matrix of three rows and columns or more".into())
        })
    };
    Ok(Intrinsics {
        fx_px: entry(0, 0)?,
        fy_px: entry(1, 1)?,
        cx_px: entry(0, 2)?,
        cy_px: entry(1, 2)?,
        ..Intrinsics::from_horizontal_fov(frame.width, frame.height, 1.0)
    })
}

/// Rigid pose of a matrix of 3 or 4 rows and 4 columns.
fn pose_of(rows: &[Vec<f64>], what: &str) -> Result<Pose, DecodeError> {
    /// Largest deviation of the rotation from an orthonormal one.
    const SKEW_MAX: f64 = 1e-2;
    let is_matrix = matches!(rows.len(), 3 | 4)
        && rows.iter().all(|row| row.len() == 4)
        && rows.iter().flatten().all(|value| value.is_finite());
    if !is_matrix {
        let message = format!("'{what}' is no finite matrix of 4 x 4 numbers");
        return Err(malformed(message));
    }
    let column = |at: usize| DVec3::new(rows[0][at], rows[1][at], rows[2][at]);
    let turn = DMat3::from_cols(column(0), column(1), column(2));
    let skew = turn.transpose() * turn - DMat3::IDENTITY;
    let largest = skew
        .to_cols_array()
        .into_iter()
        .fold(0.0, |a: f64, b| a.max(b.abs()));
    if largest > SKEW_MAX || turn.determinant() < 0.0 {
        return Err(malformed(format!(
            "'{what}' is no rigid motion: its rotation deviates by {largest:.3}"
        )));
    }
    Ok(Pose::new(DQuat::from_mat3(&turn), column(3)))
}

/// Pose in our world of a pose in the source's; the child's axes stay.
fn in_our_world(pose: &Pose) -> Pose {
    Pose::new(DQuat::from_mat3(&TURN), DVec3::ZERO).then(pose)
}

fn world_from(view: &View) -> Pose {
    in_our_world(&view.source_from_camera)
}

/// Moments of the recording, rising, none twice.
fn moments(mut times_s: Vec<f64>) -> Result<Vec<f64>, DecodeError> {
    if !times_s.iter().all(|time_s| time_s.is_finite()) {
        return Err(malformed("a time is not finite".into()));
    }
    times_s.sort_by(f64::total_cmp);
    times_s.dedup_by(|later, earlier| *later - *earlier <= SAME_TIME_S);
    Ok(times_s)
}

/// Track of an actor over `times_s`, the moments of the recording: present from half a step before
/// each frame that has it to half a step after.
fn track_of(mut poses: Vec<TimedPose>, times_s: &[f64]) -> Result<ActorTrack, DecodeError> {
    poses.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    poses.dedup_by(|later, earlier| later.time_s - earlier.time_s <= SAME_TIME_S);
    let moment = |time_s: f64| {
        let next = times_s.partition_point(|&moment_s| moment_s < time_s - SAME_TIME_S);
        next.min(times_s.len() - 1)
    };
    let mut runs: Vec<[usize; 2]> = Vec::new();
    for timed in &poses {
        let at = moment(timed.time_s);
        match runs.last_mut() {
            Some(run) if at <= run[1] + 1 => run[1] = at,
            _ => runs.push([at; 2]),
        }
    }
    let step_s = match times_s {
        [first, .., last] => (last - first) / (times_s.len() - 1) as f64,
        _ => 0.0,
    };
    // Half the way to the neighbor, so that runs with a frame between them never touch.
    let before = |at: usize| match at {
        0 => times_s[0] - 0.5 * step_s,
        _ => 0.5 * (times_s[at - 1] + times_s[at]),
    };
    let after = |at: usize| match times_s.get(at + 1) {
        Some(next) => 0.5 * (times_s[at] + next),
        None => times_s[at] + 0.5 * step_s,
    };
    let present = match runs[..] {
        [[0, last]] if last + 1 == times_s.len() => Presence::ALWAYS,
        _ => Presence::new(
            runs.iter()
                .map(|run| [before(run[0]), after(run[1])])
                .collect(),
        )
        .map_err(|reason| malformed(reason.to_string()))?,
    };
    let trajectory = Trajectory::new(poses).map_err(|reason| malformed(reason.to_string()))?;
    Ok(ActorTrack {
        trajectory,
        present,
    })
}

/// Median height of the camera of `views` above the ground, meters. None where no ground lies below
/// it.
fn height_m(views: &[&View], ground: &SplatCloud) -> Option<f64> {
    let step = views.len().div_ceil(HEIGHT_SAMPLES).max(1);
    let mut heights: Vec<f64> = Vec::new();
    for view in views.iter().step_by(step) {
        let camera = world_from(view).translation;
        let below = (0..ground.len()).map(|splat| ground.mean_m(splat));
        let mut drops: Vec<f64> = below
            .filter(|mean| camera.truncate().distance(mean.truncate()) < HEIGHT_RADIUS_M)
            .map(|mean| camera.z - mean.z)
            .filter(|drop| drop.is_finite())
            .collect();
        heights.extend(median(&mut drops));
    }
    median(&mut heights).filter(|height_m| *height_m > 0.0)
}

fn median(values: &mut [f64]) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

/// Lane of [`LANE_WIDTH_M`] along the trajectory; none where the ego hardly moves.
fn lane_along(ego: &Trajectory) -> Option<LaneMap> {
    let mut line: Vec<DVec3> = Vec::new();
    for timed in ego.poses() {
        let point = timed.pose.translation;
        if line
            .last()
            .is_none_or(|last| last.distance(point) >= LANE_STEP_M)
        {
            line.push(point);
        }
    }
    if line.len() < 2 {
        return None;
    }
    let border = |side: f64| -> Vec<DVec3> {
        let shifted = (0..line.len()).map(|at| {
            let next = line[(at + 1).min(line.len() - 1)];
            let along = (next - line[at.saturating_sub(1)])
                .truncate()
                .normalize_or_zero();
            line[at] + along.perp().extend(0.0) * (side * 0.5 * LANE_WIDTH_M)
        });
        shifted.collect()
    };
    let (left, right) = (border(1.0), border(-1.0));
    let lane = Lane {
        id: LANE.into(),
        left,
        right,
        centerline: line,
        has_height: true,
        ..Lane::default()
    };
    Some(LaneMap {
        lanes: vec![lane],
        ..LaneMap::default()
    })
}

fn malformed(message: String) -> DecodeError {
    DecodeError::Malformed(message)
}
