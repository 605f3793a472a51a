//! Drivers of agents by the names that the command line gives them.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use super::AgentDriver;
use crate::planner::{ExternalAgents, PlannerChoice, PlannerError, Timeouts, Transport};

/// Choice of a driver of agents.
///
/// | text | driver |
/// |---|---|
/// | `exec:COMMAND ARGUMENTS` | [`ExternalAgents`], a process |
/// | `unix:PATH` | [`ExternalAgents`], a server on a Unix socket |
/// | `onnx:MODEL` | a network in a file, in programs with the feature `onnx` |
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum AgentDriverChoice {
    /// A program outside this one.
    External(Transport),
    /// A network in an ONNX file.
    Onnx(PathBuf),
}

impl AgentDriverChoice {
    /// Opens a driver of this kind.
    ///
    /// # Errors
    /// A sentence, if it cannot be reached, started or read.
    pub fn open(&self, timeouts: Timeouts) -> Result<Box<dyn AgentDriver>, PlannerError> {
        match self {
            Self::External(transport) => {
                Ok(Box::new(ExternalAgents::open(transport.clone(), timeouts)?))
            }
            #[cfg(feature = "onnx")]
            Self::Onnx(path) => Ok(Box::new(super::Onnx::open(path)?)),
            #[cfg(not(feature = "onnx"))]
            Self::Onnx(path) => Err(PlannerError(format!(
                "{} cannot be run: this program was built without the feature onnx; build it with --features onnx, or drive by exec:COMMAND",
                path.display()
            ))),
        }
    }
}

impl FromStr for AgentDriverChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Some(path) = text.strip_prefix("onnx:").filter(|path| !path.is_empty()) {
            return Ok(Self::Onnx(path.into()));
        }
        let is_external = text.starts_with("exec:") || text.starts_with("unix:");
        match is_external.then(|| text.parse()) {
            Some(Ok(PlannerChoice::External(transport))) => Ok(Self::External(transport)),
            Some(Err(reason)) if text.starts_with("exec:") => Err(reason),
            _ => Err(format!(
                "unknown driver of agents {text:?}; expected exec:COMMAND ARGUMENTS, unix:PATH or onnx:MODEL"
            )),
        }
    }
}

impl fmt::Display for AgentDriverChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::External(transport) => PlannerChoice::External(transport.clone()).fmt(f),
            Self::Onnx(path) => write!(f, "onnx:{}", path.display()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn choices_read_back_what_they_show() {
        for text in ["exec:python3 'a b.py'", "unix:run/a.sock", "onnx:a b.onnx"] {
            let choice: AgentDriverChoice = text.parse().unwrap();
            assert_eq!(choice.to_string(), text);
        }
        for text in ["", "lane-follow", "exec:", "unix:", "onnx:", "replay:a.log"] {
            let reason = text.parse::<AgentDriverChoice>().unwrap_err();
            assert!(reason.contains("expected exec:COMMAND"), "{reason}");
        }
    }
}
