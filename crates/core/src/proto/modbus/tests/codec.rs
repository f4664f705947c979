//! Vectors, sweeps, mutations and garbage.

extern crate std;

use std::format;
use std::string::{String, ToString};
use std::vec;
use std::vec::Vec;

use super::world::{RegisterDrive, TestWorld, UNTIMED};
use crate::error::WireError;
use crate::explain::{
    Context, Direction, Dissector, EncodeError, EncodeOptions, ExplainSink, Field, FieldValue,
    FrameBoundary, FrameFormat,
};
use crate::profile::Encoding;
use crate::proto::modbus::device::{Framing, SerialEndpoint};
use crate::proto::modbus::host_request::{HostRequest, RequestBody};
use crate::proto::modbus::wire::{
    AnnouncedLength, Exception, ReplyPdu, RequestPdu, Space, WireFormat,
};
use crate::proto::modbus::{
    ASCII, ModbusDissector, RTU, SerialHost, TCP, ascii, encoding, rtu, tcp,
};
use crate::station::{Host as _, RequestClass, Station, Ticket, Timed};
use crate::time::Instant;

const VECTORS: &str = include_str!("../../../../../../vectors/modbus.json");

/// Calls that a sink received.
#[derive(Default, Debug)]
pub struct RecordingSink {
    pub kind: String,
    pub axis: Option<u32>,
    pub fields: Vec<(&'static str, String)>,
    pub text: String,
    pub error: Option<String>,
}

impl ExplainSink for RecordingSink {
    fn kind(&mut self, kind: &str) {
        self.kind = kind.to_string();
    }
    fn axis(&mut self, axis: u32) {
        self.axis = Some(axis);
    }
    fn field(&mut self, field: Field<'_>) {
        assert!(field.start < field.end, "{field:?}");
        let value = match field.value {
            FieldValue::Int(n) => format!("{n}"),
            FieldValue::Hex(n, _) => format!("{n:X}"),
            other => format!("{other:?}"),
        };
        self.fields.push((field.name, value));
    }
    fn text(&mut self, piece: &str) {
        self.text.push_str(piece);
    }
    fn error(&mut self, error: WireError) {
        self.error = Some(error.to_string());
    }
}

fn explain_frame(dissector: ModbusDissector, bytes: &[u8], context: &Context<'_>) -> RecordingSink {
    let mut sink = RecordingSink::default();
    dissector.explain(bytes, context, &mut sink);
    sink
}

struct Vector {
    name: String,
    dissector: ModbusDissector,
    direction: Direction,
    verdict: String,
    bytes: Vec<u8>,
    text: Option<String>,
    says: Option<String>,
    request: Option<Vec<u8>>,
}

fn bytes_of(text: &str) -> Vec<u8> {
    text.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
}

fn vectors() -> Vec<Vector> {
    let list: Vec<serde_json::Value> = serde_json::from_str(VECTORS).unwrap();
    let read = |v: &serde_json::Value| Vector {
        name: v["name"].as_str().unwrap().to_string(),
        dissector: match v["kind"].as_str() {
            Some("modbus-rtu") => RTU,
            Some("modbus-tcp") => TCP,
            _ => ASCII,
        },
        direction: match v["direction"].as_str() {
            Some("host->drive") => Direction::ToDrive,
            _ => Direction::ToHost,
        },
        verdict: v["verdict"].as_str().unwrap().to_string(),
        bytes: bytes_of(v["bytes"].as_str().unwrap()),
        text: v["encode"].as_str().map(str::to_string),
        says: v["explain"].as_str().map(str::to_string),
        request: v["request"].as_str().map(bytes_of),
    };
    list.iter().map(read).collect()
}

/// Decodes a frame by the wire types and emits it again.
fn reencode(vector: &Vector) -> Vec<u8> {
    let mut store = [0; 256];
    let (unit, pdu) = match vector.dissector.0 {
        WireFormat::Rtu => rtu::decode(&vector.bytes).unwrap(),
        WireFormat::Ascii => {
            let mut collector = ascii::AsciiDeframer::default();
            for &character in &vector.bytes {
                collector.feed(character);
            }
            let len = collector.bytes().len();
            store[..len].copy_from_slice(collector.bytes());
            ascii::decode(&store[..len]).unwrap()
        }
        WireFormat::Tcp => {
            let (header, pdu) = tcp::decode(&vector.bytes).unwrap();
            assert_eq!(tcp::span(&vector.bytes), AnnouncedLength::Bytes(vector.bytes.len()));
            (header.unit, pdu)
        }
    };
    let mut out = [0; 520];
    let put = |out: &mut [u8]| match vector.direction {
        Direction::ToDrive => RequestPdu::parse(pdu).unwrap().emit(out),
        Direction::ToHost => ReplyPdu::parse(pdu).unwrap().emit(out),
    };
    let len = match vector.dissector.0 {
        WireFormat::Rtu => rtu::emit(unit, &mut out, put),
        WireFormat::Ascii => ascii::emit(unit, &mut out, put),
        WireFormat::Tcp => {
            // Its own transaction: nothing else has one.
            let transaction = u16::from_be_bytes([vector.bytes[0], vector.bytes[1]]);
            tcp::emit(tcp::Header { transaction, unit }, &mut out, put)
        }
    };
    out[..len].to_vec()
}

#[test]
fn every_vector_encodes_and_decodes_exactly() {
    let list = vectors();
    assert!(list.len() >= 39);
    for vector in &list {
        let name = &vector.name;
        let cut = vector.dissector.find_frame(&vector.bytes, Some(vector.direction), true);
        let context = Context {
            direction: Some(vector.direction),
            request: vector.request.as_deref(),
            ..Context::default()
        };
        let sink = explain_frame(vector.dissector, &vector.bytes, &context);
        match vector.verdict.as_str() {
            "ok" => {
                assert_eq!(cut, FrameBoundary::Frame(vector.bytes.len()), "{name}");
                assert_eq!(reencode(vector), vector.bytes, "{name}");
                assert_eq!(sink.error, None, "{name}");
            }
            "accept" => assert!(!matches!(cut, FrameBoundary::Corrupt(_)), "{name}: {cut:?}"),
            _ => {
                assert!(!matches!(cut, FrameBoundary::Frame(_)), "{name}: {cut:?}");
                assert!(sink.error.is_some(), "{name}");
            }
        }
        if let Some(says) = &vector.says {
            assert_eq!(&sink.text, says, "{name}");
        }
        if let Some(text) = &vector.text {
            let mut out = [0; 520];
            let addressing = EncodeOptions { axis: sink.axis, ..EncodeOptions::default() };
            let encoded = vector.dissector.encode(text, &addressing, &mut out).unwrap();
            assert_eq!(out[..encoded.len], vector.bytes, "{name}: {text}");
        }
    }
}

/// A small generator: the same numbers from the same seed.
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let x = self.0;
        (x ^ x >> 29).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 16
    }
    pub fn below(&mut self, max: u64) -> u64 {
        self.next() % max
    }
}

