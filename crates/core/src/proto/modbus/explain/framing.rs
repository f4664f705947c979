//! Finds the end of frames in a stream.

use crate::error::WireError;
use crate::explain::{Direction, FrameBoundary};
use crate::proto::modbus::rtu::{self, ADU_MAX, ADU_MIN};
use crate::proto::modbus::wire::AnnouncedLength;
use crate::proto::modbus::{ascii, tcp, wire};

/// Longest search for the beginning of the next frame.
const SEARCH_MAX: usize = 2 * ADU_MAX;

enum HeadScan {
    Frame(usize),
    /// Whole by its length, but the check fails.
    Broken(usize),
    More,
    Nothing,
}

pub(super) fn cut_rtu(bytes: &[u8], direction: Option<Direction>, ended: bool) -> FrameBoundary {
    let broken = match scan_head(bytes, direction) {
        HeadScan::Frame(len) => return FrameBoundary::Frame(len),
        HeadScan::More if !ended => return FrameBoundary::Incomplete,
        HeadScan::Broken(len) => Some(len),
        HeadScan::More | HeadScan::Nothing => None,
    };
    let max = bytes.len().min(SEARCH_MAX);
    let next =
        (1..max).find(|&at| matches!(scan_head(&bytes[at..], direction), HeadScan::Frame(_)));
    match (next, broken) {
        (Some(at), _) if has_announced_len(&bytes[..at], direction) => FrameBoundary::Corrupt(at),
        (Some(at), _) => FrameBoundary::Skip(at),
        (None, _) if !ended && bytes.len() < SEARCH_MAX => FrameBoundary::Incomplete,
        (None, Some(len)) => FrameBoundary::Corrupt(len),
        (None, None) if (ADU_MIN..=ADU_MAX).contains(&bytes.len()) => {
            FrameBoundary::Corrupt(bytes.len())
        }
        (None, None) => FrameBoundary::Skip(max.max(1)),
    }
}

/// The frame at the head of the bytes, without a search for the next.
pub(super) fn rtu_frame_len(bytes: &[u8], direction: Option<Direction>) -> Option<usize> {
    match scan_head(bytes, direction) {
        HeadScan::Frame(len) => Some(len),
        _ => None,
    }
}

pub(super) fn cut_ascii(bytes: &[u8], ended: bool) -> FrameBoundary {
    let Some(&first) = bytes.first() else { return FrameBoundary::Incomplete };
    if first != ascii::START {
        let next = bytes.iter().position(|&character| character == ascii::START);
        return FrameBoundary::Skip(next.unwrap_or(bytes.len()));
    }
    let mut collector = ascii::AsciiDeframer::default();
    for (at, &character) in bytes.iter().enumerate() {
        match collector.feed(character) {
            ascii::FeedResult::Incomplete => {}
            ascii::FeedResult::Complete => {
                let right = ascii::decode(collector.bytes()).is_ok_and(|(_, pdu)| !pdu.is_empty());
                return if right {
                    FrameBoundary::Frame(at + 1)
                } else {
                    FrameBoundary::Corrupt(at + 1)
                };
            }
            ascii::FeedResult::Skipped(_) if character == ascii::START => {
                return FrameBoundary::Skip(at);
            }
            ascii::FeedResult::Skipped(_) => return FrameBoundary::Skip(at + 1),
        }
    }
    if ended { FrameBoundary::Skip(bytes.len()) } else { FrameBoundary::Incomplete }
}

/// The bytes of an ASCII frame.
pub(super) fn collect_ascii<'a>(
    characters: &[u8],
    store: &'a mut [u8; rtu::ADU_MAX],
) -> Result<&'a [u8], WireError> {
    let mut collector = ascii::AsciiDeframer::default();
    for (at, &character) in characters.iter().enumerate() {
        match collector.feed(character) {
            ascii::FeedResult::Incomplete => {}
            ascii::FeedResult::Complete => {
                let bytes = collector.bytes();
                store[..bytes.len()].copy_from_slice(bytes);
                return Ok(&store[..bytes.len()]);
            }
            ascii::FeedResult::Skipped(_) if character == ascii::START => {}
            ascii::FeedResult::Skipped(_) => {
                return Err(WireError::Unexpected { at: at as u16, found: character });
            }
        }
    }
    let found = characters.len() as u16;
    Err(WireError::Short { need: found + 1, found })
}

