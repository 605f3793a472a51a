//! Writes the log of an episode, record by record.

use std::ffi::OsString;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use decouplegs_scene::episode::EpisodeTick;
use decouplegs_scene::{Episode, EpisodeEnd, EpisodeHead, EpisodeStep};

use super::chain::Chain;
use super::egos::{OtherEndForm, Told};
use super::record::{EndForm, HeadForm, StepForm, to_json};
use super::sequence::Sequence;
use decouplegs_asset::sync_directory_of;
use decouplegs_asset::{AssetError, EncodeError};

/// Turns records into lines.
#[derive(Clone, Debug)]
struct Encoder {
    chain: Chain,
    /// One for each ego.
    sequences: Vec<Sequence>,
    told: Told,
    /// Number of steps that have begun.
    steps: u32,
    /// Ends of the egos that have ended, and whether they have been written.
    ends: Vec<Option<(EpisodeEnd, bool)>>,
}

impl Encoder {
    /// The encoder of an episode that has the heads and the starts of `episode`, and their lines.
    fn new(episode: &Episode) -> Result<(Self, String), EncodeError> {
        let (head, start, egos) = (&episode.head, &episode.start, episode.egos().len());
        if egos != head.scenario.egos.count() {
            return Err(EncodeError(format!(
                "records of {egos} egos; the scenario has {}",
                head.scenario.egos.count()
            )));
        }
        let sequences = episode
            .egos()
            .map(|ego| Sequence::new(&ego.head, &ego.start));
        let form = HeadForm::from_head(head, start).map_err(EncodeError)?;
        let mut encoder = Self {
            chain: Chain::new(),
            sequences: sequences.collect::<Result<_, _>>().map_err(EncodeError)?,
            told: Told::from_start(egos, start),
            steps: 0,
            ends: vec![None; egos],
        };
        let mut lines = encoder.chain.seal(&to_json(&form));
        for (number, other) in (1..).zip(&episode.others) {
            let form = encoder.told.head_form(number, other).map_err(EncodeError)?;
            lines.push_str(&encoder.chain.seal(&to_json(&form)));
        }
        Ok((encoder, lines))
    }

    /// Lines of a step of ego `ego`. Ends before the step come first.
    fn step(&mut self, ego: usize, step: &EpisodeStep) -> Result<String, EncodeError> {
        let mut lines = String::new();
        if step.step >= self.steps {
            self.steps = step.step.saturating_add(1);
            lines = self.pending_ends();
        }
        let sequence = &mut self.sequences[ego];
        sequence.step(step).map_err(EncodeError)?;
        let version = sequence.version();
        let form = match self.ends.len() {
            1 => StepForm::from_step(step, version),
            _ => {
                let form = self.told.step_form(ego, step, version);
                form.map_err(EncodeError)?
            }
        };
        lines.push_str(&self.chain.seal(&to_json(&form)));
        Ok(lines)
    }

    /// Notes the end of ego `ego`, whose line follows before the next step.
    fn end(&mut self, ego: usize, end: &EpisodeEnd) -> Result<(), EncodeError> {
        self.sequences[ego].end(end).map_err(EncodeError)?;
        self.ends[ego] = Some((end.clone(), false));
        Ok(())
    }

    /// Lines of the ends that have not been written.
    fn pending_ends(&mut self) -> String {
        let mut lines = String::new();
        for (ego, end) in self.ends.iter_mut().enumerate() {
            let Some((end, is_written @ false)) = end else {
                continue;
            };
            let form = match ego {
                0 => to_json(&EndForm::from_end(end)),
                _ => to_json(&OtherEndForm::from_end(ego, end)),
            };
            lines.push_str(&self.chain.seal(&form));
            *is_written = true;
        }
        lines
    }
}

pub(super) fn encode(episode: &Episode) -> Result<Vec<u8>, EncodeError> {
    let (mut encoder, mut lines) = Encoder::new(episode)?;
    let steps = episode.egos().map(|ego| ego.steps.len()).max();
    for step in 0..=steps.unwrap_or(0) {
        for (number, ego) in episode.egos().enumerate() {
            if ego.steps.len() == step {
                encoder.end(number, &ego.end)?;
            }
        }
        for (number, ego) in episode.egos().enumerate() {
            if let Some(step) = ego.steps.get(step) {
                lines.push_str(&encoder.step(number, step)?);
            }
        }
    }
    lines.push_str(&encoder.pending_ends());
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
        let begun = Episode {
            head: head.clone(),
            start: start.clone(),
            steps: Vec::new(),
            end: EpisodeEnd::Time,
            others: Vec::new(),
        };
        Self::create_for(path, &begun)
    }

    /// Begins the log that will be at `path`, of all egos of `episode`, which is at its start. The
    /// directory must exist.
    ///
    /// # Errors
    /// Returns the errors of [`Self::create`].
    pub fn create_for(path: &Path, episode: &Episode) -> Result<Self, AssetError> {
        let encoded = Encoder::new(episode);
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

    /// Adds a step of the only ego.
    ///
    /// # Errors
    /// [`AssetError::Encode`] when no log can hold it, after which the log is as before;
    /// [`AssetError::Write`], after which nothing more can be added.
    pub fn append(&mut self, step: &EpisodeStep) -> Result<(), AssetError> {
        self.append_for(0, step)
    }

    /// Adds a step of ego `ego`. Steps of several egos come step by step, in the order of the
    /// egos.
    ///
    /// # Errors
    /// Returns the errors of [`Self::append`].
    pub fn append_for(&mut self, ego: usize, step: &EpisodeStep) -> Result<(), AssetError> {
        // The encoder moves on only with what is written.
        let mut encoder = self.encoder.clone();
        let lines = encoder
            .step(ego, step)
            .map_err(|source| encode_error(&self.path, source))?;
        self.write(&lines)?;
        self.encoder = encoder;
        Ok(())
    }

    /// Notes the end of ego `ego`.
    ///
    /// # Errors
    /// [`AssetError::Encode`] when no log can hold the end.
    pub fn end_for(&mut self, ego: usize, end: &EpisodeEnd) -> Result<(), AssetError> {
        let noted = self.encoder.end(ego, end);
        noted.map_err(|source| encode_error(&self.path, source))
    }

    /// Adds the end of the only ego, forces everything to the disk and gives the log its name.
    ///
    /// # Errors
    /// [`AssetError::Encode`] when no log can hold the end, [`AssetError::Write`]. What was written
    /// stays under the name with `.part`.
    pub fn finish(mut self, end: &EpisodeEnd) -> Result<(), AssetError> {
        self.end_for(0, end)?;
        self.close()
    }

    /// Forces everything to the disk and gives the log its name, once all egos have ended.
    ///
    /// # Errors
    /// [`AssetError::Encode`] when an ego has not ended, [`AssetError::Write`]. What was written
    /// stays under the name with `.part`.
    pub fn close(mut self) -> Result<(), AssetError> {
        if let Some(ego) = self.encoder.ends.iter().position(Option::is_none) {
            let reason = EncodeError(format!("ego {ego} has not ended"));
            return Err(encode_error(&self.path, reason));
        }
        let lines = self.encoder.pending_ends();
        self.write(&lines)?;
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