fn request<'a>(random: &mut Random, data: &'a [u8]) -> RequestPdu<'a> {
    let start = random.next() as u16;
    let spaces = [Space::Holding, Space::Coil, Space::Discrete, Space::Input];
    match random.below(9) {
        8 => RequestPdu::ReadWriteRegisters {
            read_start: random.next() as u16,
            read_count: 1 + random.below(125) as u16,
            start,
            words: &data[..2 + 2 * random.below(121) as usize],
        },
        n @ 0..4 => {
            let space = spaces[n as usize];
            let count = 1 + random.below(space.read_max().into()) as u16;
            RequestPdu::Read { space, start, count }
        }
        4 => RequestPdu::WriteCoil { address: start, on: random.below(2) == 1 },
        5 => RequestPdu::WriteRegister { address: start, value: random.next() as u16 },
        6 => {
            let count = 1 + random.below(1968) as u16;
            let bits = &data[..usize::from(count).div_ceil(8)];
            RequestPdu::WriteCoils { start, count, bits }
        }
        _ => {
            RequestPdu::WriteRegisters { start, words: &data[..2 + 2 * random.below(123) as usize] }
        }
    }
}

fn reply<'a>(random: &mut Random, data: &'a [u8]) -> ReplyPdu<'a> {
    let start = random.next() as u16;
    let count = random.next() as u16;
    match random.below(8) {
        7 => ReplyPdu::ReadWritten { data: &data[..2 + 2 * random.below(125) as usize] },
        0 => ReplyPdu::Read {
            space: Space::Holding,
            data: &data[..2 + 2 * random.below(125) as usize],
        },
        1 => ReplyPdu::Read { space: Space::Coil, data: &data[..1 + random.below(250) as usize] },
        2 => ReplyPdu::WroteCoil { address: start, on: random.below(2) == 1 },
        3 => ReplyPdu::WroteRegister { address: start, value: count },
        4 => ReplyPdu::Wrote { coils: random.below(2) == 1, start, count },
        5 => ReplyPdu::Read { space: Space::Input, data: &data[..2] },
        _ => {
            let exception = Exception::of_code(random.next() as u8);
            ReplyPdu::Exception { function: random.next() as u8 & 0x7F, exception }
        }
    }
}

