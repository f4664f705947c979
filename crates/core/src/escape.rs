//! Text of devices, files and other programs, as a terminal may show it.

use core::fmt::{self, Write as _};

/// Shows text with its control characters escaped, and nothing else: `\n`, `\x1b`. A name with an escape sequence in it
/// would otherwise move the cursor, hide a line or write to the clipboard of its reader.
///
/// ```
/// use polepair_core::escape::EscapedText;
/// assert_eq!(EscapedText("can0\x1b[2J").to_string(), r"can0\x1b[2J");
/// assert_eq!(EscapedText("Bob's 5\" \\drive\\ Müller").to_string(), "Bob's 5\" \\drive\\ Müller");
/// ```
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct EscapedText<'a>(pub &'a str);

impl fmt::Display for EscapedText<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if is_plain(self.0.as_bytes()) {
            return f.write_str(self.0);
        }
        self.0.chars().try_for_each(|c| match c {
            '\n' => f.write_str("\\n"),
            '\r' => f.write_str("\\r"),
            '\t' => f.write_str("\\t"),
            // All of them are below 100h.
            _ if c.is_control() => write!(f, "\\x{:02x}", u32::from(c)),
            _ => f.write_char(c),
        })
    }
}

/// Returns whether text in UTF-8 has no control character: C0, delete or C1.
#[must_use]
pub fn is_plain(text: &[u8]) -> bool {
    // Nearly all text is ASCII, and one pass without branches decides it.
    if text.iter().fold(true, |plain, byte| plain & matches!(byte, 0x20..=0x7E)) {
        return true;
    }
    let has_c0 = text.iter().fold(false, |found, byte| found | (*byte < 0x20) | (*byte == 0x7F));
    !has_c0 && !has_c1(text)
}

/// Returns whether lines of text in UTF-8 have no control character but the ends of lines and tabulators.
#[must_use]
pub fn are_lines_plain(text: &[u8]) -> bool {
    /// Bytes that are looked at without a branch between them.
    const CHUNK: usize = 256;
    const BEYOND_ASCII: u8 = 0x80;
    let is_c0 = |byte: u8| ((byte < 0x20) & (byte != b'\n') & (byte != b'\t')) | (byte == 0x7F);
    let flags = |chunk: &[u8]| {
        chunk.iter().fold(0, |all, byte| all | u8::from(is_c0(*byte)) | (*byte & BEYOND_ASCII))
    };
    let mut all = 0;
    let is_bad = |chunk: &[u8]| {
        all |= flags(chunk);
        all & !BEYOND_ASCII != 0
    };
    // C1 is beyond ASCII, which most pages are.
    !text.chunks(CHUNK).any(is_bad) && (all == 0 || !has_c1(text))
}

/// Returns whether text in UTF-8 has a control character of C1, which is C2h and a byte from 80h to 9Fh.
fn has_c1(text: &[u8]) -> bool {
    text.contains(&0xC2)
        && text.windows(2).any(|pair| pair[0] == 0xC2 && (0x80..=0x9F).contains(&pair[1]))
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::string::ToString as _;

    use super::*;

    #[test]
    fn control_characters_are_escaped_and_nothing_else() {
        for (text, shown) in [
            ("", ""),
            ("plain ü € \u{200b}\u{202e}\u{a0}", "plain ü € \u{200b}\u{202e}\u{a0}"),
            ("\0\x07\x1b]0;x\x07", "\\x00\\x07\\x1b]0;x\\x07"),
            ("line\nline\n", "line\\nline\\n"),
            ("a\nb\tc\rd\x7f", "a\\nb\\tc\\rd\\x7f"),
            ("\u{80}\u{9b}31m", "\\x80\\x9b31m"),
            ("\"'\\", "\"'\\"),
        ] {
            assert_eq!(EscapedText(text).to_string(), shown);
            assert_eq!(is_plain(text.as_bytes()), text == shown, "{text:?}");
            let kept = text == shown || text.chars().all(|c| c == '\n' || !c.is_control());
            assert_eq!(are_lines_plain(text.as_bytes()), kept, "{text:?}");
        }
    }
}
