//! YAML documents as values.

use decouplegs_asset::DecodeError;
use saphyr_parser::{Event, Parser, ScalarStyle};
use serde_json::{Map, Value};

/// Nested collections, at most.
const DEPTH_MAX: usize = 64;
/// Values of a document, at most.
const VALUES_MAX: usize = 100_000;

/// A collection that is being read.
enum Open {
    List(Vec<Value>),
    /// Entries, and the key whose value comes next.
    Table(Map<String, Value>, Option<String>),
}

/// The first document in `text`, by the core schema of YAML 1.2: plain words are text, numbers,
/// true, false or null. Anchors are ignored; aliases are refused, since a short text of them stands
/// for a document of any size.
///
/// # Errors
/// Returns an error where `text` is no YAML, a key is no plain word or there twice, or the document
/// is nested too deep or has too many values.
pub(crate) fn parse(text: &str) -> Result<Value, DecodeError> {
    let malformed =
        |line: usize, reason: &str| DecodeError::Malformed(format!("line {line}: {reason}"));
    let mut open: Vec<Open> = Vec::new();
    let mut values = 0;
    for event in Parser::new_from_str(text) {
        let (event, span) =
            event.map_err(|error| malformed(error.marker().line(), error.info()))?;
        let line = span.start.line();
        let value = match event {
            Event::Alias(_) => return Err(malformed(line, "aliases (*name) are not read")),
            Event::SequenceStart(..) | Event::MappingStart(..) => {
                if open.len() >= DEPTH_MAX {
                    let reason = format!("nested deeper than {DEPTH_MAX} levels");
                    return Err(malformed(line, &reason));
                }
                open.push(match event {
                    Event::SequenceStart(..) => Open::List(Vec::new()),
                    _ => Open::Table(Map::new(), None),
                });
                continue;
            }
            Event::SequenceEnd | Event::MappingEnd => match open.pop() {
                Some(Open::List(list)) => Value::Array(list),
                Some(Open::Table(table, _)) => Value::Object(table),
                None => return Err(malformed(line, "a collection ends that did not begin")),
            },
            Event::Scalar(word, style, ..) => {
                if let Some(Open::Table(table, key @ None)) = open.last_mut() {
                    if table.contains_key(&*word) {
                        return Err(malformed(line, &format!("the key {word:?} is there twice")));
                    }
                    *key = Some(word.into_owned());
                    continue;
                }
                match style {
                    ScalarStyle::Plain => plain(&word),
                    _ => Value::String(word.into_owned()),
                }
            }
            Event::DocumentEnd => break,
            _ => continue,
        };
        values += 1;
        if values > VALUES_MAX {
            return Err(malformed(line, &format!("more than {VALUES_MAX} values")));
        }
        match open.last_mut() {
            None => return Ok(value),
            Some(Open::List(list)) => list.push(value),
            Some(Open::Table(table, key)) => {
                let Some(key) = key.take() else {
                    return Err(malformed(line, "a key is a collection; expected a word"));
                };
                table.insert(key, value);
            }
        }
    }
    Err(malformed(1, "it holds no value"))
}

/// Value of a plain word.
fn plain(word: &str) -> Value {
    match word {
        "" | "~" | "null" | "Null" | "NULL" => return Value::Null,
        "true" | "True" | "TRUE" => return Value::Bool(true),
        "false" | "False" | "FALSE" => return Value::Bool(false),
        _ => {}
    }
    let is_number = word.starts_with(|first: char| first.is_ascii_digit() || "+-.".contains(first));
    let number = word.parse::<f64>().ok().filter(|_| is_number);
    number
        .and_then(serde_json::Number::from_f64)
        .map_or_else(|| Value::String(word.to_owned()), Value::Number)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn documents_become_values() {
        let text =
            "a: 1\nb: [x, \"2\", -0.5, true, ~]\nc:\n- - 1.5 # a comment\n  - {k: v}\n- []\n";
        let value = parse(text).unwrap();
        let expected = json!({
            "a": 1.0, "b": ["x", "2", -0.5, true, null], "c": [[1.5, {"k": "v"}], []]
        });
        assert_eq!(value, expected);
    }

    #[test]
    fn hostile_documents_are_refused() {
        let (deep, deeper) = ("[".repeat(100), "[".repeat(100_000));
        let many = format!("[{}]", "1,".repeat(VALUES_MAX + 1));
        for (text, reason) in [
            ("", "no value"),
            ("a: &x [1]\nb: *x", "line 2: aliases"),
            ("a: 1\na: 2", "line 2: the key \"a\" is there twice"),
            ("? [1]\n: 2", "a key is a collection"),
            ("a: [1", "line"),
            (&deep, "deeper than 64"),
            (&deeper, "line 1"),
            (&many, "more than 100000"),
        ] {
            let sentence = parse(text).unwrap_err().to_string();
            assert!(sentence.contains(reason), "{sentence}");
        }
    }
}
