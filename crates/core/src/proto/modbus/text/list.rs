//! Writes of several items, as a decoder prints them: `write register 0x0030 = 5, register 0x0031 = 5`,
//! `write coil 0x0013, 10 bits = on: 1 3 4`.

use super::{ParsedRequest, Token, check_address_range, parse_number, parse_symbol};
use crate::explain::TextError;
use crate::proto::modbus::wire::{Function, READ_WORDS_MAX, WRITE_WORDS_MAX};

/// Reads such a list; `None` when the text is none.
///
/// # Errors
/// [`TextError`] with the place and the expected words.
pub fn parse_list(text: &str, tokens: &[Token<'_>]) -> Result<Option<ParsedRequest>, TextError> {
    let [first, rest @ ..] = tokens else { return Ok(None) };
    if !first.is("write") {
        return Ok(None);
    }
    match rest {
        [multiple, rest @ ..] if multiple.is("multiple:") => parse_registers(text, rest).map(Some),
        [kind, list @ ..]
            if kind.is("coil") && (has_word("on:", rest) || has_word("all", rest)) =>
        {
            parse_coils(text, list).map(Some)
        }
        [kind, list @ ..]
            if kind.is("register") && (has_word("then", rest) || has_register_word(list)) =>
        {
            parse_registers(text, rest).map(Some)
        }
        _ => Ok(None),
    }
}

fn has_word(word: &str, rest: &[Token<'_>]) -> bool {
    rest.iter().any(|token| token.is(word))
}

fn has_register_word(list: &[Token<'_>]) -> bool {
    list.iter().any(|token| token.is("register"))
}

/// `register A = v, register B = v, then v v`: addresses in order, without a gap.
fn parse_registers(text: &str, tokens: &[Token<'_>]) -> Result<ParsedRequest, TextError> {
    let mut parsed = ParsedRequest {
        function: Function::WriteRegisters,
        start: 0,
        count: 0,
        words: [0; READ_WORDS_MAX as usize],
        read: None,
    };
    let mut rest = tokens;
    while let [kind, address, value, more @ ..] = rest
        && kind.is("register")
    {
        let next = self::parse_address(address)?;
        if parsed.count == 0 {
            parsed.start = next;
        } else if Some(next) != parsed.start.checked_add(parsed.count) {
            return Err(TextError { at: address.at, expected: "the register that follows" });
        }
        push_value(&mut parsed, value)?;
        rest = more;
    }
    if let [then, values @ ..] = rest
        && then.is("then")
    {
        values.iter().try_for_each(|value| push_value(&mut parsed, value))?;
        rest = &[];
    }
    match (rest.first(), parsed.count) {
        (Some(token), _) => {
            Err(TextError { at: token.at, expected: "register ADDRESS = VALUE, or then VALUES" })
        }
        (None, 0) => Err(TextError { at: text.len(), expected: "register ADDRESS = VALUE" }),
        (None, count) => check_address_range(parsed.start, count, tokens).map(|_| parsed),
    }
}

fn push_value(parsed: &mut ParsedRequest, token: &Token<'_>) -> Result<(), TextError> {
    if parsed.count == WRITE_WORDS_MAX {
        return Err(TextError { at: token.at, expected: "at most 123 values" });
    }
    let expected = "a value, -32768 to 65535";
    let value = parse_number(token.text).filter(|value| (-32_768..=65_535).contains(value));
    parsed.words[usize::from(parsed.count)] =
        value.ok_or(TextError { at: token.at, expected })? as u16;
    parsed.count += 1;
    Ok(())
}

/// `A, n bits = on: 1 3` or `A = all off`. Lines are counted from 1.
fn parse_coils(text: &str, tokens: &[Token<'_>]) -> Result<ParsedRequest, TextError> {
    let missing = TextError { at: text.len(), expected: "a coil's address" };
    let (first, rest) = tokens.split_first().ok_or(missing)?;
    let start = parse_address(first)?;
    let (count, rest) = match rest {
        [count, unit, rest @ ..] if unit.is("bits") => (parse_position(count)?, rest),
        rest => (1, rest),
    };
    let mut words = [0; READ_WORDS_MAX as usize];
    match rest {
        [all, off] if all.is("all") && off.is("off") => {}
        [on, lines @ ..] if on.is("on:") && !lines.is_empty() => {
            for line in lines {
                let at = parse_position(line)?;
                let expected = "a line among those that are written";
                let outside = TextError { at: line.at, expected };
                *words[..usize::from(count)].get_mut(usize::from(at) - 1).ok_or(outside)? = 1;
            }
        }
        _ => return Err(TextError { at: first.at, expected: "A, N bits = on: LINES, or all off" }),
    }
    check_address_range(start, count, tokens)?;
    Ok(ParsedRequest { function: Function::WriteCoils, start, count, words, read: None })
}

fn parse_address(token: &Token<'_>) -> Result<u16, TextError> {
    let plain = parse_number(token.text).and_then(|value| u16::try_from(value).ok());
    let expected = "a register address, 0 to 0xFFFF";
    plain.or_else(|| parse_symbol(token.text)).ok_or(TextError { at: token.at, expected })
}

fn parse_position(token: &Token<'_>) -> Result<u16, TextError> {
    let max = i64::from(READ_WORDS_MAX);
    let found = parse_number(token.text).filter(|value| (1..=max).contains(value));
    found
        .map(|value| value as u16)
        .ok_or(TextError { at: token.at, expected: "a number, 1 to 125" })
}
