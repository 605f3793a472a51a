//! Support of the views of a captured place and opacity of its images, step by step of an episode,
//! in a file beside the log.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result};
use decouplegs::asset::write_atomically;
use decouplegs::drive::ViewSupport;
use decouplegs::planner::{Reading, images};
use decouplegs::render::lower_half_opacity;
use decouplegs::scene::VehicleState;

/// Opacity of the lower half of an image below which it shows holes.
pub const OPACITY_MIN: f32 = 0.9;

/// First line of a file.
const HEADER: &str = "time_s,seen,opacity,camera";

/// Support and opacity at a step.
#[derive(Clone, Debug, PartialEq)]
pub struct SeenStep {
    /// Time of the observation, seconds.
    pub time_s: f64,
    /// True if the place was seen from near the ego, in its direction.
    pub is_supported: bool,
    /// Mean opacity of the lower half of the image that has least, 0 to 1, and its camera; `None`
    /// where nothing was drawn.
    pub opacity: Option<(f32, String)>,
}

/// Path of the file beside a log.
pub fn path_beside(log: &Path) -> PathBuf {
    log.with_extension("seen.csv")
}

/// Notes what is seen while an episode is driven.
pub struct SeenWatch {
    support: Option<Arc<ViewSupport>>,
    path: PathBuf,
    ego: VehicleState,
    time_s: f64,
    steps: Vec<SeenStep>,
}

impl SeenWatch {
    /// A watch that writes to the file beside `log`. Without `support` everything is supported.
    pub fn new(support: Option<Arc<ViewSupport>>, log: &Path) -> Self {
        Self {
            support,
            path: path_beside(log),
            ego: VehicleState::default(),
            time_s: 0.0,
            steps: Vec::new(),
        }
    }

    /// Moves to the state at which the next observation is made.
    pub fn moved(&mut self, ego: VehicleState, time_s: f64) {
        (self.ego, self.time_s) = (ego, time_s);
    }

    /// Notes the readings of an observation.
    pub fn observe(&mut self, readings: &[Reading]) {
        let support = self.support.as_ref();
        let is_supported =
            support.is_none_or(|support| support.holds(self.ego.position_m, self.ego.yaw_rad));
        let opacities = images(readings).map(|frame| {
            let opacity = lower_half_opacity(frame.rgba, frame.camera.intrinsics.height_px);
            (opacity as f32, frame.camera.name.clone())
        });
        self.steps.push(SeenStep {
            time_s: self.time_s,
            is_supported,
            opacity: opacities.min_by(|a, b| a.0.total_cmp(&b.0)),
        });
    }

    /// Writes the file.
    pub fn finish(&mut self) -> Result<()> {
        let steps = std::mem::take(&mut self.steps);
        write_atomically(&self.path, |file| {
            writeln!(file, "{HEADER}")?;
            for step in &steps {
                let (opacity, camera) = match &step.opacity {
                    Some((opacity, camera)) => (format!("{opacity:.4}"), camera.as_str()),
                    None => (String::new(), ""),
                };
                let (time_s, seen) = (step.time_s, u8::from(step.is_supported));
                writeln!(file, "{time_s:.4},{seen},{opacity},{camera}")?;
            }
            Ok(())
        })?;
        Ok(())
    }
}

/// Support and opacity over an episode.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Seen {
    /// Steps in their order; none where the place is not captured.
    pub steps: Vec<SeenStep>,
}

