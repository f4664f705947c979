//! The text form of TMCL manuals: `ROR 0, 350`, `MVP ABS, 0, 1000`, `GAP 1, 0`.
//!
//! A command is its mnemonic with its numbers in the order type, motor or bank, value. Trailing numbers may
//! be omitted and are 0. A word replaces the type if the manuals have one (`ABS`, `MUL`, `TICKS`). Numbers
//! are decimal, or hexadecimal with `$` or `0x`. Commands without a text form in the manuals (control
//! opcodes from 128 on, and numbers without a name) are written by name or number with all three fields.

use super::opcode::Opcode;
use super::wire::Request;
use crate::explain::{Decimal, TextError};

/// Fields of a command's line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct CommandFields {
    /// The type byte.
    pub kind: bool,
    /// The motor or bank byte.
    pub motor: bool,
    /// The value.
    pub value: bool,
    /// Words for the type.
    pub type_words: &'static [(u8, &'static str)],
}

const MOVE_TYPES: &[(u8, &str)] = &[(0, "ABS"), (1, "REL"), (2, "COORD"), (3, "RELCOORD")];
const SEARCH_TYPES: &[(u8, &str)] = &[(0, "START"), (1, "STOP"), (2, "STATUS")];
const CALCV_OPERATIONS: &[(u8, &str)] = &[
    (0, "ADD"),
    (1, "SUB"),
    (2, "MUL"),
    (3, "DIV"),
    (4, "MOD"),
    (5, "AND"),
    (6, "OR"),
    (7, "XOR"),
    (8, "NOT"),
    (9, "LOAD"),
    (10, "SWAP"),
    (11, "COMP"),
];
const CALCX_OPERATIONS: &[(u8, &str)] = CALCV_OPERATIONS.split_at(11).0;
const CALC_OPERATIONS: &[(u8, &str)] = CALCV_OPERATIONS.split_at(10).0;
const CONDITIONS: &[(u8, &str)] = &[
    (0, "ZE"),
    (1, "NZ"),
    (2, "EQ"),
    (3, "NE"),
    (4, "GT"),
    (5, "GE"),
    (6, "LT"),
    (7, "LE"),
    (8, "ETO"),
    (9, "EAL"),
    (10, "EDV"),
    (11, "EPO"),
    (12, "ESD"),
];
const WAIT_TYPES: &[(u8, &str)] =
    &[(0, "TICKS"), (1, "POS"), (2, "REFSW"), (3, "LIMSW"), (4, "RFS")];
const ERRORS: &[(u8, &str)] =
    &[(0, "ALL"), (1, "ETO"), (2, "EAL"), (3, "EDV"), (4, "EPO"), (5, "ESD")];

impl CommandFields {
    /// The shape of an opcode's line.
    #[must_use]
    pub const fn of(opcode: Opcode) -> Self {
        use Opcode as O;
        match opcode {
            O::Ror | O::Rol => Self::new(false, true, true, &[]),
            O::Mst | O::Rola | O::Rora => Self::new(false, true, false, &[]),
            O::Mvp => Self::new(true, true, true, MOVE_TYPES),
            O::Mvpa => Self::new(true, true, false, MOVE_TYPES),
            O::Mvpxa => Self::new(true, false, false, MOVE_TYPES),
            O::Sapx => Self::new(true, false, true, &[]),
            O::Gapx | O::Aapx | O::Pushv | O::Popv => Self::new(true, false, false, &[]),
            O::Gap
            | O::Ggp
            | O::Stap
            | O::Rsap
            | O::Stgp
            | O::Rsgp
            | O::Gio
            | O::Gco
            | O::Cco
            | O::Aap
            | O::Agp
            | O::Aco => Self::new(true, true, false, &[]),
            O::Rfs => Self::new(true, true, false, SEARCH_TYPES),
            O::Calc => Self::new(true, false, true, CALC_OPERATIONS),
            O::Calcx => Self::new(true, false, false, CALCX_OPERATIONS),
            O::Jc | O::Call => Self::new(true, false, true, CONDITIONS),
            O::Wait => Self::new(true, true, true, WAIT_TYPES),
            O::Comp | O::Ja | O::Csub | O::Rst => Self::new(false, false, true, &[]),
            O::Calcvv | O::Calcv => Self::new(true, true, true, CALCV_OPERATIONS),
            O::Calcva | O::Calcav | O::Calcvx | O::Calcxv => {
                Self::new(true, true, false, CALCV_OPERATIONS)
            }
            O::Giv
            | O::Aiv
            | O::Rolxa
            | O::Rorxa
            | O::Mstx
            | O::Pusha
            | O::Pushx
            | O::Popa
            | O::Popx => Self::new(false, false, false, &[]),
            O::Rsub | O::Stop | O::Reti => Self::new(false, false, false, &[]),
            O::Ei | O::Di => Self::new(true, false, false, &[]),
            O::Cle => Self::new(true, false, false, ERRORS),
            O::Vect | O::Djnz => Self::new(true, false, true, &[]),
            O::Siv => Self::new(false, false, true, &[]),
            _ => Self::new(true, true, true, &[]),
        }
    }

