//! Reading text: words, signs, numbers, names, each with the place where it stood.

use crate::explain::TextError;

/// A place in a text.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reader<'a> {
    pub(super) text: &'a str,
    pub(super) at: usize,
}

/// Why a piece does not stand where it should.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Failure {
    /// Where what is wrong begins.
    pub(super) at: usize,
    /// How far the text made sense: of several attempts the one that came furthest is told.
    pub(super) reach: usize,
    /// What should be there.
    pub(super) expected: &'static str,
}

impl From<Failure> for TextError {
    fn from(failure: Failure) -> Self {
        Self { at: failure.at, expected: failure.expected }
    }
}

pub(super) type Result<T> = core::result::Result<T, Failure>;

/// A number as it was written.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Number {
    /// Where it begins.
    pub(super) at: usize,
    /// Where it ends.
    pub(super) end: usize,
    /// Its whole part, with its sign.
    pub(super) whole: i64,
    /// The whole of it in 65536ths, when it has a decimal point.
    pub(super) fixed: Option<i64>,
    /// How many digits, when it is hexadecimal.
    pub(super) hex: Option<usize>,
    /// It ends in `L`.
    pub(super) long: bool,
}

impl Number {
    /// It is not what was needed.
    pub(super) const fn refused(&self, expected: &'static str) -> Failure {
        Failure { at: self.at, reach: self.end, expected }
    }

    /// A whole number within bounds.
    pub(super) fn within(&self, least: i64, most: i64, expected: &'static str) -> Result<i64> {
        let good = self.fixed.is_none() && (least..=most).contains(&self.whole);
        if good { Ok(self.whole) } else { Err(self.refused(expected)) }
    }
}

/// What is wrong when only the first word of several is known.
const SECOND: &str = "a mode or reference that exists, such as MODE PP or EXTREF 1";

impl<'a> Reader<'a> {
    pub(super) fn rest(&self) -> &'a str {
        &self.text[self.at..]
    }

    /// What is missing at this place.
    pub(super) const fn missing(&self, expected: &'static str) -> Failure {
        Failure { at: self.at, reach: self.at, expected }
    }

    pub(super) fn skip_spaces(&mut self) {
        let rest = self.rest();
        self.at += rest.len() - rest.trim_start().len();
    }

    /// A word of the language: any case, spaces within it free, and no letter or digit behind it.
    pub(super) fn word(&mut self, word: &'static str) -> Result<()> {
        self.skip_spaces();
        let mut here = *self;
        for (n, part) in word.split(' ').enumerate() {
            here.skip_spaces();
            let found = here.rest().get(..part.len());
            if !found.is_some_and(|found| found.eq_ignore_ascii_case(part)) {
                return Err(if n == 0 { self.missing(word) } else { here.missing(SECOND) });
            }
            here.at += part.len();
        }
        if here.rest().bytes().next().is_some_and(is_name_byte) {
            return Err(self.missing(word));
        }
        *self = here;
        Ok(())
    }

    /// Signs, spaces among them free.
    pub(super) fn sign(&mut self, sign: &'static str) -> Result<()> {
        let mut here = *self;
        for letter in sign.bytes().filter(|letter| *letter != b' ') {
            here.skip_spaces();
            if letter.is_ascii_digit() {
                here.skip_marks();
            }
            if here.rest().as_bytes().first() != Some(&letter) {
                return Err(here.missing(sign.trim()));
            }
            here.at += 1;
        }
        *self = here;
        Ok(())
    }

    /// Whether that sign follows; if so, it is taken.
    pub(super) fn has_sign(&mut self, sign: &'static str) -> bool {
        self.sign(sign).is_ok()
    }

    /// A name: letters, digits and `_`, no digit first. Empty when there is none.
    pub(super) fn name(&mut self) -> &'a str {
        self.skip_spaces();
        let rest = self.rest();
        let len = rest.bytes().take_while(|byte| is_name_byte(*byte)).count();
        let len = if rest.as_bytes().first().is_some_and(u8::is_ascii_digit) { 0 } else { len };
        self.at += len;
        &rest[..len]
    }

    /// A number: decimal, hexadecimal with 0x, with a fraction; `L` and `U` may end it. Some people
    /// mark a number by `q` before it.
    pub(super) fn number(&mut self, expected: &'static str) -> Result<Number> {
        self.skip_spaces();
        let mut here = *self;
        let negative = here.has_sign("-");
        let _ = !negative && here.has_sign("+");
        here.skip_spaces();
        here.skip_marks();
        let hexadecimal = here.rest().len() > 2
            && here.rest().get(..2).is_some_and(|head| head.eq_ignore_ascii_case("0x"));
        let mut number =
            Number { at: self.at, end: 0, whole: 0, fixed: None, hex: None, long: false };
        if hexadecimal {
            here.at += 2;
        }
        let (whole, digits) = here.digits(if hexadecimal { 16 } else { 10 });
        let fraction = (!hexadecimal && here.rest().starts_with('.')).then(|| here.fraction());
        if digits == 0 && fraction.is_none_or(|(_, digits)| digits == 0) {
            return Err(self.missing(expected));
        }
        let sign = if negative { -1 } else { 1 };
        number.whole = whole * sign;
        number.hex = hexadecimal.then_some(digits);
        number.fixed = fraction.map(|(part, _)| (whole * 65536 + part) * sign);
        number.long = here.suffix();
        number.end = here.at;
        if here.rest().bytes().next().is_some_and(|byte| is_name_byte(byte) || byte == b'.') {
            return Err(Failure { reach: here.at, ..self.missing(expected) });
        }
        *self = here;
        Ok(number)
    }

    /// The letters `q` before a digit.
    fn skip_marks(&mut self) {
        let rest = self.rest().trim_start_matches(['q', 'Q']);
        if rest.starts_with(|first: char| first.is_ascii_digit()) {
            self.at = self.text.len() - rest.len();
        }
    }

    /// Digits of a base; more than any word holds count as the greatest number.
    fn digits(&mut self, base: u32) -> (i64, usize) {
        let rest = self.rest();
        let digits = rest.chars().map_while(|c| c.to_digit(base));
        let (mut value, mut count) = (0_i64, 0);
        for digit in digits {
            value = (value * i64::from(base) + i64::from(digit)).min(1 << 40);
            count += 1;
        }
        self.at += count;
        (value, count)
    }

    /// What is behind the decimal point, in 65536ths, rounded.
    fn fraction(&mut self) -> (i64, usize) {
        self.at += 1;
        let rest = self.rest();
        let len = rest.bytes().take_while(u8::is_ascii_digit).count();
        let (mut part, mut unit) = (0_i64, 1_i64);
        for digit in rest.bytes().take(len.min(9)) {
            part = part * 10 + i64::from(digit - b'0');
            unit *= 10;
        }
        self.at += len;
        ((part * 65536 * 2 + unit) / (2 * unit), len)
    }

    /// `L` and `U` in any order; tells whether there was an `L`.
    fn suffix(&mut self) -> bool {
        let rest = self.rest();
        let letters = rest.bytes().take(2).take_while(|c| b"uUlL".contains(c)).count();
        self.at += letters;
        rest[..letters].contains(['l', 'L'])
    }

    /// Whether nothing but a comment is left.
    pub(super) fn ended(&mut self) -> bool {
        self.skip_spaces();
        self.rest().is_empty() || self.rest().starts_with("//")
    }
}

/// Whether a byte can be part of a name.
pub(super) const fn is_name_byte(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || byte == b'_'
}
