//! Golden vectors both ways, and the language.

extern crate std;

use std::string::String;
use std::vec::Vec;

use crate::error::WireError;
use crate::explain::{
    Context, Dissector, EncodeError, EncodeOptions, EncodedFrame, ExplainSink, Field, FieldValue,
    FrameFormat,
};
use crate::medium::Frame;
use crate::proto::thruster::ThrusterDissector;
use crate::proto::thruster::wire::{CommandWord, DriveMessage, Request, Width, node_of_id};

const VECTORS: &str = include_str!("../../../../../../vectors/thruster.json");

/// Findings of an explainer, as text.
#[derive(Default)]
pub struct RecordingSink {
    pub kind: String,
    pub axis: u32,
    pub text: String,
    pub fields: Vec<(&'static str, String, &'static str)>,
    pub error: Option<WireError>,
}

impl ExplainSink for RecordingSink {
    fn kind(&mut self, kind: &str) {
        self.kind = kind.into();
    }
    fn axis(&mut self, axis: u32) {
        self.axis = axis;
    }
    fn field(&mut self, field: Field<'_>) {
        let value = match field.value {
            FieldValue::Int(n) => std::format!("{n}"),
            FieldValue::Hex(n, digits) => std::format!("0x{n:0digits$X}", digits = digits.into()),
            FieldValue::Real(n) => std::format!("{n:?}"),
            FieldValue::Text(text) => text.into(),
            FieldValue::Words(words) => std::format!("{words:?}"),
        };
        self.fields.push((field.name, value, field.meaning));
    }
    fn text(&mut self, piece: &str) {
        self.text.push_str(piece);
    }
    fn error(&mut self, error: WireError) {
        self.error = Some(error);
    }
}

impl RecordingSink {
    fn value(&self, name: &str) -> &str {
        self.fields.iter().find(|(n, ..)| *n == name).map_or("", |(_, value, _)| value)
    }
}

pub fn explain(frame: &Frame, request: Option<&[u8]>) -> RecordingSink {
    let mut found = RecordingSink::default();
    let context = Context { id: Some(frame.id), request, ..Context::default() };
    ThrusterDissector.explain(frame.bytes(), &context, &mut found);
    found
}

pub fn encode(text: &str, axis: u32) -> Result<Frame, EncodeError> {
    let addressing = EncodeOptions { axis: Some(axis), ..EncodeOptions::default() };
    let mut out = [0; 8];
    let EncodedFrame { len, id, .. } = ThrusterDissector.encode(text, &addressing, &mut out)?;
    Ok(Frame::standard(id.expect("an identifier") as u16, &out[..len]))
}

fn frame_of(id: &str, bytes: &str) -> Frame {
    let id = u16::from_str_radix(id.trim_start_matches("0x"), 16).expect("an identifier");
    let byte = |word| u8::from_str_radix(word, 16).expect("a byte");
    Frame::standard(id, &bytes.split(' ').map(byte).collect::<Vec<_>>())
}

#[test]
fn every_vector_in_both_directions() {
    let vectors: serde_json::Value = serde_json::from_str(VECTORS).expect("JSON");
    let (mut requested, mut count) = (None::<Frame>, 0);
    for v in vectors.as_array().expect("a list") {
        let text = |key: &str| v[key].as_str().unwrap_or("");
        let frame = frame_of(text("can_id"), text("bytes"));
        assert_eq!(frame.len as u64, v["dlc"].as_u64().expect("a length"), "{}", text("name"));
        let to_drive = matches!(node_of_id(frame.id), Some(Ok(_)));
        let request = requested.filter(|_| !to_drive);
        let found = explain(&frame, request.as_ref().map(Frame::bytes));
        assert_eq!(found.axis, frame.id & 0x7F);
        if text("protocol") == "elmo-bi" {
            assert!(found.error.is_some() && found.text.contains("Elmo"), "{}", found.text);
            continue;
        }
        assert_eq!(found.error, None, "{}", text("name"));
        requested = to_drive.then_some(frame).or(requested);
        agrees(v, &found);
        let again = encode(&found.text, found.axis);
        if v["invalid"] == true {
            assert!(matches!(again, Err(EncodeError::Forbidden(_))), "{}", found.text);
        } else {
            assert_eq!(again, Ok(frame), "{}: {}", text("name"), found.text);
        }
        count += 1;
    }
    assert!(count >= 61, "only {count}");
}

