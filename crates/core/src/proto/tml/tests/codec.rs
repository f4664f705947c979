//! Golden vectors and round trips of the three encapsulations.

extern crate std;

use std::string::String;
use std::vec::Vec;

use crate::error::WireError;
use crate::medium::Frame;
use crate::proto::tml::rules::{TmlWire, WireRule};
use crate::proto::tml::serial::{self, Deframer, FRAME_MAX, RecoveryPolicy, SerialPiece};
use crate::proto::tml::technocan::{self, MessageClass};
use crate::proto::tml::tmlcan;
use crate::proto::tml::wire::{IdCode, Instruction, Message};

const VECTORS: &str = include_str!("../../../../../../vectors/tml.json");
const VIEWER: &str = include_str!("../../../../../../vectors/tml_viewer.json");

struct Vector {
    name: String,
    via: String,
    id: u32,
    bytes: Vec<u8>,
}

fn hex(text: &str) -> Vec<u8> {
    let digits: Vec<u8> = text.bytes().filter(|c| *c != b' ').collect();
    digits
        .chunks(2)
        .map(|pair| u8::from_str_radix(core::str::from_utf8(pair).unwrap(), 16).unwrap())
        .collect()
}

/// Every vector of both files; single bytes of the serial line apart.
fn vectors() -> Vec<Vector> {
    let json: serde_json::Value = serde_json::from_str(VECTORS).expect("vectors/tml.json");
    let viewer: serde_json::Value = serde_json::from_str(VIEWER).expect("vectors/tml_viewer.json");
    let text = |v: &serde_json::Value, key: &str| String::from(v[key].as_str().unwrap_or(""));
    let printed = json.as_array().unwrap().iter().map(|v| Vector {
        name: text(v, "name"),
        via: text(v, "kind").replace("-frame", ""),
        id: u32::from_str_radix(&text(v, "can_id"), 16).unwrap_or(0),
        bytes: hex(&text(v, "bytes")),
    });
    let viewed = viewer["vectors"].as_array().unwrap().iter().map(|v| {
        let frame = text(v, "frame");
        let (id, data) = frame.split_once('#').unwrap_or(("", ""));
        Vector {
            name: text(v, "name"),
            via: text(v, "via"),
            id: u32::from_str_radix(id, 16).unwrap_or(0),
            bytes: hex(if data.is_empty() { v["bytes"].as_str().unwrap_or("") } else { data }),
        }
    });
    printed.chain(viewed).filter(|v| v.via != "serial-byte").collect()
}

fn frame(v: &Vector) -> Frame {
    let mut frame = Frame::standard(0, &v.bytes);
    (frame.id, frame.extended) = (v.id, v.via == "tmlcan");
    frame
}

#[test]
fn every_vector_in_both_directions() {
    let vectors = vectors();
    for v in &vectors {
        match v.via.as_str() {
            "serial" => {
                let message =
                    serial::decode(&v.bytes).unwrap_or_else(|e| panic!("{}: {e}", v.name));
                let mut out = [0; FRAME_MAX];
                let len = serial::encode(&message, &mut out);
                assert_eq!(out[..len], v.bytes, "{}", v.name);
            }
            "tmlcan" => {
                let message = tmlcan::decode(&frame(v)).expect(&v.name);
                assert_eq!(tmlcan::encode(&message), frame(v), "{}", v.name);
            }
            "technocan" => {
                let content = technocan::decode(&frame(v)).expect(&v.name);
                // The class does not name the receiver of TakeData2: any host will do.
                let to = content.to.unwrap_or(IdCode::host_at(9));
                let again = Message { to, instruction: content.instruction };
                assert_eq!(technocan::encode(&again), Ok(frame(v)), "{}", v.name);
            }
            other => panic!("{}: via {other}", v.name),
        }
    }
    assert!(vectors.len() >= 280, "only {}", vectors.len());
}

fn read_serial(text: &str) -> Message {
    serial::decode(&hex(text)).expect(text)
}

