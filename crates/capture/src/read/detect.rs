//! The format of a capture by its first bytes or lines.

use super::{crtd, csv};
use crate::format::{CaptureFormat, HEAD_MAX};

/// First bytes of formats that are not text.
const MAGIC: [(&[u8], CaptureFormat); 7] = [
    (&[0xA1, 0xB2, 0xC3, 0xD4], CaptureFormat::Pcap),
    (&[0xD4, 0xC3, 0xB2, 0xA1], CaptureFormat::Pcap),
    (&[0xA1, 0xB2, 0x3C, 0x4D], CaptureFormat::Pcap),
    (&[0x4D, 0x3C, 0xB2, 0xA1], CaptureFormat::Pcap),
    (&[0x0A, 0x0D, 0x0D, 0x0A], CaptureFormat::Pcapng),
    (b"LOGG", CaptureFormat::Blf),
    (b"SQLite format 3\0", CaptureFormat::Sqlite),
];

impl CaptureFormat {
    /// Format with this head; `None` while there are too few bytes. An unknown one is read line by line.
    pub(crate) fn detect(head: &[u8], ended: bool) -> Option<Self> {
        let enough = ended || head.len() >= HEAD_MAX;
        if head.len() < 4 && !enough {
            return None;
        }
        if let Some((_, format)) = MAGIC.iter().find(|(magic, _)| head.starts_with(magic)) {
            return Some(*format);
        }
        let text = head.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(head);
        let (whole, rest) =
            text.split_at(text.iter().rposition(|c| *c == b'\n').map_or(0, |n| n + 1));
        let capture_format = whole.split(|c| *c == b'\n').find_map(Self::detect_line);
        capture_format.or_else(|| enough.then(|| Self::detect_line(rest).unwrap_or(Self::Text)))
    }

    /// The format that has such a line, if it is not a mere comment.
    fn detect_line(line: &[u8]) -> Option<Self> {
        let line = line.trim_ascii();
        match line {
            _ if begins_with_word(b";$FILEVERSION", line) => Some(Self::Trc),
            [] | [b';' | b'#', ..] => None,
            _ if begins_with_word(b"date ", line) || begins_with_word(b"base ", line) => {
                Some(Self::Asc)
            }
            _ if csv::is_header(line) => Some(Self::Csv),
            _ if line.starts_with(b"***BUSMASTER") => Some(Self::Busmaster),
            _ if crtd::is_line(line) => Some(Self::Crtd),
            [b'{', ..] => Some(Self::Jsonl),
            // PEAK's first versions number their lines `1)`.
            [b'0'..=b'9', ..] if after_digits(line).first() == Some(&b')') => Some(Self::Trc),
            _ => Some(Self::Text),
        }
    }
}

fn begins_with_word(word: &[u8], line: &[u8]) -> bool {
    line.get(..word.len()).is_some_and(|start| start.eq_ignore_ascii_case(word))
}

fn after_digits(line: &[u8]) -> &[u8] {
    &line[line.iter().take_while(|c| c.is_ascii_digit()).count()..]
}
