//! Service data.

use polepair_core::proto::canopen::sdo::AbortCode;

use super::*;
use crate::session::ExchangeOutcome;

#[test]
fn a_value_in_one_frame_is_one_exchange() {
    let mut bus = CanopenLog::default();
    let report = bus.read(WORD, 0x0637, 2).report();
    report.assert_clean();
    let [exchange] = report.exchanges()[..] else { panic!("{report:?}") };
    assert_eq!((exchange.op, exchange.axis), ("SDO read", Some(5)));
    assert_eq!((exchange.outcome, exchange.latency()), (ExchangeOutcome::Done, Some(1_000_000)));
    let [word] = report.signals("statusword")[..] else { panic!("{report:?}") };
    assert_eq!((word.exact, word.request), (Some(0x0637), Some(1)));
}

#[test]
fn segments_become_a_text() {
    let mut bus = CanopenLog::default();
    let report = bus.read_long(NAME, b"A drive of ours\0").report();
    report.assert_clean();
    assert!(report.lines[2].ends_with("(segment 1 of 3 of 0x1008:0, device name)"), "{report:#?}");
    let end = "(0x1008:0, device name = \"A drive of ours\", 16 bytes in 3 segments)";
    assert!(report.lines[7].ends_with(end), "{:#?}", report.lines);
    assert_eq!(report.exchanges().len(), 1);
}

fn download(bus: &mut CanopenLog, object: ObjectIndex, value: &[u8]) {
    bus.request(SdoRequest::WriteLong(object, Some(value.len() as u32)));
    bus.reply(SdoReply::Written(object, 0));
    for segment in segments(value) {
        let toggle = segment.toggle;
        bus.request(SdoRequest::WriteSegment(segment)).reply(SdoReply::WrittenSegment(toggle));
    }
}

#[test]
fn segments_are_written_too() {
    let mut bus = CanopenLog::default();
    download(&mut bus, ObjectIndex::new(0x2001, 1), &noise(40));
    let report = bus.report();
    report.assert_clean();
    let [exchange] = report.exchanges()[..] else { panic!("{report:?}") };
    assert_eq!((exchange.op, exchange.outcome), ("SDO write", ExchangeOutcome::Done));
    assert_eq!(exchange.answered.map(|(number, _)| number), Some(14));
}

/// Writes in blocks of `room` segments; of the first block `lost` segments do not arrive.
fn block_download(bus: &mut CanopenLog, value: &[u8], capacity: u8, lost: u8, spoil: u16) {
    let object = ObjectIndex::new(0x1F50, 1);
    bus.request(SdoRequest::WriteBlock { object, crc: true, size: Some(value.len() as u32) });
    bus.reply(SdoReply::WriteBlockReady { object, crc: true, segments: capacity });
    let (all, mut at, mut lost) = (block_segments(value), 0, lost);
    while at < all.len() {
        let end = (at + usize::from(capacity)).min(all.len());
        for (segment, number) in all[at..end].iter().zip(1..) {
            let segment = BlockSegment { number, ..*segment };
            bus.send(0x600 | u16::from(NODE), &segment.bytes());
        }
        let arrived = (end - at) as u8 - core::mem::take(&mut lost);
        bus.reply(SdoReply::WriteBlockAck { arrived, segments: capacity });
        at += usize::from(arrived);
    }
    let unused = (7 - value.len() % 7) as u8 % 7;
    bus.request(SdoRequest::WriteBlockEnd { unused, crc: crc(0, value) ^ spoil });
}

#[test]
fn blocks_are_written() {
    for len in [1, 7, 8, 21, 889, 5000] {
        let mut bus = CanopenLog::default();
        block_download(&mut bus, &noise(len), 127, 0, 0);
        let report = bus.reply(SdoReply::WriteBlockDone).report();
        report.assert_clean();
        let [exchange] = report.exchanges()[..] else { panic!("{report:?}") };
        assert_eq!((exchange.op, exchange.outcome), ("SDO write", ExchangeOutcome::Done));
        assert!(report.lines[2].starts_with("SDO block write segment: "), "{}", report.lines[2]);
    }
}