fn read_technocan(id: u16, text: &str) -> technocan::FrameContent {
    technocan::decode(&Frame::standard(id, &hex(text))).expect(text)
}

#[test]
fn one_message_on_every_wire() {
    let message = Message { to: IdCode::axis(5), instruction: Instruction::of(0x205E, [0x1234]) };
    let mut out = [0; FRAME_MAX];
    let len = serial::encode(&message, &mut out);
    assert_eq!(out[..len], hex("06 00 50 20 5E 12 34 1A"));
    let frame = tmlcan::encode(&message);
    assert_eq!((frame.id, frame.bytes()), (0x0400_A05E, &[0x34, 0x12][..]));
    let frame = technocan::encode(&message).unwrap();
    assert_eq!((frame.id, frame.bytes()), (0x125, &[0x5E, 0x20, 0x34, 0x12][..]));
}

#[test]
fn technocan_gives_the_whole_instruction_back() {
    let answer = read_technocan(0x163, "04 28 2A 02 02 00");
    assert_eq!(answer.class, MessageClass::TakeData);
    assert_eq!((answer.to, answer.sender), (Some(IdCode::axis(3)), Some(5)));
    assert_eq!(answer.instruction, Instruction::of(0xB404, [0x0050, 0x022A, 2]));
    let point = read_technocan(0x045, "18 FC 00 FF F6 FF F4 01");
    assert_eq!(point.instruction, Instruction::of(0x1800, [0xFC18, 0xFF00, 0xFFF6, 0x01F4]));
    let status = read_technocan(0x101, "80 0E 09 00 84 01 02");
    assert_eq!((status.to, status.sender), (None, Some(1)));
    assert_eq!(status.instruction, Instruction::of(0xD501, [0x090E, 0x8400, 0x0201]));
    let pong = read_technocan(0x107, "40 31 35 4C 34");
    assert_eq!(pong.class, MessageClass::Pong);
    assert_eq!(pong.instruction, Instruction::of(0xD607, [0x3531, 0x344C]));
    let sync = read_technocan(0x020, "");
    assert_eq!(sync.message().unwrap().to, IdCode::BROADCAST);
}

#[test]
fn the_misprinted_answer_is_read_and_flagged() {
    let printed = read_technocan(0x165, "04 28 2A 02 02 00");
    assert!(printed.misprinted());
    assert_eq!(printed.instruction, Instruction::of(0xB404, [0x0050, 0x022A, 2]));
    assert!(!read_technocan(0x163, "04 28 2A 02 02 00").misprinted());
}

fn to(to: IdCode, instruction: Instruction) -> Result<u32, WireRule> {
    technocan::encode(&Message { to, instruction }).map(|frame| frame.id)
}

#[test]
fn technocan_axis_ids_and_groups() {
    let kpp = Instruction::of(0x205E, [5]);
    assert_eq!(to(IdCode::axis(31), kpp), Ok(0x13F));
    assert_eq!(to(IdCode::axis(255), kpp), Ok(0x13F));
    assert_eq!(to(IdCode::axis(33), kpp), Ok(0x121));
    assert!(technocan::is_ambiguous(33) && !technocan::is_ambiguous(255));
    assert_eq!(to(IdCode::groups(0b1_0001), kpp), Ok(0x011));
    assert_eq!(to(IdCode::groups(0b10_0000), kpp), Err(WireRule::TechnoCanGroups));
    assert_eq!(to(IdCode::BROADCAST, kpp), Ok(0x200));
    assert_eq!(to(IdCode::host_at(7), Instruction::of(0xA85E, [0x10, 5])), Ok(0x147));
    for id in [0, 32, 64, 224] {
        assert_eq!(to(IdCode::axis(id), kpp), Err(WireRule::TechnoCanAxis));
    }
    let from_32 = Instruction::of(0xD420, [0x0228, 1]);
    assert_eq!(to(IdCode::host_at(9), from_32), Err(WireRule::TechnoCanAxis));
}

