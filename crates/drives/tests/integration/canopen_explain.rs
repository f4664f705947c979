//! Frames explained, and every printed text encoded again.

use polepair_core::error::WireError;
use polepair_core::explain::{
    Context, Dissector, EncodeError, EncodeOptions, EncodedFrame, ExplainSink, Field, FieldValue,
    FrameConversation, RawFrame,
};
use polepair_core::medium::Frame;
use polepair_core::profile::Profile;
use polepair_core::proto::canopen::CanopenDissector;
use polepair_core::proto::canopen::sdo::{ObjectIndex, SdoReply, SdoRequest, Segment};

/// Findings of an explainer, as text.
#[derive(Default)]
struct RecordingSink {
    kind: String,
    axis: Option<u32>,
    text: String,
    fields: Vec<(&'static str, String, &'static str)>,
    error: Option<WireError>,
}

impl ExplainSink for RecordingSink {
    fn kind(&mut self, kind: &str) {
        self.kind = kind.into();
    }
    fn axis(&mut self, axis: u32) {
        self.axis = Some(axis);
    }
    fn field(&mut self, field: Field<'_>) {
        let value = match field.value {
            FieldValue::Int(n) => std::format!("{n}"),
            FieldValue::Hex(n, digits) => std::format!("0x{n:0digits$X}", digits = digits.into()),
            FieldValue::Real(n) => std::format!("{n:?}"),
            FieldValue::Text(text) => text.into(),
            FieldValue::Words(words) => std::format!("{words:?}"),
        };
        assert!(field.start <= field.end && field.end <= 16, "{}", field.name);
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

fn explain_with(
    frame: &Frame,
    request: Option<&[u8]>,
    profile: Option<&'static Profile>,
) -> RecordingSink {
    let mut found = RecordingSink::default();
    let (id, remote) = (Some(frame.id), frame.remote);
    let context = Context { id, remote, request, profile, ..Context::default() };
    CanopenDissector.explain(frame.bytes(), &context, &mut found);
    found
}

fn explain(frame: &Frame) -> RecordingSink {
    explain_with(frame, None, None)
}

fn encode_with(
    text: &str,
    axis: Option<u32>,
    profile: Option<&'static Profile>,
) -> Result<Frame, EncodeError> {
    let addressing = EncodeOptions { axis, profile, ..EncodeOptions::default() };
    let mut out = [0; 8];
    let EncodedFrame { len, id, remote_len, .. } =
        CanopenDissector.encode(text, &addressing, &mut out)?;
    let frame = Frame::standard(id.expect("an identifier") as u16, &out[..len]);
    let len = remote_len.unwrap_or(frame.len);
    Ok(Frame { remote: remote_len.is_some(), len, ..frame })
}

fn encode(text: &str, axis: u32) -> Result<Frame, EncodeError> {
    encode_with(text, Some(axis), None)
}

/// `602#2B40600006000000`.
fn frame(text: &str) -> Frame {
    let (id, data) = text.split_once('#').expect("a frame");
    let byte = |at: usize| u8::from_str_radix(&data[at..at + 2], 16).expect("a byte");
    let bytes: Vec<u8> = (0..data.len()).step_by(2).map(byte).collect();
    Frame::standard(u16::from_str_radix(id, 16).expect("an identifier"), &bytes)
}

fn profile(name: &str) -> Option<&'static Profile> {
    let found = polepair_drives::profiles().iter().find(|profile| profile.name == name);
    assert!(found.is_some(), "{name}");
    found.copied()
}

const VECTORS: &str =
    include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../vectors/canopen.json"));

/// A worked frame of a manual.
struct Vector {
    name: String,
    meaning: String,
    frame: Frame,
}

fn vectors() -> Vec<Vector> {
    let json: serde_json::Value = serde_json::from_str(VECTORS).expect("vectors/canopen.json");
    let vector = |v: &serde_json::Value| {
        let text = |key: &str| String::from(v[key].as_str().unwrap_or(""));
        let hex = |word: &str| u8::from_str_radix(word, 16).unwrap();
        let bytes: Vec<u8> = text("bytes").split_whitespace().map(hex).collect();
        let id = u16::from_str_radix(text("can_id").trim_start_matches("0x"), 16).unwrap();
        let mut frame = Frame::standard(id, &bytes);
        frame.len = v["dlc"].as_u64().unwrap() as u8;
        frame.remote = v["rtr"].as_bool().unwrap_or(false);
        Vector { name: text("name"), meaning: text("meaning"), frame }
    };
    json.as_array().unwrap().iter().map(vector).collect()
}

#[test]
fn every_printed_frame_is_explained_and_encoded_again() {
    let profiles = [None, profile("syntron-ts-canopen"), profile("cia402")];
    for (v, profile) in vectors().iter().flat_map(|v| profiles.map(|profile| (v, profile))) {
        let found = explain_with(&v.frame, None, profile);
        assert_eq!(found.error, None, "{}: {}", v.name, found.text);
        assert!(found.text.is_ascii() && !found.text.starts_with("raw"), "{}", found.text);
        let again = encode_with(&found.text, found.axis, profile);
        assert_eq!(again, Ok(v.frame), "{}: {}", v.name, found.text);
        agrees(&v.meaning, &found);
    }
}

/// Checks that the explanation has the meaning that the vector states.
fn agrees(meaning: &str, found: &RecordingSink) {
    let output = found.text.to_ascii_lowercase();
    let object = |text: &str| {
        let (index, sub) = text.split_once(':').expect("an object");
        let sub = u8::from_str_radix(sub, 16).expect("a sub-index");
        std::format!("0x{index}:{sub}").to_ascii_lowercase()
    };
    let words: Vec<&str> = meaning.split_whitespace().collect();
    match words[..] {
        ["download", "ack", what, ..] => {
            assert!(output.starts_with(&std::format!("written {}", object(what))), "{output}");
        }
        ["download", what, "=", _, value, ..] => {
            assert!(output.starts_with(&std::format!("write {}", object(what))), "{output}");
            assert_eq!(found.value("value"), value.trim_matches(['(', ')']), "{output}");
        }
        ["upload", "req", what, ..] => assert_eq!(output.find(&object(what)), Some(5), "{output}"),
        ["upload", "rsp", what, "=", _, value, ..] => {
            assert_eq!(output.find(&object(what)), Some(6), "{output}");
            assert_eq!(found.value("value"), value.trim_matches(['(', ')']), "{output}");
        }
        ["abort", code, ..] if code.len() == 8 && found.kind == "SDO abort" => {
            assert_eq!(found.value("abort"), std::format!("0x{code}"), "{output}");
        }
        _ => {}
    }
}

/// A plain congruential sequence: the same frames each time.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        self.0 >> 16
    }
}

