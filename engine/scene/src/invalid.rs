//! The error of values that make no sense.

/// Reason why a value cannot be used: one sentence with the value that was found and what was
/// expected. Callers add where it comes from, such as the file or the agent.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Invalid(String);

impl Invalid {
    /// The error whose sentence is `reason`.
    #[must_use]
    pub fn new(reason: impl Into<String>) -> Self {
        Self(reason.into())
    }

    /// The sentence.
    #[must_use]
    pub fn reason(&self) -> &str {
        &self.0
    }
}

impl From<String> for Invalid {
    fn from(reason: String) -> Self {
        Self(reason)
    }
}

impl From<&str> for Invalid {
    fn from(reason: &str) -> Self {
        Self(reason.to_owned())
    }
}

/// The sentence, for errors that begin with the place of the value.
impl From<Invalid> for String {
    fn from(error: Invalid) -> Self {
        error.0
    }
}