#[test]
fn technocan_has_room_for_three_words() {
    let four = Instruction::of(0x9401, [0x10, 0x205E, 5, 0]);
    assert_eq!(to(IdCode::axis(5), four), Err(WireRule::TechnoCanWords));
    let point = Instruction::of(0x1805, [1, 2, 3, 4]);
    assert_eq!(to(IdCode::axis(5), point), Ok(0x045));
    assert_eq!(to(IdCode::groups(1), point), Err(WireRule::TechnoCanWords));
    let answer = Instruction::of(0xB405, [0x50, 0x0228, 1, 0]);
    assert_eq!(to(IdCode::axis(3), answer), Ok(0x163));
    let request = Instruction::of(0xB004, [0x30, 0x022A]);
    assert_eq!(to(IdCode::groups(1), request), Err(WireRule::GiveMeDataToGroup));
    assert_eq!(to(IdCode::BROADCAST, request), Err(WireRule::GiveMeDataToGroup));
}

/// CiA 301's identifiers as the manual's table lists them.
fn is_canopens(id: u32) -> bool {
    matches!(id, 0 | 0x80..=0x100 | 0x181..=0x1FF | 0x201..=0x27F | 0x281..=0x2FF | 0x301..=0x37F
        | 0x381..=0x3FF | 0x401..=0x47F | 0x481..=0x4FF | 0x501..=0x57F | 0x581..=0x5FF
        | 0x601..=0x67F | 0x701..=0x77F)
}

#[test]
fn canopens_identifiers_are_never_touched() {
    for id in 0..=0x7FF {
        let ours = MessageClass::of_id(id).is_some();
        assert!(!(ours && is_canopens(id)), "{id:03X}");
        let read = technocan::decode(&Frame::standard(id as u16, &[0; 8]));
        assert_eq!(read == Err(WireError::Identifier { found: id }), !ours, "{id:03X}");
    }
    for word in 0..=u16::MAX {
        let Some(to) = IdCode::from_word(word) else { continue };
        for opcode in [0x205E, 0x1000, 0x1800, 0xB404, 0xD401, 0xD6FF, 0xD7FF, 0xFFFF] {
            let message = Message { to, instruction: Instruction::of(opcode, [0x10, 0x0228]) };
            if let Ok(frame) = technocan::encode(&message) {
                assert!(MessageClass::of_id(frame.id).is_some(), "{message:?}: {:03X}", frame.id);
            }
        }
    }
}

#[test]
fn broken_serial_frames_are_named() {
    let good = hex("06 0F F0 20 5E 00 05 88");
    let err = |bytes: &[u8]| serial::decode(bytes).expect_err("broken");
    assert_eq!(err(&[]), WireError::Short { need: 6, found: 0 });
    assert_eq!(err(&good[..7]), WireError::Short { need: 8, found: 7 });
    assert_eq!(err(&[0x05]), WireError::Count { at: 0, found: 5 });
    let mut wrong = good.clone();
    wrong[7] ^= 1;
    assert_eq!(err(&wrong), WireError::Checksum { computed: 0x88, found: 0x89 });
    assert_eq!(err(&hex("04 0F F2 00 02 07")), WireError::Unexpected { at: 2, found: 0xF2 });
    assert_eq!(err(&hex("04 2F F0 00 02 25")), WireError::Unexpected { at: 1, found: 0x2F });
}

fn pieces(recovery: RecoveryPolicy, bytes: &[u8]) -> Vec<SerialPiece> {
    let mut deframer = Deframer::new(recovery);
    let mut all = Vec::new();
    for byte in bytes {
        deframer.push(*byte);
        all.extend(core::iter::from_fn(|| deframer.next_piece()));
    }
    all
}

#[test]
fn acks_and_syncs_stand_between_frames() {
    let stream = hex("4F 0A 0F F1 B4 04 0F F0 02 5E 01 20 42 FF 0D 4F");
    let answer = SerialPiece::Message(read_serial("0A 0F F1 B4 04 0F F0 02 5E 01 20 42"));
    let expected =
        [SerialPiece::Ack, answer, SerialPiece::Stray(0xFF), SerialPiece::Sync, SerialPiece::Ack];
    assert_eq!(pieces(RecoveryPolicy::Drop, &stream), expected);
    assert_eq!(pieces(RecoveryPolicy::Search, &stream), expected);
    assert!(serial::is_sync(0x0D) && serial::is_sync(0xFF) && !serial::is_sync(0x0C));
}

