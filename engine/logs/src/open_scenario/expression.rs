//! The expressions of attributes, `${...}`, as OpenSCENARIO XML 1.1 to 1.3 define them.
//!
//! Operators, from weak to strong: `or`, `and`, `not`, `+ -`, `* / %`, the sign, `^`. Functions:
//! `round floor ceil sqrt abs sign` of one number, `pow max min` of two. `pi` is a number, as in
//! esmini. A sum whose parts are no numbers joins texts, also as in esmini.

/// Most bytes of an expression, and deepest nesting of its parts.
pub(super) const BYTES_MAX: usize = 1000;
const DEPTH_MAX: usize = 32;

/// Value of an expression.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Value {
    Number(f64),
    Truth(bool),
}

impl Value {
    /// The value that the text of a parameter is.
    fn from_text(text: &str) -> Option<Self> {
        match text {
            "true" => Some(Self::Truth(true)),
            "false" => Some(Self::Truth(false)),
            _ => decouplegs_asset::xml::finite(text).map(Self::Number),
        }
    }

    fn number(self) -> Result<f64, String> {
        match self {
            Self::Number(number) => Ok(number),
            Self::Truth(truth) => Err(format!("{truth} is no number")),
        }
    }

    fn truth(self) -> Result<bool, String> {
        match self {
            Self::Truth(truth) => Ok(truth),
            Self::Number(number) => Err(format!("{number} is neither true nor false")),
        }
    }
}

/// Text of the value of `text`, what stands between `${` and `}`. `parameter` gives the text of a
/// parameter by its name.
///
/// # Errors
/// A sentence with what is wrong: an expression too long or nested too deep, a missing operand, a
/// parameter that has no number, a result that is no finite number.
pub(super) fn evaluate(
    text: &str,
    parameter: &mut dyn FnMut(&str) -> Result<String, String>,
) -> Result<String, String> {
    if text.len() > BYTES_MAX {
        return Err(format!(
            "it has {} bytes; at most {BYTES_MAX} are evaluated",
            text.len()
        ));
    }
    // A parameter without a value is not asked for again: chains of them would take exponential
    // time.
    let mut is_unknown = false;
    let value = Parser {
        rest: text,
        depth: 0,
        parameter: &mut |name| parameter(name).inspect_err(|_| is_unknown = true),
    }
    .whole();
    match value {
        Ok(Value::Number(number)) if number.is_finite() => Ok(number.to_string()),
        Ok(Value::Number(number)) => Err(format!("its value is {number}")),
        Ok(Value::Truth(truth)) => Ok(truth.to_string()),
        Err(reason) if is_unknown => Err(reason),
        Err(reason) => joined(text, parameter)?.ok_or(reason),
    }
}

/// The texts of a sum, joined; `None` unless a parameter of the sum holds a text, or words do.
fn joined(
    text: &str,
    parameter: &mut dyn FnMut(&str) -> Result<String, String>,
) -> Result<Option<String>, String> {
    if text.contains(['*', '/', '%', '(', '^']) {
        return Ok(None);
    }
    let (mut joined, mut has_text) = (String::new(), false);
    for part in text.split('+').map(str::trim) {
        let part = match part.strip_prefix('$') {
            Some(name) => parameter(name)?,
            None => part.to_owned(),
        };
        if part.is_empty() {
            return Ok(None);
        }
        has_text |= Value::from_text(&part).is_none();
        joined += &part;
    }
    let is_sum = text.contains('+') && has_text && joined.len() <= BYTES_MAX;
    Ok(is_sum.then_some(joined))
}

struct Parser<'a, 'p> {
    rest: &'a str,
    depth: usize,
    parameter: &'p mut dyn FnMut(&str) -> Result<String, String>,
}

