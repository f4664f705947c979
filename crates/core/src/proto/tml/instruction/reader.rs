//! Reads text: words, operators, numbers, names, each with its position.

use crate::explain::TextError;

/// A place in a text.
#[derive(Clone, Copy, Debug)]
pub(super) struct SourceReader<'a> {
    pub(super) text: &'a str,
    pub(super) at: usize,
}

/// Reason why a piece is not at its place.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct ParseFailure {
    /// Position of the error.
    pub(super) at: usize,
    /// Furthest valid position: of several attempts the furthest one is reported.
    pub(super) furthest: usize,
    /// Expected text.
    pub(super) expected: &'static str,
}

impl From<ParseFailure> for TextError {
    fn from(failure: ParseFailure) -> Self {
        Self { at: failure.at, expected: failure.expected }
    }
}

pub(super) type Result<T> = core::result::Result<T, ParseFailure>;

/// A number as it was written.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct ParsedNumber {
    /// First position.
    pub(super) at: usize,
    /// Position after the last character.
    pub(super) end: usize,
    /// Whole part, with its sign.
    pub(super) integer: i64,
    /// The whole of it in 65536ths, when it has a decimal point.
    pub(super) fixed: Option<i64>,
    /// Number of digits, when it is hexadecimal.
    pub(super) hex: Option<usize>,
    /// True if it ends in `L`.
    pub(super) long: bool,
}

impl ParsedNumber {
    /// Error of a number that is unsuitable.
    pub(super) const fn failure(&self, expected: &'static str) -> ParseFailure {
        ParseFailure { at: self.at, furthest: self.end, expected }
    }

    /// A whole number within bounds.
    pub(super) fn within(&self, min: i64, max: i64, expected: &'static str) -> Result<i64> {
        let good = self.fixed.is_none() && (min..=max).contains(&self.integer);
        if good { Ok(self.integer) } else { Err(self.failure(expected)) }
    }
}

/// Error if only the first word of several is known.
const EXPECTED_MODE: &str = "a mode or reference that exists, such as MODE PP or EXTREF 1";

