//! Images to a video, by ffmpeg where it is installed.

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};

/// True if ffmpeg can be started.
pub fn has_ffmpeg() -> bool {
    let asked = Command::new("ffmpeg")
        .arg("-version")
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status();
    asked.is_ok_and(|status| status.success())
}

/// The images `CAMERA_0000.png` and on in `folder` as `video`, whole or not at all.
///
/// # Errors
/// Returns an error if ffmpeg makes no video of them.
pub fn encode(folder: &Path, camera: &str, frames_per_second: f64, video: &Path) -> Result<()> {
    let part = video.with_extension("part.mp4");
    let output = Command::new("ffmpeg")
        .args([
            "-nostdin",
            "-loglevel",
            "error",
            "-y",
            "-framerate",
            &frames_per_second.to_string(),
        ])
        // Steps that were not drawn leave gaps in the numbers.
        .args(["-pattern_type", "glob", "-i"])
        .arg(folder.join(format!("{camera}_*.png")))
        // Widths and heights that are odd are not known to every player.
        .args([
            "-vf",
            "pad=ceil(iw/2)*2:ceil(ih/2)*2",
            "-pix_fmt",
            "yuv420p",
            "-crf",
            "18",
        ])
        .arg(&part)
        .output()
        .context("ffmpeg cannot be started")?;
    if !output.status.success() {
        let _ = fs::remove_file(&part);
        let said = String::from_utf8_lossy(&output.stderr);
        bail!(
            "ffmpeg made no video of {}: {}",
            folder.display(),
            said.lines().last().unwrap_or("it does not say why")
        );
    }
    fs::rename(&part, video).with_context(|| {
        format!(
            "{} cannot be renamed to {}",
            part.display(),
            video.display()
        )
    })
}