#[test]
fn an_emitted_frame_parses_to_the_same_message() {
    let mut random = Random(1);
    let mut out = [0; 260];
    for _ in 0..20_000 {
        let data: Vec<u8> = (0..252).map(|_| random.next() as u8).collect();
        let request_pdu = request(&mut random, &data);
        let len = request_pdu.emit(&mut out);
        assert_eq!(RequestPdu::parse(&out[..len]), Ok(request_pdu));
        let reply_pdu = reply(&mut random, &data);
        let len = reply_pdu.emit(&mut out);
        assert_eq!(ReplyPdu::parse(&out[..len]), Ok(reply_pdu));
        let len = rtu::emit(7, &mut out, |out| request_pdu.emit(out));
        assert_eq!(
            RTU.find_frame(&out[..len], Some(Direction::ToDrive), false),
            FrameBoundary::Frame(len)
        );
        assert_eq!(
            RTU.find_frame(&out[..len - 1], Some(Direction::ToDrive), false),
            FrameBoundary::Incomplete
        );
    }
}

#[test]
fn codes_and_encodings_are_total() {
    for code in 0..=255 {
        assert_eq!(Exception::of_code(code).code(), code);
        assert_eq!(crate::proto::modbus::wire::Function::of_code(code).code(), code);
    }
    for raw in [-327_680_000, -200_001, -9_999, -1, 0, 1, 32_767, 123_456_789] {
        for encoding in [Encoding::I32, Encoding::I32LowFirst, Encoding::TensAndThousandths] {
            let pair = encoding::encode(encoding, raw).unwrap();
            assert_eq!(encoding::decode(encoding, pair), raw, "{encoding:?}");
        }
    }
    // TS manual V2 §2.3: F32D, 000B is 000BF32D.
    assert_eq!(encoding::decode(Encoding::I32LowFirst, [0xF32D, 0x000B, 0, 0]), 0x000B_F32D);
    assert_eq!(encoding::encode(Encoding::I16, 40_000), None);
}

fn device(format: WireFormat) -> (SerialEndpoint, RegisterDrive) {
    (SerialEndpoint::new(Framing::Length), RegisterDrive::new(1, format, 0))
}

fn drain(end: &mut SerialEndpoint, drive: &mut RegisterDrive, now: Instant) -> Vec<Vec<u8>> {
    let mut replies = vec![];
    let mut out = [0; 520];
    for _ in 0..1000 {
        match end.poll_transmit(now, &mut out) {
            Some(len) => replies.push(out[..len].to_vec()),
            None if end.poll_timeout().is_some_and(|at| at <= now) => {
                end.handle_timeout(now, drive);
            }
            None => return replies,
        }
    }
    panic!("it never stops");
}

