//! Images of panes at a row of times, written to a folder.

use std::io::Write;
use std::path::{Path, PathBuf};

use decouplegs::asset::{Replaces, write_in_folder};
use decouplegs::explain::explain;
use decouplegs_cli::camera_path::CameraPath;
use decouplegs_cli::{png_bytes, video};

use crate::drawing::{Drawn, Shot};
use crate::protocol::{CameraRequest, Pane, Pinhole, Recording, View};

/// Recording that goes on, an image of each pane at a time.
pub struct Recorder {
    /// Client that asked for it.
    pub client: u64,
    view: View,
    /// Way that cameras of the user take.
    path: Option<CameraPath>,
    folder: PathBuf,
    begin_s: f64,
    rate_hz: f64,
    count: usize,
    written: usize,
}

impl Recorder {
    /// Makes the folder.
    ///
    /// # Errors
    /// A sentence.
    pub fn begin(client: u64, view: View, recording: &Recording) -> Result<Self, String> {
        if view.panes.is_empty() {
            return Err("there is no view to record".into());
        }
        let path = match recording.path.is_empty() {
            true => None,
            false => Some(CameraPath::from_keys(recording.path.clone())?),
        };
        let folder = PathBuf::from(&recording.folder);
        std::fs::create_dir(&folder).map_err(|error| {
            format!(
                "the folder {} cannot be made: {error}. Choose another name",
                folder.display()
            )
        })?;
        let [begin_s, end_s] = recording.span_s;
        // Times of the scene are decimal: a hair below the last counts.
        let count = ((end_s - begin_s) * recording.rate_hz + 1e-6).floor() as usize + 1;
        Ok(Self {
            client,
            view,
            path,
            folder,
            begin_s,
            rate_hz: recording.rate_hz,
            count,
            written: 0,
        })
    }

    /// Time of the next image, seconds; `None` when all are written.
    pub fn next_s(&self) -> Option<f64> {
        let time_s = self.begin_s + self.written as f64 / self.rate_hz;
        (self.written < self.count).then_some(time_s)
    }

    /// Panes at `time_s`: cameras of the user are where the path has them.
    pub fn view_at(&self, time_s: f64) -> View {
        let mut view = self.view.clone();
        if let Some(path) = &self.path {
            let at = path.at(time_s);
            let at = Pinhole {
                position_m: at.position_m,
                rotation: at.rotation,
                fov_deg: at.fov_deg,
            };
            for pane in &mut view.panes {
                if !matches!(pane.camera, CameraRequest::Named { .. }) {
                    pane.camera = CameraRequest::Free(at);
                }
            }
        }
        view
    }

    /// Times that are done, and all.
    pub fn progress(&self) -> [usize; 2] {
        [self.written, self.count]
    }

    /// Writes the images of the next time.
    ///
    /// # Errors
    /// A sentence.
    pub fn write(&mut self, shots: &[Shot], drawn: &[Drawn]) -> Result<(), String> {
        for (shot, image) in shots.iter().zip(drawn) {
            let bytes = png_bytes::encode(&image.rgba, image.size_px)?;
            let name = format!("{}_{:05}.png", name_of(&shot.pane), self.written);
            let path = self.folder.join(name);
            let written = write_in_folder(&path, Replaces::Nothing, |file| file.write_all(&bytes));
            written.map_err(|error| explain(&error))?;
        }
        self.written += 1;
        Ok(())
    }

    /// Makes a video of each pane, where ffmpeg is installed. Returns a sentence about what was
    /// written.
    ///
    /// # Errors
    /// A sentence.
    pub fn finish(&self) -> Result<String, String> {
        let folder = self.folder.display();
        let what = format!("{} images of each view are in {folder}", self.written);
        if !video::has_ffmpeg() {
            return Ok(format!("{what}; no video, since ffmpeg is not installed"));
        }
        for pane in &self.view.panes {
            let name = name_of(pane);
            let video = Path::new(&self.folder).join(format!("{name}.mp4"));
            let made = video::encode(&self.folder, &name, self.rate_hz, &video);
            made.map_err(|error| explain(error.as_ref()))?;
        }
        Ok(format!("{what}, with a video of each"))
    }
}

/// Name of a pane in files.
fn name_of(pane: &Pane) -> String {
    format!("view{:04}", pane.stream)
}
