//! Telling code from comments and literals, for Rust and GLSL.

/// `text` with the inside of every comment, string and character literal replaced by spaces. Lines
/// stay where they are.
pub fn code_only(text: &str) -> String {
    let bytes = text.as_bytes();
    let mut code = Vec::with_capacity(bytes.len());
    let mut at = 0;
    while at < bytes.len() {
        let length = literal_length(&bytes[at..], at.checked_sub(1).map(|before| bytes[before]));
        if length == 0 {
            code.push(bytes[at]);
            at += 1;
        } else {
            let end = (at + length).min(bytes.len());
            code.extend(
                bytes[at..end]
                    .iter()
                    .map(|&byte| if byte == b'\n' { b'\n' } else { b' ' }),
            );
            at = end;
        }
    }
    String::from_utf8(code).expect("literals and comments are blanked whole")
}

/// Functions in `code`, which has no comments and literals: the line of each, from 1, and the code
/// from its `fn` on.
pub fn functions(code: &str) -> impl Iterator<Item = (usize, &str)> {
    let is_word = |c: char| c.is_alphanumeric() || c == '_';
    let starts = code.match_indices("fn ").map(|(at, _)| at);
    starts
        .filter(move |&at| !code[..at].ends_with(is_word))
        .map(|at| (code[..at].lines().count().max(1), &code[at..]))
}

/// Length of the comment or literal that starts `rest`, 0 if none does. `before` is the byte in
/// front of it.
fn literal_length(rest: &[u8], before: Option<u8>) -> usize {
    let inside_a_word = before.is_some_and(|byte| byte.is_ascii_alphanumeric() || byte == b'_');
    match rest {
        [b'/', b'/', ..] => rest
            .iter()
            .position(|&byte| byte == b'\n')
            .unwrap_or(rest.len()),
        [b'/', b'*', ..] => block_comment_length(rest),
        [b'"', ..] => 1 + quoted_length(&rest[1..], b'"'),
        [b'r', ..] | [b'b', b'r', ..] if !inside_a_word => raw_string_length(rest),
        // 'a' and '\n' are characters, 'a is a lifetime.
        [b'\'', b'\\', ..] => 1 + quoted_length(&rest[1..], b'\''),
        [b'\'', ..] => {
            let character = std::str::from_utf8(&rest[1..rest.len().min(5)])
                .map_or_else(|error| error.valid_up_to(), str::len);
            let first = std::str::from_utf8(&rest[1..=character])
                .ok()
                .and_then(|text| text.chars().next());
            first.map_or(0, |first| {
                if rest.get(1 + first.len_utf8()) == Some(&b'\'') {
                    first.len_utf8() + 2
                } else {
                    0
                }
            })
        }
        _ => 0,
    }
}

/// Block comments nest in Rust.
fn block_comment_length(rest: &[u8]) -> usize {
    let (mut depth, mut at) = (0_usize, 0);
    while at < rest.len() {
        match &rest[at..] {
            [b'/', b'*', ..] => (depth, at) = (depth + 1, at + 2),
            [b'*', b'/', ..] => (depth, at) = (depth - 1, at + 2),
            _ => at += 1,
        }
        if depth == 0 {
            return at;
        }
    }
    rest.len()
}

/// Bytes up to and with the closing quote, over escaped ones.
fn quoted_length(rest: &[u8], quote: u8) -> usize {
    let mut at = 0;
    while at < rest.len() {
        match rest[at] {
            b'\\' => at += 2,
            byte if byte == quote => return at + 1,
            _ => at += 1,
        }
    }
    rest.len()
}

fn raw_string_length(rest: &[u8]) -> usize {
    let prefix = if rest[0] == b'b' { 2 } else { 1 };
    let hashes = rest[prefix..]
        .iter()
        .take_while(|&&byte| byte == b'#')
        .count();
    let open = prefix + hashes;
    if rest.get(open) != Some(&b'"') {
        return 0;
    }
    let mut close = vec![b'"'];
    close.resize(1 + hashes, b'#');
    let found = rest[open + 1..]
        .windows(close.len())
        .position(|window| window == close);
    found.map_or(rest.len(), |at| open + 1 + at + close.len())
}

#[test]
fn comments_and_literals_vanish_and_code_stays() {
    let cases = [
        ("a // b\nc", "a     \nc"),
        ("a /* b /* c */ d */ e", "a                   e"),
        (r#"f("x \" // y") + 1"#, "f(           ) + 1"),
        (r##"f(r#"a " b"#) + 1"##, "f(          ) + 1"),
        ("let c = '\"'; d", "let c =    ; d"),
        ("fn f<'a>(x: &'a str) {}", "fn f<'a>(x: &'a str) {}"),
        ("let c = '\\''; d", "let c =     ; d"),
        ("let c = 'é'; d", "let c =     ; d"),
        ("var r = 1; hair\"x\"", "var r = 1; hair   "),
        ("\"never closed", "             "),
    ];
    for (text, expected) in cases {
        assert_eq!(code_only(text), expected, "{text}");
    }
}