impl<'a> SourceReader<'a> {
    pub(super) fn remaining(&self) -> &'a str {
        &self.text[self.at..]
    }

    /// Error of missing text at this position.
    pub(super) const fn failure_here(&self, expected: &'static str) -> ParseFailure {
        ParseFailure { at: self.at, furthest: self.at, expected }
    }

    pub(super) fn skip_spaces(&mut self) {
        let rest = self.remaining();
        self.at += rest.len() - rest.trim_start().len();
    }

    /// A word of the language: any case, spaces within it free, and no letter or digit behind it.
    pub(super) fn expect_word(&mut self, word: &'static str) -> Result<()> {
        self.skip_spaces();
        let mut here = *self;
        for (n, part) in word.split(' ').enumerate() {
            here.skip_spaces();
            let found = here.remaining().get(..part.len());
            if !found.is_some_and(|found| found.eq_ignore_ascii_case(part)) {
                return Err(if n == 0 {
                    self.failure_here(word)
                } else {
                    here.failure_here(EXPECTED_MODE)
                });
            }
            here.at += part.len();
        }
        if here.remaining().bytes().next().is_some_and(is_name_byte) {
            return Err(self.failure_here(word));
        }
        *self = here;
        Ok(())
    }

    /// Signs, spaces among them free.
    pub(super) fn expect_sign(&mut self, sign: &'static str) -> Result<()> {
        let mut here = *self;
        for letter in sign.bytes().filter(|letter| *letter != b' ') {
            here.skip_spaces();
            if letter.is_ascii_digit() {
                here.skip_marks();
            }
            if here.remaining().as_bytes().first() != Some(&letter) {
                return Err(here.failure_here(sign.trim()));
            }
            here.at += 1;
        }
        *self = here;
        Ok(())
    }

    /// Returns whether that sign follows; if so, it is taken.
    pub(super) fn accept_sign(&mut self, sign: &'static str) -> bool {
        self.expect_sign(sign).is_ok()
    }

    /// A name: letters, digits and `_`, no digit first. Empty when there is none.
    pub(super) fn read_name(&mut self) -> &'a str {
        self.skip_spaces();
        let rest = self.remaining();
        let len = rest.bytes().take_while(|byte| is_name_byte(*byte)).count();
        let len = if rest.as_bytes().first().is_some_and(u8::is_ascii_digit) { 0 } else { len };
        self.at += len;
        &rest[..len]
    }

    /// A number: decimal, hexadecimal with 0x, with a fraction; `L` and `U` may end it. Some people
    /// mark a number by `q` before it.
    pub(super) fn read_number(&mut self, expected: &'static str) -> Result<ParsedNumber> {
        self.skip_spaces();
        let mut here = *self;
        let negative = here.accept_sign("-");
        let _ = !negative && here.accept_sign("+");
        here.skip_spaces();
        here.skip_marks();
        let hexadecimal = here.remaining().len() > 2
            && here.remaining().get(..2).is_some_and(|head| head.eq_ignore_ascii_case("0x"));
        let mut number =
            ParsedNumber { at: self.at, end: 0, integer: 0, fixed: None, hex: None, long: false };
        if hexadecimal {
            here.at += 2;
        }
        let (whole, digits) = here.read_digits(if hexadecimal { 16 } else { 10 });
        let fraction =
            (!hexadecimal && here.remaining().starts_with('.')).then(|| here.read_fraction());
        if digits == 0 && fraction.is_none_or(|(_, digits)| digits == 0) {
            return Err(self.failure_here(expected));
        }
        let sign = if negative { -1 } else { 1 };
        number.integer = whole * sign;
        number.hex = hexadecimal.then_some(digits);
        number.fixed = fraction.map(|(part, _)| (whole * 65536 + part) * sign);
        number.long = here.read_suffix();
        number.end = here.at;
        if here.remaining().bytes().next().is_some_and(|byte| is_name_byte(byte) || byte == b'.') {
            return Err(ParseFailure { furthest: here.at, ..self.failure_here(expected) });
        }
        *self = here;
        Ok(number)
    }

    /// The letters `q` before a digit.
    fn skip_marks(&mut self) {
        let rest = self.remaining().trim_start_matches(['q', 'Q']);
        if rest.starts_with(|first: char| first.is_ascii_digit()) {
            self.at = self.text.len() - rest.len();
        }
    }

    /// Digits of a base; more than any word holds count as the greatest number.
    fn read_digits(&mut self, base: u32) -> (i64, usize) {
        let rest = self.remaining();
        let digits = rest.chars().map_while(|c| c.to_digit(base));
        let (mut value, mut count) = (0_i64, 0);
        for digit in digits {
            value = (value * i64::from(base) + i64::from(digit)).min(1 << 40);
            count += 1;
        }
        self.at += count;
        (value, count)
    }

    /// The decimals, in 65536ths, rounded.
    fn read_fraction(&mut self) -> (i64, usize) {
        self.at += 1;
        let rest = self.remaining();
        let len = rest.bytes().take_while(u8::is_ascii_digit).count();
        let (mut part, mut unit) = (0_i64, 1_i64);
        for digit in rest.bytes().take(len.min(9)) {
            part = part * 10 + i64::from(digit - b'0');
            unit *= 10;
        }
        self.at += len;
        ((part * 65536 * 2 + unit) / (2 * unit), len)
    }

    /// `L` and `U` in any order; returns whether there was an `L`.
    fn read_suffix(&mut self) -> bool {
        let rest = self.remaining();
        let letters = rest.bytes().take(2).take_while(|c| b"uUlL".contains(c)).count();
        self.at += letters;
        rest[..letters].contains(['l', 'L'])
    }

    /// Returns whether nothing but a comment is left.
    pub(super) fn is_at_end(&mut self) -> bool {
        self.skip_spaces();
        self.remaining().is_empty() || self.remaining().starts_with("//")
    }
}

/// Returns whether a byte can be part of a name.
pub(super) const fn is_name_byte(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || byte == b'_'
}
