//! NumPy arrays (format versions 1 to 3, NumPy enhancement proposal 1), little-endian and in C
//! order.

use super::malformed;
use crate::DecodeError;

const MAGIC: &[u8] = b"\x93NUMPY";

/// Type of a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    F32,
    F64,
    I32,
}

impl Kind {
    const NAMED: [(&'static str, Self); 3] =
        [("<f4", Self::F32), ("<f8", Self::F64), ("<i4", Self::I32)];

    fn bytes(self) -> usize {
        match self {
            Self::F32 | Self::I32 => 4,
            Self::F64 => 8,
        }
    }
}

/// An array in the bytes of a file.
pub struct Array<'a> {
    /// Length of each dimension.
    pub shape: Vec<usize>,
    kind: Kind,
    data: &'a [u8],
}

impl<'a> Array<'a> {
    /// The array in `bytes`.
    ///
    /// # Errors
    /// A sentence saying what is wrong.
    pub fn parse(bytes: &'a [u8]) -> Result<Self, DecodeError> {
        let (header, data) = split(bytes)?;
        let (_, descr) = entry(header, "descr")?;
        let named = Kind::NAMED.iter().find(|(name, _)| {
            let quoted = descr.strip_prefix(['\'', '"']);
            quoted.is_some_and(|rest| rest.starts_with(name))
        });
        let Some(&(_, kind)) = named else {
            return Err(malformed(format!(
                "its values are of type {descr:.20}; expected '<f4', '<f8' or '<i4'"
            )));
        };
        if !entry(header, "fortran_order")?.1.starts_with("False") {
            return Err(malformed("it is in Fortran order; save it in C order"));
        }
        let shape = shape(entry(header, "shape")?.1)?;
        let count = shape
            .iter()
            .try_fold(1_usize, |all, own| all.checked_mul(*own));
        let bytes = count.and_then(|count| count.checked_mul(kind.bytes()));
        if bytes != Some(data.len()) {
            return Err(malformed(format!(
                "an array {shape:?} of {} bytes each does not take the {} bytes that are there",
                kind.bytes(),
                data.len()
            )));
        }
        Ok(Self { shape, kind, data })
    }

    /// True if values are integers.
    pub fn is_integer(&self) -> bool {
        self.kind == Kind::I32
    }

    /// Value `index`, in C order.
    ///
    /// # Panics
    /// Panics if there is none.
    pub fn value(&self, index: usize) -> f64 {
        let own = &self.data[index * self.kind.bytes()..];
        match self.kind {
            Kind::F32 => f64::from(f32::from_le_bytes([own[0], own[1], own[2], own[3]])),
            Kind::I32 => f64::from(i32::from_le_bytes([own[0], own[1], own[2], own[3]])),
            Kind::F64 => f64::from_le_bytes([
                own[0], own[1], own[2], own[3], own[4], own[5], own[6], own[7],
            ]),
        }
    }
}

/// The header's text and the values behind it.
fn split(bytes: &[u8]) -> Result<(&str, &[u8]), DecodeError> {
    let Some(rest) = bytes.strip_prefix(MAGIC) else {
        return Err(malformed("its first bytes are not \\x93NUMPY"));
    };
    let (length, rest) = match *rest {
        [1, _, a, b, ref rest @ ..] => (usize::from(u16::from_le_bytes([a, b])), rest),
        [2 | 3, _, a, b, c, d, ref rest @ ..] => (u32::from_le_bytes([a, b, c, d]) as usize, rest),
        _ => {
            return Err(malformed(
                "it is of no version of NumPy's format that is known",
            ));
        }
    };
    let Some((header, data)) = rest.split_at_checked(length) else {
        return Err(DecodeError::Truncated {
            what: "the header of the array".into(),
            expected_bytes: length as u64,
            found_bytes: rest.len() as u64,
        });
    };
    let header = str::from_utf8(header).map_err(|_| malformed("its header is no text"))?;
    Ok((header, data))
}

/// Text behind `'key':` in a header, and what stands before it.
fn entry<'a>(header: &'a str, key: &str) -> Result<(&'a str, &'a str), DecodeError> {
    let quoted = [format!("'{key}':"), format!("\"{key}\":")];
    let found = quoted
        .iter()
        .find_map(|key| header.split_once(key.as_str()));
    let (before, after) = found.ok_or_else(|| malformed(format!("its header has no '{key}'")))?;
    Ok((before, after.trim_start()))
}

/// The numbers in the parentheses that `text` begins with.
fn shape(text: &str) -> Result<Vec<usize>, DecodeError> {
    let inner = text.strip_prefix('(').and_then(|rest| rest.split_once(')'));
    let (inner, _) = inner.ok_or_else(|| malformed("its shape is not in parentheses"))?;
    let numbers = inner
        .split(',')
        .map(str::trim)
        .filter(|number| !number.is_empty());
    let number = |text: &str| {
        text.parse()
            .map_err(|_| malformed(format!("its shape has '{text:.20}', which is no number")))
    };
    numbers.map(number).collect()
}