#[test]
fn every_explanation_encodes_to_the_same_frame() {
    let mut random = Random(4);
    let functions = [0, 0x80, 0x100, 0x180, 0x200, 0x280, 0x380, 0x500, 0x580, 0x600, 0x700];
    let profiles = [None, profile("syntron-ts-canopen"), profile("cia402")];
    let (mut raw, mut tried) = (0, 0);
    for round in 0..60_000 {
        let node = (random.next() % 127 + 1) as u16;
        let id = match functions[round % functions.len()] {
            0x80 if round % 2 == 0 => 0x80,
            own @ (0 | 0x100) => own,
            0x700 if round % 3 == 0 => 0x7E4 + (round % 2) as u16,
            base => base + node,
        };
        let mut data = random.next().to_le_bytes();
        // Half of the frames have small numbers, so that their bytes are more often of use.
        if round % 2 == 1 {
            data.iter_mut().skip(4).for_each(|byte| *byte &= 1);
        }
        let len = if round % 4 == 0 { (random.next() % 9) as usize } else { 8 };
        let len = match id {
            0x80 => len % 2,
            0 => 2,
            0x701..=0x77F => 1,
            _ => len,
        };
        let frame = Frame::standard(id, &data[..len]);
        let found = explain_with(&frame, None, profiles[round % 3]);
        let again = encode_with(&found.text, found.axis, None);
        assert_eq!(again, Ok(frame), "{}", found.text);
        raw += u32::from(found.text.starts_with("raw"));
        tried += 1;
    }
    assert!(raw * 2 < tried, "{raw} of {tried} have no words");
}