    const fn new(
        kind: bool,
        motor: bool,
        value: bool,
        type_words: &'static [(u8, &'static str)],
    ) -> Self {
        Self { kind, motor, value, type_words }
    }

    /// The word for a type, if it has one.
    #[must_use]
    pub fn type_word(&self, kind: u8) -> Option<&'static str> {
        self.type_words.iter().find(|(number, _)| *number == kind).map(|(_, word)| *word)
    }

    /// Returns whether a line of this form contains the whole request.
    #[must_use]
    pub const fn covers(&self, request: &Request) -> bool {
        (self.kind || request.kind == 0)
            && (self.motor || request.motor == 0)
            && (self.value || request.value == 0)
    }
}

/// Reads a line. The request is for module `address`.
///
/// # Errors
/// [`TextError`] with the place and the expected words.
pub fn parse(text: &str, address: u8) -> Result<Request, TextError> {
    let mut words = Tokenizer { text, at: 0 };
    let (start, name) = words.read_mnemonic();
    let opcode = parse_opcode(name).ok_or(TextError { at: start, expected: "a TMCL mnemonic" })?;
    let shape = CommandFields::of(opcode);
    let mut request = Request { address, opcode, kind: 0, motor: 0, value: 0 };
    let (mut fields, count) = words.read_fields()?;
    // All three fields may always be given: then they are type, motor, value.
    let full = count == 3;
    let mut next = || {
        let field = fields[0];
        fields.rotate_left(1);
        fields[2] = None;
        field
    };
    if (shape.kind || full)
        && let Some((at, word)) = next()
    {
        request.kind = parse_type(&shape, at, word)?;
    }
    if (shape.motor || full)
        && let Some((at, word)) = next()
    {
        request.motor = parse_byte(at, word, "a motor or bank, 0 to 255")?;
    }
    if (shape.value || full)
        && let Some((at, word)) = next()
    {
        request.value = parse_value(at, word, opcode)?;
    }
    match next() {
        Some((at, _)) => {
            Err(TextError { at, expected: "the end: this command has no more fields" })
        }
        None => Ok(request),
    }
}

/// Writes a request as a line, piece by piece.
pub fn write(request: &Request, show: &mut dyn FnMut(&str)) {
    let shape = CommandFields::of(request.opcode);
    match request.opcode.word() {
        "" => show(Decimal::of(request.opcode.number().into()).as_str()),
        word => show(word),
    }
    let full = !shape.covers(request);
    let mut separator = " ";
    let mut field = |text: &str| {
        show(separator);
        show(text);
        separator = ", ";
    };
    if shape.kind || full {
        match shape.type_word(request.kind) {
            Some(word) => field(word),
            None => field(Decimal::of(request.kind.into()).as_str()),
        }
    }
    if shape.motor || full {
        field(Decimal::of(request.motor.into()).as_str());
    }
    if shape.value || full {
        field(Decimal::of(request.value.into()).as_str());
    }
}

/// A decimal or hexadecimal number.
#[must_use]
pub fn parse_number(text: &str) -> Option<i64> {
    let (negative, digits) = match text.strip_prefix('-') {
        Some(rest) => (true, rest),
        None => (false, text.strip_prefix('+').unwrap_or(text)),
    };
    let hex = digits.strip_prefix("0x").or(digits.strip_prefix("0X")).or(digits.strip_prefix('$'));
    let (digits, radix) = hex.map_or((digits, 10), |hex| (hex, 16));
    if !digits.bytes().all(|c| c.is_ascii_hexdigit()) {
        return None;
    }
    let magnitude = i64::from_str_radix(digits, radix).ok()?;
    Some(if negative { -magnitude } else { magnitude })
}

