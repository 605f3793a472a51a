//! Way of a camera through keyframes, as the viewer writes it and `render` follows it.
//!
//! A file is JSON: `{"camera_path": 1, "keys": [{"time_s", "position_m", "rotation", "fov_deg"}]}`.
//! A camera is at each key at its time. Between keys, position and field of view are cubic in time
//! (Catmull-Rom with the times of the keys), and the rotation goes along the shorter great circle.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use glam::DQuat;
use serde::{Deserialize, Serialize};

use crate::free_view::{FOVS_DEG, FreeLens, FreeView};

/// Version of the files.
const VERSION: u32 = 1;
/// Keys of a path.
const KEYS_MAX: usize = 1000;
/// Bytes of a file: [`KEYS_MAX`] keys, with room for spaces.
const FILE_BYTES_MAX: u64 = 1 << 20;
/// Largest time, seconds.
const TIME_MAX_S: f64 = 1e9;
/// Images of one path.
const IMAGES_MAX: f64 = 1e5;

/// Camera at a time.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Key {
    /// Time of the scene, seconds; above that of the key before.
    pub time_s: f64,
    /// Position in the world, meters.
    pub position_m: [f64; 3],
    /// Rotation, a quaternion x, y, z, w; x right, y down, z forward.
    pub rotation: [f64; 4],
    /// Vertical field of view, degrees.
    pub fov_deg: f64,
}

/// Way of a camera.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraPath {
    keys: Vec<Key>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    camera_path: u32,
    keys: Vec<Key>,
}

impl CameraPath {
    /// The way through `keys`, at least one.
    ///
    /// # Errors
    /// A sentence that names the key at fault.
    pub fn from_keys(keys: Vec<Key>) -> Result<Self, String> {
        if keys.is_empty() || keys.len() > KEYS_MAX {
            return Err(format!(
                "keys: expected 1 to {KEYS_MAX}, found {}",
                keys.len()
            ));
        }
        for (index, key) in keys.iter().enumerate() {
            let at = index + 1;
            let before_s = index.checked_sub(1).map(|before| keys[before].time_s);
            // So written, a NaN is refused.
            let is_later = before_s.is_none_or(|before_s| key.time_s > before_s);
            if !(key.time_s.abs() <= TIME_MAX_S && is_later) {
                return Err(format!(
                    "key {at}: expected a time_s after that of the key before, found {}",
                    key.time_s
                ));
            }
            let checked = key.view().check();
            checked.map_err(|expected| format!("key {at}: {expected}"))?;
        }
        Ok(Self { keys })
    }

    /// Reads the file at `path`.
    ///
    /// # Errors
    /// Returns an error that names the file and what is wrong in it.
    pub fn read(path: &Path) -> Result<Self> {
        let shown = path.display();
        let bytes = std::fs::metadata(path).map(|facts| facts.len());
        let bytes = bytes.with_context(|| format!("cannot read {shown}"))?;
        ensure!(
            bytes <= FILE_BYTES_MAX,
            "{shown} has {bytes} bytes, and a camera path has at most {FILE_BYTES_MAX}: is it another file?"
        );
        let text = std::fs::read_to_string(path);
        let text = text.with_context(|| format!("cannot read {shown}"))?;
        let path = Self::decode(&text);
        path.map_err(|reason| anyhow::anyhow!("{shown} is no camera path: {reason}. The viewer writes one: 'decouplegs view', Camera path, Save"))
    }

    /// Reads the text of a file.
    ///
    /// # Errors
    /// A sentence about what was expected.
    pub fn decode(text: &str) -> Result<Self, String> {
        let file: File = serde_json::from_str(text).map_err(|error| error.to_string())?;
        if file.camera_path != VERSION {
            return Err(format!(
                "camera_path: expected version {VERSION}, found {}",
                file.camera_path
            ));
        }
        Self::from_keys(file.keys)
    }

    /// First and last time, seconds.
    #[must_use]
    pub fn span_s(&self) -> [f64; 2] {
        let last = self.keys.len() - 1;
        [self.keys[0].time_s, self.keys[last].time_s]
    }

    /// Times of images at `rate_hz`, from the first key to the last.
    ///
    /// # Errors
    /// A sentence, if there are too many.
    pub fn times_s(&self, rate_hz: f64) -> Result<Vec<f64>, String> {
        let [begin_s, end_s] = self.span_s();
        let intervals = (end_s - begin_s) * rate_hz;
        if !(0.0..IMAGES_MAX).contains(&intervals) {
            return Err(format!(
                "{intervals:.0} images are more than {IMAGES_MAX}: choose a lower rate"
            ));
        }
        // Times are decimal: a hair below the last counts.
        let count = (intervals + 1e-6).floor() as usize + 1;
        Ok((0..count)
            .map(|index| begin_s + index as f64 / rate_hz)
            .collect())
    }

    /// The camera at `time_s`; before the first key and after the last, that of the key.
    #[must_use]
    pub fn at(&self, time_s: f64) -> Key {
        let keys = &self.keys;
        let after = keys.partition_point(|key| key.time_s <= time_s);
        let (Some(before), Some(to)) = (after.checked_sub(1), keys.get(after)) else {
            let nearest = after.min(1) * (keys.len() - 1);
            return keys[nearest];
        };
        let from = &keys[before];
        if from.time_s == time_s {
            return *from;
        }
        let span_s = to.time_s - from.time_s;
        let share = (time_s - from.time_s) / span_s;
        let (begins, ends) = (self.slope(before), self.slope(after));
        let mut between = [0.0; 4];
        for (axis, value) in between.iter_mut().enumerate() {
            let ends_at = [from.numbers()[axis], to.numbers()[axis]];
            *value = hermite(ends_at, [begins[axis], ends[axis]], span_s, share);
        }
        let [from_turn, to_turn] =
            [from, to].map(|key| DQuat::from_array(key.rotation).normalize());
        let [x, y, z, fov_deg] = between;
        Key {
            time_s,
            position_m: [x, y, z],
            rotation: from_turn.slerp(to_turn, share).normalize().to_array(),
            fov_deg: fov_deg.clamp(FOVS_DEG[0], FOVS_DEG[1]),
        }
    }

