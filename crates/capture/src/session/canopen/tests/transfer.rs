//! Service data.

use polepair_core::proto::canopen::sdo::Abort;

use super::*;
use crate::session::Outcome;

#[test]
fn a_value_in_one_frame_is_one_exchange() {
    let mut bus = Bus::default();
    let told = bus.read(WORD, 0x0637, 2).told();
    told.clean();
    let [exchange] = told.exchanges()[..] else { panic!("{told:?}") };
    assert_eq!((exchange.op, exchange.axis), ("SDO read", Some(5)));
    assert_eq!((exchange.outcome, exchange.latency()), (Outcome::Done, Some(1_000_000)));
    let [word] = told.signals("statusword")[..] else { panic!("{told:?}") };
    assert_eq!((word.exact, word.request), (Some(0x0637), Some(1)));
}

#[test]
fn segments_become_a_text() {
    let mut bus = Bus::default();
    let told = bus.read_long(NAME, b"A drive of ours\0").told();
    told.clean();
    assert!(told.lines[2].ends_with("(segment 1 of 3 of 0x1008:0, device name)"), "{told:#?}");
    let end = "(0x1008:0, device name = \"A drive of ours\", 16 bytes in 3 segments)";
    assert!(told.lines[7].ends_with(end), "{:#?}", told.lines);
    assert_eq!(told.exchanges().len(), 1);
}

fn download(bus: &mut Bus, object: Object, value: &[u8]) {
    bus.ask(Request::WriteLong(object, Some(value.len() as u32)));
    bus.answer(Reply::Written(object, 0));
    for segment in segments(value) {
        let toggle = segment.toggle;
        bus.ask(Request::WriteSegment(segment)).answer(Reply::WrittenSegment(toggle));
    }
}

#[test]
fn segments_are_written_too() {
    let mut bus = Bus::default();
    download(&mut bus, Object::new(0x2001, 1), &noise(40));
    let told = bus.told();
    told.clean();
    let [exchange] = told.exchanges()[..] else { panic!("{told:?}") };
    assert_eq!((exchange.op, exchange.outcome), ("SDO write", Outcome::Done));
    assert_eq!(exchange.answered.map(|(number, _)| number), Some(14));
}

/// Writes in blocks of `room` segments; of the first block `lost` segments do not arrive.
fn block_download(bus: &mut Bus, value: &[u8], room: u8, lost: u8, spoil: u16) {
    let object = Object::new(0x1F50, 1);
    bus.ask(Request::WriteBlock { object, crc: true, size: Some(value.len() as u32) });
    bus.answer(Reply::WriteBlockReady { object, crc: true, segments: room });
    let (all, mut at, mut lost) = (block_segments(value), 0, lost);
    while at < all.len() {
        let end = (at + usize::from(room)).min(all.len());
        for (segment, number) in all[at..end].iter().zip(1..) {
            let segment = BlockSegment { number, ..*segment };
            bus.say(0x600 | u16::from(NODE), &segment.bytes());
        }
        let arrived = (end - at) as u8 - core::mem::take(&mut lost);
        bus.answer(Reply::WriteBlockAck { arrived, segments: room });
        at += usize::from(arrived);
    }
    let unused = (7 - value.len() % 7) as u8 % 7;
    bus.ask(Request::WriteBlockEnd { unused, crc: crc(0, value) ^ spoil });
}

#[test]
fn blocks_are_written() {
    for len in [1, 7, 8, 21, 889, 5000] {
        let mut bus = Bus::default();
        block_download(&mut bus, &noise(len), 127, 0, 0);
        let told = bus.answer(Reply::WriteBlockDone).told();
        told.clean();
        let [exchange] = told.exchanges()[..] else { panic!("{told:?}") };
        assert_eq!((exchange.op, exchange.outcome), ("SDO write", Outcome::Done));
        assert!(told.lines[2].starts_with("SDO block write segment: "), "{}", told.lines[2]);
    }
}

#[test]
fn what_of_a_block_did_not_arrive_goes_again() {
    let mut bus = Bus::default();
    block_download(&mut bus, &noise(100), 4, 2, 0);
    let told = bus.answer(Reply::WriteBlockDone).told();
    told.planted(Oddity::Retry);
    assert_eq!(told.exchanges()[0].retries, 1);
    assert_eq!(told.exchanges()[0].outcome, Outcome::Done);
}

#[test]
fn a_wrong_check_of_a_block_is_told_once() {
    let mut bus = Bus::default();
    block_download(&mut bus, &noise(100), 20, 0, 1);
    let told = bus.answer(Reply::Abort(Object::new(0x1F50, 1), Abort::CRC)).told();
    told.planted(Oddity::BadCheck);
    assert_eq!(told.exchanges()[0].outcome, Outcome::Refused);
}

