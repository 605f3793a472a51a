//! The text header of a PLY.

use super::column::{Column, Scalar};
use crate::DecodeError;

/// A header longer than this is taken for garbage; real ones have a few kilobytes.
pub(super) const HEADER_BYTES_MAX: usize = 1 << 20;

#[derive(Clone, Debug)]
pub(super) struct Property {
    pub(super) name: String,
    /// `None` for a list, whose rows have no fixed stride.
    pub(super) column: Option<Column>,
    /// Types of the count and of the items of a list.
    pub(super) list: Option<[Scalar; 2]>,
}

#[derive(Clone, Debug)]
pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: u64,
    pub(super) properties: Vec<Property>,
}

impl Element {
    /// Bytes of a row, unless a list makes that differ from row to row.
    pub(super) fn stride(&self) -> Option<usize> {
        self.properties.iter().try_fold(0, |sum, property| {
            Some(sum + property.column?.scalar.bytes())
        })
    }
}

/// A header.
pub(super) struct Header {
    pub(super) elements: Vec<Element>,
    /// Byte at which the body starts.
    pub(super) body_at: usize,
    /// True if the body is text.
    pub(super) is_ascii: bool,
}

/// Reads the header of `bytes`.
pub(super) fn parse(bytes: &[u8]) -> Result<Header, DecodeError> {
    let mut lines = HeaderLines { bytes, next: 0 };
    let magic = lines.next_line()?;
    if magic != "ply" {
        return Err(DecodeError::Malformed(format!(
            "the first line is '{}', expected 'ply'",
            shown(magic)
        )));
    }
    let mut elements: Vec<Element> = Vec::new();
    let mut format_is_ascii = None;
    loop {
        let line = lines.next_line()?;
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match words.as_slice() {
            ["end_header"] => break,
            [] | ["comment" | "obj_info", ..] => {}
            ["format", format, _version] => {
                format_is_ascii = Some(is_ascii(format)?);
            }
            ["element", name, count] => elements.push(parse_element(name, count)?),
            ["property", rest @ ..] => match elements.last_mut() {
                Some(element) => add_property(element, rest, line)?,
                None => {
                    return Err(DecodeError::Malformed(format!(
                        "header line '{}' stands before any element",
                        shown(line)
                    )));
                }
            },
            _ => {
                return Err(DecodeError::Malformed(format!(
                    "header line '{}' is not PLY; the header may be damaged: export the file again",
                    shown(line)
                )));
            }
        }
    }
    let Some(is_ascii) = format_is_ascii else {
        return Err(DecodeError::Malformed(
            "the header has no 'format' line".into(),
        ));
    };
    Ok(Header {
        elements,
        body_at: lines.next,
        is_ascii,
    })
}

/// Walks over header lines; a line ends with LF, before which a CR is dropped.
struct HeaderLines<'a> {
    bytes: &'a [u8],
    next: usize,
}

impl<'a> HeaderLines<'a> {
    fn next_line(&mut self) -> Result<&'a str, DecodeError> {
        let end = self.bytes.len().min(HEADER_BYTES_MAX);
        let rest = self.bytes.get(self.next..end).unwrap_or_default();
        let Some(length) = rest.iter().position(|&byte| byte == b'\n') else {
            return Err(DecodeError::Malformed(format!(
                "the header has no 'end_header' line in its first {end} bytes"
            )));
        };
        let line = rest[..length]
            .strip_suffix(b"\r")
            .unwrap_or(&rest[..length]);
        self.next += length + 1;
        // Comments may be in any encoding; everything that carries meaning is ASCII.
        Ok(std::str::from_utf8(line).unwrap_or("comment"))
    }
}

/// True for a body of text, false for a little-endian one.
fn is_ascii(format: &str) -> Result<bool, DecodeError> {
    match format {
        "binary_little_endian" => Ok(false),
        "ascii" => Ok(true),
        "binary_big_endian" => Err(DecodeError::Unsupported(format!(
            "the body is {format}; binary_little_endian and ascii are read: convert the file, for example with the PLY tool that wrote it"
        ))),
        _ => Err(DecodeError::Malformed(format!(
            "'{}' is no PLY format",
            shown(format)
        ))),
    }
}

fn parse_element(name: &str, count: &str) -> Result<Element, DecodeError> {
    let count = count.parse().map_err(|_| {
        DecodeError::Malformed(format!(
            "element '{}' has the count '{}', expected a number",
            shown(name),
            shown(count)
        ))
    })?;
    Ok(Element {
        name: name.to_owned(),
        count,
        properties: Vec::new(),
    })
}

fn add_property(element: &mut Element, words: &[&str], line: &str) -> Result<(), DecodeError> {
    let malformed =
        || DecodeError::Malformed(format!("header line '{}' is no PLY property", shown(line)));
    let property = match *words {
        ["list", count, item, name] => {
            let types = Scalar::by_name(count).zip(Scalar::by_name(item));
            let (count, item) = types.ok_or_else(malformed)?;
            Property {
                name: name.to_owned(),
                column: None,
                list: Some([count, item]),
            }
        }
        [scalar, name] => {
            let scalar = Scalar::by_name(scalar).ok_or_else(malformed)?;
            let last = element
                .properties
                .last()
                .and_then(|property| property.column);
            // After a list there is no fixed offset; such rows are refused before a column is used.
            let offset = last.map_or(0, |column| column.offset + column.scalar.bytes());
            Property {
                name: name.to_owned(),
                column: Some(Column { offset, scalar }),
                list: None,
            }
        }
        _ => return Err(malformed()),
    };
    element.properties.push(property);
    Ok(())
}

/// The start of a text from a file, fit for a message.
pub(super) fn shown(text: &str) -> String {
    text.chars()
        .take(60)
        .map(|c| if c.is_control() { '?' } else { c })
        .collect()
}
