//! Fields of frames, byte by byte.

use super::meanings;
use crate::explain::{ExplainSink, Field, FieldValue};
use crate::medium::Frame;
use crate::profile::Profile;
use crate::proto::canopen::cia402::{CONTROLWORD, STATUSWORD};
use crate::proto::canopen::cob::Cob;
use crate::proto::canopen::lss;
use crate::proto::canopen::nmt::NmtState;
use crate::proto::canopen::pdo::{MappingEntry, PdoMapping};
use crate::proto::canopen::sdo::{ExpeditedData, ObjectIndex, SdoReply, SdoRequest, Segment};
use crate::proto::canopen::text::Statement;

/// Sink of the fields, and the context of their frame.
pub(super) struct FieldWriter<'a> {
    pub frame: &'a Frame,
    pub profile: Option<&'static Profile>,
    pub sink: &'a mut dyn ExplainSink,
}

impl FieldWriter<'_> {
    fn emit_field(
        &mut self,
        name: &'static str,
        range: (u16, u16),
        value: FieldValue<'_>,
        is: &'static str,
    ) {
        let (start, end) = range;
        let end = end.min(self.frame.len.into());
        self.sink.field(Field { name, start: start.min(end), end, value, meaning: is });
    }

    fn emit_int(&mut self, name: &'static str, range: (u16, u16), value: impl Into<i64>) {
        self.emit_field(name, range, FieldValue::Int(value.into()), "");
    }

    /// The bytes from `start` to `end` as one number, in their order.
    fn emit_bytes(&mut self, name: &'static str, start: u16, end: u16) {
        let end = end.min(self.frame.len.into());
        let bytes = self.frame.data.get(start.into()..end.into()).unwrap_or_default();
        let number = bytes.iter().fold(0, |number, byte| number << 8 | u64::from(*byte));
        self.emit_field(name, (start, end), FieldValue::Hex(number, 2 * bytes.len() as u8), "");
    }

    /// Emits all fields of the frame.
    pub(super) fn emit_message(&mut self, statement: &Statement) {
        let first = self.frame.data[0];
        match *statement {
            Statement::Order(command, _) => {
                self.emit_field("command", (0, 1), FieldValue::Int(first.into()), command.name());
                let node = self.frame.data[1];
                let meaning = if node == 0 { "all nodes" } else { "" };
                self.emit_field("node", (1, 2), FieldValue::Int(node.into()), meaning);
            }
            Statement::Sync(sync) => {
                sync.counter
                    .into_iter()
                    .for_each(|counter| self.emit_int("counter", (0, 1), counter));
            }
            Statement::Time(time) => {
                self.emit_int("ms", (0, 4), time.ms);
                self.emit_field(
                    "days",
                    (4, 6),
                    FieldValue::Int(time.days.into()),
                    "since 1984-01-01",
                );
            }
            Statement::Emergency(emergency, short) => {
                let meaning = meanings::fault_text(emergency.code, self.profile);
                self.emit_field("code", (0, 2), FieldValue::Hex(emergency.code.into(), 4), meaning);
                if !short {
                    self.emit_field(
                        "register",
                        (2, 3),
                        FieldValue::Hex(emergency.register.into(), 2),
                        "",
                    );
                    self.emit_bytes("vendor", 3, 8);
                }
            }
            Statement::State(heartbeat) => {
                let state = i64::from(u8::from(heartbeat.state));
                self.emit_field("state", (0, 1), FieldValue::Int(state), heartbeat.state.name());
                if heartbeat.toggle || heartbeat.state == NmtState::BootUp {
                    self.emit_int("toggle", (0, 1), heartbeat.toggle);
                }
            }
            Statement::Process { len, .. } => self.emit_process(len),
            Statement::Request(request, _) => self.emit_request(request),
            Statement::Reply(reply, _) => self.emit_reply(reply),
            Statement::BlockSegment(part, _) => {
                self.emit_int("segment", (0, 1), part.number);
                self.emit_int("last", (0, 1), part.last);
                self.emit_bytes("data", 1, 8);
            }
            Statement::Lss(request) => self.emit_lss_request(request),
            Statement::LssReply(reply) => self.emit_lss_reply(reply),
            _ => {}
        }
    }

    fn emit_process(&mut self, len: u8) {
        self.emit_bytes("data", 0, len.into());
        let Some(map) = default_mapping(Cob::of(self.frame.id as u16), len) else { return };
        let data = u64::from_le_bytes(self.frame.data);
        for (entry, field) in map.fields() {
            let (name, start) =
                (meanings::object_name(entry.object, self.profile), u16::from(field.start));
            let range = (start / 8, (start + u16::from(field.bits)) / 8);
            let bits = field.unsigned(data);
            match entry.object {
                CONTROLWORD | STATUSWORD => {
                    self.emit_field(name, range, FieldValue::Hex(bits, 4), "")
                }
                object if meanings::is_signed(object, self.profile) => {
                    self.emit_int(name, range, field.signed(data));
                }
                _ => self.emit_int(name, range, bits.cast_signed()),
            }
        }
    }

    fn emit_head(&mut self, meaning: &'static str) {
        self.emit_field("command", (0, 1), FieldValue::Hex(self.frame.data[0].into(), 2), meaning);
    }

    fn emit_object(&mut self, object: ObjectIndex) {
        let name = meanings::object_name(object, self.profile);
        self.emit_field("index", (1, 3), FieldValue::Hex(object.index.into(), 4), name);
        self.emit_int("sub", (3, 4), object.sub);
    }

    fn emit_expedited(&mut self, object: ObjectIndex, short: ExpeditedData) {
        let (_, len) = short.bytes();
        self.emit_int("size", (0, 1), short.len);
        let number = meanings::decode_number(object, short.bits, short.len, self.profile);
        let counted = meanings::value_len(object, short.bits, short.len, self.profile);
        let end = 4 + if short.len == 0 { len as u16 } else { counted.into() };
        let Some(place) = meanings::number_place(object, short, self.profile) else {
            return self.emit_int("value", (4, end), number);
        };
        let end = end.min(self.frame.len.into());
        let value = FieldValue::Int(number);
        let field = Field { name: "value", start: 4_u16.min(end), end, value, meaning: "" };
        self.sink.number_field(field, place);
    }

    fn emit_size(&mut self, size: Option<u32>) {
        size.into_iter().for_each(|size| self.emit_int("size", (4, 8), size));
    }

    fn emit_segment(&mut self, segment: Segment) {
        self.emit_int("toggle", (0, 1), segment.toggle);
        self.emit_int("last", (0, 1), segment.last);
        self.emit_bytes("data", 1, 1 + u16::from(segment.len));
    }

    fn emit_block_end(&mut self, unused: u8, crc: u16) {
        self.emit_int("unused", (0, 1), unused);
        self.emit_field("crc", (1, 3), FieldValue::Hex(crc.into(), 4), "");
    }

    fn emit_block_ack(&mut self, arrived: u8, segments: u8) {
        self.emit_int("arrived", (1, 2), arrived);
        self.emit_int("segments", (2, 3), segments);
    }

    fn emit_abort(&mut self, abort: crate::proto::canopen::sdo::AbortCode) {
        self.emit_field(
            "abort",
            (4, 8),
            FieldValue::Hex(abort.0.into(), 8),
            meanings::abort_text(abort),
        );
    }

    fn emit_request(&mut self, request: SdoRequest) {
        self.emit_head(super::kinds::request_kind(request));
        request.object().into_iter().for_each(|object| self.emit_object(object));
        match request {
            SdoRequest::Write(object, short) => self.emit_expedited(object, short),
            SdoRequest::WriteLong(_, size) => self.emit_size(size),
            SdoRequest::WriteSegment(segment) => self.emit_segment(segment),
            SdoRequest::ReadSegment(toggle) => self.emit_int("toggle", (0, 1), toggle),
            SdoRequest::WriteBlock { crc, size, .. } => {
                self.emit_int("crc", (0, 1), crc);
                self.emit_size(size);
            }
            SdoRequest::WriteBlockEnd { unused, crc } => self.emit_block_end(unused, crc),
            SdoRequest::ReadBlock { crc, segments, threshold, .. } => {
                self.emit_int("crc", (0, 1), crc);
                self.emit_int("segments", (4, 5), segments);
                self.emit_int("threshold", (5, 6), threshold);
            }
            SdoRequest::ReadBlockAck { arrived, segments } => {
                self.emit_block_ack(arrived, segments)
            }
            SdoRequest::Abort(_, abort) => self.emit_abort(abort),
            SdoRequest::Read(_)
            | SdoRequest::ReadBlockStart
            | SdoRequest::ReadBlockEnd
            | SdoRequest::Other(_) => {}
        }
    }

    fn emit_reply(&mut self, reply: SdoReply) {
        self.emit_head(super::kinds::reply_kind(reply));
        reply.object().into_iter().for_each(|object| self.emit_object(object));
        match reply {
            SdoReply::Written(_, 0) => {}
            SdoReply::Written(_, echo) => self.emit_int("echo", (4, 8), echo),
            SdoReply::WrittenSegment(toggle) => self.emit_int("toggle", (0, 1), toggle),
            SdoReply::Value(object, short) => self.emit_expedited(object, short),
            SdoReply::ValueLong(_, size) => self.emit_size(size),
            SdoReply::ValueSegment(segment) => self.emit_segment(segment),
            SdoReply::WriteBlockReady { crc, segments, .. } => {
                self.emit_int("crc", (0, 1), crc);
                self.emit_int("segments", (4, 5), segments);
            }
            SdoReply::WriteBlockAck { arrived, segments } => self.emit_block_ack(arrived, segments),
            SdoReply::ReadBlockReady { crc, size, .. } => {
                self.emit_int("crc", (0, 1), crc);
                self.emit_size(size);
            }
            SdoReply::ReadBlockEnd { unused, crc } => self.emit_block_end(unused, crc),
            SdoReply::Abort(_, abort) => self.emit_abort(abort),
            SdoReply::WriteBlockDone | SdoReply::Other(_) => {}
        }
    }

    fn emit_lss_request(&mut self, request: lss::LssRequest) {
        use lss::LssRequest;
        self.emit_head(super::kinds::lss_kind(request));
        match request {
            LssRequest::SwitchGlobal(on) => self.emit_int("mode", (1, 2), on),
            LssRequest::SwitchSelective(_, value) | LssRequest::Identify(_, value) => {
                self.emit_field("number", (1, 5), FieldValue::Hex(value.into(), 8), "");
            }
            LssRequest::SetNode(node) => self.emit_int("node", (1, 2), node),
            LssRequest::SetBitTiming(table, index) => {
                self.emit_int("table", (1, 2), table);
                self.emit_int("index", (2, 3), index);
            }
            LssRequest::ActivateBitTiming(ms) => self.emit_int("delay_ms", (1, 3), ms),
            LssRequest::FastScan { number, bit, sub, next } => {
                self.emit_field("number", (1, 5), FieldValue::Hex(number.into(), 8), "");
                self.emit_int("bit", (5, 6), bit);
                self.emit_int("sub", (6, 7), sub as u8);
                self.emit_int("next", (7, 8), next as u8);
            }
            _ => {}
        }
    }

    fn emit_lss_reply(&mut self, reply: lss::LssReply) {
        use lss::LssReply;
        self.emit_head(super::kinds::lss_reply_kind(reply));
        match reply {
            LssReply::SetNode(error, own)
            | LssReply::SetBitTiming(error, own)
            | LssReply::Store(error, own) => {
                let meaning = if error == 0 { "done" } else { "refused" };
                self.emit_field("error", (1, 2), FieldValue::Int(error.into()), meaning);
                self.emit_int("own", (2, 3), own);
            }
            LssReply::Number(_, value) => {
                self.emit_field("number", (1, 5), FieldValue::Hex(value.into(), 8), "");
            }
            LssReply::Node(node) => self.emit_int("node", (1, 2), node),
            _ => {}
        }
    }
}

/// The default mapping of CiA 402 for a PDO of that length; the present one is in the drive's objects.
#[must_use]
pub fn default_mapping(cob: Cob, len: u8) -> Option<PdoMapping> {
    let (word, second) = match cob {
        Cob::Rpdo(number, _) => (CONTROLWORD, [0, 0x6060, 0x607A, 0x60FF].get(number as usize - 1)),
        Cob::Tpdo(number, _) => (STATUSWORD, [0, 0x6061, 0x6064, 0x606C].get(number as usize - 1)),
        _ => return None,
    };
    let word = MappingEntry { object: word, bits: 16 };
    let map = match *second? {
        0 => PdoMapping::new([word]),
        index => {
            let bits = if index < 0x6062 { 8 } else { 32 };
            PdoMapping::new([word, MappingEntry { object: ObjectIndex::new(index, 0), bits }])
        }
    };
    map.ok().filter(|map| map.bytes() == len)
}
