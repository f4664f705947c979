//! Golden vectors, round trips, the text language, the dissector.

extern crate std;

mod doubt;
mod download;
mod garbage;
mod heard;
mod motors;
mod pair;
mod quiet;

use std::string::String;
use std::vec::Vec;

use super::opcode::{Opcode, Status};
use super::text;
use super::wire::{DATAGRAM, Instruction, Reply, Request, VersionText};
use super::{TmclDissector, ascii};
use crate::error::WireError;
use crate::explain::{
    Context, Direction, Dissector, EncodeOptions, ExplainSink, Field, FieldValue, FrameBoundary,
    FrameFormat,
};

/// Marsaglia's xorshift: the tests' only randomness, by seed.
pub(super) struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 16
    }

    pub fn below(&mut self, n: u64) -> u64 {
        self.next() % n
    }
}

#[derive(Default, Debug)]
struct Seen {
    kind: String,
    axis: Option<u32>,
    fields: Vec<(&'static str, i64)>,
    text: String,
    error: Option<WireError>,
}

impl Seen {
    fn of(bytes: &[u8], context: &Context<'_>) -> Self {
        let mut seen = Self::default();
        TmclDissector.explain(bytes, context, &mut seen);
        seen
    }

    fn field(&self, name: &str) -> Option<i64> {
        self.fields.iter().find(|(n, _)| *n == name).map(|(_, v)| *v)
    }
}

impl ExplainSink for Seen {
    fn kind(&mut self, kind: &str) {
        self.kind = kind.into();
    }
    fn axis(&mut self, axis: u32) {
        self.axis = Some(axis);
    }
    fn field(&mut self, field: Field<'_>) {
        assert!(field.start < field.end, "{field:?}");
        self.fields
            .push((field.name, if let FieldValue::Int(value) = field.value { value } else { 0 }));
    }
    fn text(&mut self, piece: &str) {
        self.text.push_str(piece);
    }
    fn error(&mut self, error: WireError) {
        self.error = Some(error);
    }
}

struct Vector {
    name: String,
    bytes: Vec<u8>,
    to_drive: bool,
    transport: String,
    valid: bool,
    id: u32,
    json: serde_json::Value,
}

fn vectors() -> Vec<Vector> {
    let text = include_str!("../../../../../vectors/tmcl.json");
    let json: serde_json::Value = serde_json::from_str(text).expect("vectors/tmcl.json");
    let of = |v: &serde_json::Value| Vector {
        name: v["name"].as_str().unwrap().into(),
        bytes: hex(v["bytes"].as_str().unwrap()),
        to_drive: v["direction"] == "host->module",
        transport: v["transport"].as_str().unwrap().into(),
        valid: v["valid"].as_bool().unwrap(),
        id: v["can_id"].as_u64().unwrap_or(0) as u32,
        json: v.clone(),
    };
    json.as_array().unwrap().iter().map(of).collect()
}

fn hex(text: &str) -> Vec<u8> {
    text.split_whitespace().map(|b| u8::from_str_radix(b, 16).unwrap()).collect()
}

#[test]
fn every_vector_decodes_and_encodes_exactly() {
    let mut checked = 0;
    for v in vectors() {
        match v.transport.as_str() {
            "serial9" => check_serial(&v),
            "can" => check_can(&v),
            "serial-stream" => v.bytes.chunks(DATAGRAM).for_each(|c| assert_eq!(re(c), c)),
            "serial9-ascii-version" => {
                let version = VersionText::parse(&v.bytes).unwrap();
                assert_eq!((version.host, &version.text), (2, b"0026V311"));
                assert_eq!(version.emit()[..], v.bytes);
            }
            "serial8-without-checksum" => {
                let mut whole = v.bytes.clone();
                assert_eq!(Request::parse(&whole), Err(WireError::Short { need: 9, found: 8 }));
                whole.push(0x63);
                assert_eq!(Request::parse(&whole).unwrap().motor, 2);
            }
            other => panic!("{}: transport {other}", v.name),
        }
        checked += 1;
    }
    assert!(checked >= 46, "only {checked} vectors");
}

fn re(bytes: &[u8]) -> [u8; DATAGRAM] {
    let (request, reply) = (Request::parse(bytes).unwrap(), Reply::parse(bytes).unwrap());
    assert_eq!(request.emit(), reply.emit());
    reply.emit()
}

fn check_serial(v: &Vector) {
    let direction = Some(if v.to_drive { Direction::ToDrive } else { Direction::ToHost });
    let seen = Seen::of(&v.bytes, &Context { direction, ..Context::default() });
    assert_eq!(seen.error.is_none(), v.valid, "{}: {seen:?}", v.name);
    if !v.valid {
        assert!(matches!(Reply::parse(&v.bytes), Err(WireError::Checksum { .. })), "{}", v.name);
        assert_eq!(
            TmclDissector.find_frame(&v.bytes, direction, true),
            FrameBoundary::Corrupt(9),
            "{}",
            v.name
        );
        return;
    }
    assert_eq!(re(&v.bytes)[..], v.bytes, "{}", v.name);
    assert_eq!(
        TmclDissector.find_frame(&v.bytes, direction, false),
        FrameBoundary::Frame(9),
        "{}",
        v.name
    );
    for (name, value) in v.json["fields"].as_object().into_iter().flatten() {
        assert_eq!(seen.field(name), value.as_i64(), "{}: {name}", v.name);
    }
    if v.to_drive {
        let request = Request::parse(&v.bytes).unwrap();
        let mut line = String::new();
        text::write(&request, &mut |piece| line.push_str(piece));
        assert_eq!(text::parse(&line, request.address), Ok(request), "{}: {line}", v.name);
        let mut out = [0; 16];
        let addressing =
            EncodeOptions { axis: Some(request.address.into()), ..EncodeOptions::default() };
        let encoded = TmclDissector.encode(&line, &addressing, &mut out).unwrap();
        assert_eq!(out[..encoded.len], v.bytes, "{}: {line}", v.name);
    }
}

fn check_can(v: &Vector) {
    let eight = v.bytes.len() == 8;
    let again = if v.to_drive {
        Request::parse_can(&v.bytes, 1).unwrap().emit_can(v.id as u16, eight)
    } else {
        Reply::parse_can(&v.bytes, 2).unwrap().emit_can(v.id as u16, eight)
    };
    assert_eq!((again.bytes(), again.id), (&v.bytes[..], v.id), "{}", v.name);
    let seen = Seen::of(&v.bytes, &Context { id: Some(v.id), ..Context::default() });
    assert!(seen.error.is_none(), "{}: {seen:?}", v.name);
    assert_eq!(seen.field("status").is_none(), v.to_drive, "{}", v.name);
    assert!(!seen.kind.is_empty() && seen.axis == Some(1), "{}: {seen:?}", v.name);
}

#[test]
fn parse_undoes_emit() {
    let mut random = Random(3);
    for _ in 0..100_000 {
        let n = random.next().to_be_bytes();
        let value = match random.below(8) {
            0 => i32::MIN,
            1 => i32::MAX,
            2 => -1,
            _ => random.next() as i32,
        };
        let (opcode, status) = (Opcode::from(n[7]), Status::from(n[6]));
        let request = Request { address: n[5], opcode, kind: n[4], motor: n[3], value };
        assert_eq!(Request::parse(&request.emit()), Ok(request));
        let reply = Reply { host: n[5], module: n[4], status, opcode, value };
        assert_eq!(Reply::parse(&reply.emit()), Ok(reply));
        let eight = n[2] & 1 == 1;
        assert_eq!(Request::parse_can(request.emit_can(5, eight).bytes(), n[5]), Ok(request));
        assert_eq!(Reply::parse_can(reply.emit_can(5, eight).bytes(), n[5]), Ok(reply));
        let stored = Instruction { opcode: n[5], kind: n[4], motor: n[3], value };
        assert_eq!(Instruction::of_reply(&stored.into_reply(2)), stored);
    }
}

#[test]
fn enums_are_total() {
    for n in 0..=255 {
        assert_eq!(Opcode::from(n).number(), n);
        assert_eq!(Status::from(n).number(), n);
    }
    assert!(!Opcode::from(72).is_named());
    assert_eq!(Status::from(100), Status::Ok);
}

#[test]
fn truncations_and_flips_are_refused() {
    for v in vectors().iter().filter(|v| v.transport == "serial9" && v.valid) {
        for end in 0..DATAGRAM {
            let short = Reply::parse(&v.bytes[..end]);
            assert_eq!(short, Err(WireError::Short { need: 9, found: end as u16 }));
        }
        for bit in 0..72 {
            let mut flipped = v.bytes.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            // The sum sees every single flip: it changes one term by a power of two below 256.
            assert!(matches!(Reply::parse(&flipped), Err(WireError::Checksum { .. })));
            assert_eq!(
                TmclDissector.find_frame(&flipped, None, true),
                FrameBoundary::Corrupt(9),
                "{}",
                v.name
            );
            let seen = Seen::of(&flipped, &Context::default());
            assert!(seen.error.is_some());
        }
    }
}

#[test]
fn text_reads_as_the_manuals_write() {
    let cases: &[(&str, [u8; 9])] = &[
        ("ROR 0, 350", [1, 1, 0, 0, 0, 0, 1, 0x5E, 0x61]),
        ("ror 0,350", [1, 1, 0, 0, 0, 0, 1, 0x5E, 0x61]),
        ("ROR 0, 0, 350", [1, 1, 0, 0, 0, 0, 1, 0x5E, 0x61]),
        ("GAP 1, 0", [1, 6, 1, 0, 0, 0, 0, 0, 8]),
        ("GAP 1", [1, 6, 1, 0, 0, 0, 0, 0, 8]),
        ("MVP ABS, 0, -2147483648", [1, 4, 0, 0, 0x80, 0, 0, 0, 0x85]),
        ("SAP 157, 0, -3000", [1, 5, 0x9D, 0, 0xFF, 0xFF, 0xF4, 0x48, 0xDD]),
        ("SGP 73, 0, 4321", [1, 9, 0x49, 0, 0, 0, 0x10, 0xE1, 0x44]),
        ("RFS START, 0", [1, 13, 0, 0, 0, 0, 0, 0, 14]),
        ("MST 0", [1, 3, 0, 0, 0, 0, 0, 0, 4]),
        ("136, 0, 0", [1, 0x88, 0, 0, 0, 0, 0, 0, 0x89]),
        ("GET VERSION 1", [1, 0x88, 1, 0, 0, 0, 0, 0, 0x8A]),
        ("CALC MUL, -5000", [1, 0x13, 2, 0, 0xFF, 0xFF, 0xEC, 0x78, 0x78]),
        ("SAP 4, 0, $3E8", [1, 5, 4, 0, 0, 0, 3, 0xE8, 0xF5]),
    ];
    for (line, bytes) in cases {
        let found = text::parse(line, 1).unwrap_or_else(|error| panic!("{line}: {error:?}"));
        assert_eq!(found.emit(), *bytes, "{line}");
    }
    for (line, at) in [
        ("", 0),
        ("FLY 0", 0),
        ("ROR 0, 350, 1, 2", 15),
        ("MVP UP, 0, 3", 4),
        ("GAP 256", 4),
        ("GAP 1,, 2", 6),
        ("SAP 4, 0, 4294967296", 10),
        ("GAP 1, 0 1", 7),
        ("MST 0, 5", 7),
    ] {
        assert_eq!(text::parse(line, 1).map_err(|e| e.at), Err(at), "{line}");
    }
}

#[test]
fn text_undoes_itself_for_every_request() {
    let mut random = Random(11);
    for _ in 0..50_000 {
        let n = random.next().to_be_bytes();
        let (kind, motor) = (n[6] & n[4], n[5] & n[3]);
        let value = if n[2] & 1 == 0 { 0 } else { random.next() as i32 };
        let request = Request { address: n[2], opcode: Opcode::from(n[7]), kind, motor, value };
        let mut line = String::new();
        text::write(&request, &mut |piece| line.push_str(piece));
        assert_eq!(text::parse(&line, n[2]), Ok(request), "{line}");
    }
}

#[test]
fn ascii_lines_go_both_ways() {
    let parse = |line: &str| ascii::AsciiCommand::parse(line.as_bytes());
    let mvp = text::parse("MVP ABS, 1, 50000", 1).unwrap();
    assert_eq!(parse("AMVP ABS, 1, 50000"), Some((1, ascii::AsciiCommand::Request(mvp))));
    assert_eq!(parse("A MVP ABS, 1, 50000"), Some((1, ascii::AsciiCommand::Request(mvp))));
    assert_eq!(parse("BBIN"), Some((2, ascii::AsciiCommand::Binary)));
    assert_eq!(parse("AWAIT TICKS, 0, 1"), Some((1, ascii::AsciiCommand::Unreadable)));
    assert_eq!(parse("1 MST"), None);
    let mut line = ascii::AsciiLine::EMPTY;
    assert!(ascii::write_request(&mut line, &mvp));
    assert_eq!(line.bytes(), b"AMVP ABS, 1, 50000\r");
    let mut line = ascii::AsciiLine::EMPTY;
    ascii::write_reply(&mut line, 2, 1, Status::Ok, -5000);
    assert_eq!(line.bytes(), b"BA 100 -5000\r");
    let answer = ascii::AsciiReply { host: 2, module: 1, status: Status::Ok, value: -5000 };
    assert_eq!(ascii::AsciiReply::parse(b"BA 100 -5000"), Some(answer));
}

#[test]
fn cut_finds_the_next_boundary() {
    let good = hex("02 01 64 06 00 00 02 c7 36");
    let cut = |bytes: &[u8], ended| TmclDissector.find_frame(bytes, Some(Direction::ToHost), ended);
    for split in 0..DATAGRAM {
        assert_eq!(cut(&good[..split], false), FrameBoundary::Incomplete);
    }
    let noisy: Vec<u8> = [&[0x55, 0x02][..], &good].concat();
    assert_eq!(cut(&noisy, false), FrameBoundary::Skip(2));
    let mut bad = good.clone();
    bad[6] ^= 1;
    assert_eq!(cut(&bad, true), FrameBoundary::Corrupt(9));
    assert_eq!(cut(&bad, false), FrameBoundary::Incomplete);
    assert_eq!(cut(&[bad.clone(), good.clone()].concat(), false), FrameBoundary::Corrupt(9));
    assert_eq!(cut(&[good[..8].to_vec(), good.clone()].concat(), false), FrameBoundary::Skip(8));
    assert_eq!(cut(&hex("02 30 30 32 36 56 33 31 31"), false), FrameBoundary::Frame(9));
    assert_eq!(
        TmclDissector.find_frame(b"AMVP ABS, 1, 50000\r", None, false),
        FrameBoundary::Frame(19)
    );
    assert_eq!(cut(&good[..8], true), FrameBoundary::Corrupt(8));
    assert_eq!(cut(&good[..2], true), FrameBoundary::Skip(2));
}

#[test]
fn explains_in_words() {
    let seen = |text: &str, context: &Context<'_>| Seen::of(&hex(text), context);
    let request = seen("01 01 00 00 00 00 01 5e 61", &Context::default());
    assert_eq!((request.kind.as_str(), request.axis), ("ROR", Some(1)));
    assert_eq!(request.text, "ROR 0, 350: rotate right");
    let names: Vec<_> = request.fields.iter().map(|(name, _)| *name).collect();
    assert_eq!(names, ["address", "opcode", "type", "motor", "value", "checksum"]);
    let request_bytes = hex("01 06 01 00 00 00 00 00 08");
    let profile = Some(&super::generic::GENERIC);
    let context = Context { request: Some(&request_bytes), profile, ..Context::default() };
    let reply = seen("02 01 64 06 00 00 02 c7 36", &context);
    assert_eq!(reply.text, "actual position = 711");
    let names: Vec<_> = reply.fields.iter().map(|(name, _)| *name).collect();
    assert_eq!(names, ["host", "address", "status", "opcode", "value", "checksum"]);
    let refused = seen("02 01 04 05 00 00 00 00 0c", &Context::default());
    assert_eq!((refused.kind.as_str(), refused.text.as_str()), ("SAP", "refused: invalid value"));
    let version = seen("02 01 64 88 00 aa 01 0e a8", &Context::default());
    assert_eq!(version.text, "done, value 11141390 (module 170, version 1.14)");
    let broken = seen("02 01 64 06 00 00 02 c7 37", &Context::default());
    assert_eq!(broken.error, Some(WireError::Checksum { computed: 0x36, found: 0x37 }));
    assert_eq!(TmclDissector.code_meaning(5), Some("configuration EEPROM locked"));
    assert_eq!(TmclDissector.code_meaning(77), None);
}

#[test]
fn a_position_beyond_the_greatest_is_none() {
    let value = |line: &str| text::parse(line, 1).map(|request| request.value);
    for line in
        ["MVP ABS, 0, 2147483648", "ROR 0, 3000000000", "ROL 0, 0xFFFFFFFF", "SAP 4, 0, 4000000000"]
    {
        let error = value(line).expect_err(line);
        assert!(error.expected.contains("2147483647"), "{line}: {error:?}");
    }
    assert_eq!(value("MVP REL, 0, -2147483648"), Ok(i32::MIN));
    assert_eq!(value("SAP 4, 0, 0xFFFFFFFF"), Ok(-1), "bits are written in hexadecimal");
    assert_eq!(value("SIO 255, 2, 4294967295"), Ok(-1));
}
