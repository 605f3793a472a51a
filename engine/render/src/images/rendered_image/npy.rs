//! NumPy arrays (format versions 1 to 3, NumPy enhancement proposal 1): float32, `[height, width, 3
//! or 4]`.

use super::{Image, ImageError, ImageFileFormat, PIXELS_MAX};
use crate::PlaneMap;

const MAGIC: &[u8] = b"\x93NUMPY";

pub fn encode(image: &Image) -> Vec<u8> {
    let shape = format!("({}, {}, 4)", image.height, image.width);
    with_header(
        "<f4",
        &shape,
        image
            .interleaved_rgba()
            .iter()
            .flat_map(|value| value.to_le_bytes()),
    )
}

/// A plane of `image`, `[height, width]` or `[height, width, channels]`, of NumPy's type `descr`.
pub fn encode_plane(
    image: &Image,
    channels: usize,
    descr: &str,
    values: impl Iterator<Item = u8>,
) -> Vec<u8> {
    let (height, width) = (image.height, image.width);
    let shape = match channels {
        1 => format!("({height}, {width})"),
        _ => format!("({height}, {width}, {channels})"),
    };
    with_header(descr, &shape, values)
}

fn with_header(descr: &str, shape: &str, values: impl Iterator<Item = u8>) -> Vec<u8> {
    let mut header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
    // Magic, version, length and header together fill a multiple of 64 bytes and end in a line
    // feed.
    let filled = (MAGIC.len() + 4 + header.len() + 1).next_multiple_of(64);
    header.push_str(&" ".repeat(filled - MAGIC.len() - 4 - header.len() - 1));
    header.push('\n');
    let mut bytes = Vec::with_capacity(filled + values.size_hint().0);
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&[1, 0]);
    bytes.extend_from_slice(&(header.len() as u16).to_le_bytes());
    bytes.extend_from_slice(header.as_bytes());
    bytes.extend(values);
    bytes
}

pub fn decode(bytes: &[u8]) -> Result<Image, ImageError> {
    let (header, data) = split_header(bytes)?;
    let (width, height, channels) = array_shape(header)?;
    let expected = u64::from(width) * u64::from(height) * channels as u64 * 4;
    if data.len() as u64 != expected {
        return Err(malformed(format!(
            "{height}x{width}x{channels} float32 take {expected} bytes after the header; found {}",
            data.len()
        )));
    }
    let pixels = || data.chunks_exact(channels * 4);
    let value = |pixel: &[u8], channel: usize| {
        let at = channel * 4;
        f32::from_le_bytes([pixel[at], pixel[at + 1], pixel[at + 2], pixel[at + 3]])
    };
    Ok(Image {
        width,
        height,
        rgb: pixels()
            .map(|pixel| std::array::from_fn(|channel| value(pixel, channel)))
            .collect(),
        alpha: pixels()
            .map(|pixel| if channels == 4 { value(pixel, 3) } else { 1.0 })
            .collect(),
        planes: PlaneMap::new(),
    })
}

fn malformed(message: impl Into<String>) -> ImageError {
    ImageFileFormat::Npy.malformed(message)
}

/// The header's text and what follows it.
fn split_header(bytes: &[u8]) -> Result<(&str, &[u8]), ImageError> {
    let after_magic = bytes
        .strip_prefix(MAGIC)
        .ok_or_else(|| malformed("its first bytes are not \\x93NUMPY"))?;
    let (length, rest) = match after_magic {
        [1, _, a, b, rest @ ..] => (usize::from(u16::from_le_bytes([*a, *b])), rest),
        [2 | 3, _, a, b, c, d, rest @ ..] => (u32::from_le_bytes([*a, *b, *c, *d]) as usize, rest),
        [1..=3, ..] | [] => return Err(malformed("it ends inside its header")),
        [version, ..] => {
            return Err(malformed(format!(
                "expected format version 1, 2 or 3; found {version}"
            )));
        }
    };
    let (header, data) = rest.split_at_checked(length).ok_or_else(|| {
        malformed(format!(
            "its header claims {length} bytes and {} follow",
            rest.len()
        ))
    })?;
    let header = std::str::from_utf8(header).map_err(|_| malformed("its header is not text"))?;
    Ok((header, data))
}

/// Width, height and channels from the header's Python dictionary.
fn array_shape(header: &str) -> Result<(u32, u32, usize), ImageError> {
    let descr = field(header, "descr")?;
    if !descr.starts_with("'<f4'") && !descr.starts_with("\"<f4\"") {
        return Err(malformed(format!(
            "expected little-endian float32 ('<f4'); found {}",
            first_words(descr)
        )));
    }
    if !field(header, "fortran_order")?.starts_with("False") {
        return Err(malformed(
            "expected C order; save it with numpy.ascontiguousarray",
        ));
    }
    let shape = field(header, "shape")?;
    let wrong = || {
        malformed(format!(
            "expected a shape (height, width, 3 or 4); found {}",
            first_words(shape)
        ))
    };
    let inside = shape
        .strip_prefix('(')
        .and_then(|rest| rest.split(')').next())
        .ok_or_else(wrong)?;
    let sizes: Vec<u32> = inside
        .split(',')
        .map(str::trim)
        .filter(|size| !size.is_empty())
        .map(|size| size.parse().map_err(|_| wrong()))
        .collect::<Result<_, _>>()?;
    match sizes[..] {
        [height, width, channels @ (3 | 4)]
            if (1..=PIXELS_MAX).contains(&(u64::from(width) * u64::from(height))) =>
        {
            Ok((width, height, channels as usize))
        }
        _ => Err(wrong()),
    }
}