fn block_upload(bus: &mut Bus, value: &[u8], skip: usize) {
    let object = NAME;
    bus.ask(Request::ReadBlock { object, crc: true, segments: 127, threshold: 0 });
    bus.answer(Reply::ReadBlockReady { object, crc: true, size: Some(value.len() as u32) });
    bus.ask(Request::ReadBlockStart);
    let all = block_segments(value);
    for (at, segment) in all.iter().enumerate().filter(|(at, _)| at + 1 != skip) {
        bus.say(0x580 | u16::from(NODE), &segment.bytes());
        if segment.number == 127 || at + 1 == all.len() {
            bus.ask(Request::ReadBlockAck { arrived: segment.number, segments: 127 });
        }
    }
    let unused = (7 - value.len() % 7) as u8 % 7;
    bus.answer(Reply::ReadBlockEnd { unused, crc: crc(0, value) });
    bus.ask(Request::ReadBlockEnd);
}

#[test]
fn blocks_are_read() {
    for value in [b"x".to_vec(), b"a drive".to_vec(), noise(889), noise(3000)] {
        let mut bus = Bus::default();
        block_upload(&mut bus, &value, 0);
        let told = bus.told();
        told.clean();
        let [exchange] = told.exchanges()[..] else { panic!("{told:?}") };
        let count = bus.frames.len() as u64;
        assert_eq!(exchange.answered.map(|(number, _)| number), Some(count - 1));
    }
}

#[test]
fn a_segment_that_lacks_in_a_block_breaks_its_sequence() {
    let mut bus = Bus::default();
    block_upload(&mut bus, &noise(100), 3);
    bus.told().planted(Oddity::Sequence);
}

#[test]
fn a_refusal_has_its_meaning() {
    let mut bus = Bus::default();
    bus.ask(Request::Read(NAME)).answer(Reply::Abort(NAME, Abort::NO_OBJECT));
    let told = bus.told();
    told.planted(Oddity::Refused);
    assert_eq!(told.texts(), ["reading 0x1008:0 was refused: object does not exist"]);
    assert_eq!(told.exchanges()[0].outcome, Outcome::Refused);
}

#[test]
fn a_wrong_toggle_is_told_once() {
    for from_node in [false, true] {
        let mut bus = Bus::default();
        bus.read_long(NAME, &noise(30));
        let at = if from_node { 5 } else { 4 };
        bus.frames[at].1.data[0] ^= 0x10;
        bus.frames.truncate(6);
        bus.ask(Request::Abort(NAME, Abort::TOGGLE)).wait(20).read(WORD, 0, 2);
        bus.told().planted(Oddity::Sequence);
    }
}

#[test]
fn who_goes_on_leaves_a_transfer_incomplete() {
    let mut bus = Bus::default();
    bus.read_long(NAME, &noise(30)).frames.truncate(6);
    let told = bus.read(WORD, 0, 2).told();
    told.planted(Oddity::Incomplete);
    assert_eq!(told.exchanges().len(), 2);
    let mut bus = Bus::default();
    block_download(&mut bus, &noise(100), 20, 0, 0);
    bus.frames.truncate(8);
    bus.read(WORD, 0, 2).told().planted(Oddity::Incomplete);
}

#[test]
fn silence_is_told_when_the_time_is_over() {
    let mut bus = Bus::default();
    bus.read(WORD, 0, 2).ask(Request::Read(NAME)).wait(1500).say(0x80, &[]);
    let told = bus.told();
    told.planted(Oddity::Unanswered);
    assert_eq!(told.exchanges()[1].outcome, Outcome::Unanswered);
    // A late answer is one, and no foreign one.
    let told = bus.answer(Reply::Value(NAME, Short { bits: 1, len: 4 })).told();
    told.planted(Oddity::LateReply);
    assert_eq!(told.exchanges()[1].outcome, Outcome::Late);
}

#[test]
fn who_does_not_answer_any_more_is_told_once() {
    let mut bus = Bus::default();
    bus.read(WORD, 0, 2);
    for _ in 0..5 {
        bus.ask(Request::Read(NAME)).wait(300).ask(Request::Read(NAME)).wait(1500);
    }
    let told = bus.told();
    assert_eq!(told.odds(), [Oddity::Retry, Oddity::Unanswered]);
    assert_eq!(told.exchanges().len(), 6);
    bus.read(WORD, 0, 2).ask(Request::Read(NAME)).wait(1500).say(0x80, &[]);
    let odds = bus.told().odds();
    assert_eq!(odds, [Oddity::Retry, Oddity::Unanswered, Oddity::Unanswered]);
}