#[test]
fn missing_segments_of_a_block_are_sent_again() {
    let mut bus = CanopenLog::default();
    block_download(&mut bus, &noise(100), 4, 2, 0);
    let report = bus.reply(SdoReply::WriteBlockDone).report();
    report.assert_only(AnomalyKind::Retry);
    assert_eq!(report.exchanges()[0].retries, 1);
    assert_eq!(report.exchanges()[0].outcome, ExchangeOutcome::Done);
}

#[test]
fn a_wrong_check_of_a_block_is_reported_once() {
    let mut bus = CanopenLog::default();
    block_download(&mut bus, &noise(100), 20, 0, 1);
    let report = bus.reply(SdoReply::Abort(ObjectIndex::new(0x1F50, 1), AbortCode::CRC)).report();
    report.assert_only(AnomalyKind::BadCheck);
    assert_eq!(report.exchanges()[0].outcome, ExchangeOutcome::Refused);
}

fn block_upload(bus: &mut CanopenLog, value: &[u8], skip: usize) {
    let object = NAME;
    bus.request(SdoRequest::ReadBlock { object, crc: true, segments: 127, threshold: 0 });
    bus.reply(SdoReply::ReadBlockReady { object, crc: true, size: Some(value.len() as u32) });
    bus.request(SdoRequest::ReadBlockStart);
    let all = block_segments(value);
    for (at, segment) in all.iter().enumerate().filter(|(at, _)| at + 1 != skip) {
        bus.send(0x580 | u16::from(NODE), &segment.bytes());
        if segment.number == 127 || at + 1 == all.len() {
            bus.request(SdoRequest::ReadBlockAck { arrived: segment.number, segments: 127 });
        }
    }
    let unused = (7 - value.len() % 7) as u8 % 7;
    bus.reply(SdoReply::ReadBlockEnd { unused, crc: crc(0, value) });
    bus.request(SdoRequest::ReadBlockEnd);
}

#[test]
fn blocks_are_read() {
    for value in [b"x".to_vec(), b"a drive".to_vec(), noise(889), noise(3000)] {
        let mut bus = CanopenLog::default();
        block_upload(&mut bus, &value, 0);
        let report = bus.report();
        report.assert_clean();
        let [exchange] = report.exchanges()[..] else { panic!("{report:?}") };
        let count = bus.frames.len() as u64;
        assert_eq!(exchange.answered.map(|(number, _)| number), Some(count - 1));
    }
}

#[test]
fn a_segment_that_lacks_in_a_block_breaks_its_sequence() {
    let mut bus = CanopenLog::default();
    block_upload(&mut bus, &noise(100), 3);
    bus.report().assert_only(AnomalyKind::Sequence);
}

#[test]
fn a_refusal_has_its_meaning() {
    let mut bus = CanopenLog::default();
    bus.request(SdoRequest::Read(NAME)).reply(SdoReply::Abort(NAME, AbortCode::NO_OBJECT));
    let report = bus.report();
    report.assert_only(AnomalyKind::Refused);
    assert_eq!(report.texts(), ["reading 0x1008:0 was refused: object does not exist"]);
    assert_eq!(report.exchanges()[0].outcome, ExchangeOutcome::Refused);
}

#[test]
fn a_wrong_toggle_is_reported_once() {
    for from_node in [false, true] {
        let mut bus = CanopenLog::default();
        bus.read_long(NAME, &noise(30));
        let at = if from_node { 5 } else { 4 };
        bus.frames[at].1.data[0] ^= 0x10;
        bus.frames.truncate(6);
        bus.request(SdoRequest::Abort(NAME, AbortCode::TOGGLE)).wait(20).read(WORD, 0, 2);
        bus.report().assert_only(AnomalyKind::Sequence);
    }
}

