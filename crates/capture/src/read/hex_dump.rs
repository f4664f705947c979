//! Hexadecimal dumps: `hexdump -C`, `od -A x -t x1z`, `xxd`, and Wireshark's, whose lines begin with a rising offset.

use super::ReadError;
use super::words::{parse_hex, split_word};

/// Bytes of a line at most.
const LINE_BYTES: usize = 64;

/// Position in a dump.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct HexDump {
    /// Offset of the next line, from the second line on.
    next: Option<u64>,
}

/// Content of a line of a dump.
#[derive(PartialEq, Eq, Debug)]
pub(super) enum DumpLine {
    /// Bytes of the line.
    Bytes,
    /// The offset of the end.
    End,
}

impl HexDump {
    /// Parses a line, and puts its bytes into `bytes`. `None` where the line does not begin with the offset that is
    /// next, or with zero.
    ///
    /// # Errors
    /// The line belongs to a dump, and its bytes cannot be read.
    pub fn parse(
        &mut self,
        line: &[u8],
        bytes: &mut Vec<u8>,
    ) -> Option<Result<DumpLine, ReadError>> {
        if self.next.is_some() && line.trim_ascii() == b"*" {
            self.next = None;
            return Some(Err(ReadError("repeated lines are left out of the dump: dump with -v")));
        }
        let (offset, digits, rest) = self.split_offset(line)?;
        if rest.is_empty() {
            let is_end = self.next.take().is_some();
            return is_end.then_some(Ok(DumpLine::End));
        }
        bytes.clear();
        if digits.ends_with(b":") {
            parse_groups(rest, bytes)?;
        } else {
            parse_bytes(rest, bytes)?;
        }
        self.next = Some(offset + bytes.len() as u64);
        Some(Ok(DumpLine::Bytes))
    }

    /// Returns whether a line goes on with the bytes of the line before.
    pub fn continues(&self, line: &[u8]) -> bool {
        self.split_offset(line).is_some_and(|(offset, _, rest)| offset > 0 && !rest.is_empty())
    }

    /// The offset, its word, and the rest of a line that is next, or the first.
    fn split_offset<'l>(&self, line: &'l [u8]) -> Option<(u64, &'l [u8], &'l [u8])> {
        let (word, rest) = split_word(line);
        let digits = word.strip_suffix(b":").unwrap_or(word);
        if !(4..=16).contains(&digits.len()) {
            return None;
        }
        let offset = std::str::from_utf8(digits).ok()?;
        // `od` counts in octal digits, unless it is asked for others.
        let is_next = |radix| {
            let at = u64::from_str_radix(offset, radix).ok()?;
            (at == 0 || self.next == Some(at)).then_some(at)
        };
        Some(([16, 8, 10].into_iter().find_map(is_next)?, word, rest))
    }
}

/// Bytes of two digits each, up to the text beside them.
pub(super) fn parse_bytes(rest: &[u8], bytes: &mut Vec<u8>) -> Option<()> {
    let mut left = rest;
    while bytes.len() < LINE_BYTES {
        let word = left.trim_ascii_start();
        let gap = left.len() - word.len();
        // Two spaces are in the middle of a line too; behind a whole line, or more of them, they begin the text.
        let is_text = gap > 2 || gap == 2 && bytes.len().is_multiple_of(16) && !bytes.is_empty();
        let (word, _) = split_word(word);
        if is_text || word.len() != 2 || parse_hex(word, bytes).is_err() {
            break;
        }
        left = &left[gap + 2..];
    }
    (!bytes.is_empty()).then_some(())
}

/// `xxd`: groups of one byte or more, with two spaces before the text.
fn parse_groups(rest: &[u8], bytes: &mut Vec<u8>) -> Option<()> {
    let end = memchr::memmem::find(rest, b"  ").unwrap_or(rest.len());
    let groups = rest[..end].split(u8::is_ascii_whitespace).filter(|group| !group.is_empty());
    for group in groups {
        parse_hex(group, bytes).ok()?;
    }
    (!bytes.is_empty() && bytes.len() <= LINE_BYTES).then_some(())
}

#[cfg(test)]
mod tests {
    use super::HexDump;

    fn read(dump: &str) -> Vec<Vec<u8>> {
        let (mut reader, mut found) = (HexDump::default(), Vec::new());
        for line in dump.lines() {
            let mut bytes = Vec::new();
            if let Some(Ok(super::DumpLine::Bytes)) = reader.parse(line.as_bytes(), &mut bytes) {
                found.push(bytes);
            }
        }
        found
    }

    #[test]
    fn dumps_of_four_programs() {
        let first: Vec<u8> = (0x30..0x40).collect();
        let expected = vec![first, vec![0x01, 0x03]];
        for dump in [
            "00000000  30 31 32 33 34 35 36 37  38 39 3a 3b 3c 3d 3e 3f  |0123456789:;<=>?|\n\
             00000010  01 03                                             |..|\n00000012\n",
            "000000 30 31 32 33 34 35 36 37 38 39 3a 3b 3c 3d 3e 3f  >0123456789:;<=>?<\n\
             000010 01 03                                            >..<\n000012\n",
            "0000000 30 31 32 33 34 35 36 37 38 39 3a 3b 3c 3d 3e 3f\n0000020 01 03\n0000022\n",
            "00000000: 3031 3233 3435 3637 3839 3a3b 3c3d 3e3f  0123456789:;<=>?\n\
             00000010: 0103                                     ..\n",
            "0000   30 31 32 33 34 35 36 37 38 39 3a 3b 3c 3d 3e 3f   0123456789:;<=>?\n\
             0010   01 03                                             ..\n",
        ] {
            assert_eq!(read(dump), expected, "{dump}");
        }
        // A number that does not rise with the bytes is none of a dump.
        assert_eq!(read("1000 01 03\n0004 01 03\n"), Vec::<Vec<u8>>::new());
    }
}
