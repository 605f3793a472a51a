//! The PLY container: a text header that names elements and properties, then rows of fixed stride.
//!
//! Reads binary little-endian bodies, and small ones of text (`ascii`). Nothing is allocated by
//! what a header claims: every element's extent is checked against the bytes that are there before
//! a row is touched.

mod ascii;
mod column;
mod header;

use std::borrow::Cow;
use std::ops::Range;

use crate::DecodeError;
use header::{Element, shown};

pub(crate) use column::{Column, Scalar};

/// Names that a message lists; a file may have thousands.
const NAMES_SHOWN_MAX: usize = 20;
/// Element of the polygons of a mesh.
const FACE: &str = "face";

/// A parsed header over its body.
#[derive(Clone, Debug)]
pub(crate) struct Ply<'a> {
    elements: Vec<Element>,
    body: Cow<'a, [u8]>,
}

/// Position of the rows of an element in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Extent {
    /// Byte of the file at which they start.
    pub(crate) start: u64,
    /// Bytes from row to row, at least 1.
    pub(crate) stride: usize,
    /// Number of rows.
    pub(crate) count: usize,
}

/// The rows of one element.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rows<'a> {
    /// `count * stride` bytes.
    pub(crate) bytes: &'a [u8],
    /// Bytes from row to row, at least 1 unless there is no property.
    pub(crate) stride: usize,
    /// Number of rows.
    pub(crate) count: usize,
}

impl<'a> Ply<'a> {
    /// Parses the header of `bytes`.
    pub(crate) fn parse(bytes: &'a [u8]) -> Result<Self, DecodeError> {
        let header::Header {
            mut elements,
            body_at,
            is_ascii,
        } = header::parse(bytes)?;
        let body = &bytes[body_at..];
        let body = if is_ascii {
            Cow::Owned(ascii::packed(&mut elements, body)?)
        } else {
            Cow::Borrowed(body)
        };
        Ok(Self { elements, body })
    }

    /// A header is in this many bytes at the start of a file, or it is none.
    pub(crate) const HEADER_BYTES_MAX: usize = header::HEADER_BYTES_MAX;

    /// The header in the bytes `start` of a file of `length` bytes, without its body, and where the
    /// rows of `element` are. `None` for a text, and for a file whose rows are not all there or are
    /// not found by counting: what is wrong, [`Ply::parse`] says.
    pub(crate) fn of_header(start: &[u8], length: u64, element: &str) -> Option<(Self, Extent)> {
        let header = header::parse(start).ok().filter(|found| !found.is_ascii)?;
        let mut at = header.body_at as u64;
        let mut extent = None;
        for one in &header.elements {
            let stride = one.stride()?;
            if one.name == element {
                extent = Some(Extent {
                    start: at,
                    stride,
                    count: usize::try_from(one.count).ok()?,
                });
                break;
            }
            at = at.checked_add(one.count.checked_mul(stride as u64)?)?;
        }
        let extent = extent.filter(|extent| extent.stride > 0)?;
        let bytes = extent.count.checked_mul(extent.stride)? as u64;
        let ply = Self {
            elements: header.elements,
            body: Cow::Borrowed(&[]),
        };
        (extent.start.checked_add(bytes)? <= length).then_some((ply, extent))
    }

    /// True if the header in the bytes `start` of a file lists an element called `name`.
    pub(crate) fn header_has(start: &[u8], name: &str) -> bool {
        let header = header::parse(start);
        header.is_ok_and(|header| header.elements.iter().any(|element| element.name == name))
    }

    /// True if there is an element called `name`.
    pub(crate) fn has_element(&self, name: &str) -> bool {
        self.elements.iter().any(|element| element.name == name)
    }

