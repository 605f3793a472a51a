//! Reads an episode from the bytes of its log.

use decouplegs_scene::episode::EpisodeTick;
use decouplegs_scene::{Episode, EpisodeEnd, EpisodeHead};

use super::chain::Chain;
use super::egos::{OtherEndForm, OtherHeadForm, Told};
use super::record::{EndForm, FormatForm, HeadForm, Record, StepForm, to_json};
use super::sequence::Sequence;
use super::write::encode;
use super::{FORMAT, VERSION};
use decouplegs_asset::DecodeError;

pub(super) fn decode(bytes: &[u8]) -> Result<Episode, DecodeError> {
    let mut chain = Chain::new();
    let mut lines = Lines {
        rest: bytes,
        line: 0,
    };
    let Some(first) = lines.next() else {
        return Err(DecodeError::Malformed(
            "is empty; an episode log has at least two lines".into(),
        ));
    };
    let (head, start, sequence) = first
        .and_then(|line| head(&mut chain, line))
        .map_err(|reason| at(1, reason))?;
    let mut decoder = Decoder::new(chain, head, start, sequence);
    while let Some(line) = lines.next() {
        let read = line.and_then(|line| decoder.line(line));
        read.map_err(|reason| at(lines.line, reason))?;
    }
    let episode = decoder.into_episode(lines.line + 1)?;
    check_several(&episode, bytes)?;
    Ok(episode)
}

/// Several egos have one order of lines.
fn check_several(episode: &Episode, bytes: &[u8]) -> Result<(), DecodeError> {
    let is_same = || encode(episode).is_ok_and(|written| written == bytes);
    if episode.others.is_empty() || is_same() {
        return Ok(());
    }
    let reason = "the lines of the egos are not in the order in which this program writes them";
    Err(DecodeError::Malformed(reason.into()))
}

/// Episode of which some lines have been read.
struct Decoder {
    chain: Chain,
    egos: usize,
    episode: Episode,
    /// One for each ego whose head has been read.
    sequences: Vec<Sequence>,
    ends: Vec<Option<EpisodeEnd>>,
    told: Told,
}

impl Decoder {
    fn new(chain: Chain, head: EpisodeHead, start: EpisodeTick, sequence: Sequence) -> Self {
        let egos = head.scenario.egos.count();
        Self {
            chain,
            egos,
            told: Told::from_start(egos, &start),
            episode: Episode {
                head,
                start,
                steps: Vec::new(),
                end: EpisodeEnd::Time,
                others: Vec::new(),
            },
            sequences: vec![sequence],
            ends: vec![None; egos],
        }
    }

    /// Reads a line after the first.
    fn line(&mut self, line: &[u8]) -> Result<(), String> {
        if self.ends.iter().all(Option::is_some) {
            return Err("follows the end of the episode".into());
        }
        let payload = self.chain.open(line)?;
        if self.sequences.len() < self.egos {
            return self.other_head(payload);
        }
        match Record::parse(payload)? {
            Record::Step(form) => self.step(payload, form),
            Record::End(ego, form) => self.end(payload, ego, form),
        }
    }

    fn other_head(&mut self, payload: &str) -> Result<(), String> {
        let ego = self.sequences.len();
        let form: OtherHeadForm = serde_json::from_str(payload)
            .map_err(|error| format!("is no head of ego {ego}: {error}"))?;
        check_canonical(payload, &to_json(&form))?;
        let (head, start) = self.told.head(&self.episode.head, ego, form)?;
        self.sequences.push(Sequence::new(&head, &start)?);
        self.episode.others.push(Episode {
            head,
            start,
            steps: Vec::new(),
            end: EpisodeEnd::Time,
            others: Vec::new(),
        });
        Ok(())
    }

    /// Checks that ego `ego` is there and has not ended.
    fn check_drives(&self, ego: usize) -> Result<(), String> {
        match self.ends.get(ego) {
            Some(None) => Ok(()),
            Some(Some(_)) => Err(format!("follows the end of ego {ego}")),
            None => Err(format!("tells of ego {ego} of {}", self.egos)),
        }
    }

    fn step(&mut self, payload: &str, form: StepForm) -> Result<(), String> {
        let ego = form.ego;
        self.check_drives(ego)?;
        let mut step = form.into_step()?;
        let version = self.sequences[ego].version();
        let written = match self.egos {
            1 => StepForm::from_step(&step, version),
            _ => {
                self.told.complete_step(ego, &mut step)?;
                self.told.step_form(ego, &step, version)?
            }
        };
        check_canonical(payload, &to_json(&written))?;
        self.sequences[ego].step(&step)?;
        self.episode.ego_mut(ego).push(step);
        Ok(())
    }

    fn end(&mut self, payload: &str, ego: usize, form: EndForm) -> Result<(), String> {
        self.check_drives(ego)?;
        let end = form.into_end()?;
        let written = match ego {
            0 => to_json(&EndForm::from_end(&end)),
            _ => to_json(&OtherEndForm::from_end(ego, &end)),
        };
        check_canonical(payload, &written)?;
        self.sequences[ego].end(&end)?;
        self.ends[ego] = Some(end);
        Ok(())
    }

    /// The episode, where `line` is the number of the line after the last.
    fn into_episode(mut self, line: usize) -> Result<Episode, DecodeError> {
        let missing = "is missing: the log ends without telling how the episode ended; it was cut short, drive the episode again";
        for (ego, end) in self.ends.into_iter().enumerate() {
            let end = end.ok_or_else(|| at(line, missing.into()))?;
            self.episode.ego_mut(ego).end = end;
        }
        Ok(self.episode)
    }
}

fn at(line: usize, reason: String) -> DecodeError {
    DecodeError::Malformed(format!("line {line}: {reason}"))
}

/// Lines without their ends; the last must have one.
struct Lines<'a> {
    rest: &'a [u8],
    /// The last line given, from 1.
    line: usize,
}

impl<'a> Lines<'a> {
    fn next(&mut self) -> Option<Result<&'a [u8], String>> {
        if self.rest.is_empty() {
            return None;
        }
        self.line += 1;
        let Some(length) = self.rest.iter().position(|&byte| byte == b'\n') else {
            self.rest = &[];
            return Some(Err(
                "has no end: the log was cut short, drive the episode again".into(),
            ));
        };
        let line = &self.rest[..length];
        self.rest = &self.rest[length + 1..];
        Some(Ok(line))
    }
}

fn head(chain: &mut Chain, line: &[u8]) -> Result<(EpisodeHead, EpisodeTick, Sequence), String> {
    let payload = chain.open(line)?;
    let json_error = |error: serde_json::Error| format!("is no head of an episode log: {error}");
    let FormatForm { format, version } = serde_json::from_str(payload).map_err(json_error)?;
    if format != FORMAT || !(1..=VERSION).contains(&version) {
        return Err(format!(
            "is of format {format:?}, version {version}; this program reads {FORMAT:?}, versions 1 to {VERSION}"
        ));
    }
    let form: HeadForm = serde_json::from_str(payload).map_err(json_error)?;
    check_canonical(payload, &to_json(&form))?;
    let (head, start) = form.into_head()?;
    let sequence = Sequence::new(&head, &start)?;
    Ok((head, start, sequence))
}

/// One episode has one log: what reads the same is written the same.
fn check_canonical(found: &str, expected: &str) -> Result<(), String> {
    if found == expected {
        return Ok(());
    }
    let byte = found
        .bytes()
        .zip(expected.bytes())
        .take_while(|(a, b)| a == b)
        .count();
    Err(format!(
        "is not written as this program writes it, from byte {byte} of its record on"
    ))
}
