//! Places in the text of a TOML file, so that every complaint names its line and key.

use std::ops::Range;

use crate::SceneError;

/// Text that is being checked.
pub(crate) struct Checker<'a> {
    pub(crate) text: &'a str,
}

impl Checker<'_> {
    /// A complaint about `field` of the table called `table`, whose text begins in `span`.
    pub(crate) fn error(&self, span: &Range<usize>, table: &str, field: &str, reason: impl Into<String>) -> SceneError {
        let key = if table.is_empty() { field.to_owned() } else { format!("{table}.{field}") };
        SceneError { line: self.line_of(span.start, field), key, reason: reason.into() }
    }

    /// The line of `field` in the table at byte `start`, or of the table where it does not write the field out.
    fn line_of(&self, start: usize, field: &str) -> usize {
        let line_at = |byte: usize| 1 + self.text.bytes().take(byte).filter(|&b| b == b'\n').count();
        let table = self.text.get(start..).unwrap_or_default();
        let mut offset = 0;
        for (index, line) in table.split_inclusive('\n').enumerate() {
            // The table ends where the next begins.
            if index > 0 && line.trim_start().starts_with('[') {
                break;
            }
            let key = line.split('=').next().unwrap_or_default();
            if line.contains('=') && key.trim() == field {
                return line_at(start + offset);
            }
            offset += line.len();
        }
        line_at(start)
    }
}

/// What serde or the TOML grammar complain of, with its line.
pub(crate) fn syntax_error(text: &str, error: &toml::de::Error) -> SceneError {
    let start = error.span().map_or(0, |span| span.start);
    let line = 1 + text.bytes().take(start).filter(|&byte| byte == b'\n').count();
    let found = text.lines().nth(line - 1).unwrap_or_default().trim();
    let key: String = found.split('=').next().unwrap_or_default().trim().chars().take(60).collect();
    let key = if key.is_empty() { "the file".to_owned() } else { key };
    SceneError { line, key, reason: error.message().to_owned() }
}

/// The text of a file, or the line where it is not UTF-8.
pub(crate) fn text_of(bytes: &[u8]) -> Result<&str, SceneError> {
    std::str::from_utf8(bytes).map_err(|error| {
        let line = 1 + bytes[..error.valid_up_to()].iter().filter(|&&byte| byte == b'\n').count();
        SceneError { line, key: "text".into(), reason: "is not UTF-8".into() }
    })
}