fn parse_opcode(name: &str) -> Option<Opcode> {
    Opcode::of_word(name)
        .or_else(|| parse_number(name).and_then(|n| u8::try_from(n).ok()).map(Opcode::from))
}

fn parse_type(shape: &CommandFields, at: usize, word: &str) -> Result<u8, TextError> {
    if let Some((number, _)) = shape.type_words.iter().find(|(_, w)| w.eq_ignore_ascii_case(word)) {
        return Ok(*number);
    }
    let expected = match shape.type_words.first() {
        Some((_, "ABS")) => "ABS, REL or COORD",
        Some((_, "START")) => "START, STOP or STATUS",
        Some((_, "TICKS")) => "TICKS, POS, REFSW, LIMSW or RFS",
        Some(_) => "an operation's name or number",
        None => "a type or parameter number, 0 to 255",
    };
    parse_byte(at, word, expected)
}

fn parse_byte(at: usize, word: &str, expected: &'static str) -> Result<u8, TextError> {
    parse_number(word).and_then(|n| u8::try_from(n).ok()).ok_or(TextError { at, expected })
}

/// A value: signed or, where it is not a position or a speed, the unsigned twin of a negative one.
fn parse_value(at: usize, word: &str, opcode: Opcode) -> Result<i32, TextError> {
    // A position beyond the greatest would be one in the other direction. Bits are written in hexadecimal.
    let moves = matches!(opcode, Opcode::Mvp | Opcode::Ror | Opcode::Rol);
    let sets = matches!(opcode, Opcode::Sap) && !word.contains(['x', 'X']);
    let expected = if moves || sets {
        "a value, -2147483648 to 2147483647"
    } else {
        "a value, -2147483648 to 4294967295"
    };
    let number = parse_number(word).ok_or(TextError { at, expected })?;
    i32::try_from(number)
        .or_else(|error| {
            if moves || sets { Err(error) } else { u32::try_from(number).map(u32::cast_signed) }
        })
        .map_err(|_| TextError { at, expected })
}

/// Fields of a line with their places, and how many there are.
type LineFields<'a> = ([Option<(usize, &'a str)>; 3], usize);

struct Tokenizer<'a> {
    text: &'a str,
    at: usize,
}

impl<'a> Tokenizer<'a> {
    /// The mnemonic: one word, or two for names such as `GET VERSION`.
    fn read_mnemonic(&mut self) -> (usize, &'a str) {
        let rest = self.text.trim_start();
        let start = self.text.len() - rest.len();
        let name = Opcode::NAMED
            .iter()
            .map(|opcode| opcode.word())
            .filter(|word| begins_with_word(rest, word))
            .map(str::len)
            .max()
            .unwrap_or_else(|| rest.find([' ', '\t', ',']).unwrap_or(rest.len()));
        self.at = start + name;
        (start, &rest[..name])
    }

    fn read_fields(&mut self) -> Result<LineFields<'a>, TextError> {
        let mut fields = [None; 3];
        let mut count = 0;
        // A comma behind the name does no harm: `136, 0, 0`.
        let comma = self.text[self.at..].trim_start().starts_with(',');
        if comma {
            self.at += self.text[self.at..].find(',').map_or(0, |at| at + 1);
        }
        let rest = &self.text[self.at..];
        if rest.trim().is_empty() {
            return Ok((fields, 0));
        }
        let mut at = self.at;
        for piece in rest.split(',') {
            let word = piece.trim();
            let index = at + (piece.len() - piece.trim_start().len());
            if word.is_empty() || word.contains([' ', '\t']) {
                return Err(TextError { at: index, expected: "one number or word between commas" });
            }
            let expected = "at most three fields: type, motor, value";
            *fields.get_mut(count).ok_or(TextError { at: index, expected })? = Some((index, word));
            count += 1;
            at += piece.len() + 1;
        }
        Ok((fields, count))
    }
}

fn begins_with_word(text: &str, word: &str) -> bool {
    let Some((head, tail)) = text.split_at_checked(word.len()) else { return false };
    head.eq_ignore_ascii_case(word)
        && tail.bytes().next().is_none_or(|c| !c.is_ascii_alphanumeric())
}
