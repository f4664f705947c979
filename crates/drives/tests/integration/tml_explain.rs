//! Explanations for people: pieces of streams, fields, replies, refusals.

use polepair_core::error::WireError;
use polepair_core::explain::{
    Context, Direction, Dissector, EncodeError, EncodeOptions, ExplainSink, Field, FieldValue,
    FrameBoundary, FrameConversation, FrameFormat, RawFrame, WireKind,
};
use polepair_core::proto::tml::explain::{SERIAL, TECHNOCAN, TMLCAN};
use polepair_core::proto::tml::rules::WireRule;
use polepair_core::proto::tml::serial;
use polepair_core::proto::tml::wire::{IdCode, Instruction, Message};
use polepair_drives::technosoft::profile::TECHNOSOFT_F514L;

#[derive(Default, Debug)]
struct ExplainedFields {
    kind: String,
    axis: Option<u32>,
    fields: Vec<(&'static str, (u16, u16), String)>,
    text: String,
    error: Option<WireError>,
}

impl ExplainSink for ExplainedFields {
    fn kind(&mut self, kind: &str) {
        self.kind = kind.into();
    }
    fn axis(&mut self, axis: u32) {
        self.axis = Some(axis);
    }
    fn field(&mut self, field: Field<'_>) {
        assert!(field.start <= field.end, "{field:?}");
        let value = match field.value {
            FieldValue::Text(text) => text.to_string(),
            FieldValue::Int(value) => value.to_string(),
            FieldValue::Hex(value, _) => format!("{value:X}"),
            FieldValue::Real(value) => value.to_string(),
            FieldValue::Words(words) => format!("{words:02X?}"),
        };
        self.fields.push((field.name, (field.start, field.end), value));
    }
    fn text(&mut self, piece: &str) {
        self.text.push_str(piece);
    }
    fn error(&mut self, error: WireError) {
        self.error = Some(error);
    }
}

impl ExplainedFields {
    fn field(&self, name: &str) -> &str {
        let found = self.fields.iter().find(|(field, ..)| *field == name);
        found.map_or("", |(.., value)| value)
    }

