//! Arrays as NumPy writes them: `.npy`, and the entries of a `.npz`.
//!
//! After the description of the format in NumPy's `numpy.lib.format`: a magic word, a version, the
//! length of a header, the header, a dictionary of Python in text, and the numbers.

use half::f16;

use crate::DecodeError;

/// First bytes of a file.
const MAGIC: &[u8] = b"\x93NUMPY";
/// Largest header, bytes; NumPy's own limit.
const HEADER_BYTES_MAX: usize = 10_000;
/// Most dimensions.
const DIMENSIONS_MAX: usize = 8;

/// Type of the elements.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Element {
    F16,
    F32,
    F64,
    Signed(usize),
    Unsigned(usize),
    /// Texts of so many characters of 32 bits.
    Text(usize),
}

impl Element {
    /// The type that `descr` says, as in `<f4`; `None` where it is not read.
    fn from_descr(descr: &str) -> Option<Self> {
        let (order, rest) = descr.split_at_checked(1)?;
        let (kind, size) = rest.split_at_checked(1)?;
        let size: usize = size.parse().ok().filter(|size| *size <= 1 << 16)?;
        if !matches!((order, size), ("<", _) | ("|", 1)) {
            return None;
        }
        match (kind, size) {
            ("f", 2) => Some(Self::F16),
            ("f", 4) => Some(Self::F32),
            ("f", 8) => Some(Self::F64),
            ("i", 1 | 2 | 4 | 8) => Some(Self::Signed(size)),
            ("u", 1 | 2 | 4 | 8) | ("b", 1) => Some(Self::Unsigned(size)),
            ("U", 1..) => Some(Self::Text(size)),
            _ => None,
        }
    }

    fn bytes(self) -> usize {
        match self {
            Self::F16 => 2,
            Self::F32 => 4,
            Self::F64 => 8,
            Self::Signed(bytes) | Self::Unsigned(bytes) => bytes,
            Self::Text(characters) => 4 * characters,
        }
    }
}

/// An array over the bytes of its file, rows first.
#[derive(Clone, Debug)]
pub(crate) struct NpyArray<'a> {
    shape: Vec<usize>,
    element: Element,
    data: &'a [u8],
}

impl<'a> NpyArray<'a> {
    /// Reads the array called `name` in messages.
    pub(crate) fn parse(bytes: &'a [u8], name: &str) -> Result<Self, DecodeError> {
        let wrong = |reason: &str| DecodeError::Malformed(format!("'{name}' {reason}"));
        let is_cut = || wrong("ends within its header");
        let rest = bytes
            .strip_prefix(MAGIC)
            .ok_or_else(|| wrong("is no array of NumPy"))?;
        let (version, rest) = rest.split_at_checked(2).ok_or_else(is_cut)?;
        let width = if version[0] == 1 { 2 } else { 4 };
        let (length, rest) = rest.split_at_checked(width).ok_or_else(is_cut)?;
        let length = length
            .iter()
            .rev()
            .fold(0usize, |sum, byte| sum << 8 | usize::from(*byte));
        if length > HEADER_BYTES_MAX {
            return Err(wrong("has a header that is too long"));
        }
        let (header, data) = rest.split_at_checked(length).ok_or_else(is_cut)?;
        let header = str::from_utf8(header).map_err(|_| wrong("has a header that is no text"))?;
        let descr = value_of(header, "descr").unwrap_or_default();
        let descr = descr.trim_matches(['\'', '"']);
        let element = Element::from_descr(descr).ok_or_else(|| {
            wrong(&format!(
                "has elements of type '{descr}', which are not read; save plain numbers or texts"
            ))
        })?;
        if value_of(header, "fortran_order") != Some("False") {
            return Err(wrong("is stored columns first; save it with rows first"));
        }
        let shape = shape_of(header).ok_or_else(|| wrong("has no shape that is read"))?;
        let claimed = shape
            .iter()
            .try_fold(element.bytes(), |product, side| product.checked_mul(*side));
        if claimed != Some(data.len()) {
            return Err(wrong(&format!(
                "claims the shape {shape:?} of {descr}, and has {} bytes; copy or export it again",
                data.len()
            )));
        }
        Ok(Self {
            shape,
            element,
            data,
        })
    }

