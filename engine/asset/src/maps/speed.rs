//! Speeds as texts with a unit.

use crate::xml::finite;

/// Number and unit of `text`, in any case: the unit as the factor that makes meters a second of it,
/// `None` where the text has none. `None` for what is no number of at least zero with a known unit.
pub(super) fn with_unit(text: &str) -> Option<(f64, Option<f64>)> {
    let text = text.trim();
    let digits = text
        .find(|c: char| !(c.is_ascii_digit() || matches!(c, '.' | '+')))
        .unwrap_or(text.len());
    let number = finite(&text[..digits])?;
    Some((number, factor(&text[digits..])?))
}

/// Factor from a unit to meters a second, `None` within for no unit at all; `None` for an unknown
/// one.
pub(super) fn factor(unit: &str) -> Option<Option<f64>> {
    match unit.trim().to_ascii_lowercase().as_str() {
        "" => Some(None),
        "km/h" | "kmh" | "kph" | "kmph" | "km/hr" | "kilometers_per_hour" => Some(Some(1.0 / 3.6)),
        "mph" | "mi/h" => Some(Some(0.447_04)),
        "m/s" | "mps" | "ms" => Some(Some(1.0)),
        "knots" | "kn" => Some(Some(1852.0 / 3600.0)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_told_in_any_writing() {
        for (text, expected) in [
            ("50kmh", Some((50.0, Some(1.0 / 3.6)))),
            (" 50 km/h", Some((50.0, Some(1.0 / 3.6)))),
            ("50KMPH", Some((50.0, Some(1.0 / 3.6)))),
            ("30 mph", Some((30.0, Some(0.447_04)))),
            ("13.9", Some((13.9, None))),
            ("10 mps", Some((10.0, Some(1.0)))),
            ("fast", None),
            ("50 furlongs", None),
            ("1e999", None),
            ("-5", None),
        ] {
            assert_eq!(with_unit(text), expected, "{text}");
        }
    }
}
