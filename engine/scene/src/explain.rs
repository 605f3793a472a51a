//! Errors as sentences for people.

use std::error::Error;

/// Most characters of a sentence. A field of a file may be megabytes long.
const CHARS_MAX: usize = 400;
/// Characters that are kept of the start of a longer sentence; the others are kept of its end.
const START_CHARS: usize = 160;
/// Stands for what is left out.
const CUT: &str = " [...] ";
/// Numbers of more characters are written with an exponent: `1e308` has 309 digits.
const NUMBER_CHARS_MAX: usize = 24;

/// The error and its causes, one line each, as `error: ...` and ` because: ...`. A cause that the
/// line above already contains is left out, and each line is made as [`one_line`] does.
#[must_use]
pub fn explain(error: &(dyn Error + 'static)) -> String {
    let mut above = error.to_string();
    let mut lines = format!("error: {}\n", one_line(&above));
    let mut next = error.source();
    while let Some(cause) = next {
        let sentence = cause.to_string();
        if !above.contains(&sentence) {
            lines.push_str(&format!("  because: {}\n", one_line(&sentence)));
        }
        (above, next) = (sentence, cause.source());
    }
    lines
}

/// `text` as a line of at most 400 characters. Characters that a terminal obeys instead of showing
/// them are escaped, and long numbers have an exponent. What is cut is cut from the middle: a path
/// stands first, the advice last.
#[must_use]
pub fn one_line(text: &str) -> String {
    // The middle of a text that is far too long is cut before it is examined.
    let kept: Vec<char> = match text.char_indices().nth(16 * CHARS_MAX) {
        None => text.chars().collect(),
        Some(_) => {
            let mut end: Vec<char> = text.chars().rev().take(8 * CHARS_MAX).collect();
            end.reverse();
            text.chars().take(8 * CHARS_MAX).chain(end).collect()
        }
    };
    let shown = shown(&kept);
    let count = shown.chars().count();
    if count <= CHARS_MAX {
        return shown;
    }
    let end_chars = CHARS_MAX - START_CHARS - CUT.len();
    let start = shown.chars().take(START_CHARS);
    start
        .chain(CUT.chars())
        .chain(shown.chars().skip(count - end_chars))
        .collect()
}

fn shown(text: &[char]) -> String {
    let mut shown = String::new();
    let mut rest = text;
    while let Some((&first, behind)) = rest.split_first() {
        if first.is_ascii_digit() {
            let (number, behind) = rest.split_at(number_length(rest));
            shown.push_str(&short(number.iter().collect()));
            rest = behind;
            continue;
        }
        match is_obeyed(first) {
            true => shown.extend(first.escape_default()),
            false => shown.push(first),
        }
        rest = behind;
    }
    shown
}

/// Characters of the digits at the start of `text`, with a decimal part if there is one.
fn number_length(text: &[char]) -> usize {
    let digits = |text: &[char]| text.iter().take_while(|c| c.is_ascii_digit()).count();
    let whole = digits(text);
    match text.get(whole) {
        Some('.') => match digits(&text[whole + 1..]) {
            0 => whole,
            decimals => whole + 1 + decimals,
        },
        _ => whole,
    }
}

fn short(number: String) -> String {
    if number.len() <= NUMBER_CHARS_MAX {
        return number;
    }
    match number.parse::<f64>() {
        Ok(value) if value.is_finite() => format!("{value:e}"),
        _ => format!("{}... ({} digits)", &number[..8], number.len()),
    }
}

/// True for characters that move the cursor, or change the direction in which text is shown.
fn is_obeyed(c: char) -> bool {
    c.is_control()
        || matches!(
            c,
            '\u{061c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{feff}'
        )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error)]
    #[error("{0}")]
    struct Told(String, #[source] Option<Box<Told>>);

    #[test]
    fn a_cause_is_told_once() {
        let disk = Told("disk on fire".into(), None);
        let write = Told(
            "cannot write a.ply: disk on fire".into(),
            Some(Box::new(disk)),
        );
        let street = Told("the street was not written".into(), Some(Box::new(write)));
        assert_eq!(
            explain(&street),
            "error: the street was not written\n  because: cannot write a.ply: disk on fire\n"
        );
    }

    #[test]
    fn long_and_hostile_sentences_are_tamed() {
        let hostile = Told(
            format!("a\u{1b}[2Jb\nc.ply: {}; copy it again", "x".repeat(30_000)),
            None,
        );
        let message = explain(&hostile);
        assert!(
            message.chars().count() <= "error: \n".len() + 400
                && message.starts_with("error: a\\u{1b}[2Jb\\nc.ply"),
            "{message}"
        );
        assert!(message.ends_with("; copy it again\n"), "{message}");
        // A path whose end would be shown first, and a zero-width mark.
        assert_eq!(
            one_line("\u{202e}ylp.\u{2066}a\u{feff}"),
            "\\u{202e}ylp.\\u{2066}a\\u{feff}"
        );
        assert_eq!(one_line("Straße 道 🚗"), "Straße 道 🚗");
        let controls = "\u{7}".repeat(5000);
        assert!(one_line(&controls).chars().count() <= 400);
    }

    #[test]
    fn long_numbers_have_an_exponent() {
        let speed = format!("a speed of {} m/s; expected at most 100", 1e308);
        assert_eq!(
            one_line(&speed),
            "a speed of 1e308 m/s; expected at most 100"
        );
        assert_eq!(one_line(&format!("{}", 5e-324)), "5e-324");
        assert_eq!(
            one_line(&format!("-{}.", f64::MAX)),
            "-1.7976931348623157e308."
        );
        let digits = "9".repeat(4000);
        assert_eq!(one_line(&digits), "99999999... (4000 digits)");
        for kept in ["18446744073709551615", "0.1 of 3.141592653589793", "1.2.3"] {
            assert_eq!(one_line(kept), kept);
        }
    }
}
