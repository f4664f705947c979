//! Modbus RTU: station address, PDU, CRC-16 with the low byte first.
//!
//! Source: MODBUS over Serial Line V1.02 (here "MSL") 2.5.1; TS manual V2 §2.3. Frames are separated by the
//! length in their header and confirmed by the CRC, because silence between frames is lost in USB adapters,
//! pseudo-terminals and TCP. Drives that use silence do this at their own end (see `device`).

use super::wire::{self, AnnouncedLength, RequestPdu};
use crate::convert::tail;
use crate::error::WireError;
use crate::medium::SerialLine;

/// Longest frame, bytes: address, PDU, CRC.
pub const ADU_MAX: usize = 256;
/// Shortest frame, bytes: address, function code, CRC.
pub const ADU_MIN: usize = 4;

/// Bytes of a read or of a single write.
pub(super) const SHORT_FRAME_LEN: usize = 8;

/// CRC of one byte followed by 0 to 7 zero bytes: slicing by eight.
static CRC_TABLES: [[u16; 256]; 8] = crc_tables();

/// CRC-16/MODBUS: polynomial 8005 reflected, start FFFF.
#[must_use]
#[inline(always)]
pub fn crc16(bytes: &[u8]) -> u16 {
    let (eights, rest) = bytes.as_chunks::<8>();
    let mut crc = 0xFFFF;
    for eight in eights {
        let head = u16::from_le_bytes([eight[0], eight[1]]) ^ crc;
        crc = table_entry(7, head as u8)
            ^ table_entry(6, (head >> 8) as u8)
            ^ table_entry(5, eight[2])
            ^ table_entry(4, eight[3])
            ^ table_entry(3, eight[4])
            ^ table_entry(2, eight[5])
            ^ table_entry(1, eight[6])
            ^ table_entry(0, eight[7]);
    }
    crc_tail(crc, rest)
}

/// Writes address, PDU and CRC around a PDU that `pdu` emits, and returns the length.
///
/// `out` must hold [`ADU_MAX`] bytes, or the emitted frame.
#[inline(always)]
pub fn emit(unit: u8, out: &mut [u8], pdu: impl FnOnce(&mut [u8]) -> usize) -> usize {
    out[0] = unit;
    let end = 1 + pdu(&mut out[1..]);
    let crc = crc16(&out[..end]);
    out[end..end + 2].copy_from_slice(&crc.to_le_bytes());
    end + 2
}

/// Writes a request and returns its length, as [`emit`] does.
#[inline(always)]
pub fn emit_request(unit: u8, pdu: &RequestPdu<'_>, out: &mut [u8]) -> usize {
    match pdu.as_short() {
        Some(pdu) => {
            out[..SHORT_FRAME_LEN].copy_from_slice(&short_frame(unit, pdu));
            SHORT_FRAME_LEN
        }
        None => emit(unit, out, |out| pdu.emit(out)),
    }
}

/// A frame around a PDU of five bytes. It is put together in a register: bytes just written one by
/// one are slow to read again.
#[inline(always)]
pub(super) fn short_frame(unit: u8, pdu: (u8, u16, u16)) -> [u8; SHORT_FRAME_LEN] {
    let (code, first, second) = pdu;

    let head = u64::from(unit) | u64::from(code) << 8;
    let body = head | u64::from(first.swap_bytes()) << 16 | u64::from(second.swap_bytes()) << 32;
    let [a, b, c, d, e, f, _, _] = body.to_le_bytes();
    (body | u64::from(crc16(&[a, b, c, d, e, f])) << 48).to_le_bytes()
}

/// Returns whether the check sum of a frame is valid. The CRC over a frame with its own CRC is zero.
#[must_use]
#[inline]
pub fn crc_matches(adu: &[u8]) -> bool {
    adu.len() >= ADU_MIN && crc16(adu) == 0
}

/// Address and PDU of a frame whose check sum was verified before; `None` if it is too short or too long.
#[must_use]
pub fn verified_parts(adu: &[u8]) -> Option<(u8, &[u8])> {
    match adu {
        [unit, pdu @ .., _, _] if !pdu.is_empty() && adu.len() <= ADU_MAX => Some((*unit, pdu)),
        _ => None,
    }
}

/// Address and PDU of one whole frame.
///
/// # Errors
/// [`WireError::Short`], [`WireError::Long`] or [`WireError::Checksum`]; a CRC is printed in the
/// order of the wire.
#[inline]
pub fn decode(adu: &[u8]) -> Result<(u8, &[u8]), WireError> {
    match adu {
        [unit, pdu @ .., _, _] if !pdu.is_empty() && adu.len() <= ADU_MAX && crc16(adu) == 0 => {
            Ok((*unit, pdu))
        }
        _ => Err(check_error(adu)),
    }
}