#[test]
fn every_split_gives_the_same_and_no_damage_is_executed() {
    for vector in vectors() {
        if vector.verdict != "ok" || vector.direction != Direction::ToDrive {
            continue;
        }
        let format = vector.dissector.0;
        let bytes = &vector.bytes;
        let (mut end, mut drive) = device(format);
        end.handle_input(Instant(1), bytes, &mut drive);
        let whole = drain(&mut end, &mut drive, Instant(1));
        assert_eq!(whole.len(), 1, "{}", vector.name);
        for at in 1..bytes.len() {
            let (mut end, mut drive) = device(format);
            end.handle_input(Instant(1), &bytes[..at], &mut drive);
            assert!(drain(&mut end, &mut drive, Instant(1)).is_empty());
            assert!(drive.writes.is_empty());
            end.handle_input(Instant(2), &bytes[at..], &mut drive);
            assert_eq!(drain(&mut end, &mut drive, Instant(2)), whole, "{} at {at}", vector.name);
        }
        if format != WireFormat::Rtu {
            continue; // The 8-bit sum of ASCII lets some damage through; TCP has no sum, and needs none.
        }
        for bit in 0..8 * bytes.len() {
            let (mut end, mut drive) = device(format);
            let mut bytes = bytes.clone();
            bytes[bit / 8] ^= 1 << (bit % 8);
            end.handle_input(Instant(1), &bytes, &mut drive);
            end.handle_timeout(Instant(1_000_000_000), &mut drive);
            assert!(drive.writes.is_empty(), "{} bit {bit}", vector.name);
            assert!(drain(&mut end, &mut drive, Instant(1_000_000_000)).is_empty());
        }
    }
}

#[test]
fn glued_frames_are_all_answered_in_order() {
    for (format, dissector) in
        [(WireFormat::Rtu, RTU), (WireFormat::Ascii, ASCII), (WireFormat::Tcp, TCP)]
    {
        let mut glued = vec![0x55, 0x01];
        for value in 0..3 {
            let mut out = [0; 520];
            let addressing = EncodeOptions::default();
            let text = format!("write 0x10 {value}");
            let len = dissector.encode(&text, &addressing, &mut out).unwrap().len;
            glued.extend(&out[..len]);
        }
        let (mut end, mut drive) = device(format);
        end.handle_input(Instant(1), &glued, &mut drive);
        assert_eq!(drain(&mut end, &mut drive, Instant(1)).len(), 3, "{format:?}");
        assert_eq!(drive.writes.len(), 3);
    }
}

/// Pure noise, or a good frame with a little damage.
fn garbage(random: &mut Random, good: &[Vec<u8>]) -> Vec<u8> {
    if random.below(2) == 0 {
        return (0..random.below(40)).map(|_| random.next() as u8).collect();
    }
    let mut bytes = good[random.below(good.len() as u64) as usize].clone();
    for _ in 0..=random.below(3) {
        let at = random.below(bytes.len() as u64) as usize;
        match random.below(4) {
            0 => bytes[at] ^= 1 << random.below(8),
            1 => bytes.insert(at, random.next() as u8),
            2 if bytes.len() > 1 => drop(bytes.remove(at)),
            _ => bytes.truncate(at.max(1)),
        }
    }
    bytes
}

const GARBAGE: usize = 300_000;

#[test]
fn garbage_never_hangs_a_device() {
    let good: Vec<_> = vectors().into_iter().map(|vector| vector.bytes).collect();
    for (format, framing) in [
        (WireFormat::Rtu, Framing::Length),
        (WireFormat::Rtu, Framing::TS),
        (WireFormat::Ascii, Framing::Length),
    ] {
        let mut random = Random(7);
        let mut end = SerialEndpoint::new(framing);
        let mut drive = RegisterDrive::new(1, format, 0);
        let mut now = Instant(1);
        for _ in 0..GARBAGE {
            now = now.plus_ns(random.below(20_000_000));
            end.handle_input(now, &garbage(&mut random, &good), &mut drive);
            drain(&mut end, &mut drive, now);
        }
        // A CRC lets one in 65536 through; damage that leaves a whole frame inside is that frame.
        let frame = match format {
            WireFormat::Rtu => good[8].clone(),
            WireFormat::Ascii => b":0106003300C8FE\r\n".to_vec(),
            WireFormat::Tcp => unreachable!("not in the list"),
        };
        now = now.plus_ms(1000);
        end.handle_timeout(now, &mut drive);
        drain(&mut end, &mut drive, now);
        end.handle_input(now, &frame, &mut drive);
        now = now.plus_ms(11);
        end.handle_timeout(now, &mut drive);
        assert_eq!(drain(&mut end, &mut drive, now), vec![frame], "{framing:?} recovers");
    }
}

