//! Golden vectors, round trips, and every byte as a specifier.

extern crate std;

use std::string::String;
use std::vec::Vec;

use crate::error::WireError;
use crate::medium::Frame;
use crate::proto::canopen::Cob;
use crate::proto::canopen::emcy::Emergency;
use crate::proto::canopen::heartbeat::{Heartbeat, guarding_request};
use crate::proto::canopen::lss::{self, IdentifyBound, IdentityNumber};
use crate::proto::canopen::nmt::{NmtCommand, NmtMessage, NmtState};
use crate::proto::canopen::pdo::{
    BitField, CobId, MappingEntry, MappingError, PdoMapping, Transmission,
};
use crate::proto::canopen::sdo::{
    self, AbortCode, BlockSegment, ExpeditedData, ObjectIndex, SEGMENT, SdoReply, SdoRequest,
    Segment,
};
use crate::proto::canopen::sync::SyncMessage;
use crate::proto::canopen::time::TimeOfDay;

const VECTORS: &str = include_str!("../../../../../../vectors/canopen.json");

pub struct Vector {
    pub name: String,
    pub kind: String,
    pub frame: Frame,
}

pub fn vectors() -> Vec<Vector> {
    let json: serde_json::Value = serde_json::from_str(VECTORS).expect("vectors/canopen.json");
    let vector = |v: &serde_json::Value| {
        let text = |key: &str| String::from(v[key].as_str().unwrap_or(""));
        let hex = |word: &str| u8::from_str_radix(word, 16).unwrap();
        let bytes: Vec<u8> = text("bytes").split_whitespace().map(hex).collect();
        let id = u16::from_str_radix(text("can_id").trim_start_matches("0x"), 16).unwrap();
        let mut frame = Frame::standard(id, &bytes);
        frame.len = v["dlc"].as_u64().unwrap() as u8;
        frame.remote = v["rtr"].as_bool().unwrap_or(false);
        Vector { name: text("name"), kind: text("kind"), frame }
    };
    json.as_array().unwrap().iter().map(vector).collect()
}

/// The frame made anew from what was read in it.
fn reencode(v: &Vector) -> Frame {
    let (frame, bytes) = (&v.frame, v.frame.bytes());
    match Cob::of(frame.id as u16) {
        Cob::Nmt => NmtMessage::parse(bytes).unwrap().emit(),
        Cob::Sync => SyncMessage::parse(bytes).unwrap().emit(),
        Cob::Emcy(node) if frame.len == 2 => Emergency::parse(bytes).unwrap().emit_short(node),
        Cob::Emcy(node) => Emergency::parse(bytes).unwrap().emit(node),
        Cob::SdoReply(node) => SdoReply::of(frame.data).emit(node),
        // The manual prints nine requests with seven bytes; zeros stand for what lacks.
        Cob::SdoRequest(node) => Frame { len: frame.len, ..SdoRequest::of(frame.data).emit(node) },
        Cob::Heartbeat(node) if frame.remote => guarding_request(node),
        Cob::Heartbeat(node) => Heartbeat::parse(bytes).unwrap().emit(node),
        Cob::Tpdo(..) | Cob::Rpdo(..) => *frame,
        other => panic!("{}: {other:?}", v.name),
    }
}

#[test]
fn every_printed_frame_is_read_and_made_again() {
    let vectors = vectors();
    assert!(vectors.len() >= 150);
    for v in &vectors {
        assert_eq!(reencode(v), v.frame, "{}", v.name);
        let kind = match Cob::of(v.frame.id as u16) {
            Cob::Nmt => "nmt",
            Cob::Emcy(_) => "emcy",
            Cob::Tpdo(..) => "tpdo",
            Cob::Rpdo(..) => "rpdo",
            Cob::SdoReply(_) => "sdo-rsp",
            Cob::SdoRequest(_) => "sdo-req",
            Cob::Heartbeat(_) if v.frame.remote => "guard-rtr",
            Cob::Heartbeat(_) => "heartbeat",
            other => panic!("{}: {other:?}", v.name),
        };
        assert_eq!(kind, v.kind, "{}", v.name);
    }
}

