//! Modbus TCP: a header of seven bytes (MBAP) in place of address and check sum.
//!
//! Source: MODBUS Messaging on TCP/IP Implementation Guide V1.0b (here "MTG") 3.1.3 and 4.2. TCP keeps the bytes whole
//! and in order, so a frame ends by its length, and an answer repeats the transaction of its request.

use super::wire::{self, AnnouncedLength, PDU_MAX};
use crate::convert::tail;
use crate::error::WireError;

/// Port of the service.
pub const PORT: u16 = 502;
/// Bytes of the header: transaction, protocol, length, unit.
pub const HEADER_LEN: usize = 7;
/// Longest frame, bytes.
pub const ADU_MAX: usize = HEADER_LEN + PDU_MAX;
/// Shortest frame, bytes: a function code alone.
pub const ADU_MIN: usize = HEADER_LEN + 1;
/// Unit of a device without a gateway before it (MTG 4.4.1.2).
pub const DEVICE_UNIT: u8 = 255;
/// Bytes before those that the length counts.
const COUNTED_FROM: usize = 6;

/// Header of a frame, as far as it differs from frame to frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Header {
    /// Number of the request, which its answer repeats.
    pub transaction: u16,
    /// Station behind a gateway, or [`DEVICE_UNIT`].
    pub unit: u8,
}

/// Writes header and PDU, which `pdu` emits, and returns the length.
///
/// `out` must hold [`ADU_MAX`] bytes, or the emitted frame.
pub fn emit(header: Header, out: &mut [u8], pdu: impl FnOnce(&mut [u8]) -> usize) -> usize {
    let len = pdu(&mut out[HEADER_LEN..]);
    out[..2].copy_from_slice(&header.transaction.to_be_bytes());
    out[2..4].fill(0);
    out[4..COUNTED_FROM].copy_from_slice(&(len as u16 + 1).to_be_bytes());
    out[COUNTED_FROM] = header.unit;
    HEADER_LEN + len
}

/// Header and PDU of one whole frame.
///
/// # Errors
/// [`WireError::Short`], [`WireError::Long`]; [`WireError::Unexpected`] for another protocol than 0,
/// [`WireError::Count`] for a length that no frame has.
pub fn decode(adu: &[u8]) -> Result<(Header, &[u8]), WireError> {
    let found = adu.len() as u16;
    if adu.len() < ADU_MIN {
        return Err(WireError::Short { need: ADU_MIN as u16, found });
    }
    if let Some(at) = (2..4).find(|&at| adu[at] != 0) {
        return Err(WireError::Unexpected { at: at as u16, found: adu[at] });
    }
    let len = COUNTED_FROM + usize::from(wire::word(adu, 4));
    if !(ADU_MIN..=ADU_MAX).contains(&len) {
        return Err(WireError::Count { at: 4, found: wire::word(adu, 4) });
    }
    match adu.len() {
        given if given < len => Err(WireError::Short { need: len as u16, found }),
        given if given > len => Err(WireError::Long { need: len as u16, found }),
        _ => {
            let header = Header { transaction: wire::word(adu, 0), unit: adu[COUNTED_FROM] };
            Ok((header, &adu[HEADER_LEN..]))
        }
    }
}

/// Length of the frame that begins with `head`, by its header alone.
#[must_use]
pub fn span(head: &[u8]) -> AnnouncedLength {
    if head.iter().skip(2).take(2).any(|&byte| byte != 0) {
        return AnnouncedLength::Never;
    }
    let Some([high, low]) = head.get(4..COUNTED_FROM) else { return AnnouncedLength::More };
    match COUNTED_FROM + usize::from(u16::from_be_bytes([*high, *low])) {
        len @ ADU_MIN..=ADU_MAX => AnnouncedLength::Bytes(len),
        _ => AnnouncedLength::Never,
    }
}

/// Length of the request that begins with `head`, where the length of its function agrees.
#[must_use]
pub fn request_span(head: &[u8]) -> AnnouncedLength {
    agreed_span(head, wire::request_span)
}

/// Length of the reply that begins with `head`, where the length of its function agrees.
#[must_use]
pub fn reply_span(head: &[u8]) -> AnnouncedLength {
    agreed_span(head, wire::reply_span)
}

/// A length that two fields state, as there is no check sum.
fn agreed_span(head: &[u8], of_pdu: fn(&[u8]) -> AnnouncedLength) -> AnnouncedLength {
    let AnnouncedLength::Bytes(len) = span(head) else { return span(head) };
    match of_pdu(tail(head, HEADER_LEN)) {
        AnnouncedLength::Bytes(pdu) if HEADER_LEN + pdu != len => AnnouncedLength::Never,
        AnnouncedLength::Never => AnnouncedLength::Never,
        _ => AnnouncedLength::Bytes(len),
    }
}
