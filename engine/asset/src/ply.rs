//! The PLY container: a text header that names elements and properties, then rows of fixed stride.
//!
//! Reads binary little-endian bodies. Nothing is allocated by what a header claims: every element's extent is checked
//! against the bytes that are there before a row is touched.

use std::ops::Range;

use crate::DecodeError;

/// A header longer than this is taken for garbage; real ones have a few kilobytes.
const HEADER_BYTES_MAX: usize = 1 << 20;

/// A scalar type of a PLY property.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn by_name(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

/// Where one property lies in a row.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Column {
    offset: usize,
    pub(crate) scalar: Scalar,
}

impl Column {
    /// The property's value in `row` as f32; integers keep their number, doubles are rounded.
    pub(crate) fn f32_of(self, row: &[u8]) -> f32 {
        match self.scalar {
            Scalar::F32 => f32::from_le_bytes(self.bytes_of(row)),
            Scalar::F64 => f64::from_le_bytes(self.bytes_of(row)) as f32,
            Scalar::I8 => f32::from(i8::from_le_bytes(self.bytes_of(row))),
            Scalar::U8 => f32::from(row[self.offset]),
            Scalar::I16 => f32::from(i16::from_le_bytes(self.bytes_of(row))),
            Scalar::U16 => f32::from(u16::from_le_bytes(self.bytes_of(row))),
            Scalar::I32 => i32::from_le_bytes(self.bytes_of(row)) as f32,
            Scalar::U32 => u32::from_le_bytes(self.bytes_of(row)) as f32,
        }
    }

    /// The bits of a four-byte property.
    pub(crate) fn u32_of(self, row: &[u8]) -> u32 {
        debug_assert_eq!(self.scalar.bytes(), 4);
        u32::from_le_bytes(self.bytes_of(row))
    }

    fn bytes_of<const N: usize>(self, row: &[u8]) -> [u8; N] {
        let mut bytes = [0; N];
        bytes.copy_from_slice(&row[self.offset..self.offset + N]);
        bytes
    }
}

#[derive(Clone, Debug)]
struct Property {
    name: String,
    /// `None` for a list, whose rows have no fixed stride.
    column: Option<Column>,
}

#[derive(Clone, Debug)]
struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
}

impl Element {
    /// Bytes of a row, unless a list makes that differ from row to row.
    fn stride(&self) -> Option<usize> {
        self.properties.iter().try_fold(0, |sum, property| Some(sum + property.column?.scalar.bytes()))
    }
}

/// A parsed header over its body.
#[derive(Clone, Debug)]
pub(crate) struct Ply<'a> {
    elements: Vec<Element>,
    body: &'a [u8],
}

/// The rows of one element.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rows<'a> {
    /// `count * stride` bytes.
    pub(crate) bytes: &'a [u8],
    /// Bytes from row to row, at least 1 unless there is no property.
    pub(crate) stride: usize,
    /// Rows.
    pub(crate) count: usize,
}

impl<'a> Ply<'a> {
    /// Parses the header of `bytes`.
    pub(crate) fn parse(bytes: &'a [u8]) -> Result<Self, DecodeError> {
        let mut lines = HeaderLines { bytes, next: 0 };
        if lines.next_line()? != "ply" {
            return Err(DecodeError::Malformed("the first line must be 'ply'".into()));
        }
        let mut elements: Vec<Element> = Vec::new();
        let mut has_format = false;
        loop {
            let line = lines.next_line()?;
            let words: Vec<&str> = line.split_ascii_whitespace().collect();
            match words.as_slice() {
                ["end_header"] => break,
                [] | ["comment" | "obj_info", ..] => {}
                ["format", format, _version] => {
                    require_little_endian(format)?;
                    has_format = true;
                }
                ["element", name, count] => elements.push(parse_element(name, count)?),
                ["property", rest @ ..] => match elements.last_mut() {
                    Some(element) => add_property(element, rest, line)?,
                    None => {
                        return Err(DecodeError::Malformed(format!("header line '{}' stands before any element", shown(line))));
                    }
                },
                _ => return Err(DecodeError::Malformed(format!("header line '{}' is not PLY", shown(line)))),
            }
        }
        if !has_format {
            return Err(DecodeError::Malformed("the header has no 'format' line".into()));
        }
        Ok(Self { elements, body: &bytes[lines.next..] })
    }

    /// Whether there is an element called `name`.
    pub(crate) fn has_element(&self, name: &str) -> bool {
        self.elements.iter().any(|element| element.name == name)
    }

