//! Places in the text of a TOML file, so that every complaint names its line and key.

use std::ops::Range;

use crate::{SceneError, memory};

/// Text that is being checked.
pub struct Checker<'a> {
    pub text: &'a str,
}

impl Checker<'_> {
    /// A complaint about `field` of the table called `table`, whose text begins in `span`.
    pub fn error(
        &self,
        span: &Range<usize>,
        table: &str,
        field: &str,
        reason: impl Into<String>,
    ) -> SceneError {
        let key = if table.is_empty() {
            field.to_owned()
        } else {
            format!("{table}.{field}")
        };
        SceneError {
            line: self.line_of(span.start, field),
            key,
            reason: reason.into(),
        }
    }

    /// The line of `field` in the table at byte `start`, or of the table where it does not write
    /// the field out.
    fn line_of(&self, start: usize, field: &str) -> usize {
        let line_at =
            |byte: usize| 1 + self.text.bytes().take(byte).filter(|&b| b == b'\n').count();
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

/// Error of serde or of the TOML grammar, with its line.
pub fn syntax_error(text: &str, error: &toml::de::Error) -> SceneError {
    let start = error.span().map_or(0, |span| span.start);
    let line = 1 + text
        .bytes()
        .take(start)
        .filter(|&byte| byte == b'\n')
        .count();
    let found = text.lines().nth(line - 1).unwrap_or_default().trim();
    let key: String = found
        .split('=')
        .next()
        .unwrap_or_default()
        .trim()
        .chars()
        .take(60)
        .collect();
    let key = if key.is_empty() {
        "the file".to_owned()
    } else {
        key
    };
    // One of several tables that was written as the only one.
    let table = found
        .strip_prefix('[')
        .and_then(|found| found.strip_suffix(']'));
    let reason = match (error.message(), table) {
        ("invalid type: map, expected a sequence", Some(table)) => {
            format!(
                "expected a table in double brackets, [[{table}]], of which there may be several"
            )
        }
        (message, _) => message.to_owned(),
    };
    SceneError { line, key, reason }
}

/// Most dots of a key, such as `agent.trajectory.time_s`. The parser makes a table for each, so
/// that `a.a.a...` of a few megabytes would take gigabytes.
const KEY_DOTS_MAX: usize = 8;
/// About the memory that the parser takes for each byte of a text.
const PARSER_BYTES_PER_BYTE: u64 = 100;

/// The text of a TOML file, or the line where it is not UTF-8 or too deep.
pub fn text_of(bytes: &[u8]) -> Result<&str, SceneError> {
    let line_at = |byte: usize| 1 + bytes[..byte].iter().filter(|&&byte| byte == b'\n').count();
    let text = std::str::from_utf8(bytes).map_err(|error| {
        let line = line_at(error.valid_up_to());
        SceneError {
            line,
            key: "text".into(),
            reason:
                "is not UTF-8; expected a TOML file, which is text: splats and packages are none"
                    .into(),
        }
    })?;
    memory::require_product(
        "reading this text",
        &[bytes.len() as u64],
        PARSER_BYTES_PER_BYTE,
    )
    .map_err(|reason| SceneError {
        line: 1,
        key: "text".into(),
        reason: reason.into(),
    })?;
    for (index, line) in text.lines().enumerate() {
        // Numbers, in lines of arrays, stand behind commas or brackets.
        let key = line
            .split(['=', ',', ']', '"', '\'', '#'])
            .next()
            .unwrap_or_default();
        if key.bytes().filter(|&byte| byte == b'.').count() > KEY_DOTS_MAX {
            let reason = format!(
                "a key of more than {} parts; no table is so deep",
                KEY_DOTS_MAX + 1
            );
            return Err(SceneError {
                line: index + 1,
                key: "text".into(),
                reason,
            });
        }
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_that_may_be_there_several_times_has_double_brackets() {
        #[derive(Debug, serde::Deserialize)]
        struct Form {
            #[serde(rename = "ego")]
            _egos: Vec<toml::Table>,
        }
        let text = "version = 1\n[ego]\nposes = []\n";
        let error = toml::from_str::<Form>(text).unwrap_err();
        assert_eq!(
            syntax_error(text, &error).to_string(),
            "line 2, [ego]: expected a table in double brackets, [[ego]], of which there may be several"
        );
    }

    #[test]
    fn deep_keys_are_refused_by_their_line() {
        let deep = format!("version = 1\n{} = 1\n", vec!["a"; 3_000].join("."));
        let error = text_of(deep.as_bytes()).unwrap_err();
        assert!(
            error.line == 2 && error.reason.contains("9 parts"),
            "{error}"
        );
        let matrix = "a.b.c = [\n  [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0],\n  1.5\n]\nb = \"x.y.z.a.b.c.d.e.f.g.h\"\n";
        assert_eq!(text_of(matrix.as_bytes()), Ok(matrix));
    }
}
