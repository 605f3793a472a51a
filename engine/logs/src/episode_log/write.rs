//! Writes the log of an episode, record by record.

use std::ffi::OsString;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use decouplegs_scene::episode::EpisodeTick;
use decouplegs_scene::{Episode, EpisodeEnd, EpisodeHead, EpisodeStep};

use super::chain::Chain;
use super::record::{EndForm, HeadForm, StepForm, to_json};
use super::sequence::Sequence;
use decouplegs_asset::sync_directory_of;
use decouplegs_asset::{AssetError, EncodeError};

/// Turns records into lines.
#[derive(Debug)]
struct Encoder {
    chain: Chain,
    sequence: Sequence,
}

impl Encoder {
    fn new(head: &EpisodeHead, start: &EpisodeTick) -> Result<(Self, String), EncodeError> {
        let sequence = Sequence::new(head, start).map_err(EncodeError)?;
        let form = HeadForm::from_head(head, start).map_err(EncodeError)?;
        let mut chain = Chain::new();
        let line = chain.seal(&to_json(&form));
        Ok((Self { chain, sequence }, line))
    }

    fn step(&mut self, step: &EpisodeStep) -> Result<String, EncodeError> {
        self.sequence.step(step).map_err(EncodeError)?;
        Ok(self.chain.seal(&to_json(&StepForm::from_step(
            step,
            self.sequence.version(),
        ))))
    }

    fn end(&mut self, end: &EpisodeEnd) -> Result<String, EncodeError> {
        self.sequence.end(end).map_err(EncodeError)?;
        Ok(self.chain.seal(&to_json(&EndForm::from_end(end))))
    }
}

pub(super) fn encode(episode: &Episode) -> Result<Vec<u8>, EncodeError> {
    let (mut encoder, mut lines) = Encoder::new(&episode.head, &episode.start)?;
    for step in &episode.steps {
        lines.push_str(&encoder.step(step)?);
    }
    lines.push_str(&encoder.end(&episode.end)?);
    Ok(lines.into_bytes())
}

/// The log of an episode that is going on.
///
/// It grows under the name of its path with `.part` behind it, each record handed to the operating
/// system as it comes, and gets its own name with its last record: a log under its own name is
/// whole. What a crash leaves behind is overwritten by the next log of the same path.
#[derive(Debug)]
pub struct EpisodeLog {
    path: PathBuf,
    part: PathBuf,
    file: File,
    encoder: Encoder,
    /// True after a missing or broken record: nothing can follow it.
    broken: bool,
}

impl EpisodeLog {
    /// Begins the log that will be at `path`, with what is known before the episode. The directory
    /// must exist.
    ///
    /// # Errors
    /// [`AssetError::Encode`] when no log can hold it, [`AssetError::Write`] of the file that
    /// grows.
    pub fn create(
        path: &Path,
        head: &EpisodeHead,
        start: &EpisodeTick,
    ) -> Result<Self, AssetError> {
        let encoded = Encoder::new(head, start);
        let (encoder, line) = encoded.map_err(|source| encode_error(path, source))?;
        let mut name: OsString = path.as_os_str().to_owned();
        name.push(".part");
        let part = PathBuf::from(name);
        let file = File::create(&part).map_err(|source| AssetError::Write {
            path: part.clone(),
            source,
        })?;
        let mut log = Self {
            path: path.to_owned(),
            part,
            file,
            encoder,
            broken: false,
        };
        log.write(&line)?;
        Ok(log)
    }

    /// Adds a step.
    ///
    /// # Errors
    /// [`AssetError::Encode`] when no log can hold it, after which the log is as before;
    /// [`AssetError::Write`], after which nothing more can be added.
    pub fn append(&mut self, step: &EpisodeStep) -> Result<(), AssetError> {
        // The encoder moves on only with what is written.
        let mut encoder = Encoder {
            chain: self.encoder.chain.clone(),
            sequence: self.encoder.sequence.clone(),
        };
        let line = encoder
            .step(step)
            .map_err(|source| encode_error(&self.path, source))?;
        self.write(&line)?;
        self.encoder = encoder;
        Ok(())
    }

    /// Adds the end, forces everything to the disk and gives the log its name.
    ///
    /// # Errors
    /// [`AssetError::Encode`] when no log can hold the end, [`AssetError::Write`]. What was written
    /// stays under the name with `.part`.
    pub fn finish(mut self, end: &EpisodeEnd) -> Result<(), AssetError> {
        let line = self
            .encoder
            .end(end)
            .map_err(|source| encode_error(&self.path, source))?;
        self.write(&line)?;
        self.file.sync_data().map_err(|source| AssetError::Write {
            path: self.part.clone(),
            source,
        })?;
        std::fs::rename(&self.part, &self.path).map_err(|source| AssetError::Write {
            path: self.path.clone(),
            source,
        })?;
        sync_directory_of(&self.path);
        Ok(())
    }

    /// The file that grows until the log is finished.
    #[must_use]
    pub fn part_path(&self) -> &Path {
        &self.part
    }

    fn write(&mut self, line: &str) -> Result<(), AssetError> {
        let write_error = |source| AssetError::Write {
            path: self.part.clone(),
            source,
        };
        if self.broken {
            return Err(write_error(io::Error::other(
                "a record before this one could not be written; begin the log anew",
            )));
        }
        self.file.write_all(line.as_bytes()).map_err(|source| {
            self.broken = true;
            write_error(source)
        })
    }
}

fn encode_error(path: &Path, source: EncodeError) -> AssetError {
    AssetError::Encode {
        path: path.to_owned(),
        format: "an episode log",
        source,
    }
}