#[test]
fn the_language_makes_every_service() {
    let reports = [
        ("write 0x6040:0 u16 0x000F", "602#2B4060000F000000"),
        ("read 0x6041:0", "602#4041600000000000"),
        ("read 0x6041", "602#4041600000000000"),
        ("write 0x60FF:0 i32 -1000", "602#23FF600018FCFFFF"),
        ("write 0x1010:1 u32 0x65766173", "602#2310100173617665"),
        ("write 0x2FF0:0 size 17", "602#21F02F0011000000"),
        ("upload-block 0x1008:0", "602#A40810007F000000"),
        ("download 0x1F50:1 64", "602#21501F0140000000"),
        ("download-block 0x1F50:1 64", "602#C6501F0140000000"),
        ("abort 0x1008:0 0x05040000", "602#8008100000000405"),
        ("read segment 1", "602#7000000000000000"),
        ("write segment 0 last 41 42", "602#0B41420000000000"),
        ("nmt start", "000#0102"),
        ("nmt stop all", "000#0200"),
        ("nmt pre-operational", "000#8002"),
        ("nmt reset", "000#8102"),
        ("nmt reset-communication", "000#8202"),
        ("sync", "080#"),
        ("sync 5", "080#05"),
        ("time 2026-11-21 14:24:37.000", "100#88941703313D"),
        ("emcy 0x8130 register 0x11", "082#3081110000000000"),
        ("emcy 0x160C short", "082#0C16"),
        ("heartbeat operational", "702#05"),
        ("boot-up", "702#00"),
        ("rpdo1 0F 00", "202#0F00"),
        ("tpdo2 01 02 03", "282#010203"),
        ("value 0x6041:0 u16 0x0037", "582#4B41600037000000"),
        ("written 0x6040:0", "582#6040600000000000"),
        ("refused 0x5FFF:0 0x06020000", "582#80FF5F0000000206"),
        ("lss configuration", "7E5#0401000000000000"),
        ("lss node 5", "7E5#1105000000000000"),
        ("lss bit-timing 0 2", "7E5#1300020000000000"),
        ("lss inquire vendor", "7E5#5A00000000000000"),
        ("lss inquire", "7E5#5E00000000000000"),
        ("lss fastscan", "7E5#5100000000800000"),
        ("lss reply node 0 0", "7E4#1100000000000000"),
        ("raw 0x702 01 02", "702#0102"),
    ];
    for (text, expected) in reports {
        let expected = frame(expected);
        assert_eq!(encode(text, 2), Ok(expected), "{text}");
    }
    let guard = encode("guard", 2).expect("a frame");
    assert_eq!((guard.id, guard.remote, guard.len), (0x702, true, 1));
    let request = encode("tpdo1 remote 2", 2).expect("a frame");
    assert_eq!((request.id, request.remote, request.len), (0x182, true, 2));
    for wrong in ["", "write 0x6040:0", "write 0x6040:0 u8 256", "nmt", "rpdo5 00", "read", "emcy"]
    {
        assert!(matches!(encode(wrong, 2), Err(EncodeError::Text(_))), "{wrong}");
    }
    assert!(encode("sync", 128).is_err() && encode("guard", 0).is_err());
    let Err(EncodeError::Text(error)) = encode("nmt start now", 2) else { panic!("refused") };
    assert_eq!((error.at, error.expected), (10, "the end"));
}

#[test]
fn a_profile_names_objects_and_faults() {
    let ts = profile("syntron-ts-canopen");
    let named = encode_with("write controlword 15", Some(2), ts);
    assert_eq!(named, Ok(frame("602#2B4060000F000000")));
    let named = encode_with("write target velocity 1000", Some(2), ts);
    assert_eq!(named, Ok(frame("602#23FF6000E8030000")));
    let text = explain_with(&frame("601#2B332000C8000000"), None, ts).text;
    assert!(text.starts_with("write 0x2033:0 ") && text.contains("Fn_33 "), "{text}");
    let text = explain_with(&frame("081#0C16"), None, ts).text;
    assert!(text.contains("oc") && text.to_lowercase().contains("current"), "{text}");
    assert!(explain(&frame("081#0C16")).text.contains("TS drive that shows oc"));
    let text = explain(&frame("602#2B4060000F000000")).text;
    assert_eq!(text, "write 0x6040:0 u16 0x000F (controlword = 15, enable operation)");
    let text = explain(&frame("182#3700")).text;
    assert_eq!(text, "tpdo1 37 00 (if mapped as usual: statusword = 55, operation enabled)");
    let text = explain(&frame("302#E8030000E8030000")).text;
    assert!(text.ends_with("(by its mapping, 0x1601)"), "{text}");
    let text = explain(&frame("602#2301160120008360")).text;
    assert!(text.contains("maps 0x6083:0 in 32 bits, profile acceleration"), "{text}");
}

