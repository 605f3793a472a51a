//! Planners of others, in any language: a child process or a server on a Unix socket that speaks
//! the protocol of `planner-protocol.md`.
//!
//! Nothing that such a planner does ends more than its episode: an answer that is late, endless,
//! wrong or missing is an error with a sentence, the process is ended with all that it started, and
//! the next episode begins with a new one.

mod agents;
mod connection;
mod message;
mod process;
mod session;

use std::path::PathBuf;
use std::time::Duration;

use decouplegs_scene::plan::Plan;

pub use self::agents::ExternalAgents;
use self::message::{Answer, Introduction};
use self::session::Session;
use super::{EpisodeInfo, Observation, ObservationRequest, Planner, PlannerError};
use crate::planner::{images, sweeps};

/// `observation` as the protocol tells it to a planner, without the bytes of images and sweeps.
#[must_use]
pub fn observation_json(observation: &Observation) -> serde_json::Value {
    message::observe(observation)
}

/// Transport to an external planner.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Transport {
    /// A program and its arguments, which is started and spoken to through its stdin and stdout.
    Command(Vec<String>),
    /// A Unix socket on which a planner listens.
    Socket(PathBuf),
}

/// Timeouts of an external planner.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timeouts {
    /// Time from the planner's start to its hello: it may have to load a network.
    pub hello: Duration,
    /// Time from the first byte of a question to the last of the answer.
    pub answer: Duration,
}

impl Default for Timeouts {
    fn default() -> Self {
        Self {
            hello: Duration::from_secs(30),
            answer: Duration::from_secs(10),
        }
    }
}

/// A planner outside this program.
#[derive(Debug)]
pub struct External {
    attachment: Transport,
    timeouts: Timeouts,
    introduction: Introduction,
    /// None after a failure, until the next episode begins.
    session: Option<Session>,
}

impl External {
    /// Starts or connects to the planner and has it say what it wants to see.
    ///
    /// # Errors
    /// Returns an error if the planner cannot be started or reached, or does not introduce itself
    /// in time and form.
    pub fn open(attachment: Transport, timeouts: Timeouts) -> Result<Self, PlannerError> {
        let (session, introduction) = Session::open(&attachment, &timeouts)?;
        Ok(Self {
            attachment,
            timeouts,
            introduction,
            session: Some(session),
        })
    }

    /// Waits for answers as long as `timeouts` says.
    #[must_use]
    pub fn with_timeouts(self, timeouts: Timeouts) -> Self {
        Self { timeouts, ..self }
    }

    /// Makes sure that there is a session, a new one where the last was lost.
    fn reopen(&mut self) -> Result<(), PlannerError> {
        if self.session.as_mut().is_some_and(Session::is_open) {
            return Ok(());
        }
        self.session = None;
        let (mut session, introduction) = Session::open(&self.attachment, &self.timeouts)?;
        if introduction != self.introduction {
            return Err(session.broken(
                "introduced itself in another way than before; expected the same name and wishes",
            ));
        }
        self.session = Some(session);
        Ok(())
    }

    /// The answer to a question; a session that does not have one is over.
    fn ask(
        &mut self,
        header: &serde_json::Value,
        payload: &[&[u8]],
    ) -> Result<Answer, PlannerError> {
        let lost = || {
            PlannerError(
                "the external planner was lost; it is started again when an episode begins".into(),
            )
        };
        let answer =
            self.session
                .as_mut()
                .ok_or_else(lost)?
                .ask(header, payload, self.timeouts.answer);
        if answer.is_err() {
            self.session = None;
        }
        answer
    }

    /// Handles an answer of the wrong kind. A planner that says it failed keeps to the protocol,
    /// and may go on.
    fn refused(&mut self, answer: &Answer, asked: &str, expected: &str) -> PlannerError {
        if let Answer::Fail(reason) = answer {
            return PlannerError(format!("the external planner failed: {reason}"));
        }
        let what = format!(
            "answered `{asked}` with {}; expected {expected} or fail",
            answer.word()
        );
        self.session.take().map_or_else(
            || PlannerError(what.clone()),
            |mut session| session.broken(&what),
        )
    }
}

impl Planner for External {
    fn name(&self) -> String {
        self.introduction.name.clone()
    }

    fn sees(&self) -> ObservationRequest {
        self.introduction.sees.clone()
    }

    fn begin(&mut self, info: &EpisodeInfo) -> Result<(), PlannerError> {
        self.reopen()?;
        match self.ask(&message::begin(info), &[])? {
            Answer::Ready => Ok(()),
            other => Err(self.refused(&other, "begin", "ready")),
        }
    }

    fn plan(&mut self, observation: &Observation) -> Result<Plan, PlannerError> {
        let points: Vec<Vec<u8>> = sweeps(observation.readings).map(message::points).collect();
        let frames = images(observation.readings).map(|frame| frame.rgba);
        let payload: Vec<&[u8]> = frames.chain(points.iter().map(Vec::as_slice)).collect();
        match self.ask(&message::observe(observation), &payload)? {
            Answer::Plan { step, plan } if step == u64::from(observation.step) => Ok(plan),
            other => Err(self.refused(
                &other,
                "observe",
                &format!("a plan for step {}", observation.step),
            )),
        }
    }
}