    fn field_range(&self, name: &str) -> Option<(u16, u16)> {
        self.fields.iter().find(|(field, ..)| *field == name).map(|(_, position, _)| *position)
    }
}

fn hex(text: &str) -> Vec<u8> {
    text.split_whitespace().map(|b| u8::from_str_radix(b, 16).unwrap()).collect()
}

fn serial(text: &str, context: &Context<'_>) -> ExplainedFields {
    let mut seen = ExplainedFields::default();
    SERIAL.explain(&hex(text), context, &mut seen);
    seen
}

fn can(dissector: &dyn Dissector, id: u32, text: &str) -> ExplainedFields {
    let mut seen = ExplainedFields::default();
    let context = Context { id: Some(id), extended: id > 0x7FF, ..Context::default() };
    dissector.explain(&hex(text), &context, &mut seen);
    seen
}

const ASK: &str = "08 00 10 B0 04 0F F1 02 5E 2C";
const TAKE: &str = "0A 0F F1 B4 04 00 10 02 5E 01 20 53";

#[test]
fn fields_have_their_bytes() {
    let seen = serial(ASK, &Context::default());
    assert_eq!((seen.kind.as_str(), seen.axis), ("GiveMeData", Some(1)));
    assert_eq!(seen.field("sender"), "the host at axis 255");
    let places = ["length", "to", "opcode", "sender", "address", "checksum"];
    let expected = [(0, 1), (1, 3), (3, 5), (5, 7), (7, 9), (9, 10)];
    assert_eq!(places.map(|name| seen.field_range(name)), expected.map(Some));
    let seen = serial(TAKE, &Context::default());
    assert_eq!((seen.kind.as_str(), seen.axis), ("TakeData", Some(1)));
    assert_eq!((seen.field("value"), seen.field_range("value")), ("288", Some((9, 11))));
    assert!(seen.text.ends_with("from axis 1 to the host at axis 255, by relay axis 255"));
    let seen = serial("0C 00 50 18 00 FC 18 FF 00 FF F6 01 F4 71", &Context::default());
    assert_eq!((seen.field("position"), seen.field("velocity")), ("-1000", "-10"));
}

#[test]
fn can_frames_say_what_their_class_leaves() {
    let seen = can(&TMLCAN, 0x1A80_6005, "2A 02 02 00");
    assert_eq!((seen.kind.as_str(), seen.axis, seen.field("value")), ("TakeData2", Some(5), "2"));
    assert_eq!(seen.field_range("to"), Some((0, 0)));
    let seen = can(&TECHNOCAN, 0x163, "04 28 2A 02 02 00");
    assert_eq!((seen.kind.as_str(), seen.field("class")), ("TakeData", "TakeData"));
    assert_eq!((seen.field("sender"), seen.field_range("sender")), ("axis 5", Some((1, 2))));
    let printed = can(&TECHNOCAN, 0x165, "04 28 2A 02 02 00");
    assert!(printed.error.is_none() && printed.text.contains("as the manual prints it"));
    let host = can(&TECHNOCAN, 0x147, "5E A8 10 00 05 00");
    assert_eq!((host.field("class"), host.axis), ("Host", Some(1)));
    assert!(host.text.contains("by relay axis 7"), "{}", host.text);
    let mer = can(&TECHNOCAN, 0x102, "00 FC 08 08 00");
    assert_eq!((mer.axis, mer.field("class"), mer.field("value")), (Some(2), "TakeData2", "8"));
    assert!(mer.text.contains("unasked"));
    let pong = can(&TECHNOCAN, 0x107, "40 31 35 4C 34");
    assert_eq!((pong.kind.as_str(), pong.field("firmware")), ("PONG", "F514L"));
    assert!(can(&TECHNOCAN, 0x181, "00").error.is_some());
}

#[test]
fn bytes_between_frames_are_frames_of_their_own() {
    let (host, drive) = (Some(Direction::ToDrive), Some(Direction::ToHost));
    assert_eq!(SERIAL.find_frame(&hex("4F 0D"), drive, false), FrameBoundary::Frame(1));
    assert_eq!(SERIAL.find_frame(&hex("FF FF"), host, false), FrameBoundary::Frame(1));
    assert_eq!(
        SERIAL.find_frame(&hex("4F"), host, false),
        FrameBoundary::Skip(1),
        "hosts acknowledge nothing"
    );
    assert_eq!(SERIAL.find_frame(&hex("41"), None, false), FrameBoundary::Skip(1));
    let request = hex(ASK);
    let context = Context { request: Some(&request), direction: drive, ..Context::default() };
    let ack = serial("4F", &context);
    assert_eq!((ack.kind.as_str(), ack.axis), ("ack", Some(1)));
    assert!(ack.text.starts_with("ack of "));
    assert_eq!(serial("FF", &Context { direction: host, ..context }).kind, "synchronisation byte");
    assert!(serial("04", &Context::default()).error.is_some());
}

#[test]
fn streams_are_cut_and_cut_again_behind_junk() {
    let cut = |text: &str, ended: bool| SERIAL.find_frame(&hex(text), None, ended);
    assert_eq!(cut(TAKE, false), FrameBoundary::Frame(12));
    assert_eq!(cut("0A 0F F1 B4", false), FrameBoundary::Incomplete);
    assert_eq!(cut("0A 0F F1 B4", true), FrameBoundary::Corrupt(4));
    let wrong = TAKE.replace("01 20", "01 21");
    assert_eq!(cut(&wrong, true), FrameBoundary::Corrupt(12));
    assert_eq!(
        cut(&wrong, false),
        FrameBoundary::Incomplete,
        "a good frame may begin among its bytes"
    );
    assert_eq!(cut(&format!("{wrong} {ASK}"), false), FrameBoundary::Corrupt(12));
    // A serial server made up a byte that could be a length.
    assert_eq!(cut(&format!("0A {TAKE}"), false), FrameBoundary::Skip(1));
    // A byte was lost: the length of the next frame is at the place of the checksum.
    assert_eq!(cut(&format!("06 0F F0 20 5E 05 88 {ASK}"), false), FrameBoundary::Corrupt(7));
    assert_eq!(serial(&wrong, &Context::default()).field("value"), "289");
}

#[test]
fn answers_find_their_requests() {
    let raw = |bytes| RawFrame { bytes, ..RawFrame::default() };
    let (request, take) = (hex(ASK), hex(TAKE));
    let other = hex("0A 0F F1 B4 04 0F F0 02 5E 01 20 42");
    assert!(SERIAL.is_request(&raw(&request)) && !SERIAL.is_request(&raw(&[0xFF])));
    assert!(SERIAL.is_answer_to(&raw(&take), &raw(&request)));
    assert!(!SERIAL.is_answer_to(&raw(&other), &raw(&request)), "another axis answers");
    let frame = |id, bytes| RawFrame { bytes, id: Some(id), extended: false };
    let (request, take) = (hex("04 B0 30 00 2A 02"), hex("04 28 2A 02 02 00"));
    let (raw_frame, take) = (frame(0x125, request.as_slice()), frame(0x163, take.as_slice()));
    assert!(
        TECHNOCAN.is_request(&raw_frame)
            && !TECHNOCAN.is_request(&take)
            && TECHNOCAN.is_answer_to(&take, &raw_frame)
    );
}

fn refusal(dissector: &dyn Dissector, text: &str, addressing: EncodeOptions) -> EncodeError {
    dissector.encode(text, &addressing, &mut [0; 14]).expect_err("a refusal")
}

#[test]
fn a_request_that_the_wire_forbids_is_refused_in_a_sentence() {
    let to = |axis| EncodeOptions { axis: Some(axis), ..EncodeOptions::default() };
    let group = EncodeOptions { groups: true, wire: WireKind::Rs485, ..to(1) };
    let forbidden = |rule: WireRule| EncodeError::Forbidden(rule.sentence());
    let ask_2 = ".word 0xB204, 0x0FF0, 0x022A";
    assert_eq!(refusal(&SERIAL, ask_2, group), forbidden(WireRule::Rs485AnswersFromGroup));
    assert_eq!(refusal(&TECHNOCAN, ".word 0x0002", to(64)), forbidden(WireRule::TechnoCanAxis));
    let sixth = EncodeOptions { groups: true, ..to(0x20) };
    assert_eq!(refusal(&TECHNOCAN, ".word 0x0002", sixth), forbidden(WireRule::TechnoCanGroups));
    let same = EncodeOptions { host: Some(5), ..to(5) };
    assert_eq!(
        refusal(&TMLCAN, ".word 0xB004, 0x0050, 0x022A", same),
        forbidden(WireRule::OwnHostId)
    );
    assert!(matches!(refusal(&SERIAL, "not TML", to(1)), EncodeError::Text(_)));
    let via_can = EncodeOptions { wire: WireKind::Can, ..to(1) };
    assert!(matches!(refusal(&SERIAL, ".word 0x0002", via_can), EncodeError::Forbidden(_)));
}

#[test]
fn the_answer_is_reported_as_far_as_it_is_known() {
    let expected = |dissector: &dyn Dissector, text: &str, addressing: EncodeOptions| {
        let mut bytes = [0; 14];
        let encoded = dissector.encode(text, &addressing, &mut bytes).expect("a message");
        let (bytes, id) = (&bytes[..encoded.len], encoded.id);
        let raw = RawFrame { bytes, id, extended: encoded.extended };
        let mut seen = ExplainedFields::default();
        dissector.explain_expected_reply(&raw, &addressing, &mut seen);
        (encoded.answer_len, seen)
    };
    let to = |axis| EncodeOptions { axis: Some(axis), ..EncodeOptions::default() };
    let (bytes, seen) = expected(&SERIAL, ".word 0x205E, 0x0005", to(255));
    assert_eq!((bytes, seen.kind.as_str(), seen.text.as_str()), (Some(1), "ack", "4F"));
    let (bytes, seen) = expected(&SERIAL, ".word 0xB004, 0x0FF1, 0x025E", to(255));
    assert_eq!((bytes, seen.kind.as_str()), (Some(13), "TakeData"));
    assert_eq!(seen.field("frame"), "0A 0F F1 B4 04 0F F0 02 5E ?? ?? ??");
    let (bytes, seen) = expected(&TECHNOCAN, ".word 0xB005, 0x0030, 0x0228", to(5));
    assert_eq!((bytes, seen.field("frame")), (Some(8), "163#05282802????????"));
    let group = EncodeOptions { groups: true, ..to(1) };
    let (bytes, seen) = expected(&TMLCAN, ".word 0xB204, 0x0030, 0x022A", group);
    assert_eq!((bytes, seen.field("frame")), (None, "2A 02 ?? ??"));
    let (bytes, seen) = expected(&TMLCAN, ".word 0x205E, 0x0005", to(5));
    assert_eq!((bytes, seen.kind.as_str()), (None, ""), "nothing answers it on CAN");
}

#[test]
fn a_register_is_reported_bit_by_bit() {
    let named = |name: &str, value| {
        let mut seen = ExplainedFields::default();
        let found = SERIAL.explain_named_value(name, value, Some(&TECHNOSOFT_F514L), &mut seen);
        found.then_some(seen)
    };
    let error = named("mer", 0x0008).expect("a register");
    assert_eq!((error.kind.as_str(), error.field("CTRER")), ("MER", "1"));
    assert!(error.text.contains("remedy  free the shaft"), "{}", error.text);
    assert_eq!(named("AAR", 0x01FF).expect("a register").field("AXISID"), "255");
    let both = named("SR32", 0x0201_8400).expect("two registers");
    assert_eq!((both.field("AXISST"), both.field("TRGR")), ("1", "1"));
    assert!(named("KPP", 5).is_none());
    let frame = hex("0A 0F F1 D5 FF 09 0E 84 00 02 01 7C");
    let context = Context { profile: Some(&TECHNOSOFT_F514L), ..Context::default() };
    let mut seen = ExplainedFields::default();
    SERIAL.explain(&frame, &context, &mut seen);
    let output = "(axis on, motion complete, target command reached, initialised)";
    assert!(seen.text.contains(output), "{}", seen.text);
}

/// TML communication manual, chapters 3 and 4: GiveMeData is for one axis, and on RS-485 no request goes
/// to a group. A host on RS-232 has the host bit, one on RS-485 has not.
#[test]
fn requests_that_the_manual_forbids_are_flagged() {
    let give = |to: IdCode, sender: IdCode, opcode: u16| {
        let instruction = Instruction::of(opcode, [sender.word(), 0x022A]);
        let mut out = [0; serial::FRAME_MAX];
        let len = serial::encode(&Message { to, instruction }, &mut out);
        let mut seen = ExplainedFields::default();
        SERIAL.explain(&out[..len], &Context::default(), &mut seen);
        seen.text
    };
    let group = IdCode::groups(1);
    let text = give(group, IdCode::axis(200), 0xB204);
    assert!(text.contains("not allowed: on RS-485 no request for data goes to a group"), "{text}");
    let text = give(group, IdCode::host_at(255), 0xB004);
    assert!(text.contains("not allowed: GiveMeData is for one axis"), "{text}");
    for (to, sender, opcode) in
        [(group, IdCode::host_at(255), 0xB204), (IdCode::axis(5), IdCode::axis(200), 0xB004)]
    {
        let text = give(to, sender, opcode);
        assert!(!text.contains("not allowed"), "{text}");
    }
}

/// H in the destination: a message for the host, as answers are.
#[test]
fn a_text_is_encoded_for_a_host() {
    let options = EncodeOptions { axis: Some(5), to_host: true, ..EncodeOptions::default() };
    let mut out = [0; 16];
    let text = "@0x022A == 5 FROM 7";
    let len = SERIAL.encode(text, &options, &mut out).expect("a frame").len;
    let message = serial::decode(&out[..len]).expect("a message");
    assert_eq!(message.to, IdCode::host_at(5));
    assert_eq!(message.instruction, Instruction::of(0xB404, [0x0070, 0x022A, 5]));
}