#[test]
fn every_identifier_has_one_meaning() {
    for id in 0..=0x7FF {
        assert_eq!(Cob::of(id).id(), id);
        assert!(Cob::of(id).node().is_none_or(|node| (1..=127).contains(&node)));
    }
    let intended: [(u16, Cob); 12] = [
        (0x000, Cob::Nmt),
        (0x005, Cob::Other(0x005)),
        (0x080, Cob::Sync),
        (0x081, Cob::Emcy(1)),
        (0x100, Cob::Time),
        (0x180, Cob::Other(0x180)),
        (0x182, Cob::Tpdo(1, 2)),
        (0x4FF, Cob::Tpdo(4, 127)),
        (0x502, Cob::Rpdo(4, 2)),
        (0x702, Cob::Heartbeat(2)),
        (0x7E4, Cob::LssReply),
        (0x7E5, Cob::LssRequest),
    ];
    for (id, cob) in intended {
        assert_eq!(Cob::of(id), cob);
    }
}

#[test]
fn every_specifier_is_read_and_made_again() {
    for head in 0..=255 {
        let bytes = [head, 0x40, 0x60, 2, 0x78, 0x56, 0x34, 0x12];
        // Reserved bits do not change the value that is read.
        let request = SdoRequest::of(bytes);
        assert_eq!(SdoRequest::of(request.bytes()), request, "{head:02X}");
        let reply = SdoReply::of(bytes);
        assert_eq!(SdoReply::of(reply.bytes()), reply, "{head:02X}");
        let lss = lss::LssRequest::parse(&bytes).unwrap();
        assert_eq!(lss::LssRequest::parse(&lss.bytes()), Ok(lss), "{head:02X}");
        let lss = lss::LssReply::parse(&bytes).unwrap();
        assert_eq!(lss::LssReply::parse(&lss.bytes()), Ok(lss), "{head:02X}");
        assert_eq!(BlockSegment::of(bytes).bytes(), bytes);
        assert_eq!(u8::from(NmtCommand::from(head)), head);
        assert_eq!(u8::from(NmtState::from(head)), head & 0x7F);
        assert_eq!(u8::from(Transmission::from(head)), head);
        let heartbeat = Heartbeat::parse(&[head]).unwrap();
        assert_eq!(heartbeat.emit(5), Frame::standard(0x705, &[head]));
    }
}

#[test]
fn transfers_have_the_standards_bytes() {
    let object = ObjectIndex::new(0x1008, 3);
    let head = |request: SdoRequest| request.bytes()[0];
    let short = |len| ExpeditedData { bits: 0x44332211, len };
    assert_eq!(SdoRequest::Write(object, short(4)).bytes(), [0x23, 8, 0x10, 3, 17, 34, 51, 68]);
    let heads: [(SdoRequest, u8); 10] = [
        (SdoRequest::Write(object, short(1)), 0x2F),
        (SdoRequest::Write(object, short(2)), 0x2B),
        (SdoRequest::Write(object, short(3)), 0x27),
        (SdoRequest::Write(object, short(0)), 0x22),
        (SdoRequest::WriteLong(object, Some(9)), 0x21),
        (SdoRequest::WriteLong(object, None), 0x20),
        (SdoRequest::ReadSegment(true), 0x70),
        (SdoRequest::ReadBlockStart, 0xA3),
        (SdoRequest::ReadBlockEnd, 0xA1),
        (SdoRequest::WriteBlock { object, crc: true, size: Some(9) }, 0xC6),
    ];
    for (request, specifier) in heads {
        assert_eq!(head(request), specifier, "{request:?}");
    }
    let read = SdoRequest::ReadBlock { object, crc: true, segments: 127, threshold: 21 };
    assert_eq!(read.bytes(), [0xA4, 8, 0x10, 3, 127, 21, 0, 0]);
    assert_eq!(
        SdoRequest::WriteBlockEnd { unused: 5, crc: 0x1234 }.bytes()[..3],
        [0xD5, 0x34, 0x12]
    );
    assert_eq!(SdoReply::WriteBlockAck { arrived: 4, segments: 7 }.bytes()[..3], [0xA2, 4, 7]);
    assert_eq!(
        SdoReply::ReadBlockReady { object, crc: false, size: Some(0x0102) }.bytes(),
        [0xC2, 8, 0x10, 3, 2, 1, 0, 0]
    );
    assert_eq!(sdo::as_eight_bytes(&[0; 7]), Err(WireError::Short { need: 8, found: 7 }));
}

