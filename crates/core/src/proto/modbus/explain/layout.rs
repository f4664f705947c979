//! The places of fields in a frame.

use crate::error::WireError;
use crate::explain::{ExplainSink, Field, FieldValue, NumberPlace};
use crate::proto::modbus::tcp;
use crate::proto::modbus::wire::WireFormat;

/// Layout of the bytes of a frame on the wire.
#[derive(Clone, Copy)]
pub(super) struct FrameLayout {
    pub format: WireFormat,
    /// Bytes of the check.
    pub check_len: usize,
}

impl FrameLayout {
    fn offset_of(self, byte: usize) -> u16 {
        match self.format {
            WireFormat::Rtu => byte as u16,
            WireFormat::Ascii => (1 + 2 * byte) as u16,
            // The unit is the last byte of the header.
            WireFormat::Tcp => (tcp::HEADER_LEN - 1 + byte) as u16,
        }
    }

    pub(super) fn emit_field(
        self,
        sink: &mut dyn ExplainSink,
        name: &'static str,
        bytes: core::ops::Range<usize>,
        value: FieldValue<'_>,
        meaning: &'static str,
    ) {
        let (start, end) = (self.offset_of(bytes.start), self.offset_of(bytes.end));
        sink.field(Field { name, start, end, value, meaning });
    }

    /// The check sum after `len` bytes of the frame.
    pub(super) fn emit_check(
        self,
        len: usize,
        check: &[u8],
        error: Option<WireError>,
        sink: &mut dyn ExplainSink,
    ) {
        let name = match self.format {
            WireFormat::Rtu => "crc",
            WireFormat::Ascii => "lrc",
            WireFormat::Tcp => return,
        };
        let found = check.iter().fold(0, |found, &byte| found << 8 | u64::from(byte));
        let wrong = matches!(error, Some(WireError::Checksum { .. }));
        let value = FieldValue::Hex(found, 2 * check.len() as u8);
        let (start, end) = (self.offset_of(len), self.offset_of(len + check.len()));
        let meaning = if wrong { "wrong" } else { "" };
        let field = Field { name, start, end, value, meaning };
        match (self.number_origin(), u8::try_from(len)) {
            (Some(_), Ok(at)) => {
                sink.number_field(field, NumberPlace::unsigned(at, check.len() as u8));
            }
            _ => sink.field(field),
        }
    }

    /// First byte of the registers in the reply to a read; `None` where they are not bytes of the frame, or no reply to
    /// another request has the same bytes.
    pub(super) fn number_origin(self) -> Option<usize> {
        (self.format == WireFormat::Rtu).then_some(3)
    }
}