#[test]
fn garbage_ends_every_request_of_a_host() {
    let good: Vec<_> = vectors().into_iter().map(|vector| vector.bytes).collect();
    for format in [WireFormat::Rtu, WireFormat::Ascii] {
        let mut random = Random(11);
        let mut host = SerialHost::new(format, &UNTIMED);
        let mut now = Instant(1);
        let mut out = [0; 520];
        let (mut requested, mut ended) = (0, 0);
        for _ in 0..GARBAGE {
            now = now.plus_ns(random.below(30_000_000));
            let query = RequestBody::Read { space: Space::Holding, start: 0x102E, count: 2 };
            let request = HostRequest { unit: 1, body: query, class: RequestClass::Idempotent };
            requested += u32::from(host.submit(now, Ticket(requested), request).is_ok());
            host.handle_timeout(now);
            while host.poll_transmit(now, &mut out).is_some() {}
            host.handle_input(now, &garbage(&mut random, &good));
            while host.poll_event().is_some() {
                ended += 1;
            }
        }
        for _ in 0..100 {
            now = now.plus_ms(100);
            host.handle_timeout(now);
            while host.poll_transmit(now, &mut out).is_some() {}
            while host.poll_event().is_some() {
                ended += 1;
            }
        }
        assert_eq!(requested, ended, "{format:?}");
        assert!(requested > 1000, "{requested}");
    }
}

#[test]
fn garbage_is_cut_and_explained_without_end() {
    let good: Vec<_> = vectors().into_iter().map(|vector| vector.bytes).collect();
    let directions = [None, Some(Direction::ToDrive), Some(Direction::ToHost)];
    for dissector in [RTU, ASCII] {
        let mut random = Random(13);
        for n in 0..GARBAGE {
            let bytes = garbage(&mut random, &good);
            let direction = directions[n % 3];
            let mut rest = &bytes[..];
            while !rest.is_empty() {
                let len = match dissector.find_frame(rest, direction, true) {
                    FrameBoundary::Frame(len) | FrameBoundary::Corrupt(len) => {
                        explain_frame(
                            dissector,
                            &rest[..len],
                            &Context { direction, ..Context::default() },
                        );
                        len
                    }
                    FrameBoundary::Skip(len) => len,
                    FrameBoundary::Incomplete => panic!("more, though it ended: {rest:02X?}"),
                };
                assert!((1..=rest.len()).contains(&len));
                rest = &rest[len..];
            }
        }
    }
}

#[test]
fn a_lone_frame_with_a_bad_check_says_both_checks() {
    let bytes = bytes_of("01 06 00 33 00 C8 78 54");
    for direction in [None, Some(Direction::ToDrive), Some(Direction::ToHost)] {
        assert_eq!(RTU.find_frame(&bytes, direction, true), FrameBoundary::Corrupt(8));
    }
    let sink = explain_frame(RTU, &bytes, &Context::default());
    assert_eq!(sink.error.unwrap(), "checksum: computed 7853, found 7854");
    assert_eq!(sink.kind, "write single register");
    assert_eq!(sink.fields[3], ("value", "200".to_string()));
}

/// The CRC of a frame that ends in 00h is valid without its last byte as well: one answer of two registers in 256 was
/// cut where a request would end.
#[test]
fn an_answer_that_ends_in_zero_is_whole() {
    let mut seen = 0;
    for value in 0..0x2000_u32 {
        let [a, b, c, d] = (value * 0x0001_0203).to_be_bytes();
        let mut frame = [0; 9];
        let len = rtu::emit(1, &mut frame, |out| {
            out[..6].copy_from_slice(&[3, 4, a, b, c, d]);
            6
        });
        seen += usize::from(frame[len - 1] == 0);
        for direction in [Some(Direction::ToHost), None] {
            assert_eq!(
                RTU.find_frame(&frame, direction, true),
                FrameBoundary::Frame(9),
                "{frame:x?}"
            );
            assert_eq!(RTU.find_frame(&frame, direction, false), FrameBoundary::Frame(9));
        }
    }
    assert!(seen > 8, "{seen} of them end so");
}