impl<'a> Parser<'a, '_> {
    fn whole(&mut self) -> Result<Value, String> {
        let value = self.either()?;
        self.skip_blanks();
        if self.rest.is_empty() {
            Ok(value)
        } else {
            Err(format!("{:?} is not expected there", self.rest))
        }
    }

    fn either(&mut self) -> Result<Value, String> {
        let mut value = self.both()?;
        while self.takes_word("or") {
            // Both sides are read: what follows is found behind them.
            let right = self.both()?.truth()?;
            value = Value::Truth(value.truth()? | right);
        }
        Ok(value)
    }

    fn both(&mut self) -> Result<Value, String> {
        let mut value = self.negated()?;
        while self.takes_word("and") {
            let right = self.negated()?.truth()?;
            value = Value::Truth(value.truth()? & right);
        }
        Ok(value)
    }

    fn negated(&mut self) -> Result<Value, String> {
        if self.takes_word("not") {
            return self.nested(|parser| Ok(Value::Truth(!parser.negated()?.truth()?)));
        }
        self.sum()
    }

    fn sum(&mut self) -> Result<Value, String> {
        let mut value = self.product()?;
        while let Some(sign) = self.takes(&['+', '-']) {
            let right = self.product()?.number()?;
            let left = value.number()?;
            value = Value::Number(if sign == '+' {
                left + right
            } else {
                left - right
            });
        }
        Ok(value)
    }

    fn product(&mut self) -> Result<Value, String> {
        let mut value = self.signed()?;
        while let Some(operator) = self.takes(&['*', '/', '%']) {
            let right = self.signed()?.number()?;
            let left = value.number()?;
            value = Value::Number(match operator {
                '*' => left * right,
                '/' => left / right,
                _ => left % right,
            });
        }
        Ok(value)
    }

    fn signed(&mut self) -> Result<Value, String> {
        match self.takes(&['+', '-']) {
            Some('-') => self.nested(|parser| Ok(Value::Number(-parser.signed()?.number()?))),
            Some(_) => self.nested(Self::signed),
            None => self.power(),
        }
    }

    fn power(&mut self) -> Result<Value, String> {
        let value = self.operand()?;
        if self.takes(&['^']).is_none() {
            return Ok(value);
        }
        let exponent = self.nested(Self::signed)?.number()?;
        Ok(Value::Number(value.number()?.powf(exponent)))
    }

    fn operand(&mut self) -> Result<Value, String> {
        if self.takes(&['(']).is_some() {
            return self.nested(|parser| {
                let value = parser.either()?;
                parser.close()?;
                Ok(value)
            });
        }
        if self.takes(&['$']).is_some() {
            let name = self.word();
            let text = (self.parameter)(name)?;
            return Value::from_text(text.trim())
                .ok_or_else(|| format!("the parameter ${name} is {text:?}, no number"));
        }
        if self
            .rest
            .starts_with(|letter: char| letter.is_ascii_digit() || letter == '.')
        {
            return self.literal();
        }
        let name = self.word();
        match name {
            "" if self.rest.is_empty() => Err("it ends where a value is expected".into()),
            "" => Err(format!("{:?} stands where a value is expected", self.rest)),
            "pi" => Ok(Value::Number(std::f64::consts::PI)),
            "true" | "false" => Ok(Value::Truth(name == "true")),
            _ => self.nested(|parser| parser.function(name)),
        }
    }

    fn function(&mut self, name: &str) -> Result<Value, String> {
        if self.takes(&['(']).is_none() {
            return Err(format!(
                "{name:?} is neither a number, a parameter ($name) nor a function"
            ));
        }
        let first = self.either()?.number()?;
        let second = match self.takes(&[',']) {
            Some(_) => Some(self.either()?.number()?),
            None => None,
        };
        self.close()?;
        Ok(Value::Number(match (name, second) {
            ("round", None) => first.round(),
            ("floor", None) => first.floor(),
            ("ceil", None) => first.ceil(),
            ("sqrt", None) => first.sqrt(),
            ("abs", None) => first.abs(),
            ("sign", None) if first == 0.0 => 0.0,
            ("sign", None) => first.signum(),
            ("pow", Some(second)) => first.powf(second),
            ("max", Some(second)) => first.max(second),
            ("min", Some(second)) => first.min(second),
            _ => {
                return Err(format!(
                    "there is no function {name} of so many values; expected round, floor, ceil, sqrt, abs or \
                     sign of one, or pow, max or min of two"
                ));
            }
        }))
    }

    /// A number: digits, a point, and an exponent.
    fn literal(&mut self) -> Result<Value, String> {
        let bytes = self.rest.as_bytes();
        let mut end = 0;
        while let Some(&byte) = bytes.get(end) {
            let is_exponents_sign = matches!(byte, b'+' | b'-')
                && matches!(bytes[..end].last(), Some(b'e' | b'E'))
                && bytes.get(end + 1).is_some_and(u8::is_ascii_digit);
            if !(byte.is_ascii_alphanumeric() || byte == b'.' || is_exponents_sign) {
                break;
            }
            end += 1;
        }
        let (number, rest) = self.rest.split_at(end);
        self.rest = rest;
        decouplegs_asset::xml::finite(number)
            .map(Value::Number)
            .ok_or_else(|| format!("{number:?} is no finite number"))
    }

    /// Letters, digits and underscores at the start of what is left.
    fn word(&mut self) -> &'a str {
        let is_part = |letter: char| letter.is_ascii_alphanumeric() || letter == '_';
        let end = self
            .rest
            .find(|letter| !is_part(letter))
            .unwrap_or(self.rest.len());
        let (word, rest) = self.rest.split_at(end);
        self.rest = rest;
        word
    }

    fn close(&mut self) -> Result<(), String> {
        self.takes(&[')'])
            .map(|_| ())
            .ok_or_else(|| "a parenthesis is not closed".into())
    }

    fn skip_blanks(&mut self) {
        self.rest = self.rest.trim_start();
    }

    /// Takes one of `letters`, after blanks.
    fn takes(&mut self, letters: &[char]) -> Option<char> {
        self.skip_blanks();
        let letter = self
            .rest
            .chars()
            .next()
            .filter(|letter| letters.contains(letter))?;
        self.rest = &self.rest[letter.len_utf8()..];
        Some(letter)
    }

    /// Takes `word`, after blanks, unless a longer word begins with it.
    fn takes_word(&mut self, word: &str) -> bool {
        self.skip_blanks();
        let before = self.rest;
        if self.word() == word {
            return true;
        }
        self.rest = before;
        false
    }

    /// `read`, one level deeper.
    fn nested<T>(
        &mut self,
        read: impl FnOnce(&mut Self) -> Result<T, String>,
    ) -> Result<T, String> {
        if self.depth == DEPTH_MAX {
            return Err(format!("it is nested more than {DEPTH_MAX} deep"));
        }
        self.depth += 1;
        let read = read(self);
        self.depth -= 1;
        read
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(text: &str) -> Result<String, String> {
        evaluate(text, &mut |name| match name {
            "V" => Ok("54".into()),
            "on" => Ok("true".into()),
            "name" => Ok("Car".into()),
            _ => Err(format!("the parameter ${name} is not declared")),
        })
    }

    #[test]
    fn operators_bind_as_in_the_standard() {
        for (text, expected) in [
            ("$V / 3.6", 15.0),
            (" 2 + 3 * 4 - 1 ", 13.0),
            ("-(2 + 3) * -2", 10.0),
            ("7 % 4 + 10 / 4", 5.5),
            ("2 ^ 3 ^ 2 - pow(2, 3)", 504.0),
            ("-2 ^ 2", -4.0),
            ("round(2.5) + floor(-1.5) + ceil(1.2)", 3.0),
            ("sqrt(16) + abs(-1) + sign(-9) + sign(0)", 4.0),
            ("max(1, min($V, 3))", 3.0),
            ("1.5e+2 - 1E2", 50.0),
            ("2 * pi", std::f64::consts::TAU),
            ("400-50", 350.0),
        ] {
            assert_eq!(value(text).unwrap().parse::<f64>(), Ok(expected), "{text}");
        }
        for (text, expected) in [
            ("not $on or true and false", "false"),
            ("not (false and $on)", "true"),
            ("$name + _front", "Car_front"),
        ] {
            assert_eq!(value(text).unwrap(), expected, "{text}");
        }
    }

    #[test]
    fn what_has_no_value_is_an_error_in_bounded_time() {
        let deep = "(".repeat(400) + "1" + &")".repeat(400);
        let signs = "-".repeat(900) + "1";
        for text in [
            "",
            "1 +",
            "(1",
            "1)",
            "1 2",
            "1 / 0",
            "sqrt(-1)",
            "pow(2)",
            "sin(1)",
            "$name * 2",
            "$other",
            "true + 1",
            "not 3",
            "1e999",
            "0x10",
            "^2",
            "€",
            "1 € 2",
            &deep,
            &signs,
            &"1+".repeat(600),
        ] {
            assert!(value(text).is_err(), "{text}: {:?}", value(text));
        }
    }
}
