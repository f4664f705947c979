//! Names protocols of others, by what each of their frames has. They are not decoded: a name saves a person the search.

use crate::record::{Record, RecordData};

/// Records of a protocol that name it.
const RECORDS_MIN: u64 = 8;

/// A protocol that is recognised and not decoded.
struct ForeignProtocol {
    name: &'static str,
    has_shape: fn(&RecordData<'_>) -> bool,
}

const PROTOCOLS: [ForeignProtocol; 6] = [
    ForeignProtocol { name: "Elmo's binary interpreter", has_shape: is_elmo },
    ForeignProtocol { name: "vehicle diagnosis (ISO-TP)", has_shape: is_iso_tp },
    ForeignProtocol { name: "Dynamixel", has_shape: is_dynamixel },
    ForeignProtocol { name: "Pelco-D", has_shape: is_pelco },
    ForeignProtocol { name: "VESC", has_shape: is_vesc },
    ForeignProtocol { name: "lines of text", has_shape: is_text },
];

/// Counts of the records of one link.
#[derive(Clone, Debug, Default)]
pub(super) struct ForeignCounts {
    records: u64,
    shapes: [u64; PROTOCOLS.len()],
}

impl ForeignCounts {
    pub fn observe(&mut self, record: &Record<'_>) {
        self.records += 1;
        for (count, protocol) in self.shapes.iter_mut().zip(&PROTOCOLS) {
            *count += u64::from((protocol.has_shape)(&record.data));
        }
    }

    /// The protocol that three of four records have the shape of.
    pub fn name(&self) -> Option<&'static str> {
        let mut named = PROTOCOLS.iter().zip(self.shapes);
        let is_most = |count: u64| count >= RECORDS_MIN && 4 * count >= 3 * self.records;
        named.find(|(_, count)| is_most(*count)).map(|(protocol, _)| protocol.name)
    }
}

/// Two letters at 300h + id, and the answer with the same at 280h + id.
fn is_elmo(data: &RecordData<'_>) -> bool {
    let RecordData::Frame(frame) = data else { return false };
    let is_id = matches!(frame.id, 0x281..=0x2FF | 0x301..=0x37F) && !frame.extended;
    let letters = frame.bytes().first_chunk::<2>();
    is_id && letters.is_some_and(|letters| letters.iter().all(u8::is_ascii_uppercase))
}

/// Single frames whose length is possible, first and consecutive frames, and flow control (ISO 15765-2).
fn is_iso_tp(data: &RecordData<'_>) -> bool {
    let RecordData::Frame(frame) = data else { return false };
    let Some((first, rest)) = frame.bytes().split_first() else { return false };
    match first >> 4 {
        0 => (1..=7).contains(first) && usize::from(*first) <= rest.len(),
        1 => rest.len() == 7,
        2 => true,
        3 => *first <= 0x32,
        _ => false,
    }
}

/// Two bytes FFh, the length, and the inverted sum; or FFh FFh FDh 00h.
fn is_dynamixel(data: &RecordData<'_>) -> bool {
    match data {
        RecordData::Bytes([0xFF, 0xFF, 0xFD, 0, ..]) => true,
        RecordData::Bytes([0xFF, 0xFF, body @ .., sum]) if body.len() >= 3 => {
            let all = body.iter().fold(0_u8, |all, byte| all.wrapping_add(*byte));
            usize::from(body[1]) == body.len() - 1 && *sum == !all
        }
        _ => false,
    }
}

/// FFh, five bytes and their sum.
fn is_pelco(data: &RecordData<'_>) -> bool {
    match data {
        RecordData::Bytes([0xFF, body @ .., sum]) if body.len() == 5 => {
            body.iter().fold(0_u8, |all, byte| all.wrapping_add(*byte)) == *sum
        }
        _ => false,
    }
}

/// 02h, the length, and 03h at the end.
fn is_vesc(data: &RecordData<'_>) -> bool {
    match data {
        RecordData::Bytes([2, len, rest @ .., 3]) => usize::from(*len) + 2 == rest.len(),
        _ => false,
    }
}

/// Printable characters with an end of line, as Roboteq, Copley and modems have them.
fn is_text(data: &RecordData<'_>) -> bool {
    let RecordData::Bytes(bytes) = data else { return false };
    let is_printable = |c: &u8| matches!(c, b' '..=b'~' | b'\r' | b'\n' | b'\t');
    bytes.len() > 1 && bytes[0] != b':' && bytes.iter().all(is_printable)
}