    /// Sides of the array.
    pub(crate) fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// The numbers; none where elements are texts. Integers beyond 2^53 are rounded.
    pub(crate) fn numbers(&self) -> Vec<f64> {
        let integer = |bytes: &[u8]| {
            let bits = bytes
                .iter()
                .rev()
                .fold(0u64, |sum, byte| sum << 8 | u64::from(*byte));
            let unused = 64 - 8 * bytes.len();
            (bits << unused, unused)
        };
        let number = |bytes: &[u8]| match (self.element, bytes) {
            (Element::F16, &[a, b]) => f16::from_le_bytes([a, b]).to_f64(),
            (Element::F32, &[a, b, c, d]) => f32::from_le_bytes([a, b, c, d]).into(),
            (Element::F64, bytes) => f64::from_bits(integer(bytes).0),
            (Element::Signed(_), bytes) => {
                let (bits, unused) = integer(bytes);
                (bits.cast_signed() >> unused) as f64
            }
            (_, bytes) => {
                let (bits, unused) = integer(bytes);
                (bits >> unused) as f64
            }
        };
        match self.element {
            Element::Text(_) => Vec::new(),
            element => self
                .data
                .chunks_exact(element.bytes())
                .map(number)
                .collect(),
        }
    }

    /// The texts; none where elements are numbers.
    pub(crate) fn texts(&self) -> Vec<String> {
        let Element::Text(characters) = self.element else {
            return Vec::new();
        };
        let text = |bytes: &[u8]| -> String {
            let (codes, _) = bytes.as_chunks::<4>();
            let codes = codes.iter().map(|code| u32::from_le_bytes(*code));
            let letter = |code| char::from_u32(code).unwrap_or(char::REPLACEMENT_CHARACTER);
            codes.take_while(|code| *code != 0).map(letter).collect()
        };
        self.data.chunks_exact(4 * characters).map(text).collect()
    }
}

/// Text of the value of `key` in a dictionary of Python, up to the next comma or brace.
fn value_of<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    let after = header.split_once(&format!("'{key}'"))?.1;
    let value = after.split_once(':')?.1;
    value.split([',', '}']).next().map(str::trim)
}

/// The tuple of numbers behind the key `shape`.
fn shape_of(header: &str) -> Option<Vec<usize>> {
    let after = header.split_once("'shape'")?.1;
    let (sides, _) = after.split_once('(')?.1.split_once(')')?;
    let sides = sides.split(',').map(str::trim);
    let sides = sides.filter(|side| !side.is_empty());
    let sides: Option<Vec<usize>> = sides.map(|side| side.parse().ok()).collect();
    sides.filter(|sides| sides.len() <= DIMENSIONS_MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
        let header =
            format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n");
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.bytes());
        bytes.extend(data);
        bytes
    }

    #[test]
    fn numbers_and_texts_are_read() {
        let read = |descr: &str, shape: &str, data: &[u8]| {
            let bytes = file(descr, shape, data);
            let array = NpyArray::parse(&bytes, "a").unwrap();
            (array.shape().to_vec(), array.numbers(), array.texts())
        };
        let halves = [f16::from_f32(0.5), f16::from_f32(-2.0)].map(f16::to_le_bytes);
        let (shape, numbers, _) = read("<f2", "(1, 2)", halves.as_flattened());
        assert_eq!((shape, numbers), (vec![1, 2], vec![0.5, -2.0]));
        assert_eq!(read("<i8", "()", &(-3i64).to_le_bytes()).1, [-3.0]);
        assert_eq!(read("|u1", "(2,)", &[0, 255]).1, [0.0, 255.0]);
        assert_eq!(read("<f8", "(1,)", &0.1f64.to_le_bytes()).1, [0.1]);
        let letters = ['a', 'b', '\0'].map(|letter| u32::from(letter).to_le_bytes());
        assert_eq!(read("<U3", "(1,)", letters.as_flattened()).2, ["ab"]);
    }

    #[test]
    fn hostile_arrays_get_a_sentence() {
        let whole = file("<f4", "(2,)", &[0; 8]);
        for cut in 0..whole.len() {
            assert!(NpyArray::parse(&whole[..cut], "a").is_err(), "{cut}");
        }
        for (descr, shape) in [
            (">f4", "(2,)"),
            ("|O", "(1,)"),
            ("<f4", "(18446744073709551615, 18446744073709551615)"),
            ("<f4", "(-1,)"),
            ("<U0", "(2,)"),
            ("<U99999999", "(2,)"),
        ] {
            assert!(NpyArray::parse(&file(descr, shape, &[0; 8]), "a").is_err());
        }
    }
}