#[test]
fn both_directions_glued_are_cut_by_the_check() {
    let frames = ["01 03 10 2E 00 02 A0 C2", "01 03 04 F3 2D 00 0B 18 B9", "01 86 06 C2 62"];
    let glued: Vec<u8> = frames.iter().flat_map(|frame| bytes_of(frame)).collect();
    assert_eq!(RTU.find_frame(&glued, None, false), FrameBoundary::Frame(8));
    assert_eq!(RTU.find_frame(&glued[8..], None, false), FrameBoundary::Frame(9));
    assert_eq!(RTU.find_frame(&glued[17..], None, false), FrameBoundary::Frame(5));
    assert_eq!(RTU.find_frame(&glued[3..], None, false), FrameBoundary::Skip(5));
}

#[test]
fn the_language_is_what_people_expect() {
    let encode = |text: &str| {
        let mut out = [0; 520];
        let addressing = EncodeOptions { axis: Some(1), ..EncodeOptions::default() };
        RTU.encode(text, &addressing, &mut out).map(|encoded| out[1..encoded.len - 2].to_vec())
    };
    for (text, pdu) in [
        ("read Dn_00", "03 10 00 00 01"),
        ("read 0x102E 2", "03 10 2E 00 02"),
        ("write Fn_33 200", "06 00 33 00 C8"),
        ("write Fn_33 = -200", "06 00 33 FF 38"),
        ("write 0x30 5 5", "10 00 30 00 02 04 00 05 00 05"),
        ("write registers 0x30 5", "10 00 30 00 01 02 00 05"),
        ("write 0x40 5 read 0x30 2", "17 00 30 00 02 00 40 00 01 02 00 05"),
        (
            "write registers 0x40 5 6 read registers 0x30",
            "17 00 30 00 01 00 40 00 02 04 00 05 00 06",
        ),
        ("coils 0 4", "01 00 00 00 04"),
        ("inputs 0 8", "02 00 00 00 08"),
        ("read input registers 7", "04 00 07 00 01"),
        ("write coil 3 on", "05 00 03 FF 00"),
        ("coil 3 off", "05 00 03 00 00"),
        ("write coils 4 1 0 1", "0F 00 04 00 03 01 05"),
    ] {
        assert_eq!(encode(text), Ok(bytes_of(pdu)), "{text}");
    }
    for (text, at) in [
        ("fetch 1", 0),
        ("read", 4),
        ("read nonsense", 5),
        ("write 0x33", 10),
        ("write coil 3 on read 0x30", 0),
        ("write 0x40 5 read coils 3", 18),
        ("write 0x33 70000", 11),
        ("read 0 126", 7),
        ("read 0xFFFF 2", 5),
        ("read 1 2 3", 9),
    ] {
        let error = encode(text).unwrap_err();
        assert!(matches!(error, EncodeError::Text(e) if e.at == at), "{text}: {error:?}");
    }
}

#[test]
fn a_foreign_unit_answers_nothing_of_ours() {
    let mut world = TestWorld::plain(WireFormat::Rtu);
    world.fault = std::boxed::Box::new(|n, mut bytes| {
        if n == 1 {
            bytes[0] = 2;
            let len = bytes.len();
            let crc = rtu::crc16(&bytes[..len - 2]).to_le_bytes();
            bytes[len - 2..].copy_from_slice(&crc);
        }
        vec![(0, bytes)]
    });
    assert_eq!(world.read(3, 1).unwrap().words[0], 771);
    assert!(world.host.counters().foreign >= 1);
}

/// A refused read of function 23 leaves nothing written; one that is not refused is answered with what was written.
#[test]
fn a_refused_read_leaves_nothing_written() {
    for (format, dissector) in
        [(WireFormat::Rtu, RTU), (WireFormat::Ascii, ASCII), (WireFormat::Tcp, TCP)]
    {
        for (read, writes) in [(0x1FF, 0), (0x300, 0), (0x10, 1)] {
            let mut out = [0; 520];
            let text = format!("write 0x10 5 read 0x{read:X} 2");
            let len = dissector.encode(&text, &EncodeOptions::default(), &mut out).unwrap().len;
            let (mut end, mut drive) = device(format);
            end.handle_input(Instant(1), &out[..len], &mut drive);
            assert_eq!(drain(&mut end, &mut drive, Instant(1)).len(), 1, "{format:?} {text}");
            assert_eq!(drive.writes.len(), writes, "{format:?} {text}");
        }
    }
}