#[test]
fn storing_may_take_its_time() {
    let mut bus = Bus::default();
    let store = Object::new(0x1010, 1);
    bus.ask(Request::Write(store, Short { bits: 0x6576_6173, len: 4 })).wait(3000);
    bus.say(0x80, &[]).answer(Reply::Written(store, 0)).told().clean();
}

#[test]
fn the_same_request_again_is_a_retry() {
    let mut bus = Bus::default();
    bus.read(WORD, 0, 2).ask(Request::Read(NAME)).wait(200).read(NAME, 7, 4);
    let told = bus.told();
    told.planted(Oddity::Retry);
    assert_eq!(told.exchanges()[1].retries, 1);
    // Both requests may be answered.
    let value = Reply::Value(NAME, Short { bits: 7, len: 4 });
    bus.answer(value).told().planted(Oddity::Retry);
}

#[test]
fn an_answer_that_nobody_asked_for_is_foreign() {
    let mut bus = Bus::default();
    bus.read(WORD, 0, 2).wait(2000);
    bus.answer(Reply::Value(NAME, Short { bits: 7, len: 4 }));
    bus.told().planted(Oddity::ForeignReply);
    let mut bus = Bus::default();
    bus.read(WORD, 0, 2).ask(Request::Read(NAME));
    bus.answer(Reply::Value(Object::new(0x2000, 1), Short { bits: 7, len: 4 }));
    bus.answer(Reply::Value(NAME, Short { bits: 7, len: 4 }));
    bus.told().planted(Oddity::ForeignReply);
}

#[test]
fn an_answer_twice_is_one_node_s_and_always_twice_is_two_nodes() {
    let mut bus = Bus::default();
    bus.read(WORD, 0, 2).read(WORD, 1, 2).answer(Reply::Value(WORD, Short { bits: 1, len: 2 }));
    bus.read(WORD, 1, 2).read(WORD, 1, 2);
    bus.told().planted(Oddity::DuplicateReply);
    for bits in 0..20 {
        bus.read(WORD, bits, 2).answer(Reply::Value(WORD, Short { bits, len: 2 }));
    }
    let odds = bus.told().odds();
    let two = odds.iter().filter(|odd| **odd == Oddity::DuplicateAddress);
    assert_eq!((two.count(), odds.len()), (1, 3));
    let mut bus = Bus::default();
    let serial = Object::new(0x1018, 4);
    bus.read(serial, 1, 4).answer(Reply::Value(serial, Short { bits: 2, len: 4 }));
    bus.told().planted(Oddity::DuplicateAddress);
}

#[test]
fn nobody_is_accused_of_what_came_before_the_capture() {
    let mut bus = Bus::default();
    bus.read_long(NAME, &noise(60));
    download(&mut bus, Object::new(0x2001, 1), &noise(60));
    block_download(&mut bus, &noise(2000), 127, 0, 0);
    bus.answer(Reply::WriteBlockDone);
    block_upload(&mut bus, &noise(2000), 0);
    bus.read(WORD, 0, 2);
    bus.told().clean();
    for first in 0..bus.frames.len() {
        let told = bus.told_from(first);
        assert_eq!(told.texts(), [""; 0], "from frame {first}");
    }
}

#[test]
fn who_looks_for_nodes_accuses_none_of_not_being_there() {
    let mut bus = Bus::default();
    for node in 1..=127 {
        bus.frame(Request::Read(Object::new(0x1000, 0)).emit(node)).wait(50);
    }
    bus.wait(2000).say(0x80, &[]).told().clean();
    let mut bus = Bus::default();
    for _ in 0..6 {
        bus.ask(Request::Read(WORD)).wait(1500);
    }
    bus.told().planted(Oddity::Unanswered);
}

#[test]
fn other_channels_are_followed_once_configured() {
    let mut bus = Bus::default();
    bus.write(Object::new(0x1201, 1), 0x6E0, 4).write(Object::new(0x1201, 2), 0x5E0, 4);
    let ask = Request::Read(NAME).bytes();
    let tell = Reply::Value(NAME, Short { bits: 0x6F6C_6568, len: 4 }).bytes();
    let told = bus.say(0x6E0, &ask).say(0x5E0, &tell).told();
    told.clean();
    assert_eq!(told.exchanges().len(), 3);
    assert!(told.lines[5].starts_with("SDO value: value 0x1008:0"), "{:#?}", told.lines);
}
