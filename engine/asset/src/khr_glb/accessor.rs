//! Numbers of accessors, as floats.

use super::document::{Accessor, BufferView, Document};
use crate::DecodeError;

/// The types of numbers in accessors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Component {
    I8,
    U8,
    I16,
    U16,
    F32,
}

impl Component {
    fn of_code(code: u32) -> Option<Self> {
        Some(match code {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5126 => Self::F32,
            _ => return None,
        })
    }

    fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::F32 => 4,
        }
    }

    fn read(self, bytes: &[u8], normalized: bool) -> f32 {
        let value = match self {
            Self::I8 => f32::from(bytes[0] as i8),
            Self::U8 => f32::from(bytes[0]),
            Self::I16 => f32::from(i16::from_le_bytes([bytes[0], bytes[1]])),
            Self::U16 => f32::from(u16::from_le_bytes([bytes[0], bytes[1]])),
            Self::F32 => return f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]),
        };
        let largest = match self {
            Self::I8 => 127.0,
            Self::U8 => 255.0,
            Self::I16 => 32_767.0,
            Self::U16 | Self::F32 => 65_535.0,
        };
        // The lowest of a signed type is one step beyond minus one.
        if normalized {
            (value / largest).max(-1.0)
        } else {
            value
        }
    }
}

/// The rows of accessor `index`, called `what` in messages: `N` numbers each.
pub(super) fn rows<const N: usize>(
    document: &Document,
    binary: &[u8],
    index: usize,
    what: &str,
) -> Result<Vec<[f32; N]>, DecodeError> {
    let malformed =
        |message: String| DecodeError::Malformed(format!("attribute '{what}': {message}"));
    let accessor = document
        .accessors
        .get(index)
        .ok_or_else(|| malformed(format!("there is no accessor {index}")))?;
    let component = Component::of_code(accessor.component_type).ok_or_else(|| {
        malformed(format!(
            "numbers of type {} are not read",
            accessor.component_type
        ))
    })?;
    let expected = match N {
        1 => "SCALAR",
        3 => "VEC3",
        _ => "VEC4",
    };
    if accessor.kind != expected {
        return Err(malformed(format!(
            "accessor {index} is another type than {expected}"
        )));
    }
    if accessor.sparse.is_some() {
        return Err(DecodeError::Unsupported(format!(
            "attribute '{what}' is sparse; export it whole"
        )));
    }
    let view = accessor
        .buffer_view
        .ok_or_else(|| malformed(format!("accessor {index} has no buffer view")))?;
    let (bytes, view) = view_bytes(document, binary, view).map_err(malformed)?;
    let width = N * component.bytes();
    let stride = view.byte_stride.unwrap_or(width as u64);
    let extent = extent_of(accessor, stride, width)
        .filter(|&end| stride >= width as u64 && end <= bytes.len() as u64);
    if extent.is_none() {
        return Err(malformed(format!(
            "accessor {index} claims {} rows of {width} bytes, {stride} apart, in {} bytes",
            accessor.count,
            bytes.len()
        )));
    }
    let start = accessor.byte_offset as usize;
    let row = |row: usize| {
        let at = start + row * stride as usize;
        std::array::from_fn(|i| {
            component.read(&bytes[at + i * component.bytes()..], accessor.normalized)
        })
    };
    Ok((0..accessor.count as usize).map(row).collect())
}

/// Byte at which the last row of an accessor ends in its view.
fn extent_of(accessor: &Accessor, stride: u64, width: usize) -> Option<u64> {
    if accessor.count == 0 {
        return Some(0);
    }
    (accessor.count - 1)
        .checked_mul(stride)?
        .checked_add(accessor.byte_offset)?
        .checked_add(width as u64)
}

/// The bytes of buffer view `index`.
pub(super) fn view_bytes<'d, 'b>(
    document: &'d Document,
    binary: &'b [u8],
    index: usize,
) -> Result<(&'b [u8], &'d BufferView), String> {
    let view = document
        .buffer_views
        .get(index)
        .ok_or_else(|| format!("there is no buffer view {index}"))?;
    let buffer = document
        .buffers
        .get(view.buffer)
        .ok_or_else(|| format!("there is no buffer {}", view.buffer))?;
    if view.buffer != 0 || buffer.uri.is_some() {
        return Err(format!(
            "buffer {} is another file; pack everything into one .glb",
            view.buffer
        ));
    }
    let end = view
        .byte_offset
        .checked_add(view.byte_length)
        .filter(|&end| end <= binary.len() as u64);
    let end = end.ok_or_else(|| {
        format!(
            "buffer view {index} has {} bytes from {}, of {}",
            view.byte_length,
            view.byte_offset,
            binary.len()
        )
    })?;
    Ok((&binary[view.byte_offset as usize..end as usize], view))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integers_are_normalized_as_gltf_says() {
        assert_eq!(
            [127, 0, -127, -128].map(|x: i8| Component::I8.read(&[x as u8], true)),
            [1.0, 0.0, -1.0, -1.0]
        );
        assert_eq!(Component::I8.read(&[0xfe], false), -2.0);
        assert_eq!(Component::I16.read(&i16::MIN.to_le_bytes(), true), -1.0);
        assert_eq!(
            [
                Component::U8.read(&[51], true),
                Component::U16.read(&[0xff, 0xff], true)
            ],
            [0.2, 1.0]
        );
        assert_eq!(Component::F32.read(&(-1.5f32).to_le_bytes(), true), -1.5);
    }
}
