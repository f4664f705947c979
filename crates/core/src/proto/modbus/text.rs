//! Text form of requests: `read Dn_00`, `write 0x30 5 5`, `write 0x30 5 read 0x40 2`, `coils 0 4`.
//!
//! Numbers are decimal or, with `0x`, hexadecimal; `=` and `,` count as spaces. A register is a number, a
//! name or symbol of the profile, or `Fn_hex` and `Dn_hex` (TS manual V2 §2.2: Fn_n is at n, Dn_n at 1000h
//! + n). The output of a decoder is accepted too (`list`).

mod list;

use super::device_id;
use super::encoding::{self, register_count};
use super::wire::{Function, READ_WORDS_MAX, READ_WRITE_WORDS_MAX, Space, WRITE_WORDS_MAX};
use crate::explain::TextError;
use crate::profile::{Parameter, Profile};

const TOKENS_MAX: usize = WRITE_WORDS_MAX as usize + 16;

/// A parsed request.
#[derive(Clone, Copy, Debug)]
pub struct ParsedRequest {
    /// The function.
    pub function: Function,
    /// First address.
    pub start: u16,
    /// Bits or registers.
    pub count: u16,
    /// Values to write, one per coil or register.
    pub words: [u16; READ_WORDS_MAX as usize],
    /// First register and number of those that the same request reads back.
    pub read: Option<(u16, u16)>,
}

impl ParsedRequest {
    /// Writes the text of a read of what it writes; `false` for a read.
    pub fn read_back(&self, out: &mut dyn core::fmt::Write) -> bool {
        let items = match self.function {
            Function::WriteCoil | Function::WriteCoils => "coils",
            Function::WriteRegister | Function::WriteRegisters | Function::ReadWriteRegisters => {
                "registers"
            }
            _ => return false,
        };
        write!(out, "read {items} 0x{:04X} {}", self.start, self.count.max(1)).is_ok()
    }
}

/// Phrases that begin a text, the longer before those they begin with.
const PHRASES: [(&str, TextVerb); 28] = [
    ("read device id", TextVerb::DeviceId),
    ("read holding registers", TextVerb::Read(Space::Holding)),
    ("read holding register", TextVerb::Read(Space::Holding)),
    ("read input registers", TextVerb::Read(Space::Input)),
    ("read input register", TextVerb::Read(Space::Input)),
    ("read discrete inputs", TextVerb::Read(Space::Discrete)),
    ("read discrete input", TextVerb::Read(Space::Discrete)),
    ("read registers", TextVerb::Read(Space::Holding)),
    ("read register", TextVerb::Read(Space::Holding)),
    ("read coils", TextVerb::Read(Space::Coil)),
    ("read coil", TextVerb::Read(Space::Coil)),
    ("read inputs", TextVerb::Read(Space::Discrete)),
    ("input registers", TextVerb::Read(Space::Input)),
    ("registers", TextVerb::Read(Space::Holding)),
    ("coils", TextVerb::Read(Space::Coil)),
    ("inputs", TextVerb::Read(Space::Discrete)),
    ("read", TextVerb::ReadNamed),
    ("write multiple registers", TextVerb::Write(Function::WriteRegisters)),
    ("write multiple coils", TextVerb::Write(Function::WriteCoils)),
    ("write single register", TextVerb::Write(Function::WriteRegister)),
    ("write single coil", TextVerb::Write(Function::WriteCoil)),
    ("write registers", TextVerb::Write(Function::WriteRegisters)),
    ("write register", TextVerb::Write(Function::WriteRegister)),
    ("write coils", TextVerb::Write(Function::WriteCoils)),
    ("write coil", TextVerb::Write(Function::WriteCoil)),
    ("write", TextVerb::WriteNamed),
    ("set", TextVerb::WriteNamed),
    ("coil", TextVerb::Write(Function::WriteCoil)),
];

#[derive(Clone, Copy)]
enum TextVerb {
    Read(Space),
    ReadNamed,
    Write(Function),
    WriteNamed,
    DeviceId,
}

#[derive(Clone, Copy, Default)]
struct Token<'a> {
    at: usize,
    text: &'a str,
}

impl Token<'_> {
    fn is(&self, word: &str) -> bool {
        self.text.eq_ignore_ascii_case(word)
    }
}

struct RegisterTarget {
    space: Space,
    start: u16,
    parameter: Option<&'static Parameter>,
}