#[test]
fn a_client_that_goes_on_leaves_a_transfer_incomplete() {
    let mut bus = CanopenLog::default();
    bus.read_long(NAME, &noise(30)).frames.truncate(6);
    let report = bus.read(WORD, 0, 2).report();
    report.assert_only(AnomalyKind::Incomplete);
    assert_eq!(report.exchanges().len(), 2);
    let mut bus = CanopenLog::default();
    block_download(&mut bus, &noise(100), 20, 0, 0);
    bus.frames.truncate(8);
    bus.read(WORD, 0, 2).report().assert_only(AnomalyKind::Incomplete);
}

#[test]
fn silence_is_reported_after_the_time_limit() {
    let mut bus = CanopenLog::default();
    bus.read(WORD, 0, 2).request(SdoRequest::Read(NAME)).wait(1500).send(0x80, &[]);
    let report = bus.report();
    report.assert_only(AnomalyKind::Unanswered);
    assert_eq!(report.exchanges()[1].outcome, ExchangeOutcome::Unanswered);
    // A late answer is one, and no foreign one.
    let report = bus.reply(SdoReply::Value(NAME, ExpeditedData { bits: 1, len: 4 })).report();
    report.assert_only(AnomalyKind::LateReply);
    assert_eq!(report.exchanges()[1].outcome, ExchangeOutcome::Late);
}

#[test]
fn a_node_that_falls_silent_is_reported_once() {
    let mut bus = CanopenLog::default();
    bus.read(WORD, 0, 2);
    for _ in 0..5 {
        bus.request(SdoRequest::Read(NAME)).wait(300).request(SdoRequest::Read(NAME)).wait(1500);
    }
    let report = bus.report();
    assert_eq!(report.anomalies(), [AnomalyKind::Retry, AnomalyKind::Unanswered]);
    assert_eq!(report.exchanges().len(), 6);
    bus.read(WORD, 0, 2).request(SdoRequest::Read(NAME)).wait(1500).send(0x80, &[]);
    let odds = bus.report().anomalies();
    assert_eq!(odds, [AnomalyKind::Retry, AnomalyKind::Unanswered, AnomalyKind::Unanswered]);
}

#[test]
fn storing_may_take_its_time() {
    let mut bus = CanopenLog::default();
    let store = ObjectIndex::new(0x1010, 1);
    bus.request(SdoRequest::Write(store, ExpeditedData { bits: 0x6576_6173, len: 4 })).wait(3000);
    bus.send(0x80, &[]).reply(SdoReply::Written(store, 0)).report().assert_clean();
}

#[test]
fn the_same_request_again_is_a_retry() {
    let mut bus = CanopenLog::default();
    bus.read(WORD, 0, 2).request(SdoRequest::Read(NAME)).wait(200).read(NAME, 7, 4);
    let report = bus.report();
    report.assert_only(AnomalyKind::Retry);
    assert_eq!(report.exchanges()[1].retries, 1);
    // Both requests may be answered.
    let value = SdoReply::Value(NAME, ExpeditedData { bits: 7, len: 4 });
    bus.reply(value).report().assert_only(AnomalyKind::Retry);
}

#[test]
fn a_reply_without_a_request_is_foreign() {
    let mut bus = CanopenLog::default();
    bus.read(WORD, 0, 2).wait(2000);
    bus.reply(SdoReply::Value(NAME, ExpeditedData { bits: 7, len: 4 }));
    bus.report().assert_only(AnomalyKind::ForeignReply);
    let mut bus = CanopenLog::default();
    bus.read(WORD, 0, 2).request(SdoRequest::Read(NAME));
    bus.reply(SdoReply::Value(ObjectIndex::new(0x2000, 1), ExpeditedData { bits: 7, len: 4 }));
    bus.reply(SdoReply::Value(NAME, ExpeditedData { bits: 7, len: 4 }));
    bus.report().assert_only(AnomalyKind::ForeignReply);
}

