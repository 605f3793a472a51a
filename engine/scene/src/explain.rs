//! Errors as sentences for people.

use std::error::Error;

/// Most characters of a sentence. A field of a file may be megabytes long.
const CHARS_MAX: usize = 1000;

/// The error and its causes, one line each, as `error: ...` and ` because: ...`. A cause that the
/// line above already contains is left out, long sentences are cut, and control characters, which a
/// terminal would obey, are replaced.
#[must_use]
pub fn explain(error: &(dyn Error + 'static)) -> String {
    let mut above = error.to_string();
    let mut lines = format!("error: {}\n", one_line(&above));
    let mut next = error.source();
    while let Some(cause) = next {
        let sentence = cause.to_string();
        if !above.contains(&sentence) {
            lines.push_str(&format!("  because: {}\n", one_line(&sentence)));
        }
        (above, next) = (sentence, cause.source());
    }
    lines
}

/// `text` without control characters, cut to 1000 characters. Its start and end are kept: a path
/// stands first, the advice last.
#[must_use]
pub fn one_line(text: &str) -> String {
    let shown = |c: char| if c.is_control() { '\u{fffd}' } else { c };
    let count = text.chars().count();
    if count <= CHARS_MAX {
        return text.chars().map(shown).collect();
    }
    let half = CHARS_MAX / 2;
    let start = text.chars().take(half).map(shown);
    start
        .chain(" [...] ".chars())
        .chain(text.chars().skip(count - half).map(shown))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error)]
    #[error("{0}")]
    struct Told(String, #[source] Option<Box<Told>>);

    #[test]
    fn a_cause_is_told_once() {
        let disk = Told("disk on fire".into(), None);
        let write = Told(
            "cannot write a.ply: disk on fire".into(),
            Some(Box::new(disk)),
        );
        let street = Told("the street was not written".into(), Some(Box::new(write)));
        assert_eq!(
            explain(&street),
            "error: the street was not written\n  because: cannot write a.ply: disk on fire\n"
        );
    }

    #[test]
    fn long_and_hostile_sentences_are_tamed() {
        let hostile = Told(
            format!("a\u{1b}[2Jb\nc.ply: {}; copy it again", "x".repeat(30_000)),
            None,
        );
        let message = explain(&hostile);
        assert!(
            message.len() < 1200 && message.starts_with("error: a\u{fffd}[2Jb\u{fffd}c.ply"),
            "{message}"
        );
        assert!(message.ends_with("; copy it again\n"), "{message}");
    }
}