pub(super) fn cut_tcp(bytes: &[u8], direction: Option<Direction>, ended: bool) -> FrameBoundary {
    match scan_tcp_head(bytes, direction) {
        HeadScan::Frame(len) => FrameBoundary::Frame(len),
        HeadScan::More if !ended => FrameBoundary::Incomplete,
        // A stream that lost its beginning goes on with the next header.
        _ => {
            let next = (1..bytes.len().min(SEARCH_MAX))
                .find(|&at| !matches!(scan_tcp_head(&bytes[at..], direction), HeadScan::Nothing));
            FrameBoundary::Skip(next.unwrap_or(bytes.len()).max(1))
        }
    }
}

/// The frame of TCP at the head of the bytes.
pub(super) fn tcp_frame_len(bytes: &[u8], direction: Option<Direction>) -> Option<usize> {
    match scan_tcp_head(bytes, direction) {
        HeadScan::Frame(len) => Some(len),
        _ => None,
    }
}

fn scan_tcp_head(bytes: &[u8], direction: Option<Direction>) -> HeadScan {
    let spans = match direction {
        Some(Direction::ToDrive) => [tcp::request_span(bytes); 2],
        Some(Direction::ToHost) => [tcp::reply_span(bytes); 2],
        None => [tcp::request_span(bytes), tcp::reply_span(bytes)],
    };
    let whole = |span: &AnnouncedLength| match span {
        AnnouncedLength::Bytes(len) if *len <= bytes.len() => Some(*len),
        _ => None,
    };
    match spans.iter().find_map(whole) {
        Some(len) => HeadScan::Frame(len),
        None if spans.iter().all(|span| *span == AnnouncedLength::Never) => HeadScan::Nothing,
        None => HeadScan::More,
    }
}

fn scan_head(bytes: &[u8], direction: Option<Direction>) -> HeadScan {
    let request = match (direction, check_span(bytes, rtu::request_span(bytes))) {
        // An adapter that echoes, or another host on the line: only a valid request counts there.
        (Some(Direction::ToHost), HeadScan::Frame(len)) => HeadScan::Frame(len),
        (Some(Direction::ToHost), _) => HeadScan::Nothing,
        (_, found) => found,
    };
    let reply = match direction {
        Some(Direction::ToDrive) => HeadScan::Nothing,
        _ => check_span(bytes, rtu::reply_span(bytes)),
    };
    match (request, reply) {
        // The CRC of a frame that ends in 00h is valid without that byte too, so only the longer one is proven.
        (HeadScan::Frame(a), HeadScan::Frame(b)) if a.abs_diff(b) == 1 => HeadScan::Frame(a.max(b)),
        (HeadScan::Frame(len), _) | (_, HeadScan::Frame(len)) => HeadScan::Frame(len),
        (HeadScan::More, _) | (_, HeadScan::More) => HeadScan::More,
        (HeadScan::Broken(a), HeadScan::Broken(b)) => {
            HeadScan::Broken(if b == bytes.len() { b } else { a })
        }
        (HeadScan::Broken(len), _) | (_, HeadScan::Broken(len)) => HeadScan::Broken(len),
        _ => HeadScan::Nothing,
    }
}

fn check_span(bytes: &[u8], span: AnnouncedLength) -> HeadScan {
    match span {
        AnnouncedLength::Bytes(len) if bytes.len() < len => HeadScan::More,
        AnnouncedLength::Bytes(len) if rtu::crc_matches(&bytes[..len]) => HeadScan::Frame(len),
        AnnouncedLength::Bytes(len) => HeadScan::Broken(len),
        AnnouncedLength::More => HeadScan::More,
        AnnouncedLength::Unknown if rtu::crc_matches(bytes) && bytes.len() <= wire::PDU_MAX + 3 => {
            HeadScan::Frame(bytes.len())
        }
        AnnouncedLength::Unknown | AnnouncedLength::Never => HeadScan::Nothing,
    }
}

/// Returns whether the head announces exactly this number of bytes.
fn has_announced_len(bytes: &[u8], direction: Option<Direction>) -> bool {
    let request = rtu::request_span(bytes) == AnnouncedLength::Bytes(bytes.len());
    let reply = rtu::reply_span(bytes) == AnnouncedLength::Bytes(bytes.len());
    match direction {
        Some(Direction::ToDrive) => request,
        Some(Direction::ToHost) => reply,
        None => request || reply,
    }
}
