//! Parameters: attributes with the value `$name` get the value of the declaration.

use std::borrow::Cow;
use std::collections::HashMap;

use decouplegs_asset::DecodeError;
use decouplegs_asset::xml::{self, Element, excerpt};

/// Longest value of a parameter, and largest file after substitution, bytes.
const VALUE_BYTES_MAX: usize = 1000;
const TEXT_BYTES_MAX: usize = 64 << 20;

/// The text of a file, parameters replaced by their values. Lines stay where they are.
///
/// # Errors
/// Returns an error if the file is not XML, or uses an expression or an undeclared parameter.
pub(super) fn substituted(bytes: &[u8]) -> Result<Cow<'_, str>, DecodeError> {
    let document = xml::parse(bytes)?;
    let text = document.input_text();
    if !text.contains(['$']) {
        return Ok(Cow::Borrowed(text));
    }
    let root = Element::root(&document, "OpenSCENARIO")?;
    let mut values: HashMap<&str, String> = HashMap::new();
    for declaration in root.descendants("ParameterDeclaration") {
        let (name, value) = (
            declaration.needed_attribute("name")?,
            declaration.needed_attribute("value")?,
        );
        if value.len() > VALUE_BYTES_MAX {
            return Err(declaration.fault(format!(
                "a value of {} bytes; at most {VALUE_BYTES_MAX} are read",
                value.len()
            )));
        }
        values
            .entry(name.trim_start_matches('$'))
            .or_insert_with(|| escaped(value));
    }
    let mut replaced = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(at) = rest.find(['"', '\'']) {
        let (before, quoted) = rest.split_at(at + 1);
        replaced.push_str(before);
        rest = quoted;
        let Some(name) = quoted.strip_prefix('$') else {
            continue;
        };
        let end = name.find(['"', '\'']).unwrap_or(name.len());
        let line = || 1 + replaced.bytes().filter(|&byte| byte == b'\n').count();
        let name = &name[..end];
        if name.starts_with('{') {
            return Err(DecodeError::Malformed(format!(
                "line {}: the expression ${} is not evaluated; write its value",
                line(),
                excerpt(name)
            )));
        }
        let value = values.get(name).ok_or_else(|| {
            DecodeError::Malformed(format!(
                "line {}: the parameter ${} is not declared",
                line(),
                excerpt(name)
            ))
        })?;
        if replaced.len() + value.len() > TEXT_BYTES_MAX {
            return Err(DecodeError::Malformed(format!(
                "more than {TEXT_BYTES_MAX} bytes after its parameters are replaced"
            )));
        }
        replaced.push_str(value);
        rest = &quoted[1 + end..];
    }
    replaced.push_str(rest);
    Ok(Cow::Owned(replaced))
}

/// Text of an attribute's value.
fn escaped(value: &str) -> String {
    let mut text = String::with_capacity(value.len());
    for letter in value.chars() {
        match letter {
            '&' => text.push_str("&amp;"),
            '<' => text.push_str("&lt;"),
            '"' => text.push_str("&quot;"),
            '\'' => text.push_str("&apos;"),
            _ => text.push(letter),
        }
    }
    text
}