    /// The names of all elements, in the order of the header.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.elements.iter().map(|element| element.name.as_str())
    }

    /// The names of all elements, for messages.
    pub(crate) fn element_names(&self) -> String {
        listed(self.names())
    }

    /// The names of the properties of `element`, none if it is not there.
    pub(crate) fn property_names(&self, element: &str) -> impl Iterator<Item = &str> {
        let found = self
            .elements
            .iter()
            .find(|candidate| candidate.name == element);
        found.into_iter().flat_map(|element| {
            element
                .properties
                .iter()
                .map(|property| property.name.as_str())
        })
    }

    /// Advice about an element without a column that splats have.
    fn advice(&self, element: &str) -> &'static str {
        let is_splat = |name: &str| {
            let starts = ["scale_", "rot_", "f_dc_", "opacity"];
            starts.iter().any(|start| name.starts_with(start))
        };
        if self.property_names(element).any(is_splat) {
            "these are Gaussian splats of a trainer that leaves it out: export them with all of x y z, f_dc_0 to 2, \
             opacity, scale_0 to 2 and rot_0 to 3"
        } else {
            "if these are points or a mesh, export the Gaussian splats that were trained from them"
        }
    }

    /// The column of a scalar property.
    pub(crate) fn column(&self, element: &str, property: &str) -> Result<Column, DecodeError> {
        self.column_if_present(element, property).ok_or_else(|| {
            DecodeError::Malformed(format!(
                "element '{element}' has no scalar property '{property}', only: {}; {}",
                listed(self.property_names(element)),
                self.advice(element)
            ))
        })
    }

    /// The column of a scalar property, if it exists.
    pub(crate) fn column_if_present(&self, element: &str, property: &str) -> Option<Column> {
        let element = self
            .elements
            .iter()
            .find(|candidate| candidate.name == element)?;
        element
            .properties
            .iter()
            .find(|candidate| candidate.name == property)?
            .column
    }

    /// The rows of `name`, all of them there.
    pub(crate) fn rows(&self, name: &str) -> Result<Rows<'_>, DecodeError> {
        let mut start: u64 = 0;
        for element in &self.elements {
            let Some(stride) = element.stride() else {
                return Err(DecodeError::Unsupported(format!(
                    "element '{}' has list properties and stands at or before element '{name}'; export the splats alone",
                    shown(&element.name)
                )));
            };
            let extent = element
                .count
                .checked_mul(stride as u64)
                .and_then(|bytes| start.checked_add(bytes));
            let found_bytes = self.body.len() as u64;
            match extent {
                Some(end) if end <= found_bytes => {
                    if element.name == name {
                        return self.rows_at(
                            start as usize..end as usize,
                            stride,
                            element.count,
                            name,
                        );
                    }
                    start = end;
                }
                _ => {
                    return Err(DecodeError::Truncated {
                        what: format!(
                            "element '{}' of {} rows of {stride} bytes",
                            shown(&element.name),
                            element.count
                        ),
                        expected_bytes: extent.unwrap_or(u64::MAX),
                        found_bytes,
                    });
                }
            }
        }
        Err(DecodeError::Malformed(format!(
            "there is no element '{name}', only: {}",
            self.element_names()
        )))
    }

    /// Triangles of a mesh: the polygons of the element `face` as fans of the vertices that its
    /// list names. `None` without such an element; a text has none.
    ///
    /// # Errors
    /// [`DecodeError`] if the list is cut or longer than the file.
    pub(crate) fn triangles(&self) -> Result<Option<Vec<[u32; 3]>>, DecodeError> {
        let Some(at) = self.elements.iter().position(|found| found.name == FACE) else {
            return Ok(None);
        };
        let before = self.elements[..at].iter();
        let start: u64 = before
            .map(|element| {
                element
                    .stride()
                    .map(|stride| (element.count, stride as u64))
            })
            .try_fold(0u64, |sum, of| {
                let (count, stride) = of?;
                count.checked_mul(stride)?.checked_add(sum)
            })
            .unwrap_or(u64::MAX);
        let cut = || DecodeError::Truncated {
            what: format!("element '{FACE}' of {} rows", self.elements[at].count),
            expected_bytes: start.saturating_add(self.elements[at].count),
            found_bytes: self.body.len() as u64,
        };
        let mut rest = usize::try_from(start)
            .ok()
            .and_then(|start| self.body.get(start..))
            .ok_or_else(cut)?;
        let mut take = |bytes: usize| -> Result<&[u8], DecodeError> {
            let (taken, left) = rest.split_at_checked(bytes).ok_or_else(cut)?;
            rest = left;
            Ok(taken)
        };
        let mut triangles = Vec::new();
        for _ in 0..self.elements[at].count {
            for property in &self.elements[at].properties {
                let Some([count, item]) = property.list else {
                    take(property.column.map_or(0, |column| column.scalar.bytes()))?;
                    continue;
                };
                let first = |scalar| Column { offset: 0, scalar };
                let items = first(count).f64_of(take(count.bytes())?).max(0.0) as usize;
                let bytes = items.checked_mul(item.bytes()).ok_or_else(cut)?;
                let indices = take(bytes)?.chunks_exact(item.bytes());
                if !property.name.starts_with("vert") {
                    continue;
                }
                let indices: Vec<u32> = indices
                    .map(|index| first(item).f64_of(index) as u32)
                    .collect();
                let fan = indices.windows(2).skip(1);
                triangles.extend(fan.map(|pair| [indices[0], pair[0], pair[1]]));
            }
            // Rows without properties take no bytes, and their number is only claimed.
            if self.elements[at].properties.is_empty() {
                break;
            }
        }
        Ok(Some(triangles))
    }

    fn rows_at(
        &self,
        range: Range<usize>,
        stride: usize,
        count: u64,
        name: &str,
    ) -> Result<Rows<'_>, DecodeError> {
        // Rows without properties take no bytes, so the bytes do not bound their number; equal
        // depths and buffers are indexed with 32 bits.
        let count = u32::try_from(count).map_err(|_| {
            DecodeError::Unsupported(format!(
                "element '{name}' has {count} rows; at most 4294967295 are read"
            ))
        })?;
        Ok(Rows {
            bytes: &self.body[range],
            stride,
            count: count as usize,
        })
    }
}

