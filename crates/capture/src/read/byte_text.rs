//! Bytes in the notations of many programs.

use super::words::{parse_hex, parse_hex_digit};

/// Characters between bytes. ESPHome writes `01.03`, others `01:03` and `01-03`.
const SEPARATORS: [char; 6] = [' ', ',', '\t', '-', ':', '.'];

/// Parses bytes: `01 03`, `0x1 0x3`, `01,03`, `01:03`, `b'\x01\x03'`. Returns the text after them; `None` where
/// there are none.
pub(super) fn parse_bytes<'t>(text: &'t str, bytes: &mut Vec<u8>) -> Option<&'t str> {
    let text = text.trim_start();
    let quoted = text.strip_prefix('b').unwrap_or(text);
    if let Some(quote) = quoted.chars().next().filter(|c| matches!(c, '\'' | '"' | '\\')) {
        return parse_escapes(quoted, quote, bytes);
    }
    let mut rest = text;
    while !rest.is_empty() {
        let (word, after) = rest.split_at(rest.find(SEPARATORS).unwrap_or(rest.len()));
        let number = word.strip_prefix("0x").or_else(|| word.strip_prefix("0X"));
        let digits = number.unwrap_or(word).as_bytes();
        if !digits.iter().all(u8::is_ascii_hexdigit) {
            break;
        }
        match digits {
            [digit] if number.is_some() => bytes.push(parse_hex_digit(*digit).ok()?),
            [_, ..] if digits.len().is_multiple_of(2) => parse_hex(digits, bytes).ok()?,
            _ => break,
        }
        rest = after.trim_start_matches(SEPARATORS);
    }
    (!bytes.is_empty()).then_some(rest)
}

/// Parses the bytes of a Python literal, `\x01\x03A\r`, up to the closing quote.
fn parse_escapes<'t>(text: &'t str, quote: char, bytes: &mut Vec<u8>) -> Option<&'t str> {
    let quoted = quote != '\\';
    let mut chars = if quoted { &text[quote.len_utf8()..] } else { text }.chars();
    while let Some(c) = chars.next() {
        let byte = match c {
            _ if quoted && c == quote => return Some(chars.as_str().trim_start()),
            '\\' => match chars.next()? {
                'x' => {
                    let digits = chars.as_str().get(..2)?;
                    chars = chars.as_str()[2..].chars();
                    u8::from_str_radix(digits, 16).ok()?
                }
                'r' => b'\r',
                'n' => b'\n',
                't' => b'\t',
                other => u8::try_from(other).ok()?,
            },
            _ => u8::try_from(c).ok()?,
        };
        bytes.push(byte);
    }
    // Without quotes, the end of the line ends the bytes.
    (!quoted).then_some("")
}

/// Returns whether text after the bytes is one that programs append, and not the rest of other data.
pub(super) fn is_trailer(rest: &str) -> bool {
    let first = rest.chars().next();
    first.is_none_or(|c| {
        matches!(c, '(' | '<' | '>' | '[' | '\'' | '"' | '|' | '#' | ';' | '□' | '■')
    }) || rest.starts_with("//")
        || ["old_data", "extra", "addr", "bytes"].iter().any(|word| rest.starts_with(word))
}

/// The text up to a gap of two spaces, or a tab.
pub(super) fn first_column(text: &str) -> &str {
    let text = text.split('\t').next().unwrap_or(text);
    text.split_once("  ").map_or(text, |(column, _)| column)
}