    /// The names of all elements, for messages.
    pub(crate) fn element_names(&self) -> String {
        self.elements.iter().map(|element| shown(&element.name)).collect::<Vec<_>>().join(", ")
    }

    /// The names of the properties of `element`, none if it is not there.
    pub(crate) fn property_names(&self, element: &str) -> impl Iterator<Item = &str> {
        let found = self.elements.iter().find(|candidate| candidate.name == element);
        found.into_iter().flat_map(|element| element.properties.iter().map(|property| property.name.as_str()))
    }

    /// The column of a scalar property.
    pub(crate) fn column(&self, element: &str, property: &str) -> Result<Column, DecodeError> {
        self.column_if_present(element, property)
            .ok_or_else(|| DecodeError::Malformed(format!("element '{element}' has no scalar property '{property}'")))
    }

    /// The column of a scalar property, if it exists.
    pub(crate) fn column_if_present(&self, element: &str, property: &str) -> Option<Column> {
        let element = self.elements.iter().find(|candidate| candidate.name == element)?;
        element.properties.iter().find(|candidate| candidate.name == property)?.column
    }

    /// The rows of `name`, all of them there.
    pub(crate) fn rows(&self, name: &str) -> Result<Rows<'a>, DecodeError> {
        let mut start: u64 = 0;
        for element in &self.elements {
            let Some(stride) = element.stride() else {
                return Err(DecodeError::Unsupported(format!(
                    "element '{}' has list properties and stands at or before element '{name}'; export the splats alone",
                    shown(&element.name)
                )));
            };
            let extent = element.count.checked_mul(stride as u64).and_then(|bytes| start.checked_add(bytes));
            let found_bytes = self.body.len() as u64;
            match extent {
                Some(end) if end <= found_bytes => {
                    if element.name == name {
                        return self.rows_at(start as usize..end as usize, stride, element.count, name);
                    }
                    start = end;
                }
                _ => {
                    return Err(DecodeError::Truncated {
                        what: format!("element '{}' of {} rows of {stride} bytes", shown(&element.name), element.count),
                        expected_bytes: extent.unwrap_or(u64::MAX),
                        found_bytes,
                    });
                }
            }
        }
        Err(DecodeError::Malformed(format!("there is no element '{name}', only: {}", self.element_names())))
    }

    fn rows_at(&self, range: Range<usize>, stride: usize, count: u64, name: &str) -> Result<Rows<'a>, DecodeError> {
        // Rows without properties take no bytes, so the bytes do not bound their number; equal depths and buffers are
        // indexed with 32 bits.
        let count = u32::try_from(count)
            .map_err(|_| DecodeError::Unsupported(format!("element '{name}' has {count} rows; at most 4294967295 are read")))?;
        Ok(Rows { bytes: &self.body[range], stride, count: count as usize })
    }
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
            return Err(DecodeError::Malformed(format!("the header has no 'end_header' line in its first {end} bytes")));
        };
        let line = rest[..length].strip_suffix(b"\r").unwrap_or(&rest[..length]);
        self.next += length + 1;
        // Comments may be in any encoding; everything that carries meaning is ASCII.
        Ok(std::str::from_utf8(line).unwrap_or("comment"))
    }
}

fn require_little_endian(format: &str) -> Result<(), DecodeError> {
    match format {
        "binary_little_endian" => Ok(()),
        "ascii" | "binary_big_endian" => Err(DecodeError::Unsupported(format!(
            "the body is {format}; only binary_little_endian is read: convert the file, for example with the PLY tool that wrote it"
        ))),
        _ => Err(DecodeError::Malformed(format!("'{}' is no PLY format", shown(format)))),
    }
}

fn parse_element(name: &str, count: &str) -> Result<Element, DecodeError> {
    let count = count.parse().map_err(|_| {
        DecodeError::Malformed(format!("element '{}' has the count '{}', expected a number", shown(name), shown(count)))
    })?;
    Ok(Element { name: name.to_owned(), count, properties: Vec::new() })
}