#[cold]
fn check_error(adu: &[u8]) -> WireError {
    let found = adu.len() as u16;
    if adu.len() < ADU_MIN {
        return WireError::Short { need: ADU_MIN as u16, found };
    }
    if adu.len() > ADU_MAX {
        return WireError::Long { need: ADU_MAX as u16, found };
    }
    let (body, check) = adu.split_at(adu.len() - 2);
    let computed = u32::from(crc16(body).swap_bytes());
    WireError::Checksum { computed, found: u32::from(wire::word(check, 0)) }
}

/// Length of the request frame that begins with `head`.
#[must_use]
pub fn request_span(head: &[u8]) -> AnnouncedLength {
    frame_span(head, wire::request_span)
}

/// Length of the reply frame that begins with `head`.
#[must_use]
pub fn reply_span(head: &[u8]) -> AnnouncedLength {
    frame_span(head, wire::reply_span)
}

/// Silence between frames by the standard (MSL 2.5.1.1): 3.5 characters, fixed at 1.75 ms above
/// 19200 baud; 0 on a wire without timing. In ns.
#[must_use]
pub const fn silence_ns(line: &SerialLine) -> u64 {
    match line.baud {
        0 => 0,
        1..=19_200 => character_silence_ns(line),
        _ => 1_750_000,
    }
}

/// 3.5 characters at any baud rate, for fast lines. In ns.
#[must_use]
pub const fn character_silence_ns(line: &SerialLine) -> u64 {
    line.characters_ns(7) / 2
}

fn frame_span(head: &[u8], span: fn(&[u8]) -> AnnouncedLength) -> AnnouncedLength {
    match span(tail(head, 1)) {
        AnnouncedLength::Bytes(pdu) if pdu > wire::PDU_MAX => AnnouncedLength::Never,
        AnnouncedLength::Bytes(pdu) => AnnouncedLength::Bytes(pdu + 3),
        other => other,
    }
}

#[inline(always)]
fn table_entry(zeros: usize, byte: u8) -> u16 {
    CRC_TABLES[zeros][usize::from(byte)]
}

/// The last up to seven bytes: those of a short request or answer at once, others in steps of four,
/// two and one.
#[inline(always)]
fn crc_tail(mut crc: u16, mut rest: &[u8]) -> u16 {
    match *rest {
        [a, b, c, d, e, f] => {
            let head = u16::from_le_bytes([a, b]) ^ crc;
            let tail =
                table_entry(3, c) ^ table_entry(2, d) ^ table_entry(1, e) ^ table_entry(0, f);
            return table_entry(5, head as u8) ^ table_entry(4, (head >> 8) as u8) ^ tail;
        }
        [a, b, c, d, e, f, g] => {
            let head = u16::from_le_bytes([a, b]) ^ crc;
            let tail = table_entry(4, c)
                ^ table_entry(3, d)
                ^ table_entry(2, e)
                ^ table_entry(1, f)
                ^ table_entry(0, g);
            return table_entry(6, head as u8) ^ table_entry(5, (head >> 8) as u8) ^ tail;
        }
        _ => {}
    }
    if let Some((&[a, b, c, d], after)) = rest.split_first_chunk::<4>() {
        let head = u16::from_le_bytes([a, b]) ^ crc;
        crc = table_entry(3, head as u8)
            ^ table_entry(2, (head >> 8) as u8)
            ^ table_entry(1, c)
            ^ table_entry(0, d);
        rest = after;
    }
    if let Some((&pair, after)) = rest.split_first_chunk::<2>() {
        let head = u16::from_le_bytes(pair) ^ crc;
        crc = table_entry(1, head as u8) ^ table_entry(0, (head >> 8) as u8);
        rest = after;
    }
    match rest {
        [byte, ..] => (crc >> 8) ^ table_entry(0, crc as u8 ^ byte),
        [] => crc,
    }
}

const fn crc_tables() -> [[u16; 256]; 8] {
    let mut tables = [[0; 256]; 8];
    let mut byte = 0;
    while byte < 256 {
        let mut crc = byte as u16;
        let mut bit = 0;
        while bit < 8 {
            crc = if crc & 1 == 1 { (crc >> 1) ^ 0xA001 } else { crc >> 1 };
            bit += 1;
        }
        tables[0][byte] = crc;
        byte += 1;
    }
    let mut zeros = 1;
    while zeros < 8 {
        let mut byte = 0;
        while byte < 256 {
            let before = tables[zeros - 1][byte];
            tables[zeros][byte] = (before >> 8) ^ tables[0][(before & 0xFF) as usize];
            byte += 1;
        }
        zeros += 1;
    }
    tables
}
