//! XML as the readers of maps and tracks take it: errors with lines, numbers that are finite, and
//! no document types, so that no entity grows.

use roxmltree::{Document, Node};

use crate::DecodeError;

/// The document that `bytes` hold.
pub fn parse(bytes: &[u8]) -> Result<Document<'_>, DecodeError> {
    let text = std::str::from_utf8(bytes).map_err(|error| {
        let found = match other_encoding(bytes) {
            Some(name) => format!("the file is in {name}"),
            None => error.to_string(),
        };
        DecodeError::Malformed(format!(
            "{found}; expected XML in UTF-8: convert it, for instance with `iconv -t UTF-8`, and change the \
             encoding that its first line names"
        ))
    })?;
    check_attributes(bytes)?;
    Document::parse(text)
        .map_err(|error| DecodeError::Malformed(format!("not XML that is read here: {error}")))
}

/// Name of the encoding that `bytes` begin with, if that is not UTF-8.
pub(crate) fn other_encoding(bytes: &[u8]) -> Option<&'static str> {
    match bytes {
        [0xff, 0xfe, 0, 0, ..] | [0, 0, 0xfe, 0xff, ..] => Some("UTF-32"),
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] | [0, b'<', 0, ..] | [b'<', 0, _, 0, ..] => {
            Some("UTF-16")
        }
        _ => None,
    }
}

/// Most attributes of one element. The parser compares each with all others, and maps have at most
/// twenty.
const ATTRIBUTES_MAX: usize = 256;
/// Most declarations of namespaces in a document. The parser copies them from element to element,
/// and maps have one or two.
const NAMESPACES_MAX: usize = 64;

/// Refuses documents for which the parser would take quadratic time, in one pass over the bytes.
fn check_attributes(bytes: &[u8]) -> Result<(), DecodeError> {
    let (mut rest, mut namespaces) = (bytes, 0);
    while let Some(start) = rest.iter().position(|&byte| byte == b'<') {
        rest = &rest[start..];
        let skipped = [
            (&b"<!--"[..], &b"-->"[..]),
            (b"<![CDATA[", b"]]>"),
            (b"<?", b"?>"),
        ];
        let end = match skipped.into_iter().find(|(open, _)| rest.starts_with(open)) {
            Some((open, close)) => {
                open.len()
                    + rest[open.len()..]
                        .windows(close.len())
                        .position(|window| window == close)
                        .unwrap_or(rest.len())
            }
            None => {
                let tag = Tag::at(rest);
                namespaces += tag.namespaces;
                let message = if tag.attributes > ATTRIBUTES_MAX {
                    format!(
                        "an element has {} attributes; at most {ATTRIBUTES_MAX} are read",
                        tag.attributes
                    )
                } else if namespaces > NAMESPACES_MAX {
                    format!("more than {NAMESPACES_MAX} namespaces are declared")
                } else {
                    rest = &rest[tag.bytes..];
                    continue;
                };
                let line = 1 + bytes[..bytes.len() - rest.len()]
                    .iter()
                    .filter(|&&byte| byte == b'\n')
                    .count();
                return Err(DecodeError::Malformed(format!(
                    "line {line}: {message}; maps and tracks have fewer"
                )));
            }
        };
        rest = &rest[end.min(rest.len())..];
    }
    Ok(())
}

/// Counts of a tag.
struct Tag {
    bytes: usize,
    attributes: usize,
    namespaces: usize,
}

impl Tag {
    /// The tag that `text` begins with, up to the first `>` outside of quotes. Each `=` outside of
    /// quotes is an attribute.
    fn at(text: &[u8]) -> Self {
        let mut tag = Self {
            bytes: text.len(),
            attributes: 0,
            namespaces: 0,
        };
        let mut quote = None;
        for (at, &byte) in text.iter().enumerate() {
            match (quote, byte) {
                (Some(open), _) if byte == open => quote = None,
                (Some(_), _) => {}
                (None, b'"' | b'\'') => quote = Some(byte),
                (None, b'=') => tag.attributes += 1,
                (None, b'x') => tag.namespaces += usize::from(text[at..].starts_with(b"xmlns")),
                (None, b'>') => {
                    tag.bytes = at + 1;
                    break;
                }
                _ => {}
            }
        }
        tag
    }
}

/// An element of a document.
#[derive(Clone, Copy)]
pub struct Element<'a>(Node<'a, 'a>);

impl<'a> Element<'a> {
    /// The root, which must have `name`.
    pub fn root(document: &'a Document<'a>, name: &str) -> Result<Self, DecodeError> {
        let root = Self(document.root_element());
        if root.name() == name {
            Ok(root)
        } else {
            Err(root.fault(format!("the root is no <{name}>")))
        }
    }

