//! Where frames end in a stream.

use crate::explain::{Cut, Direction};
use crate::proto::modbus::rtu::{self, ADU_MAX, ADU_MIN};
use crate::proto::modbus::wire::Span;
use crate::proto::modbus::{ascii, wire};

/// How far the beginning of the next frame is looked for.
const LOOK_MAX: usize = 2 * ADU_MAX;

enum Head {
    Frame(usize),
    /// Whole by its length, but the check fails.
    Broken(usize),
    More,
    Nothing,
}

pub(super) fn rtu(bytes: &[u8], direction: Option<Direction>, ended: bool) -> Cut {
    let broken = match head(bytes, direction) {
        Head::Frame(len) => return Cut::Frame(len),
        Head::More if !ended => return Cut::More,
        Head::Broken(len) => Some(len),
        Head::More | Head::Nothing => None,
    };
    let most = bytes.len().min(LOOK_MAX);
    let next = (1..most).find(|&at| matches!(head(&bytes[at..], direction), Head::Frame(_)));
    match (next, broken) {
        (Some(at), _) if shaped(&bytes[..at], direction) => Cut::Broken(at),
        (Some(at), _) => Cut::Skip(at),
        (None, _) if !ended && bytes.len() < LOOK_MAX => Cut::More,
        (None, Some(len)) => Cut::Broken(len),
        (None, None) if (ADU_MIN..=ADU_MAX).contains(&bytes.len()) => Cut::Broken(bytes.len()),
        (None, None) => Cut::Skip(most.max(1)),
    }
}

/// The frame at the head of the bytes, without a search for the next.
pub(super) fn rtu_whole(bytes: &[u8], direction: Option<Direction>) -> Option<usize> {
    match head(bytes, direction) {
        Head::Frame(len) => Some(len),
        _ => None,
    }
}

pub(super) fn ascii(bytes: &[u8], ended: bool) -> Cut {
    let Some(&first) = bytes.first() else { return Cut::More };
    if first != ascii::START {
        let next = bytes.iter().position(|&character| character == ascii::START);
        return Cut::Skip(next.unwrap_or(bytes.len()));
    }
    let mut collector = ascii::Collector::default();
    for (at, &character) in bytes.iter().enumerate() {
        match collector.feed(character) {
            ascii::Fed::Goes => {}
            ascii::Fed::Ended => {
                let right = ascii::open(collector.bytes()).is_ok_and(|(_, pdu)| !pdu.is_empty());
                return if right { Cut::Frame(at + 1) } else { Cut::Broken(at + 1) };
            }
            ascii::Fed::Skipped(_) if character == ascii::START => return Cut::Skip(at),
            ascii::Fed::Skipped(_) => return Cut::Skip(at + 1),
        }
    }
    if ended { Cut::Skip(bytes.len()) } else { Cut::More }
}

fn head(bytes: &[u8], direction: Option<Direction>) -> Head {
    let request = match direction {
        Some(Direction::ToHost) => Head::Nothing,
        _ => judged(bytes, rtu::request_span(bytes)),
    };
    let reply = match direction {
        Some(Direction::ToDrive) => Head::Nothing,
        _ => judged(bytes, rtu::reply_span(bytes)),
    };
    match (request, reply) {
        (Head::Frame(len), _) | (_, Head::Frame(len)) => Head::Frame(len),
        (Head::More, _) | (_, Head::More) => Head::More,
        (Head::Broken(a), Head::Broken(b)) => Head::Broken(if b == bytes.len() { b } else { a }),
        (Head::Broken(len), _) | (_, Head::Broken(len)) => Head::Broken(len),
        _ => Head::Nothing,
    }
}

fn judged(bytes: &[u8], span: Span) -> Head {
    match span {
        Span::Bytes(len) if bytes.len() < len => Head::More,
        Span::Bytes(len) if rtu::agrees(&bytes[..len]) => Head::Frame(len),
        Span::Bytes(len) => Head::Broken(len),
        Span::More => Head::More,
        Span::Unknown if rtu::agrees(bytes) && bytes.len() <= wire::PDU_MAX + 3 => {
            Head::Frame(bytes.len())
        }
        Span::Unknown | Span::Never => Head::Nothing,
    }
}

/// Whether so many bytes are just what their head announces.
fn shaped(bytes: &[u8], direction: Option<Direction>) -> bool {
    let request = rtu::request_span(bytes) == Span::Bytes(bytes.len());
    let reply = rtu::reply_span(bytes) == Span::Bytes(bytes.len());
    match direction {
        Some(Direction::ToDrive) => request,
        Some(Direction::ToHost) => reply,
        None => request || reply,
    }
}
