//! Reads an episode from the bytes of its log.

use decouplegs_scene::episode::EpisodeTick;
use decouplegs_scene::{Episode, EpisodeEnd, EpisodeHead, EpisodeStep};

use super::chain::Chain;
use super::record::{EndForm, FormatForm, HeadForm, Record, StepForm, to_json};
use super::sequence::Sequence;
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
    let (head, start, mut sequence) = first
        .and_then(|line| head(&mut chain, line))
        .map_err(|reason| at(1, reason))?;
    let mut episode = Episode {
        head,
        start,
        steps: Vec::new(),
        end: EpisodeEnd::Time,
    };
    let mut end: Option<EpisodeEnd> = None;
    while let Some(line) = lines.next() {
        let number = lines.line;
        if end.is_some() {
            return Err(at(number, "follows the end of the episode".into()));
        }
        match line
            .and_then(|line| record(&mut chain, line, &mut sequence))
            .map_err(|reason| at(number, reason))?
        {
            Decoded::Step(step) => episode.push(step),
            Decoded::End(found) => end = Some(found),
        }
    }
    let missing = "is missing: the log ends without telling how the episode ended; it was cut short, drive the episode again";
    episode.end = end.ok_or_else(|| at(lines.line + 1, missing.into()))?;
    Ok(episode)
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

enum Decoded {
    Step(EpisodeStep),
    End(EpisodeEnd),
}

fn record(chain: &mut Chain, line: &[u8], sequence: &mut Sequence) -> Result<Decoded, String> {
    let payload = chain.open(line)?;
    match Record::parse(payload)? {
        Record::Step(form) => {
            let step = form.into_step()?;
            check_canonical(
                payload,
                &to_json(&StepForm::from_step(&step, sequence.version())),
            )?;
            sequence.step(&step)?;
            Ok(Decoded::Step(step))
        }
        Record::End(form) => {
            let end = form.into_end()?;
            check_canonical(payload, &to_json(&EndForm::from_end(&end)))?;
            sequence.end(&end)?;
            Ok(Decoded::End(end))
        }
    }
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