#[test]
fn breakage_is_named() {
    let short = |need, found| Some(WireError::Short { need, found });
    let unexpected = |at, found| Some(WireError::Unexpected { at, found });
    let wrong = [
        ("602#2B406000", short(8, 4)),
        ("602#2340600000000F", short(8, 7)),
        ("000#01", short(2, 1)),
        ("000#0180", unexpected(1, 0x80)),
        ("000#5502", unexpected(0, 0x55)),
        ("702#0000", Some(WireError::Long { need: 1, found: 2 })),
        ("702#33", unexpected(0, 0x33)),
        ("082#000000", short(8, 3)),
        ("100#00", short(6, 1)),
        ("080#0102", Some(WireError::Long { need: 1, found: 2 })),
        ("080#00", Some(WireError::Count { at: 0, found: 0 })),
        ("602#E000000000000000", unexpected(0, 0xE0)),
        ("582#E900000000000000", unexpected(0, 0xE9)),
        ("582#A408100000000000", Some(WireError::Count { at: 4, found: 0 })),
        ("7E5#9900000000000000", unexpected(0, 0x99)),
    ];
    for (text, error) in wrong {
        let found = explain(&frame(text));
        assert_eq!(found.error, error, "{text}: {}", found.text);
        assert_eq!(encode_with(&found.text, found.axis, None), Ok(frame(text)), "{}", found.text);
    }
    let seven = explain(&frame("602#2F001600000000"));
    assert!(seven.error.is_none() && seven.text.contains("7 of 8 bytes"), "{}", seven.text);
}

#[test]
fn replies_belong_to_the_requests_of_their_node() {
    fn raw(frame: &Frame) -> RawFrame<'_> {
        RawFrame { bytes: frame.bytes(), id: Some(frame.id), extended: false }
    }
    let answers =
        |reply: &Frame, request: &Frame| CanopenDissector.is_answer_to(&raw(reply), &raw(request));
    let word = ObjectIndex::new(0x6041, 0);
    let request = SdoRequest::Read(word).emit(2);
    assert!(CanopenDissector.is_request(&raw(&request)));
    let reply = frame("582#4B41600037000000");
    assert!(!CanopenDissector.is_request(&raw(&reply)) && answers(&reply, &request));
    assert!(!answers(&frame("583#4B41600037000000"), &request));
    assert!(!answers(&frame("582#4B40600037000000"), &request));
    assert!(answers(&frame("582#8041600000000206"), &request));
    let part = Segment { toggle: true, last: true, len: 1, data: [0; 7] };
    let reply = SdoReply::ValueSegment(part).emit(2);
    let in_turn = SdoRequest::ReadSegment(true).emit(2);
    let out_of_turn = SdoRequest::ReadSegment(false).emit(2);
    assert!(answers(&reply, &in_turn) && !answers(&reply, &out_of_turn));
}

#[test]
fn codes_and_words_are_named() {
    let code = |code| CanopenDissector.code_meaning(code);
    assert_eq!(code(0x0602_0000), Some("object does not exist"));
    assert_eq!(code(0x8130), Some("communication"));
    assert_eq!(code(0x0237), Some("operation enabled"));
    assert_eq!(code(0x0602_0001), None);
    let named = |name: &str, value| {
        let mut found = RecordingSink::default();
        CanopenDissector.explain_named_value(name, value, None, &mut found).then_some(found)
    };
    let word = named("statusword", 0x0237).expect("a word");
    assert!(word.text.starts_with("operation enabled"), "{}", word.text);
    assert_eq!(word.fields.len(), 13);
    assert!(word.fields.contains(&("bit", "1".into(), "remote")));
    let word = named("controlword", 0x010F).expect("a word");
    assert_eq!(word.text, "enable operation, halt");
    assert_eq!(named("emcy", 0x8130).expect("a code").text, "communication");
    let object = named("0x6060:0", 4).expect("an object");
    assert_eq!(object.text, "mode = 4, profile torque");
    assert!(named("0F", 0).is_none() && named("nothing", 0).is_none());
}

#[test]
fn the_commands_size_says_how_many_bytes_are_the_value() {
    for (line, value, remark) in [
        ("583#4B41600018028FAF", "536", "unused bytes are not zero"),
        ("583#4F616000FE8FAF01", "-2", "unused bytes are not zero"),
        ("583#4B00200018028FAF", "536", "unused bytes are not zero"),
        ("583#4364600018028FAF", "-1349582312", ""),
        ("583#4B41600018020000", "536", ""),
    ] {
        let found = explain_with(&frame(line), None, profile("cia402"));
        assert_eq!(found.value("value"), value, "{line}");
        assert!(found.text.contains(remark), "{line}: {}", found.text);
        assert_eq!(found.text.contains("unused"), !remark.is_empty(), "{line}: {}", found.text);
    }
    // A drive that is known to have more bytes than the commands of its manual state (TS, chapter 3).
    let position =
        explain_with(&frame("602#2B7A6000A0860100"), None, profile("syntron-ts-canopen"));
    assert_eq!(position.value("value"), "100000");
    assert!(position.text.contains("size is too small"), "{}", position.text);
}