/// Reads a text.
///
/// # Errors
/// [`TextError`] with the place and the expected words.
pub fn parse(text: &str, profile: Option<&'static Profile>) -> Result<ParsedRequest, TextError> {
    let mut store = [Token::default(); TOKENS_MAX];
    let tokens = tokenize(text, &mut store)?;
    let read_at = tokens.iter().skip(1).position(|token| token.is("read"));
    match read_at {
        Some(at) if tokens[0].is("write") => parse_read_write(text, tokens, at + 1, profile),
        _ => parse_tokens(text, tokens, profile),
    }
}

fn parse_tokens(
    text: &str,
    tokens: &[Token<'_>],
    profile: Option<&'static Profile>,
) -> Result<ParsedRequest, TextError> {
    if let Some(parsed) = list::parse_list(text, tokens)? {
        return Ok(parsed);
    }
    let Some((verb, words)) = PHRASES.iter().find_map(|(phrase, verb)| {
        let count = phrase.split(' ').count();
        let same = tokens.len() >= count
            && phrase.split(' ').zip(tokens).all(|(word, t)| t.text.eq_ignore_ascii_case(word));
        same.then_some((*verb, count))
    }) else {
        let at = text.len() - text.trim_start().len();
        return Err(TextError { at, expected: "read, write, coils, inputs or registers" });
    };
    let rest = &tokens[words..];
    match verb {
        TextVerb::Read(space) => parse_read(text, rest, Some(space), profile),
        TextVerb::ReadNamed => parse_read(text, rest, None, profile),
        TextVerb::Write(function) => parse_write(text, rest, Some(function), profile),
        TextVerb::WriteNamed => parse_write(text, rest, None, profile),
        TextVerb::DeviceId => parse_device_id(text, rest),
    }
}

fn tokenize<'a, 't>(
    text: &'t str,
    store: &'a mut [Token<'t>; TOKENS_MAX],
) -> Result<&'a [Token<'t>], TextError> {
    let mut count = 0;
    for word in text.split(|c: char| c.is_whitespace() || c == '=' || c == ',') {
        if word.is_empty() {
            continue;
        }
        let at = word.as_ptr() as usize - text.as_ptr() as usize;
        if count == TOKENS_MAX {
            return Err(TextError { at, expected: "at most 123 values" });
        }
        store[count] = Token { at, text: word };
        count += 1;
    }
    Ok(&store[..count])
}

/// A number, decimal or with `0x` hexadecimal, with or without sign.
fn parse_number(text: &str) -> Option<i64> {
    let (sign, digits) = match text.strip_prefix('-') {
        Some(digits) => (-1, digits),
        None => (1, text.strip_prefix('+').unwrap_or(text)),
    };
    let hex = digits.strip_prefix("0x").or_else(|| digits.strip_prefix("0X"));
    let (digits, radix) = hex.map_or((digits, 10), |hex| (hex, 16));
    if digits.starts_with(['+', '-']) {
        return None;
    }
    i64::from_str_radix(digits, radix).ok().map(|magnitude| sign * magnitude)
}

/// The register that the first tokens mean, and the tokens behind it.
fn parse_target<'a, 't>(
    text: &str,
    tokens: &'a [Token<'t>],
    space: Option<Space>,
    profile: Option<&'static Profile>,
) -> Result<(RegisterTarget, &'a [Token<'t>]), TextError> {
    let missing = TextError { at: text.len(), expected: "a register: a number or a name" };
    let first = tokens.first().ok_or(missing)?;
    if let Some(value) = parse_number(first.text) {
        let expected = "a register address, 0 to 0xFFFF";
        let start = u16::try_from(value).map_err(|_| TextError { at: first.at, expected })?;
        let space = space.unwrap_or(Space::Holding);
        return Ok((RegisterTarget { space, start, parameter: None }, &tokens[1..]));
    }
    let plain =
        tokens.iter().rposition(|token| parse_number(token.text).is_none()).unwrap_or(0) + 1;
    for count in plain..=tokens.len() {
        let last = tokens[count - 1];
        let name = &text[first.at..last.at + last.text.len()];
        if let Some(found) = find_named(name, profile) {
            return Ok((found, &tokens[count..]));
        }
    }
    match parse_symbol(first.text) {
        Some(start) => {
            let space = space.unwrap_or(Space::Holding);
            Ok((RegisterTarget { space, start, parameter: None }, &tokens[1..]))
        }
        None => Err(TextError { at: first.at, expected: "a register: a number or a known name" }),
    }
}

fn find_named(name: &str, profile: Option<&'static Profile>) -> Option<RegisterTarget> {
    let profile = profile?;
    let parameter = profile.parameter(profile.find_parameter(name)?)?;
    let space = Space::of_number(parameter.space)?;
    Some(RegisterTarget { space, start: parameter.index, parameter: Some(parameter) })
}

