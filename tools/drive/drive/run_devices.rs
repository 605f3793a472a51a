//! The devices of a run: which one drove which episode, and which are out of it.
//!
//! With `--devices`, `devices.jsonl` in the folder of the run has a line for each episode that was
//! driven and for each fault. Lines are appended, so that a run that is stopped keeps them.

use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use decouplegs::asset::write_atomically;
use decouplegs::episode::EpisodeError;
use decouplegs::gpu::{DeviceChoice, Gpu, GpuError};
use decouplegs::session::SessionError;
use serde_json::{Value, json};

use crate::arguments::warn;
use crate::device::name_of;
use crate::episode_report::DeviceUse;

/// The devices of a run.
pub struct RunDevices {
    gpus: Vec<Gpu>,
    is_out: Vec<AtomicBool>,
    /// The time at which the first episode had its place.
    began: OnceLock<Instant>,
    /// The file and its lines, where devices were named.
    log: Option<Mutex<DeviceLog>>,
}

struct DeviceLog {
    path: PathBuf,
    file: File,
    lines: Vec<Value>,
    /// Number of the first lines, which are of runs before.
    before: usize,
}

impl RunDevices {
    /// Devices of a run. With a `folder`, what they do is kept there.
    pub fn new(gpus: Vec<Gpu>, folder: Option<&Path>) -> Result<Self> {
        let log = folder
            .map(|folder| DeviceLog::open(folder.join("devices.jsonl")))
            .transpose()?;
        Ok(Self {
            is_out: gpus.iter().map(|_| AtomicBool::new(false)).collect(),
            gpus,
            began: OnceLock::new(),
            log: log.map(Mutex::new),
        })
    }

    pub fn gpus(&self) -> &[Gpu] {
        &self.gpus
    }

    /// True if the device at `position` draws no more in this run.
    pub fn is_out(&self, position: usize) -> bool {
        self.is_out[position].load(Ordering::Relaxed)
    }

    /// Notes that an episode has its place, and is driven from now on.
    pub fn begin(&self) {
        self.began.get_or_init(Instant::now);
    }

    /// Notes that the device at `position` drove `episode`.
    pub fn drove(&self, position: usize, episode: &str, took: Duration) -> Result<()> {
        self.add(|| {
            json!({
                "episode": episode, "device": self.to_json(position), "seconds": took.as_secs_f64(),
            })
        })
    }

    /// Takes the device at `position` out of the run for `error`, which it met in `episode`.
    pub fn take_out(&self, position: usize, episode: &str, error: &anyhow::Error) -> Result<()> {
        let reason = format!("{error:#}");
        if !self.is_out[position].swap(true, Ordering::Relaxed) {
            warn(&format!(
                "device {position}, {}, draws no more in this run, and {episode} goes back to the queue: {reason}",
                name_of(&self.gpus[position])
            ));
        }
        self.add(
            || json!({ "episode": episode, "device": self.to_json(position), "fault": reason }),
        )
    }

    /// Record for the report; none where no devices were named.
    pub fn report(&self) -> Option<DeviceUse> {
        let log = self.log.as_ref()?;
        let log = log.lock().unwrap_or_else(PoisonError::into_inner);
        Some(DeviceUse {
            devices: (0..self.gpus.len()).map(|at| self.to_json(at)).collect(),
            lines: log.lines.clone(),
            before: log.before,
            took: self.began.get().map(Instant::elapsed).unwrap_or_default(),
        })
    }

    fn to_json(&self, position: usize) -> Value {
        let info = self.gpus[position].info();
        json!({
            "position": position, "name": info.name, "driver": info.driver,
            "uuid": DeviceChoice::Uuid(info.uuid).to_string(),
        })
    }

    fn add(&self, line: impl FnOnce() -> Value) -> Result<()> {
        self.log.as_ref().map_or(Ok(()), |log| {
            let mut log = log.lock().unwrap_or_else(PoisonError::into_inner);
            log.add(line())
        })
    }
}

impl DeviceLog {
    /// The file at `path` and its lines; made if it does not exist. Half a line at its end, which a
    /// run left that was killed, is removed.
    fn open(path: PathBuf) -> Result<Self> {
        let text = match fs::read_to_string(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => String::new(),
            Err(error) => {
                return Err(error).with_context(|| format!("{} cannot be read", path.display()));
            }
        };
        let whole = text.rfind('\n').map_or("", |end| &text[..=end]);
        if whole.len() < text.len() {
            write_atomically(&path, |file| file.write_all(whole.as_bytes()))?;
        }
        let parsed = |(index, line): (usize, &str)| {
            serde_json::from_str(line).with_context(|| {
                format!(
                    "{}: line {} is no JSON: remove the file",
                    path.display(),
                    index + 1
                )
            })
        };
        let lines = whole
            .lines()
            .enumerate()
            .map(parsed)
            .collect::<Result<Vec<_>>>()?;
        let open = OpenOptions::new().create(true).append(true).open(&path);
        let file = open.with_context(|| format!("{} cannot be written", path.display()))?;
        Ok(Self {
            before: lines.len(),
            path,
            file,
            lines,
        })
    }

    fn add(&mut self, line: Value) -> Result<()> {
        // One call: lines of a run that is killed are whole, but for the last one.
        self.file
            .write_all(format!("{line}\n").as_bytes())
            .with_context(|| format!("{} cannot be written", self.path.display()))?;
        self.lines.push(line);
        Ok(())
    }
}

/// True if `error` says that a device is lost or full, so that another one may do the work.
pub fn is_device_fault(error: &anyhow::Error) -> bool {
    let of_session = |error: &SessionError| error.gpu().cloned();
    let gpu_error = error.chain().find_map(|cause| {
        let of_episode = match cause.downcast_ref() {
            Some(EpisodeError::Render(error)) => of_session(error),
            _ => None,
        };
        of_episode.or_else(|| cause.downcast_ref().and_then(of_session))
    });
    gpu_error.is_some_and(|error: GpuError| error.is_lost() || error.is_full())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_a_run_that_was_killed_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("devices.jsonl");
        let line = json!({ "episode": "easy_0000" });
        DeviceLog::open(path.clone())
            .unwrap()
            .add(line.clone())
            .unwrap();
        let mut file = OpenOptions::new().append(true).open(&path).unwrap();
        file.write_all(b"{\"episode\": \"ea").unwrap();
        let mut log = DeviceLog::open(path.clone()).unwrap();
        assert_eq!(log.lines, std::slice::from_ref(&line));
        log.add(line.clone()).unwrap();
        assert_eq!(
            DeviceLog::open(path.clone()).unwrap().lines,
            [line.clone(), line]
        );
        fs::write(&path, "nonsense\n").unwrap();
        let refused = format!("{:#}", DeviceLog::open(path).err().unwrap());
        assert!(refused.contains("devices.jsonl: line 1"), "{refused}");
    }

    #[test]
    fn a_fault_of_the_device_is_told_from_others() {
        let lost = || GpuError::DeviceLost {
            during: "vkQueueSubmit2",
            progress: "nothing was in flight".into(),
        };
        let drawn = EpisodeError::Render(SessionError::Gpu(lost()));
        let drawn = anyhow::Error::new(drawn).context("episode easy_0000 was not driven");
        assert!(is_device_fault(&drawn));
        assert!(is_device_fault(&SessionError::Gpu(lost()).into()));
        for other in [
            EpisodeError::Render(SessionError::NoCameras).into(),
            anyhow::anyhow!("device lost"),
            SessionError::Gpu(GpuError::NoDevice).into(),
        ] {
            assert!(!is_device_fault(&other), "{other:#}");
        }
    }
}