    /// Name without a namespace.
    pub fn name(self) -> &'a str {
        self.0.tag_name().name()
    }

    /// All elements in it.
    pub fn elements(self) -> impl Iterator<Item = Self> {
        self.0.children().filter(Node::is_element).map(Self)
    }

    /// The element that it is in; `None` for the root.
    pub fn parent(self) -> Option<Self> {
        self.0.parent_element().map(Self)
    }

    /// Number of the element in its document, which no other has.
    pub fn key(self) -> u32 {
        self.0.id().get()
    }

    /// The elements in it that have `name`.
    pub fn all(self, name: &str) -> impl Iterator<Item = Self> {
        self.elements()
            .filter(move |element| element.name() == name)
    }

    /// All elements below it, at any depth, that have `name`, in the order of the file.
    pub fn descendants(self, name: &str) -> impl Iterator<Item = Self> {
        self.0
            .descendants()
            .filter(Node::is_element)
            .map(Self)
            .filter(move |element| element.name() == name)
    }

    /// Line of its start tag, from 1.
    pub fn line(self) -> u32 {
        self.0.document().text_pos_at(self.0.range().start).row
    }

    /// The first element in it that has `name`.
    pub fn first(self, name: &str) -> Option<Self> {
        self.all(name).next()
    }

    /// Like [`Element::first`]; an error if there is none.
    pub fn needed(self, name: &str) -> Result<Self, DecodeError> {
        self.first(name)
            .ok_or_else(|| self.fault(format!("it has no <{name}>")))
    }

    /// Value of an attribute.
    pub fn attribute(self, name: &str) -> Option<&'a str> {
        self.0.attribute(name).map(str::trim)
    }

    /// Like [`Element::attribute`]; an error if there is none.
    pub fn needed_attribute(self, name: &str) -> Result<&'a str, DecodeError> {
        self.attribute(name)
            .ok_or_else(|| self.fault(format!("it has no attribute '{name}'")))
    }

    /// The number in an attribute.
    pub fn number(self, name: &str) -> Result<f64, DecodeError> {
        let text = self.needed_attribute(name)?;
        finite(text)
            .ok_or_else(|| self.fault(format!("{name}=\"{}\" is no finite number", excerpt(text))))
    }

    /// Like [`Element::number`], or `otherwise` if the attribute is absent.
    pub fn number_or(self, name: &str, otherwise: f64) -> Result<f64, DecodeError> {
        if self.attribute(name).is_some() {
            self.number(name)
        } else {
            Ok(otherwise)
        }
    }

    /// The text in it, trimmed; empty where there is none.
    pub fn text(self) -> &'a str {
        self.0.text().unwrap_or_default().trim()
    }

    /// The number that its text is.
    pub fn text_number(self) -> Result<f64, DecodeError> {
        finite(self.text())
            .ok_or_else(|| self.fault(format!("'{}' is no finite number", excerpt(self.text()))))
    }

    /// Error about this element, with its line and name.
    pub fn fault(self, reason: impl AsRef<str>) -> DecodeError {
        DecodeError::Malformed(format!(
            "line {}, <{}>: {}",
            self.line(),
            excerpt(self.name()),
            reason.as_ref()
        ))
    }
}

/// The finite number that `text` is.
pub fn finite(text: &str) -> Option<f64> {
    text.parse().ok().filter(|number: &f64| number.is_finite())
}

/// The start of `text`, short enough for a sentence.
pub fn excerpt(text: &str) -> String {
    const CHARS_MAX: usize = 60;
    match text.char_indices().nth(CHARS_MAX) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_has_its_line_and_name() {
        let document = parse(b"<a>\n<b x='1e999' y=' 2 '/>\n</a>").unwrap();
        let root = Element::root(&document, "a").unwrap();
        let error = root
            .first("b")
            .unwrap()
            .number("x")
            .unwrap_err()
            .to_string();
        assert_eq!(error, "line 2, <b>: x=\"1e999\" is no finite number");
        assert_eq!(root.first("b").unwrap().number("y"), Ok(2.0));
        assert!(
            root.needed("c")
                .is_err_and(|error| error.to_string().contains("<c>"))
        );
        assert!(Element::root(&document, "z").is_err());
    }

    #[test]
    fn document_types_and_other_encodings_are_refused() {
        let bomb = b"<!DOCTYPE a [<!ENTITY b 'bb'><!ENTITY c '&b;&b;&b;'>]><a>&c;</a>";
        assert!(parse(bomb).is_err());
        assert!(
            parse(b"\xff\xfe<\0a\0")
                .unwrap_err()
                .to_string()
                .contains("UTF-8")
        );
    }

    #[test]
    fn attributes_and_namespaces_without_end_are_refused_at_once() {
        let attributes = |count: usize| {
            (0..count)
                .map(|i| format!(" a{i}='{i}>'"))
                .collect::<String>()
        };
        let since = std::time::Instant::now();
        let message = parse(format!("<m>\n<e{}/></m>", attributes(400_000)).as_bytes())
            .unwrap_err()
            .to_string();
        assert!(
            message.contains("line 2") && message.contains("400000 attributes"),
            "{message}"
        );
        let nested = (0..20_000)
            .map(|i| format!("<e xmlns:n{i} ='u{i}'>"))
            .collect::<String>();
        assert!(
            parse(nested.as_bytes())
                .unwrap_err()
                .to_string()
                .contains("namespaces")
        );
        assert!(since.elapsed().as_secs_f64() < 20.0);
        // What is not an attribute is not counted, and what is allowed is read.
        let equals = "=".repeat(1000);
        let text = format!(
            "<?xml version='1.0'?><m{}><!-- it's {equals} --><![CDATA[<a {equals}>]]>{equals}</m>",
            attributes(256)
        );
        parse(text.as_bytes()).unwrap();
    }

    #[test]
    fn depth_costs_no_stack() {
        let deep = "<a>".repeat(200_000) + &"</a>".repeat(200_000);
        let document = parse(deep.as_bytes()).unwrap();
        assert_eq!(Element::root(&document, "a").unwrap().elements().count(), 1);
        assert!(parse("<a>".repeat(200_000).as_bytes()).is_err());
    }
}