/// Value after `'key':` in the header.
fn field<'a>(header: &'a str, key: &str) -> Result<&'a str, ImageError> {
    [format!("'{key}'"), format!("\"{key}\"")]
        .iter()
        .find_map(|quoted| header.split_once(quoted.as_str()))
        .and_then(|(_, after)| after.trim_start().strip_prefix(':'))
        .map(str::trim_start)
        .ok_or_else(|| malformed(format!("its header has no '{key}'")))
}

/// Enough of `text` for a message.
fn first_words(text: &str) -> String {
    text.chars()
        .take(40)
        .filter(|character| !character.is_control())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Plane, PlaneValues};

    fn file(header: &str, data: &[u8]) -> Vec<u8> {
        [
            MAGIC,
            &[1, 0],
            &(header.len() as u16).to_le_bytes(),
            header.as_bytes(),
            data,
        ]
        .concat()
    }

    #[test]
    fn the_bytes_are_what_numpy_writes() {
        // numpy.save of a (1, 2, 4) float32 array: 128 bytes of header, then row-major values.
        let mut image = Image::filled(2, 1, [0.5, -1.0, 2.0]);
        image.alpha[1] = 0.25;
        let bytes = encode(&image);
        assert_eq!(&bytes[..10], b"\x93NUMPY\x01\x00\x76\x00");
        assert!(
            bytes[10..]
                .starts_with(b"{'descr': '<f4', 'fortran_order': False, 'shape': (1, 2, 4), }")
        );
        assert_eq!(bytes[127], b'\n');
        assert_eq!(bytes.len(), 128 + 32);
        assert_eq!(&bytes[128..132], &0.5f32.to_le_bytes());
        assert_eq!(&bytes[156..160], &0.25f32.to_le_bytes());
    }

    #[test]
    fn planes_have_their_own_shape_and_type() {
        let image = Image {
            planes: PlaneMap::from([
                (Plane::Depth, PlaneValues::F32(vec![1.5, 0.0])),
                (Plane::Instance, PlaneValues::U16(vec![0, 259])),
                (
                    Plane::FlowForward,
                    PlaneValues::F32(vec![1.0, 2.0, 3.0, 4.0]),
                ),
            ]),
            ..Image::filled(2, 1, [0.0; 3])
        };
        let (depth, instance) = (
            image.encode_plane(Plane::Depth).unwrap(),
            image.encode_plane(Plane::Instance).unwrap(),
        );
        assert!(
            depth[10..].starts_with(b"{'descr': '<f4', 'fortran_order': False, 'shape': (1, 2), }")
        );
        assert_eq!(
            depth[128..],
            [1.5f32.to_le_bytes(), 0f32.to_le_bytes()].concat()
        );
        let flow = image.encode_plane(Plane::FlowForward).unwrap();
        assert!(
            flow[10..]
                .starts_with(b"{'descr': '<f4', 'fortran_order': False, 'shape': (1, 2, 2), }")
        );
        assert!(instance[10..].starts_with(b"{'descr': '<u2'") && instance[128..] == [0, 0, 3, 1]);
        assert!(
            Image::filled(2, 1, [0.0; 3])
                .encode_plane(Plane::Depth)
                .is_none()
        );
    }

    #[test]
    fn three_channels_and_another_order_of_keys_are_read() {
        let data: Vec<u8> = [0.1f32, 0.2, 0.3]
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect();
        let image = decode(&file(
            "{'shape':(1,1,3),\"fortran_order\": False, 'descr':\"<f4\"}\n",
            &data,
        ))
        .unwrap();
        assert_eq!((image.rgb[0], image.alpha[0]), ([0.1, 0.2, 0.3], 1.0));
    }

    #[test]
    fn absurd_headers_are_refused_with_a_reason() {
        let header = |descr: &str, order: &str, shape: &str| {
            file(
                &format!("{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}\n"),
                &[0; 16],
            )
        };
        assert!(decode(&header("'<f4'", "False", "(1, 1, 4)")).is_ok());
        for (bytes, word) in [
            (
                header("'<f4'", "False", "(4000000000, 4000000000, 4)"),
                "shape",
            ),
            (
                header("'<f4'", "False", "(8000, 8000, 4)"),
                "bytes after the header",
            ),
            (
                header("'<f4'", "False", "(99999999999999999999, 1, 4)"),
                "shape",
            ),
            (header("'<f4'", "False", "(0, 1, 4)"), "shape"),
            (header("'<f4'", "False", "(-1, 1, 4)"), "shape"),
            (header("'<f4'", "False", "(1, 4)"), "shape"),
            (header("'<f4'", "False", "(1, 1, 2)"), "shape"),
            (header("'<f4'", "True", "(1, 1, 4)"), "C order"),
            (header("'<f8'", "False", "(1, 1, 4)"), "float32"),
            (header("[('a', '<f4')]", "False", "(1, 1, 4)"), "float32"),
            (file("{}", &[]), "descr"),
            (file("\u{1f}\u{0}", &[]), "descr"),
            (
                b"\x93NUMPY\x02\x00\xff\xff\xff\xff".to_vec(),
                "claims 4294967295",
            ),
            (b"\x93NUMPY\x09\x00\xff\xff".to_vec(), "version"),
            (b"\x93NUMPY\x01".to_vec(), "ends inside"),
        ] {
            let message = decode(&bytes).unwrap_err().to_string();
            assert!(message.contains(word), "{message}");
        }
    }
}