impl Seen {
    /// Reads the file beside `log`; nothing where there is none.
    pub fn beside(log: &Path) -> Result<Self> {
        let path = path_beside(log);
        let text = match std::fs::read_to_string(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return Ok(Self::default());
            }
            Err(error) => {
                return Err(error).with_context(|| format!("{} cannot be read", path.display()));
            }
        };
        Self::parse(&text).with_context(|| {
            format!(
                "{} is no table of what was seen; expected lines of {HEADER}: remove it",
                path.display()
            )
        })
    }

    fn parse(text: &str) -> Option<Self> {
        let mut lines = text.lines();
        (lines.next()? == HEADER).then_some(())?;
        let step = |line: &str| {
            let mut fields = line.splitn(4, ',');
            let time_s = fields.next()?.parse().ok()?;
            let is_supported = fields.next()? == "1";
            let opacity = match fields.next()? {
                "" => None,
                number => Some((number.parse().ok()?, fields.next()?.to_owned())),
            };
            Some(SeenStep {
                time_s,
                is_supported,
                opacity,
            })
        };
        let steps = lines.map(step).collect::<Option<_>>()?;
        Some(Self { steps })
    }

    /// Time of the first step at which the ego had left where the place was seen from, seconds, and
    /// the share of such steps.
    pub fn left(&self) -> Option<(f64, f64)> {
        let unseen = || self.steps.iter().filter(|step| !step.is_supported);
        let first = unseen().next()?;
        Some((
            first.time_s,
            unseen().count() as f64 / self.steps.len() as f64,
        ))
    }

    /// The least opacity of the lower half of an image, with its camera and time.
    pub fn least_opacity(&self) -> Option<(f32, &str, f64)> {
        let steps = self.steps.iter();
        let known = steps.filter_map(|step| {
            let (opacity, camera) = step.opacity.as_ref()?;
            Some((*opacity, camera.as_str(), step.time_s))
        });
        known.min_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// A sentence for each way in which the images cannot be trusted.
    pub fn warnings(&self) -> Vec<String> {
        let left = self.left().map(|(from_s, share)| {
            format!(
                "from {from_s:.1} s on the ego was where, or looked where, the place was not seen from: {:.0} % of the steps",
                100.0 * share
            )
        });
        let least = self.least_opacity();
        let thin = least.filter(|(opacity, ..)| *opacity < OPACITY_MIN);
        let thin = thin.map(|(opacity, camera, time_s)| {
            format!(
                "the lower half of the image of camera {camera} is only {:.0} % opaque at {time_s:.1} s: expected {:.0} % or more",
                100.0 * opacity,
                100.0 * OPACITY_MIN
            )
        });
        left.into_iter().chain(thin).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs::scene::{CapturedView, Intrinsics, Pose, RigCamera};
    use glam::{DVec2, DVec3};

    #[test]
    fn what_was_seen_is_what_the_file_says() {
        let folder = tempfile::tempdir().unwrap();
        let log = folder.path().join("a.log");
        assert_eq!(Seen::beside(&log).unwrap(), Seen::default());
        let view = CapturedView {
            position_m: DVec3::ZERO,
            ahead: DVec3::X,
        };
        let support = ViewSupport::from_views(&[view]).map(Arc::new);
        let mut watch = SeenWatch::new(support, &log);
        let camera = |name: &str| RigCamera {
            name: name.into(),
            intrinsics: Intrinsics::from_horizontal_fov(1, 2, 1.0),
            rig_from_camera: Pose::IDENTITY,
        };
        let (front, rear) = (camera("front"), camera("rear, low"));
        // Only the lower half counts.
        let (full, thin) = ([0, 0, 0, 0, 9, 9, 9, 255], [0, 0, 0, 255, 9, 9, 9, 51]);
        for (step, x_m) in [0.0, 4.0, 8.0].into_iter().enumerate() {
            let ego = VehicleState {
                position_m: DVec2::new(x_m, 0.0),
                ..VehicleState::default()
            };
            watch.moved(ego, 0.5 * step as f64);
            let rear_image = if step == 1 { &thin } else { &full };
            let readings = [
                Reading::image(&front, &full),
                Reading::image(&rear, rear_image),
            ];
            watch.observe(&readings);
        }
        watch.finish().unwrap();
        let seen = Seen::beside(&log).unwrap();
        assert_eq!(seen.left(), Some((1.0, 1.0 / 3.0)));
        assert_eq!(seen.least_opacity(), Some((0.2, "rear, low", 0.5)));
        let warnings = seen.warnings();
        assert!(warnings[0].contains("1.0 s") && warnings[0].contains("33 %"));
        assert!(warnings[1].contains("rear, low") && warnings[1].contains("20 %"));
    }

    #[test]
    fn a_file_that_is_no_table_is_said() {
        let folder = tempfile::tempdir().unwrap();
        let log = folder.path().join("a.log");
        for text in ["", "time_s\n", "time_s,seen,opacity,camera\nx,1,,\n"] {
            std::fs::write(path_beside(&log), text).unwrap();
            let error = format!("{:#}", Seen::beside(&log).unwrap_err());
            assert!(error.contains("a.seen.csv"), "{error}");
        }
    }
}
