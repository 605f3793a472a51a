//! Bodies of text: numbers apart by white space, as small test files have them.

use super::column::Scalar;
use super::header::{Element, shown};
use crate::DecodeError;

/// The rows in `body` as those of a binary file. Elements with lists are left out of `elements`.
///
/// Nothing is allocated by what the header claims: the rows grow with the numbers that are there.
pub(super) fn packed(elements: &mut Vec<Element>, body: &[u8]) -> Result<Vec<u8>, DecodeError> {
    let text = std::str::from_utf8(body)
        .map_err(|error| DecodeError::Malformed(format!("the body is ascii, but {error}")))?;
    let mut words = text.split_ascii_whitespace();
    let mut bytes = Vec::new();
    for element in elements
        .iter()
        .filter(|element| !element.properties.is_empty())
    {
        let has_lists = element.stride().is_none();
        for row in 0..element.count {
            for property in &element.properties {
                let mut word = || {
                    words.next().ok_or_else(|| {
                        DecodeError::Malformed(format!(
                            "element '{}' has {} rows; the text ends in row {row}",
                            shown(&element.name),
                            element.count
                        ))
                    })
                };
                let read = word()?;
                let fault = || {
                    DecodeError::Malformed(format!(
                        "element '{}', row {row}, '{}': '{}' is no number of its type",
                        shown(&element.name),
                        shown(&property.name),
                        shown(read)
                    ))
                };
                match property.column {
                    None => {
                        for _ in 0..read.parse::<u64>().map_err(|_| fault())? {
                            word()?;
                        }
                    }
                    Some(_) if has_lists => {}
                    Some(column) => push(&mut bytes, column.scalar, read).ok_or_else(fault)?,
                }
            }
        }
    }
    elements.retain(|element| element.stride().is_some());
    Ok(bytes)
}

/// Adds the number that `word` is; `None` if it is none of its type.
fn push(bytes: &mut Vec<u8>, scalar: Scalar, word: &str) -> Option<()> {
    let number: f64 = word.parse().ok()?;
    let within = |least: f64, most: f64| {
        (number.fract() == 0.0 && (least..=most).contains(&number)).then_some(number)
    };
    match scalar {
        Scalar::F32 => bytes.extend((number as f32).to_le_bytes()),
        Scalar::F64 => bytes.extend(number.to_le_bytes()),
        Scalar::I8 => bytes.extend((within(-128.0, 127.0)? as i8).to_le_bytes()),
        Scalar::U8 => bytes.push(within(0.0, 255.0)? as u8),
        Scalar::I16 => bytes.extend((within(-32_768.0, 32_767.0)? as i16).to_le_bytes()),
        Scalar::U16 => bytes.extend((within(0.0, 65_535.0)? as u16).to_le_bytes()),
        Scalar::I32 => {
            let whole = within(f64::from(i32::MIN), f64::from(i32::MAX))?;
            bytes.extend((whole as i32).to_le_bytes());
        }
        Scalar::U32 => bytes.extend((within(0.0, f64::from(u32::MAX))? as u32).to_le_bytes()),
    }
    Some(())
}
