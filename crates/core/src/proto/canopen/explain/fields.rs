//! The fields of frames, byte by byte.

use super::say;
use crate::explain::{Field, Sink, Value};
use crate::medium::Frame;
use crate::profile::Profile;
use crate::proto::canopen::cia402::{CONTROLWORD, STATUSWORD};
use crate::proto::canopen::cob::Cob;
use crate::proto::canopen::lss;
use crate::proto::canopen::nmt::State;
use crate::proto::canopen::pdo::{Entry, Map};
use crate::proto::canopen::sdo::{Object, Reply, Request, Segment, Short};
use crate::proto::canopen::text::Said;

/// Where fields go, and what is known of their frame.
pub(super) struct Fields<'a> {
    pub frame: &'a Frame,
    pub profile: Option<&'static Profile>,
    pub sink: &'a mut dyn Sink,
}

impl Fields<'_> {
    fn put(&mut self, name: &'static str, range: (u16, u16), value: Value<'_>, is: &'static str) {
        let (start, end) = range;
        let end = end.min(self.frame.len.into());
        self.sink.field(Field { name, start: start.min(end), end, value, meaning: is });
    }

    fn int(&mut self, name: &'static str, range: (u16, u16), value: impl Into<i64>) {
        self.put(name, range, Value::Int(value.into()), "");
    }

    /// The bytes from `start` to `end` as one number in the order in which they stand.
    fn bytes(&mut self, name: &'static str, start: u16, end: u16) {
        let end = end.min(self.frame.len.into());
        let bytes = self.frame.data.get(start.into()..end.into()).unwrap_or_default();
        let number = bytes.iter().fold(0, |number, byte| number << 8 | u64::from(*byte));
        self.put(name, (start, end), Value::Hex(number, 2 * bytes.len() as u8), "");
    }

    /// All fields of what the frame says.
    pub(super) fn of(&mut self, said: &Said) {
        let first = self.frame.data[0];
        match *said {
            Said::Order(command, _) => {
                self.put("command", (0, 1), Value::Int(first.into()), command.name());
                let node = self.frame.data[1];
                let meaning = if node == 0 { "all nodes" } else { "" };
                self.put("node", (1, 2), Value::Int(node.into()), meaning);
            }
            Said::Sync(sync) => {
                sync.counter.into_iter().for_each(|counter| self.int("counter", (0, 1), counter));
            }
            Said::Time(time) => {
                self.int("ms", (0, 4), time.ms);
                self.put("days", (4, 6), Value::Int(time.days.into()), "since 1984-01-01");
            }
            Said::Emergency(emergency, short) => {
                let meaning = say::fault(emergency.code, self.profile);
                self.put("code", (0, 2), Value::Hex(emergency.code.into(), 4), meaning);
                if !short {
                    self.put("register", (2, 3), Value::Hex(emergency.register.into(), 2), "");
                    self.bytes("vendor", 3, 8);
                }
            }
            Said::State(heartbeat) => {
                let state = i64::from(u8::from(heartbeat.state));
                self.put("state", (0, 1), Value::Int(state), heartbeat.state.name());
                if heartbeat.toggle || heartbeat.state == State::BootUp {
                    self.int("toggle", (0, 1), heartbeat.toggle);
                }
            }
            Said::Process { len, .. } => self.process(len),
            Said::Request(request, _) => self.request(request),
            Said::Reply(reply, _) => self.reply(reply),
            Said::Part(part, _) => {
                self.int("segment", (0, 1), part.number);
                self.int("last", (0, 1), part.last);
                self.bytes("data", 1, 8);
            }
            Said::Lss(request) => self.lss(request),
            Said::LssReply(reply) => self.lss_reply(reply),
            _ => {}
        }
    }

    fn process(&mut self, len: u8) {
        self.bytes("data", 0, len.into());
        let Some(map) = usual_mapping(Cob::of(self.frame.id as u16), len) else { return };
        let data = u64::from_le_bytes(self.frame.data);
        for (entry, field) in map.fields() {
            let (name, start) = (say::name(entry.object, self.profile), u16::from(field.at));
            let range = (start / 8, (start + u16::from(field.bits)) / 8);
            let bits = field.unsigned(data);
            match entry.object {
                CONTROLWORD | STATUSWORD => self.put(name, range, Value::Hex(bits, 4), ""),
                object if say::signed(object, self.profile) => {
                    self.int(name, range, field.signed(data));
                }
                _ => self.int(name, range, bits.cast_signed()),
            }
        }
    }

    fn head(&mut self, meaning: &'static str) {
        self.put("command", (0, 1), Value::Hex(self.frame.data[0].into(), 2), meaning);
    }

    fn object(&mut self, object: Object) {
        let name = say::name(object, self.profile);
        self.put("index", (1, 3), Value::Hex(object.index.into(), 4), name);
        self.int("sub", (3, 4), object.sub);
    }

    fn short(&mut self, object: Object, short: Short) {
        let (_, len) = short.bytes();
        self.int("size", (0, 1), short.len);
        let number = say::number(object, short.bits, short.len, self.profile);
        let beyond = short.len > 0 && len < 4 && short.bits >> (8 * len) != 0;
        let end = if beyond { 8 } else { 4 + len as u16 };
        self.int("value", (4, end), number);
    }

    fn size(&mut self, size: Option<u32>) {
        size.into_iter().for_each(|size| self.int("size", (4, 8), size));
    }

    fn segment(&mut self, segment: Segment) {
        self.int("toggle", (0, 1), segment.toggle);
        self.int("last", (0, 1), segment.last);
        self.bytes("data", 1, 1 + u16::from(segment.len));
    }

    fn end(&mut self, unused: u8, crc: u16) {
        self.int("unused", (0, 1), unused);
        self.put("crc", (1, 3), Value::Hex(crc.into(), 4), "");
    }

    fn ack(&mut self, arrived: u8, segments: u8) {
        self.int("arrived", (1, 2), arrived);
        self.int("segments", (2, 3), segments);
    }

    fn abort(&mut self, abort: crate::proto::canopen::sdo::Abort) {
        self.put("abort", (4, 8), Value::Hex(abort.0.into(), 8), say::abort(abort));
    }

    fn request(&mut self, request: Request) {
        self.head(super::request_kind(request));
        request.object().into_iter().for_each(|object| self.object(object));
        match request {
            Request::Write(object, short) => self.short(object, short),
            Request::WriteLong(_, size) => self.size(size),
            Request::WriteSegment(segment) => self.segment(segment),
            Request::ReadSegment(toggle) => self.int("toggle", (0, 1), toggle),
            Request::WriteBlock { crc, size, .. } => {
                self.int("crc", (0, 1), crc);
                self.size(size);
            }
            Request::WriteBlockEnd { unused, crc } => self.end(unused, crc),
            Request::ReadBlock { crc, segments, threshold, .. } => {
                self.int("crc", (0, 1), crc);
                self.int("segments", (4, 5), segments);
                self.int("threshold", (5, 6), threshold);
            }
            Request::ReadBlockAck { arrived, segments } => self.ack(arrived, segments),
            Request::Abort(_, abort) => self.abort(abort),
            Request::Read(_)
            | Request::ReadBlockStart
            | Request::ReadBlockEnd
            | Request::Other(_) => {}
        }
    }

    fn reply(&mut self, reply: Reply) {
        self.head(super::reply_kind(reply));
        reply.object().into_iter().for_each(|object| self.object(object));
        match reply {
            Reply::Written(_, 0) => {}
            Reply::Written(_, echo) => self.int("echo", (4, 8), echo),
            Reply::WrittenSegment(toggle) => self.int("toggle", (0, 1), toggle),
            Reply::Value(object, short) => self.short(object, short),
            Reply::ValueLong(_, size) => self.size(size),
            Reply::ValueSegment(segment) => self.segment(segment),
            Reply::WriteBlockReady { crc, segments, .. } => {
                self.int("crc", (0, 1), crc);
                self.int("segments", (4, 5), segments);
            }
            Reply::WriteBlockAck { arrived, segments } => self.ack(arrived, segments),
            Reply::ReadBlockReady { crc, size, .. } => {
                self.int("crc", (0, 1), crc);
                self.size(size);
            }
            Reply::ReadBlockEnd { unused, crc } => self.end(unused, crc),
            Reply::Abort(_, abort) => self.abort(abort),
            Reply::WriteBlockDone | Reply::Other(_) => {}
        }
    }

    fn lss(&mut self, request: lss::Request) {
        use lss::Request;
        self.head(super::lss_kind(request));
        match request {
            Request::SwitchGlobal(on) => self.int("mode", (1, 2), on),
            Request::SwitchSelective(_, value) | Request::Identify(_, value) => {
                self.put("number", (1, 5), Value::Hex(value.into(), 8), "");
            }
            Request::SetNode(node) => self.int("node", (1, 2), node),
            Request::SetBitTiming(table, index) => {
                self.int("table", (1, 2), table);
                self.int("index", (2, 3), index);
            }
            Request::ActivateBitTiming(ms) => self.int("delay_ms", (1, 3), ms),
            Request::FastScan { number, bit, sub, next } => {
                self.put("number", (1, 5), Value::Hex(number.into(), 8), "");
                self.int("bit", (5, 6), bit);
                self.int("sub", (6, 7), sub as u8);
                self.int("next", (7, 8), next as u8);
            }
            _ => {}
        }
    }

    fn lss_reply(&mut self, reply: lss::Reply) {
        use lss::Reply;
        self.head(super::lss_reply_kind(reply));
        match reply {
            Reply::SetNode(error, own)
            | Reply::SetBitTiming(error, own)
            | Reply::Store(error, own) => {
                let meaning = if error == 0 { "done" } else { "refused" };
                self.put("error", (1, 2), Value::Int(error.into()), meaning);
                self.int("own", (2, 3), own);
            }
            Reply::Number(_, value) => {
                self.put("number", (1, 5), Value::Hex(value.into(), 8), "");
            }
            Reply::Node(node) => self.int("node", (1, 2), node),
            _ => {}
        }
    }
}

/// The mapping that CiA 402 gives a PDO of that length from the factory; what a drive's is now
/// stands in its objects.
#[must_use]
pub fn usual_mapping(cob: Cob, len: u8) -> Option<Map> {
    let (word, second) = match cob {
        Cob::Rpdo(number, _) => (CONTROLWORD, [0, 0x6060, 0x607A, 0x60FF].get(number as usize - 1)),
        Cob::Tpdo(number, _) => (STATUSWORD, [0, 0x6061, 0x6064, 0x606C].get(number as usize - 1)),
        _ => return None,
    };
    let word = Entry { object: word, bits: 16 };
    let map = match *second? {
        0 => Map::new([word]),
        index => {
            let bits = if index < 0x6062 { 8 } else { 32 };
            Map::new([word, Entry { object: Object::new(index, 0), bits }])
        }
    };
    map.ok().filter(|map| map.bytes() == len)
}