/// The values that the vector states.
fn agrees(v: &serde_json::Value, found: &RecordingSink) {
    let name = &v["name"];
    if let Some(value) = v["value"].as_f64() {
        assert_eq!(found.value("value").parse(), Ok(value), "{name}: {:?}", found.fields);
    }
    for (key, value) in v["fields"].as_object().into_iter().flatten() {
        match value.as_array() {
            Some(bits) => {
                let bits: Vec<_> = bits.iter().map(|bit| std::format!("{bit}")).collect();
                let reports = found.fields.iter().skip(2).map(|(_, n, _)| n.clone());
                assert_eq!(reports.collect::<Vec<_>>(), bits, "{name}");
            }
            None if key == "status" => assert_eq!(found.value(key), "0x0000", "{name}"),
            None => {
                assert_eq!(found.value(key).parse().ok(), value.as_f64(), "{name} {key}");
            }
        }
    }
    if v["error"] == true {
        assert!(found.text.contains("refused"), "{name}: {}", found.text);
    }
}

#[test]
fn each_text_that_decode_prints_is_read_again() {
    // Every command with odd and even data, both lengths, both directions, and every report.
    let data_words =
        [0, 5, 0xFFFB, 0xFFFF_FFFB, 0xEEEE, 0x0001_0000, 0x1234_5678, 0x0300_0064, 0x0300];
    let mut tried = 0;
    let mut both = |frame: Frame| {
        let found = explain(&frame, None);
        match encode(&found.text, 5) {
            Err(EncodeError::Forbidden(_)) => assert!(matches!(node_of_id(frame.id), Some(Ok(_)))),
            again => assert_eq!(again, Ok(frame), "{}", found.text),
        }
        tried += 1;
    };
    for (command, ..) in CommandWord::ALL {
        for sub in [0, 10, 0x4C41, 0xFFFF] {
            both(Request { command, sub, data: None }.frame(5));
            for data in data_words {
                both(Request { command, sub, data: Some(data) }.frame(5));
                both(crate::proto::thruster::Reply { command, sub, data }.frame(5));
            }
        }
    }
    for of in *b"TVA" {
        for part in 1..=3 {
            let mut data = [of, part, 0xFF, 0x01, 0x80, 0x02, 0xFC, 0x18];
            both(Frame::standard(0x285, &data));
            data[2] = 0;
            both(Frame::standard(0x285, &data));
        }
    }
    both(Frame::standard(0x285, &[0xFE, 0x0D, 1, 0xE0, 0xFF, 0xFF, 0x04, 0x10]));
    assert!(tried > 2000, "{tried}");
}

#[test]
fn texts_of_users() {
    for (text, frame) in [
        ("TC -5", "30B 54 43 00 00 00 00 FF FB"),
        ("tc 5%", "30B 54 43 00 00 00 00 00 05"),
        ("TC -5 wide", "30B 54 43 00 00 FF FF FF FB"),
        ("VC -1500 rpm", "30B 56 43 00 00 00 00 FA 24"),
        ("QP", "30B 51 50 00 00"),
        ("QP dlc 8", "30B 51 50 00 00 00 00 00 00"),
        ("QP 48 V", "28B 51 50 00 00 00 00 01 E0"),
        ("QP 480", "28B 51 50 00 00 00 00 01 E0"),
        ("LA 100 rpm -90 deg", "30B 4C 41 00 64 FF FF FC 7C"),
        ("LA 100rpm -90deg short", "30B 4C 41 00 64 00 00 FC 7C"),
        ("LA 10 900", "30B 4C 41 00 0A 00 00 03 84"),
        ("LR 10 rpm 0.5 deg", "30B 4C 52 00 0A 00 00 00 05"),
        ("VM headerless", "30B 56 4D 00 00 00 00 01 00"),
        ("VM silent", "30B 56 4D 00 00 00 00 02 00"),
        ("VM 2 0", "30B 56 4D 00 00 00 00 02 00"),
        ("VM 0 3", "30B 56 4D 00 00 00 00 00 03"),
        ("VM frames 1+2+3", "30B 56 4D 00 00 00 00 00 07"),
        ("SR frames 1+3 every 250 ms", "30B 53 52 00 00 00 05 00 FA"),
        ("SR 5 250", "30B 53 52 00 00 00 05 00 FA"),
        ("SPLA -90 deg 45.5 deg", "30B 53 50 4C 41 FC 7C 01 C7"),
        ("RPLA", "30B 52 50 4C 41"),
        ("RP 0x1234", "30B 52 50 12 34"),
        ("SP 0x1234 0x3F800000", "30B 53 50 12 34 3F 80 00 00"),
        ("LS", "30B 4C 53 00 00 00 00 00 00"),
        ("LS dlc 4", "30B 4C 53 00 00"),
        ("ST 0", "30B 53 54 00 00 00 00 00 00"),
        ("TC refused", "28B 54 43 00 00 00 00 EE EE"),
        ("raw 4C 53", "30B 4C 53"),
    ] {
        let (id, bytes) = frame.split_once(' ').expect("an identifier");
        assert_eq!(encode(text, 11), Ok(frame_of(id, bytes)), "{text}");
    }
}