/// `Fn_33` is register 33h, `Dn_12` is 1012h (TS manual V2 §2.2).
fn parse_symbol(text: &str) -> Option<u16> {
    let (head, digits) = text.split_at_checked(2)?;
    let digits = digits.strip_prefix('_').unwrap_or(digits);
    let number = u16::from_str_radix(digits, 16).ok()?;
    match head {
        _ if head.eq_ignore_ascii_case("Fn") && number < 0x1000 => Some(number),
        _ if head.eq_ignore_ascii_case("Dn") && number < 0x1000 => Some(0x1000 + number),
        _ => None,
    }
}

fn parse_read(
    text: &str,
    tokens: &[Token<'_>],
    space: Option<Space>,
    profile: Option<&'static Profile>,
) -> Result<ParsedRequest, TextError> {
    let (target, rest) = parse_target(text, tokens, space, profile)?;
    let count = match rest {
        [] => target.parameter.map_or(1, |parameter| register_count(parameter.encoding)),
        [_, extra] if !(extra.is("registers") || extra.is("bits")) => {
            return Err(TextError { at: extra.at, expected: "the end of the text" });
        }
        [count] | [count, _] => {
            let max = i64::from(target.space.read_max());
            let value = parse_number(count.text).filter(|value| (1..=max).contains(value));
            let expected = "how many: 1 to 125 registers, or 1 to 2000 bits";
            value.ok_or(TextError { at: count.at, expected })? as u16
        }
        [_, _, extra, ..] => {
            return Err(TextError { at: extra.at, expected: "the end of the text" });
        }
    };
    let start = check_address_range(target.start, count, tokens)?;
    Ok(ParsedRequest {
        function: target.space.read_function(),
        start,
        count,
        words: [0; READ_WORDS_MAX as usize],
        read: None,
    })
}

fn parse_write(
    text: &str,
    tokens: &[Token<'_>],
    function: Option<Function>,
    profile: Option<&'static Profile>,
) -> Result<ParsedRequest, TextError> {
    let coils = matches!(function, Some(Function::WriteCoil | Function::WriteCoils));
    let space = if coils { Space::Coil } else { Space::Holding };
    // Text behind the address that is no number can only be the word of a coil's state.
    let states =
        tokens.iter().rev().take_while(|token| parse_coil_state(token.text).is_some()).count();
    let worded =
        tokens.iter().any(|token| parse_number(token.text).is_none() && is_word(token.text));
    let cut = if worded { tokens.len() - states.min(tokens.len().saturating_sub(1)) } else { 0 };
    let (target, values) = if worded {
        let (target, _) = parse_target(text, &tokens[..cut], Some(space), profile)?;
        (target, &tokens[cut..])
    } else {
        parse_target(text, tokens, Some(space), profile)?
    };
    if values.is_empty() {
        return Err(TextError { at: text.len(), expected: "a value" });
    }
    match target.space {
        Space::Holding => parse_register_values(&target, values, tokens, function),
        Space::Coil => parse_coil_values(&target, values, tokens, function),
        Space::Discrete | Space::Input => {
            Err(TextError { at: tokens[0].at, expected: "a register that can be written" })
        }
    }
}

/// `write 0x40 5 read 0x30 2`: one request that writes, then reads.
fn parse_read_write(
    text: &str,
    tokens: &[Token<'_>],
    at: usize,
    profile: Option<&'static Profile>,
) -> Result<ParsedRequest, TextError> {
    let wrote = parse_tokens(text, &tokens[..at], profile)?;
    let is_list = matches!(wrote.function, Function::WriteRegister | Function::WriteRegisters);
    if !is_list || wrote.count > READ_WRITE_WORDS_MAX {
        return Err(TextError { at: tokens[0].at, expected: "1 to 121 registers to write" });
    }
    let mut rest = &tokens[at + 1..];
    if let [word, behind @ ..] = rest
        && (word.is("register") || word.is("registers"))
    {
        rest = behind;
    }
    let read = parse_read(text, rest, Some(Space::Holding), profile)?;
    if read.function != Function::ReadHoldingRegisters {
        return Err(TextError { at: tokens[at].at, expected: "a read of holding registers" });
    }
    let read = Some((read.start, read.count));
    let (function, count) = (Function::ReadWriteRegisters, wrote.count.max(1));
    Ok(ParsedRequest { function, count, read, ..wrote })
}

/// `read device id OBJECT`, and which seven bytes of the object are the answer's value.
fn parse_device_id(text: &str, tokens: &[Token<'_>]) -> Result<ParsedRequest, TextError> {
    let expected = "an object of the device identification, 0 to 255";
    let missing = TextError { at: text.len(), expected };
    let [object, rest @ ..] = tokens else { return Err(missing) };
    let start = parse_number(object.text).and_then(|number| u8::try_from(number).ok());
    let start = start.ok_or(TextError { at: object.at, expected })?;
    let expected = "which seven bytes of the text: 0 to 34, and the end of the text";
    let count = match rest {
        [] => 0,
        [only] => number_part(only).ok_or(TextError { at: only.at, expected })? as u16,
        [_, extra, ..] => return Err(TextError { at: extra.at, expected }),
    };
    Ok(ParsedRequest {
        function: Function::Unknown(device_id::FUNCTION),
        start: start.into(),
        count,
        words: [0; READ_WORDS_MAX as usize],
        read: None,
    })
}

fn number_part(token: &Token<'_>) -> Option<i64> {
    parse_number(token.text).filter(|part| (0..=34).contains(part))
}

fn is_word(text: &str) -> bool {
    text.eq_ignore_ascii_case("on") || text.eq_ignore_ascii_case("off")
}

/// The state of a coil, in a word or as 0 or 1.
fn parse_coil_state(text: &str) -> Option<u16> {
    match text {
        _ if text.eq_ignore_ascii_case("on") => Some(1),
        _ if text.eq_ignore_ascii_case("off") => Some(0),
        "0" => Some(0),
        "1" => Some(1),
        _ => None,
    }
}

fn parse_register_values(
    target: &RegisterTarget,
    values: &[Token<'_>],
    tokens: &[Token<'_>],
    function: Option<Function>,
) -> Result<ParsedRequest, TextError> {
    let mut words = [0; READ_WORDS_MAX as usize];
    let mut count = values.len();
    match (values, target.parameter) {
        ([value], Some(parameter)) => {
            let expected = "a value in the parameter's range";
            let wrong = TextError { at: value.at, expected };
            let raw = parse_number(value.text).ok_or(wrong)?;
            let pair = encoding::encode(parameter.encoding, raw).ok_or(wrong)?;
            count = usize::from(register_count(parameter.encoding));
            words[..count].copy_from_slice(&pair[..count]);
        }
        _ => {
            for (word, value) in words.iter_mut().zip(values) {
                let expected = "a value, -32768 to 65535";
                *word = parse_number(value.text)
                    .filter(|value| (-32_768..=65_535).contains(value))
                    .ok_or(TextError { at: value.at, expected })? as u16;
            }
        }
    }
    let max = if function == Some(Function::WriteRegister) { 1 } else { WRITE_WORDS_MAX as usize };
    if count > max {
        let at = values.get(max).unwrap_or(&values[0]).at;
        return Err(TextError { at, expected: "fewer values" });
    }
    let single = if count == 1 { Function::WriteRegister } else { Function::WriteRegisters };
    write_request(function.unwrap_or(single), target.start, count as u16, words, tokens)
}

fn parse_coil_values(
    target: &RegisterTarget,
    values: &[Token<'_>],
    tokens: &[Token<'_>],
    function: Option<Function>,
) -> Result<ParsedRequest, TextError> {
    let mut words = [0; READ_WORDS_MAX as usize];
    let count = values.len();
    if count > words.len() || (function == Some(Function::WriteCoil) && count > 1) {
        return Err(TextError { at: values[1].at, expected: "fewer coils" });
    }
    for (word, value) in words.iter_mut().zip(values) {
        *word = parse_coil_state(value.text)
            .ok_or(TextError { at: value.at, expected: "on, off, 1 or 0" })?;
    }
    let single = if count == 1 { Function::WriteCoil } else { Function::WriteCoils };
    write_request(function.unwrap_or(single), target.start, count as u16, words, tokens)
}

fn write_request(
    function: Function,
    start: u16,
    count: u16,
    words: [u16; READ_WORDS_MAX as usize],
    tokens: &[Token<'_>],
) -> Result<ParsedRequest, TextError> {
    let start = check_address_range(start, count, tokens)?;
    Ok(ParsedRequest { function, start, count, words, read: None })
}

fn check_address_range(start: u16, count: u16, tokens: &[Token<'_>]) -> Result<u16, TextError> {
    let end = start.checked_add(count.max(1) - 1);
    let expected = "addresses up to 0xFFFF";
    end.map(|_| start).ok_or(TextError { at: tokens[0].at, expected })
}
