//! Read Device Identification, function 43/14 (MAP 6.21): vendor, product code, version and names.
//!
//! A reply lists several objects in one frame. Its length is not in its header: each object has its own
//! length.

use super::wire::AnnouncedLength;

/// Function code of the encapsulated interface transport.
pub const FUNCTION: u8 = 0x2B;
/// The MEI type of Read Device Identification.
pub const MEI_TYPE: u8 = 0x0E;
/// Bytes of the PDU before the first object: function, MEI type, access code, conformity level, more
/// follows, next object, number of objects.
const HEAD_LEN: usize = 7;
/// Bytes of an object's text that one answer carries as a number.
pub const PART_LEN: usize = 7;

/// The access code by which an object is read: basic, regular or extended.
#[must_use]
pub const fn access_code(object: u8) -> u8 {
    match object {
        0..=2 => 1,
        3..=0x7F => 2,
        _ => 3,
    }
}

/// Data after the function code in a request for an object and the following ones.
#[must_use]
pub const fn request_data(object: u8) -> [u8; 3] {
    [MEI_TYPE, access_code(object), object]
}

/// The standard's name of an object; empty for objects of the maker.
#[must_use]
pub const fn object_name(object: u8) -> &'static str {
    match object {
        0 => "vendor",
        1 => "product code",
        2 => "revision",
        3 => "vendor URL",
        4 => "product name",
        5 => "model",
        6 => "application",
        _ => "",
    }
}

/// The length of the reply PDU that begins with `head`.
pub(super) fn reply_span(head: &[u8]) -> AnnouncedLength {
    match head.get(1) {
        None => return AnnouncedLength::More,
        Some(&MEI_TYPE) => {}
        Some(_) => return AnnouncedLength::Unknown,
    }
    let Some(&count) = head.get(HEAD_LEN - 1) else { return AnnouncedLength::More };
    let mut end = HEAD_LEN;
    for _ in 0..count {
        let Some(&len) = head.get(end + 1) else { return AnnouncedLength::More };
        end += 2 + usize::from(len);
        if end > super::wire::PDU_MAX {
            return AnnouncedLength::Never;
        }
    }
    AnnouncedLength::Bytes(end)
}

/// The objects of a reply, by what follows its function code; `None` for another MEI type, or where
/// the lengths contradict each other.
pub fn objects(data: &[u8]) -> Option<impl Iterator<Item = (u8, &[u8])>> {
    let [MEI_TYPE, _, _, _, _, count, list @ ..] = data else { return None };
    let mut rest = list;
    for _ in 0..*count {
        let [_, len, tail @ ..] = rest else { return None };
        rest = tail.get(usize::from(*len)..)?;
    }
    if !rest.is_empty() {
        return None;
    }
    let mut rest = list;
    Some(core::iter::from_fn(move || {
        let [object, len, tail @ ..] = rest else { return None };
        let (text, tail) = tail.split_at(usize::from(*len));
        rest = tail;
        Some((*object, text))
    }))
}

/// Bytes of an object's text, from part `part` on, as a number: their count, at most [`PART_LEN`], is in the highest
/// byte.
#[must_use]
pub fn part_words(text: &[u8], part: u16) -> [u16; 4] {
    let from = (usize::from(part) * PART_LEN).min(text.len());
    let part = &text[from..text.len().min(from + PART_LEN)];
    let mut bytes = [0; 8];
    bytes[0] = part.len() as u8;
    bytes[1..=part.len()].copy_from_slice(part);
    let mut words = [0; 4];
    words.iter_mut().zip(super::wire::words(&bytes)).for_each(|(to, word)| *to = word);
    words
}

#[cfg(test)]
mod tests {
    use super::{objects, part_words, reply_span};
    use crate::proto::modbus::wire::AnnouncedLength;

    /// The example of MAP 6.21, with its texts.
    const REPLY: &[u8] = b"\x2B\x0E\x01\x01\x00\x00\x03\x00\x16Company identification\
                           \x01\x0FProduct code XX\x02\x05V2.11";

    #[test]
    fn a_reply_tells_its_length_object_by_object() {
        for len in 0..REPLY.len() {
            let span = reply_span(&REPLY[..len]);
            let known = len > REPLY.len() - 6;
            let all = AnnouncedLength::Bytes(REPLY.len());
            assert_eq!(span, if known { all } else { AnnouncedLength::More }, "{len}");
        }
        assert_eq!(reply_span(&[0x2B, 0x0D]), AnnouncedLength::Unknown);
        let too_long = [0x2B, 0x0E, 1, 1, 0, 0, 2, 0, 255, 0];
        assert_eq!(reply_span(&too_long), AnnouncedLength::Never);
    }

    #[test]
    fn objects_are_found_and_cut_into_parts() {
        let mut found = objects(&REPLY[1..]).expect("objects");
        assert_eq!(found.nth(2), Some((2, &b"V2.11"[..])));
        assert_eq!(found.next(), None);
        assert!(objects(&REPLY[1..REPLY.len() - 1]).is_none() && objects(b"\x0D").is_none());
        assert_eq!(part_words(b"V2.11", 0), [0x0556, 0x322E, 0x3131, 0]);
        assert_eq!(part_words(b"V2.11", 1), [0; 4]);
        assert_eq!(part_words(b"12345678", 1), [0x0138, 0, 0, 0]);
    }
}