fn add_property(element: &mut Element, words: &[&str], line: &str) -> Result<(), DecodeError> {
    let malformed = || DecodeError::Malformed(format!("header line '{}' is no PLY property", shown(line)));
    let property = match *words {
        ["list", count, item, name] => {
            Scalar::by_name(count).and(Scalar::by_name(item)).ok_or_else(malformed)?;
            Property { name: name.to_owned(), column: None }
        }
        [scalar, name] => {
            let scalar = Scalar::by_name(scalar).ok_or_else(malformed)?;
            let last = element.properties.last().and_then(|property| property.column);
            // After a list there is no fixed offset; such rows are refused before a column is used.
            let offset = last.map_or(0, |column| column.offset + column.scalar.bytes());
            Property { name: name.to_owned(), column: Some(Column { offset, scalar }) }
        }
        _ => return Err(malformed()),
    };
    element.properties.push(property);
    Ok(())
}

/// The start of a text from a file, fit for a message.
fn shown(text: &str) -> String {
    text.chars().take(60).map(|c| if c.is_control() { '?' } else { c }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ply(header: &str, body: &[u8]) -> Vec<u8> {
        let mut bytes = format!("ply\nformat binary_little_endian 1.0\n{header}end_header\n").into_bytes();
        bytes.extend_from_slice(body);
        bytes
    }

    #[test]
    fn every_type_is_read_at_its_offset() {
        let header = "element vertex 1\nproperty char a\nproperty uchar b\nproperty short c\nproperty ushort d\n\
                      property int e\nproperty uint f\nproperty float g\nproperty double h\n";
        let mut body = vec![0xff, 0xfe];
        body.extend_from_slice(&(-3i16).to_le_bytes());
        body.extend_from_slice(&65_535u16.to_le_bytes());
        body.extend_from_slice(&(-70_000i32).to_le_bytes());
        body.extend_from_slice(&3_000_000_000u32.to_le_bytes());
        body.extend_from_slice(&1.5f32.to_le_bytes());
        body.extend_from_slice(&(-2.25f64).to_le_bytes());
        let bytes = ply(header, &body);
        let ply = Ply::parse(&bytes).unwrap();
        let rows = ply.rows("vertex").unwrap();
        let value = |name: &str| ply.column("vertex", name).unwrap().f32_of(rows.bytes);
        let values = ["a", "b", "c", "d", "e", "f", "g", "h"].map(value);
        assert_eq!(values, [-1.0, 254.0, -3.0, 65_535.0, -70_000.0, 3.0e9, 1.5, -2.25]);
    }

    #[test]
    fn elements_are_found_behind_others_and_windows_line_ends_are_read() {
        let bytes = b"ply\r\nformat binary_little_endian 1.0\r\ncomment \xff latin\r\nelement other 2\r\nproperty short s\r\n\
            element vertex 1\r\nproperty uchar v\r\nelement face 1\r\nproperty list uchar int vertex_indices\r\nend_header\r\n\x01\x00\x02\x00\x07";
        let ply = Ply::parse(bytes).unwrap();
        assert_eq!(ply.rows("vertex").unwrap().bytes, [7]);
        assert!(ply.rows("face").unwrap_err().to_string().contains("list"));
    }

    #[test]
    fn what_is_not_read_is_said() {
        let error = |bytes: &[u8]| Ply::parse(bytes).and_then(|ply| ply.rows("vertex").map(|_| ())).unwrap_err().to_string();
        assert!(error(b"ply\nformat ascii 1.0\nend_header\n").contains("ascii"));
        assert!(error(b"ply\nformat binary_big_endian 1.0\nend_header\n").contains("big_endian"));
        assert!(error(b"ply\nend_header\n").contains("format"));
        assert!(error(b"ply\nformat binary_little_endian 1.0\nproperty float x\nend_header\n").contains("before any element"));
        assert!(error(&ply("element vertex -1\n", b"")).contains("-1"));
        assert!(error(&ply("element vertex 1\nproperty quad x\n", b"")).contains("quad"));
        assert!(error(&ply("element mesh 0\n", b"")).contains("mesh"));
        assert!(error(b"ply\nformat binary_little_endian 1.0\n").contains("end_header"));
    }

    #[test]
    fn absurd_counts_are_refused_before_anything_is_allocated() {
        for count in ["18446744073709551615", "4611686018427387904", "1000000000000", "3"] {
            let bytes = ply(&format!("element vertex {count}\nproperty float x\n"), &[0; 8]);
            let error = Ply::parse(&bytes).unwrap().rows("vertex").unwrap_err();
            assert!(matches!(error, DecodeError::Truncated { found_bytes: 8, .. }), "{error}");
        }
        let empty_rows = ply("element vertex 99999999999\n", b"");
        assert!(Ply::parse(&empty_rows).unwrap().rows("vertex").is_err());
    }
}