/// The first of `names`, for messages.
fn listed<'n>(names: impl Iterator<Item = &'n str>) -> String {
    let mut names = names.map(shown);
    let mut list = names
        .by_ref()
        .take(NAMES_SHOWN_MAX)
        .collect::<Vec<_>>()
        .join(", ");
    if names.next().is_some() {
        list += ", ...";
    }
    list
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ply(header: &str, body: &[u8]) -> Vec<u8> {
        let mut bytes =
            format!("ply\nformat binary_little_endian 1.0\n{header}end_header\n").into_bytes();
        bytes.extend_from_slice(body);
        bytes
    }

    #[test]
    fn text_is_read_like_bytes() {
        let header = "element face 2\nproperty list uchar int corners\nproperty uchar flag\nelement vertex 2\n\
                      property float x\nproperty uchar red\nproperty double y\nelement none 5\n";
        let text =
            |body: &str| format!("ply\nformat ascii 1.0\n{header}end_header\n{body}").into_bytes();
        let bytes = text("3 0 1 2 7\n0 9\n1.5 255 -2.25\n nan\t0\r\n1e9\n");
        let ply = Ply::parse(&bytes).unwrap();
        let rows = ply.rows("vertex").unwrap();
        assert_eq!((rows.count, rows.stride, rows.bytes.len()), (2, 13, 26));
        let value = |name: &str, row: usize| {
            let column = ply.column("vertex", name).unwrap();
            column.f64_of(&rows.bytes[row * 13..][..13])
        };
        assert_eq!(
            (value("x", 0), value("red", 0), value("y", 0)),
            (1.5, 255.0, -2.25)
        );
        assert!(value("x", 1).is_nan() && value("y", 1) == 1e9);
        for (body, part) in [
            ("3 0 1 2 7 0 9 1.5 255", "the text ends in row 0"),
            ("3 0 1 2 7 0 9 1.5 256 0", "'red': '256' is no number"),
            ("3 0 1 2 7 0 9 x 1 0", "'x': 'x' is no number"),
            ("99999999 0 1", "element 'face' has 2 rows"),
        ] {
            let message = Ply::parse(&text(body)).unwrap_err().to_string();
            assert!(message.contains(part), "{body}: {message}");
        }
        let claim = b"ply\nformat ascii 1.0\nelement vertex 18446744073709551615\nproperty float x\nend_header\n1 2\n";
        assert!(Ply::parse(claim).unwrap_err().to_string().contains("row 2"));
        let nothing = b"ply\nformat ascii 1.0\nelement vertex 18446744073709551615\nend_header\n";
        assert!(Ply::parse(nothing).is_ok());
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
        assert_eq!(
            values,
            [-1.0, 254.0, -3.0, 65_535.0, -70_000.0, 3.0e9, 1.5, -2.25]
        );
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
        let error = |bytes: &[u8]| {
            Ply::parse(bytes)
                .and_then(|ply| ply.rows("vertex").map(|_| ()))
                .unwrap_err()
                .to_string()
        };
        assert!(error(b"ply\nformat binary_big_endian 1.0\nend_header\n").contains("ascii"));
        assert!(error(b"ply\nformat binary_big_endian 1.0\nend_header\n").contains("big_endian"));
        assert!(error(b"ply\nend_header\n").contains("format"));
        assert!(
            error(b"ply\nformat binary_little_endian 1.0\nproperty float x\nend_header\n")
                .contains("before any element")
        );
        assert!(error(&ply("element vertex -1\n", b"")).contains("-1"));
        assert!(error(&ply("element vertex 1\nproperty quad x\n", b"")).contains("quad"));
        assert!(error(&ply("element mesh 0\n", b"")).contains("mesh"));
        assert!(error(b"ply\nformat binary_little_endian 1.0\n").contains("end_header"));
    }

    #[test]
    fn absurd_counts_are_refused_before_anything_is_allocated() {
        for count in [
            "18446744073709551615",
            "4611686018427387904",
            "1000000000000",
            "3",
        ] {
            let bytes = ply(
                &format!("element vertex {count}\nproperty float x\n"),
                &[0; 8],
            );
            let error = Ply::parse(&bytes).unwrap().rows("vertex").unwrap_err();
            assert!(
                matches!(error, DecodeError::Truncated { found_bytes: 8, .. }),
                "{error}"
            );
        }
        let empty_rows = ply("element vertex 99999999999\n", b"");
        assert!(Ply::parse(&empty_rows).unwrap().rows("vertex").is_err());
    }
}