#[test]
fn mistakes_are_pointed_at() {
    for (text, at) in [
        ("", 0),
        ("XX", 0),
        ("TC x", 3),
        ("TC 5 6", 5),
        ("TC 5 rpm", 5),
        ("QP 4..8", 3),
        ("LA rpm", 3),
        ("VM frames 4", 10),
        ("TC 65531", 3),
        ("CF 5", 3),
        ("QV 1.5", 3),
    ] {
        match encode(text, 11) {
            Err(EncodeError::Text(error)) => assert_eq!(error.at, at, "{text}: {error:?}"),
            other => panic!("{text}: {other:?}"),
        }
    }
    for (text, rule) in [
        ("TC 101", "100 %"),
        ("VC 29", "30 rpm"),
        ("VC -4370", "EE EE"),
        ("LR 10 rpm -437.0 deg", "EE EE"),
        ("CI 0", "127"),
        ("CI 128", "127"),
        ("CB 501", "bit rates"),
        ("ST 99", "100 to 60000"),
        ("ST 60001", "100 to 60000"),
        ("LA 10 rpm 180 deg", "179.9"),
        ("SPLA 5 deg 90 deg", "safe range"),
        ("TC", "needs a value"),
    ] {
        match encode(text, 11) {
            Err(EncodeError::Forbidden(output)) => {
                assert!(output.contains(rule), "{text}: {output}")
            }
            other => panic!("{text}: {other:?}"),
        }
    }
}

#[test]
fn values_are_read_in_whatever_width_they_come() {
    for data in [0x0000_FFFB, 0xFFFF_FFFB] {
        assert_eq!(Width::Signed.decode(data), -5);
    }
    assert_eq!(Width::Signed.decode(0x0001_0000), 65536);
    assert_eq!(Width::Unsigned.decode(0xEA60), 60000);
    assert_eq!(Width::Absolute.decode(63737), -1799);
    assert_eq!(Width::Absolute.decode(63736), 63736);
    assert_eq!(Width::Long.decode(63737), 63737, "a relative way may be so long");
    assert_eq!(Width::Long.decode(0xFFFF_FC7C), -900);
}

#[test]
fn identifiers_of_others_are_not_claimed() {
    let claims = |id| ThrusterDissector.claims_id(id, false);
    assert!(claims(0x281) && claims(0x2FF) && claims(0x301) && claims(0x37F));
    for id in [0x280, 0x300, 0x27F, 0x380, 0x001, 0x181, 0x581, 0x701] {
        assert!(!claims(id), "{id:03X}");
    }
    assert!(!ThrusterDissector.claims_id(0x301, true) && ThrusterDissector.shares_id(0x301, false));
}

#[test]
fn impossible_lengths_are_reported() {
    for len in [0, 1, 3, 5, 7] {
        let found = explain(&Frame::standard(0x30B, &[0x54; 8][..len]), None);
        assert!(matches!(found.error, Some(WireError::Short { .. })), "{len}");
        let found = explain(&Frame::standard(0x28B, &[0x54; 8][..len]), None);
        assert!(matches!(found.error, Some(WireError::Short { .. })), "{len}");
    }
    assert_eq!(DriveMessage::parse(&[0; 9]), Err(WireError::Long { need: 8, found: 9 }));
}