#[test]
fn segments_say_how_many_of_their_bytes_count() {
    for len in 0..=SEGMENT as u8 {
        let segment = Segment { toggle: len % 2 == 0, last: len < 7, len, data: *b"segment" };
        assert_eq!(SdoRequest::of(SdoRequest::WriteSegment(segment).bytes()), {
            SdoRequest::WriteSegment(segment)
        });
        assert_eq!(
            SdoReply::of(SdoReply::ValueSegment(segment).bytes()),
            SdoReply::ValueSegment(segment)
        );
        assert_eq!(segment.bytes(), &b"segment"[..usize::from(len)]);
    }
    // The last segment of "Tiny Node - Mega Domains !", as the standard's users send it.
    let last = SdoReply::of([0x05, b'i', b'n', b's', b' ', b'!', 0, 0]);
    let SdoReply::ValueSegment(segment) = last else { panic!("{last:?}") };
    assert_eq!((segment.last, segment.bytes()), (true, &b"ins !"[..]));
}

#[test]
fn the_block_check_is_xmodems() {
    assert_eq!(sdo::crc(0, b"123456789"), 0x31C3);
    assert_eq!(sdo::crc(sdo::crc(0, b"1234"), b"56789"), 0x31C3);
    assert_eq!(sdo::crc(0, &[]), 0);
}

#[test]
fn every_abort_of_the_standard_has_its_words() {
    let vectors = vectors();
    let aborts = vectors.iter().filter(|v| v.name.starts_with("o_abort_"));
    for v in aborts {
        let SdoReply::Abort(object, abort) = SdoReply::of(v.frame.data) else {
            panic!("{}", v.name)
        };
        assert_eq!(object, ObjectIndex::new(0x2033, 0));
        assert_eq!(std::format!("o_abort_{:08x}", abort.0), v.name);
        assert!(abort.text().is_some(), "{}", v.name);
    }
    assert_eq!(AbortCode(0x1234).text(), None);
}

#[test]
fn emergencies_come_in_two_forms() {
    let full = Emergency { code: 0x8130, register: 0x11, vendor: [1, 2, 3, 4, 5] };
    assert_eq!(full.emit(3), Frame::standard(0x083, &[0x30, 0x81, 0x11, 1, 2, 3, 4, 5]));
    assert_eq!(Emergency::parse(full.emit(3).bytes()), Ok(full));
    let short = Emergency { code: 0x160C, ..Emergency::default() };
    assert_eq!(Emergency::parse(short.emit_short(1).bytes()), Ok(short));
    assert_eq!(Emergency::parse(&[1, 2, 3]), Err(WireError::Short { need: 8, found: 3 }));
}

#[test]
fn time_begins_in_1984() {
    // 2024-02-29 12:34:56.789
    let unix_ms = 1_709_210_096_789;
    let time = TimeOfDay::from_unix_ms(unix_ms).unwrap();
    assert_eq!((time.days, time.ms), (14_669, 45_296_789));
    assert_eq!(time.unix_ms(), unix_ms);
    assert_eq!(TimeOfDay::parse(time.emit().bytes()), Ok(time));
    assert_eq!(TimeOfDay::from_unix_ms(0), None);
    assert_eq!(TimeOfDay::from_unix_ms(u64::MAX), None);
    assert!(TimeOfDay::parse(&[0; 5]).is_err());
}