#[test]
fn an_answer_twice_is_one_node_s_and_always_twice_is_two_nodes() {
    let mut bus = CanopenLog::default();
    bus.read(WORD, 0, 2)
        .read(WORD, 1, 2)
        .reply(SdoReply::Value(WORD, ExpeditedData { bits: 1, len: 2 }));
    bus.read(WORD, 1, 2).read(WORD, 1, 2);
    bus.report().assert_only(AnomalyKind::DuplicateReply);
    for bits in 0..20 {
        bus.read(WORD, bits, 2).reply(SdoReply::Value(WORD, ExpeditedData { bits, len: 2 }));
    }
    let odds = bus.report().anomalies();
    let two = odds.iter().filter(|anomaly_kind| **anomaly_kind == AnomalyKind::DuplicateAddress);
    assert_eq!((two.count(), odds.len()), (1, 3));
    let mut bus = CanopenLog::default();
    let serial = ObjectIndex::new(0x1018, 4);
    bus.read(serial, 1, 4).reply(SdoReply::Value(serial, ExpeditedData { bits: 2, len: 4 }));
    bus.report().assert_only(AnomalyKind::DuplicateAddress);
}

#[test]
fn traffic_before_the_capture_is_no_anomaly() {
    let mut bus = CanopenLog::default();
    bus.read_long(NAME, &noise(60));
    download(&mut bus, ObjectIndex::new(0x2001, 1), &noise(60));
    block_download(&mut bus, &noise(2000), 127, 0, 0);
    bus.reply(SdoReply::WriteBlockDone);
    block_upload(&mut bus, &noise(2000), 0);
    bus.read(WORD, 0, 2);
    bus.report().assert_clean();
    for first in 0..bus.frames.len() {
        let report = bus.report_from(first);
        assert_eq!(report.texts(), [""; 0], "from frame {first}");
    }
}

#[test]
fn a_scan_for_nodes_reports_no_missing_node() {
    let mut bus = CanopenLog::default();
    for node in 1..=127 {
        bus.frame(SdoRequest::Read(ObjectIndex::new(0x1000, 0)).emit(node)).wait(50);
    }
    bus.wait(2000).send(0x80, &[]).report().assert_clean();
    let mut bus = CanopenLog::default();
    for _ in 0..6 {
        bus.request(SdoRequest::Read(WORD)).wait(1500);
    }
    bus.report().assert_only(AnomalyKind::Unanswered);
}

#[test]
fn other_channels_are_followed_once_configured() {
    let mut bus = CanopenLog::default();
    bus.write(ObjectIndex::new(0x1201, 1), 0x6E0, 4).write(ObjectIndex::new(0x1201, 2), 0x5E0, 4);
    let request = SdoRequest::Read(NAME).bytes();
    let tell = SdoReply::Value(NAME, ExpeditedData { bits: 0x6F6C_6568, len: 4 }).bytes();
    let report = bus.send(0x6E0, &request).send(0x5E0, &tell).report();
    report.assert_clean();
    assert_eq!(report.exchanges().len(), 3);
    assert!(report.lines[5].starts_with("SDO value: value 0x1008:0"), "{:#?}", report.lines);
}

/// The node took so long that the client gave up, and starts meanwhile: the answer is late, and no other request's.
#[test]
fn an_answer_to_what_was_given_up_is_late_behind_a_boot_up() {
    let object = ObjectIndex::new(0x1000, 0);
    for starts in [false, true] {
        let mut bus = CanopenLog::default();
        bus.request(SdoRequest::Read(object)).wait(600);
        bus.request(SdoRequest::Abort(object, AbortCode::TIMEOUT)).wait(50);
        if starts {
            bus.send(0x700 | u16::from(NODE), &[0]).wait(20);
        }
        let value = ExpeditedData { bits: 0x0002_0192, len: 4 };
        let report = bus.reply(SdoReply::Value(object, value)).report();
        assert!(report.texts().iter().any(|text| text.starts_with("the answer for 0x1000:0 came")));
        let found = report.anomalies();
        assert!(!found.contains(&AnomalyKind::DuplicateAddress), "{starts}: {found:?}");
        assert!(!found.contains(&AnomalyKind::DuplicateReply), "{starts}: {found:?}");
    }
}