    /// Change per second of position and field of view at key `index`: that between its neighbors.
    fn slope(&self, index: usize) -> [f64; 4] {
        let last = self.keys.len() - 1;
        let (before, after) = (index.saturating_sub(1), (index + 1).min(last));
        let (from, to) = (&self.keys[before], &self.keys[after]);
        let span_s = (to.time_s - from.time_s).max(f64::MIN_POSITIVE);
        std::array::from_fn(|axis| (to.numbers()[axis] - from.numbers()[axis]) / span_s)
    }
}

impl Key {
    /// The pinhole at the key.
    #[must_use]
    pub fn view(&self) -> FreeView {
        FreeView {
            position_m: self.position_m,
            rotation: self.rotation,
            lens: FreeLens::Fov(self.fov_deg),
        }
    }

    /// Position and field of view.
    fn numbers(&self) -> [f64; 4] {
        let [x, y, z] = self.position_m;
        [x, y, z, self.fov_deg]
    }
}

/// Cubic from `ends` with `slopes` per second over `span_s`, at `share` of it.
fn hermite(ends: [f64; 2], slopes: [f64; 2], span_s: f64, share: f64) -> f64 {
    let (s, rest) = (share, 1.0 - share);
    let value = ends[0] * rest * rest * (1.0 + 2.0 * s) + ends[1] * s * s * (3.0 - 2.0 * s);
    value + span_s * s * rest * (slopes[0] * rest - slopes[1] * s)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn key(time_s: f64, x_m: f64, yaw_rad: f64) -> Key {
        Key {
            time_s,
            position_m: [x_m, 0.0, 2.0],
            rotation: DQuat::from_rotation_z(yaw_rad).to_array(),
            fov_deg: 60.0,
        }
    }

    fn path(keys: &[Key]) -> CameraPath {
        CameraPath::from_keys(keys.to_vec()).unwrap()
    }

    #[test]
    fn a_camera_is_at_its_keys_and_moves_without_jumps() {
        let keys = [key(1.0, 0.0, 0.0), key(2.0, 4.0, 1.0), key(5.0, 6.0, -2.0)];
        let way = path(&keys);
        assert_eq!(way.span_s(), [1.0, 5.0]);
        for key in &keys {
            assert_eq!(way.at(key.time_s), *key);
        }
        assert_eq!(way.at(0.0), keys[0]);
        assert_eq!(way.at(9.0), keys[2]);
        let x_m = |time_s: f64| way.at(time_s).position_m[0];
        let step_s = 1e-3;
        let mut before = 0.0;
        for step in 1..4000 {
            let time_s = 1.0 + step_s * f64::from(step);
            let speed = (x_m(time_s) - x_m(time_s - step_s)) / step_s;
            // No leap of the speed either, where a path of lines would have one of 3.3 m/s.
            assert!(
                step == 1 || (speed - before).abs() < 0.03,
                "{time_s}: {speed}"
            );
            before = speed;
        }
        // Along a line at one speed it stays on the line.
        let line = path(&[key(0.0, 0.0, 0.0), key(1.0, 2.0, 0.0), key(3.0, 6.0, 0.0)]);
        assert!((line.at(2.2).position_m[0] - 4.4).abs() < 1e-12);
        // The shorter way round.
        let half = path(&[key(0.0, 0.0, 3.0), key(1.0, 0.0, -3.0)]).at(0.5);
        let ahead = half.view().pose().rotation * DVec3::X;
        assert!(ahead.x < -0.999, "{ahead}");
    }

    #[test]
    fn times_reach_the_last_key() {
        let way = path(&[key(0.2, 0.0, 0.0), key(0.5, 1.0, 0.0)]);
        assert_eq!(way.times_s(10.0).unwrap().len(), 4);
        assert_eq!(path(&[key(3.0, 0.0, 0.0)]).times_s(10.0).unwrap(), [3.0]);
        let long = path(&[key(0.0, 0.0, 0.0), key(1e8, 1.0, 0.0)]);
        assert!(long.times_s(240.0).unwrap_err().contains("lower rate"));
    }

    #[test]
    fn files_that_are_no_path_are_explained() {
        let good = r#"{"camera_path":1,"keys":[{"time_s":0,"position_m":[0,0,2],"rotation":[0,0,0,1],"fov_deg":60},{"time_s":1,"position_m":[0,0,2],"rotation":[0,0,0,1],"fov_deg":60}]}"#;
        assert!(CameraPath::decode(good).is_ok());
        for (text, word) in [
            ("", "EOF"),
            ("[]", "invalid"),
            (r#"{"camera_path":1,"keys":[]}"#, "1 to 1000"),
            (&good.replace("h\":1", "h\":2"), "version 1"),
            (&good.replace("\"time_s\":1", "\"time_s\":0"), "key 2"),
            (&good.replace("\"time_s\":1", "\"time_s\":1e300"), "key 2"),
            (&good.replace("60}]", "170}]"), "key 2"),
            (&good.replace("fov_deg", "fov"), "fov"),
        ] {
            let refused = CameraPath::decode(text).unwrap_err();
            assert!(refused.contains(word), "{text}: {refused}");
        }
        let deep = "[".repeat(100_000);
        assert!(CameraPath::decode(&deep).is_err());
    }
}