#[test]
fn lss_has_the_standards_bytes() {
    let bytes = |request: lss::LssRequest| request.bytes();
    assert_eq!(bytes(lss::LssRequest::SwitchGlobal(true))[..2], [4, 1]);
    let selective = lss::LssRequest::SwitchSelective(IdentityNumber::Serial, 0x1234_5678);
    assert_eq!(bytes(selective)[..5], [0x43, 0x78, 0x56, 0x34, 0x12]);
    let bound = lss::LssRequest::Identify(IdentifyBound::SerialHigh, 9);
    assert_eq!(bytes(bound)[..2], [0x4B, 9]);
    let scan = lss::LssRequest::FastScan {
        number: 0x0102_0304,
        bit: 31,
        sub: IdentityNumber::Product,
        next: IdentityNumber::Revision,
    };
    assert_eq!(bytes(scan), [0x51, 4, 3, 2, 1, 31, 1, 2]);
    assert_eq!(
        lss::LssReply::Identified.emit(),
        Frame::standard(0x7E4, &[0x4F, 0, 0, 0, 0, 0, 0, 0])
    );
    assert_eq!(lss::LssRequest::InquireNode.emit().id, 0x7E5);
    assert!(lss::LssReply::parse(&[0x4F]).is_err());
}

#[test]
fn network_management_is_two_bytes() {
    let message = NmtMessage { command: NmtCommand::Start, node: 6 };
    assert_eq!(message.emit(), Frame::standard(0, &[1, 6]));
    assert_eq!(NmtMessage::parse(&[1]), Err(WireError::Short { need: 2, found: 1 }));
    assert_eq!(NmtMessage::parse(&[1, 128]), Err(WireError::Unexpected { at: 1, found: 128 }));
    assert_eq!(SyncMessage::parse(&[7]), Ok(SyncMessage { counter: Some(7) }));
    assert!(SyncMessage::parse(&[7, 8]).is_err());
    assert!(Heartbeat::parse(&[]).is_err());
}

#[test]
fn a_mapping_lays_values_one_behind_the_other() {
    let raw = [0x6041_0010, 0x0005_0008, 0x6064_0020, 0x6061_0008];
    let map: PdoMapping = PdoMapping::new(raw.map(MappingEntry::from)).unwrap();
    assert_eq!(map.bytes(), 8);
    let data = u64::from_le_bytes([0x37, 0x06, 0, 0xFE, 0xFF, 0xFF, 0xFF, 0xFF]);
    let values: Vec<i64> = map.fields().map(|(_, field)| field.signed(data)).collect();
    assert_eq!(values, [0x0637, 0, -2, -1]);
    assert_eq!(map.fields().nth(2).unwrap().1.unsigned(data), 0xFFFF_FFFE);
    assert!(map.fields().nth(1).unwrap().0.is_gap());
    let back: Vec<u32> = map.fields().map(|(entry, _)| entry.into()).collect();
    assert_eq!(back, raw);
}

#[test]
fn a_mapping_has_64_bits() {
    let entry = |bits| MappingEntry { object: ObjectIndex::new(0x2000, 1), bits };
    let mut map: PdoMapping<3> = PdoMapping::new([entry(32), entry(31)]).unwrap();
    assert_eq!(map.push(entry(2)), Err(MappingError::TooLong));
    assert_eq!(map.push(entry(0)), Err(MappingError::EmptyEntry));
    assert_eq!(map.push(entry(1)), Ok(()));
    assert_eq!(map.bytes(), 8);
    let full: PdoMapping<1> = PdoMapping::new([entry(8)]).unwrap();
    assert_eq!({ full }.push(entry(8)), Err(MappingError::TooMany));
    assert_eq!(PdoMapping::<1>::default().push(entry(255)), Err(MappingError::TooLong));
}

#[test]
fn a_field_returns_its_value_and_changes_no_other() {
    for at in 0..64 {
        for bits in 1..=64 - at {
            let field = BitField { start: at, bits };
            let value = 0xA5A5_5A5A_0F0F_F0F1_u64 & u64::MAX >> (64 - bits);
            for around in [0, u64::MAX] {
                let data = field.insert(around, value);
                assert_eq!(field.unsigned(data), value);
                let sign = value >> (bits - 1) & 1 != 0;
                assert_eq!(field.signed(data) < 0, sign);
                assert_eq!(field.insert(data, field.unsigned(around)), around);
            }
        }
    }
}

#[test]
fn identifiers_of_objects_have_flags() {
    assert_eq!(CobId(0x4000_0182).id(), 0x182);
    assert!(CobId(0x182).is_valid() && !CobId(0x8000_0182).is_valid());
    assert_eq!(CobId(0x2123_4567).id(), 0x0123_4567);
}
