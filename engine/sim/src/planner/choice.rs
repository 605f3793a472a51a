//! Planners by the names that the command line gives them.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use decouplegs_logs::read_episode_log;

use super::external::{External, Timeouts, Transport};
use super::{
    ConstantVelocity, DrivingStyle, LaneFollow, Learned, Planner, PlannerError, Replay, Vision,
};

/// Choice of a planner. It can be opened many times over: each thread that drives episodes has a
/// planner of its own.
///
/// | text | planner |
/// |---|---|
/// | `constant-velocity` | [`ConstantVelocity`] |
/// | `lane-follow`, `lane-follow-cautious`, `lane-follow-brisk` | [`LaneFollow`], by its style |
/// | `vision` | [`Vision`] |
/// | `learned` | [`Learned`] |
/// | `learned:FILE` | [`Learned`] with the network in this file |
/// | `replay:LOG` | [`Replay`] of an episode's log |
/// | `exec:COMMAND ARGUMENTS` | [`External`], a process; words with blanks stand in `'` or `"` |
/// | `unix:PATH` | [`External`], a server on a Unix socket |
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PlannerChoice {
    /// Planner that drives straight on.
    ConstantVelocity,
    /// Privileged planner that follows lanes.
    LaneFollow(DrivingStyle),
    /// Planner that drives by camera images.
    Vision,
    /// Planner that learned to drive by camera images, with the network in this file; `None` for
    /// its own.
    Learned(Option<PathBuf>),
    /// The way of the ego in the episode of this log.
    Replay(PathBuf),
    /// An external planner.
    External(Transport),
}

impl PlannerChoice {
    /// Opens a planner of this kind. External planners answer within `timeouts`.
    ///
    /// # Errors
    /// Returns an error if an external planner cannot be reached or started, or if a log cannot be
    /// read or replayed.
    pub fn open(&self, timeouts: Timeouts) -> Result<Box<dyn Planner>, PlannerError> {
        Ok(match self {
            Self::ConstantVelocity => Box::new(ConstantVelocity),
            Self::LaneFollow(style) => Box::new(LaneFollow::new(*style)),
            Self::Vision => Box::new(Vision::default()),
            Self::Learned(None) => Box::new(Learned::default()),
            Self::Learned(Some(file)) => Box::new(Learned::from_file(file)?),
            Self::Replay(log) => {
                let episode =
                    read_episode_log(log).map_err(|error| PlannerError(error.to_string()))?;
                Box::new(Replay::of_episode(&episode)?)
            }
            Self::External(attachment) => Box::new(External::open(attachment.clone(), timeouts)?),
        })
    }
}

impl FromStr for PlannerChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (kind, rest) = text
            .split_once(':')
            .map_or((text, None), |(kind, rest)| (kind, Some(rest)));
        let style = DrivingStyle::by_name(kind).filter(|_| rest.is_none());
        if let Some(style) = style {
            return Ok(Self::LaneFollow(style));
        }
        match (kind, rest) {
            ("constant-velocity", None) => Ok(Self::ConstantVelocity),
            ("vision", None) => Ok(Self::Vision),
            ("learned", None) => Ok(Self::Learned(None)),
            ("learned", Some(file)) if !file.is_empty() => Ok(Self::Learned(Some(file.into()))),
            ("replay", Some(log)) if !log.is_empty() => Ok(Self::Replay(log.into())),
            ("unix", Some(path)) if !path.is_empty() => {
                Ok(Self::External(Transport::Socket(path.into())))
            }
            ("exec", Some(command)) => match words_of(command)? {
                words if words.is_empty() => {
                    Err("exec: names no program; expected exec:COMMAND ARGUMENTS".into())
                }
                words => Ok(Self::External(Transport::Command(words))),
            },
            _ => Err(format!(
                "unknown planner {text:?}; expected constant-velocity, lane-follow, lane-follow-cautious, lane-follow-brisk, vision, learned, learned:FILE, replay:LOG, exec:COMMAND ARGUMENTS or unix:PATH"
            )),
        }
    }
}

impl fmt::Display for PlannerChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::ConstantVelocity => f.write_str("constant-velocity"),
            Self::LaneFollow(style) => f.write_str(style.name()),
            Self::Vision => f.write_str("vision"),
            Self::Learned(None) => f.write_str("learned"),
            Self::Learned(Some(file)) => write!(f, "learned:{}", file.display()),
            Self::Replay(log) => write!(f, "replay:{}", log.display()),
            Self::External(Transport::Socket(path)) => write!(f, "unix:{}", path.display()),
            Self::External(Transport::Command(words)) => {
                write!(
                    f,
                    "exec:{}",
                    words
                        .iter()
                        .map(|word| quoted(word))
                        .collect::<Vec<_>>()
                        .join(" ")
                )
            }
        }
    }
}

/// The words of a command: parted by blanks, those with blanks in `'` or `"`.
fn words_of(command: &str) -> Result<Vec<String>, String> {
    let (mut words, mut word, mut quote) = (Vec::new(), None::<String>, None);
    for c in command.chars() {
        match quote {
            Some(open) if c == open => quote = None,
            None if c == '\'' || c == '"' => {
                quote = Some(c);
                word.get_or_insert_default();
            }
            None if c.is_whitespace() => words.extend(word.take()),
            _ => word.get_or_insert_default().push(c),
        }
    }
    match quote {
        Some(open) => Err(format!("a {open} in {command:?} is not closed")),
        None => Ok(words.into_iter().chain(word).collect()),
    }
}

/// A word so that [`words_of`] reads it back.
fn quoted(word: &str) -> String {
    let needs_none = |c: char| !(c.is_whitespace() || c == '\'' || c == '"');
    match word {
        _ if !word.is_empty() && word.chars().all(needs_none) => word.to_owned(),
        _ if !word.contains('\'') => format!("'{word}'"),
        // Single quotes stand in double ones, all else in single ones.
        _ => word
            .split('\'')
            .map(|part| format!("'{part}'"))
            .collect::<Vec<_>>()
            .join("\"'\""),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_choice_reads_back_what_it_shows() {
        let texts = [
            "constant-velocity",
            "lane-follow",
            "lane-follow-cautious",
            "lane-follow-brisk",
            "vision",
            "learned",
            "learned:a b.safetensors",
            "replay:a b/c.log",
            "unix:run/p.sock",
            "exec:python3 -u my.py",
        ];
        for text in texts {
            assert_eq!(text.parse::<PlannerChoice>().unwrap().to_string(), text);
        }
        let words = ["a b", "it's", "\"", "", "x'\"y", "plain"]
            .map(String::from)
            .to_vec();
        let choice = PlannerChoice::External(Transport::Command(words));
        assert_eq!(
            choice.to_string().parse::<PlannerChoice>().unwrap(),
            choice,
            "{choice}"
        );
    }

    #[test]
    fn what_is_no_planner_is_refused_with_what_is() {
        for text in [
            "",
            "fast",
            "replay:",
            "unix:",
            "replay",
            "lane-follow:x",
            "learned:",
        ] {
            let refusal = text.parse::<PlannerChoice>().unwrap_err();
            assert!(
                refusal.contains("expected constant-velocity, lane-follow, lane-follow-cautious, lane-follow-brisk, vision, learned, learned:FILE, replay:LOG"),
                "{refusal}"
            );
        }
        assert!(
            "exec:  "
                .parse::<PlannerChoice>()
                .unwrap_err()
                .contains("names no program")
        );
        assert!(
            "exec:sh -c 'x"
                .parse::<PlannerChoice>()
                .unwrap_err()
                .contains("is not closed")
        );
    }
}