#[test]
fn a_drive_is_lost_until_it_is_synchronised() {
    // A byte of the frame was lost: the next frame's first byte is taken for its sum.
    let mut stream = hex("06 0F F0 20 5E 05 88");
    stream.extend([serial::SYNC; 2]);
    let found = pieces(RecoveryPolicy::Drop, &stream);
    assert!(matches!(
        found[..],
        [SerialPiece::Broken(WireError::Checksum { .. }), SerialPiece::Sync]
    ));
}

#[test]
fn a_host_finds_the_answer_behind_a_made_up_byte() {
    let stream = hex("0A 4F 0A 0F F1 B4 04 0F F0 02 5E 01 20 42");
    let found = pieces(RecoveryPolicy::Search, &stream);
    let answer = SerialPiece::Message(read_serial("0A 0F F1 B4 04 0F F0 02 5E 01 20 42"));
    assert!(
        matches!(found[..], [SerialPiece::Broken(_), SerialPiece::Ack, last] if last == answer)
    );
}

#[test]
fn rules_of_the_serial_wires() {
    let request = |to: IdCode, opcode: u16| Message {
        to,
        instruction: Instruction::of(opcode, [0x0FF0, 0x022A]),
    };
    assert_eq!(
        TmlWire::Rs485.check(&request(IdCode::groups(1), 0xB204)),
        Err(WireRule::Rs485AnswersFromGroup)
    );
    assert_eq!(
        TmlWire::Rs485.check(&request(IdCode::axis(0), 0xB004)),
        Err(WireRule::Rs485AnswersFromGroup)
    );
    assert_eq!(TmlWire::Rs485.check(&request(IdCode::axis(1), 0xB004)), Ok(()));
    assert_eq!(TmlWire::Rs232.check(&request(IdCode::groups(1), 0xB204)), Ok(()));
    assert_eq!(
        TmlWire::TmlCan.check(&request(IdCode::groups(1), 0xB004)),
        Err(WireRule::GiveMeDataToGroup)
    );
    assert_eq!(TmlWire::Rs485.check_unsolicited(), Err(WireRule::Rs485Unsolicited));
    assert_eq!(TmlWire::Rs232.check_host_id(255, 255), Ok(()));
    assert_eq!(TmlWire::Rs232.check_host_id(3, 255), Err(WireRule::Rs232HostId));
    assert_eq!(TmlWire::TmlCan.check_host_id(5, 5), Err(WireRule::OwnHostId));
    assert_eq!(
        TmlWire::TechnoCan.check_host_id(255, 31),
        Err(WireRule::OwnHostId),
        "255 acts as 31"
    );
    assert!(TmlWire::Rs485.acknowledges(IdCode::axis(1)));
    assert!(!TmlWire::Rs485.acknowledges(IdCode::groups(1)));
    assert!(TmlWire::Rs232.acknowledges(IdCode::groups(1)));
    assert_eq!(TmlWire::Rs232.host_id_code(255).word(), 0x0FF1);
    assert_eq!(TmlWire::Rs485.host_id_code(255).word(), 0x0FF0);
}

#[test]
fn tmlcan_refuses_foreign_identifiers() {
    let err = |frame: &Frame| tmlcan::decode(frame).expect_err("foreign");
    let good =
        tmlcan::encode(&Message { to: IdCode::axis(5), instruction: Instruction::of(0x205E, [5]) });
    assert_eq!(
        err(&Frame { id: good.id | 0x400, ..good }),
        WireError::Identifier { found: good.id | 0x400 }
    );
    assert_eq!(err(&Frame { extended: false, ..good }), WireError::Identifier { found: good.id });
    assert_eq!(err(&Frame { len: 3, ..good }), WireError::Count { at: 0, found: 3 });
}
