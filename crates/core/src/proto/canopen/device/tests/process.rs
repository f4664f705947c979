//! PDOs: mapping, every transmission type, times, SYNC both ways, TIME.

use super::*;

const U8: u32 = 0x2000_0008;
const I16: u32 = 0x2001_0010;
const U32: u32 = 0x2002_0020;
const RO: u32 = 0x2007_0010;
const SYNC: u16 = 0x80;

fn started(fixture: &mut NodeFixture) -> Vec<Frame> {
    fixture.answers(frame(0, &[1, 5]))
}

#[test]
fn values_are_taken_as_mapped() {
    let mut fixture = NodeFixture::new();
    fixture.map(0, 255, &[I16, U8, U32]);
    let data = frame(0x205, &[0xFE, 0xFF, 7, 1, 2, 3, 4]);
    fixture.receive(data);
    assert_eq!(fixture.toy.values[0], 0, "not before operational");
    started(&mut fixture);
    assert_eq!(fixture.answers(data), []);
    assert_eq!(fixture.toy.values[..3], [7, (-2_i64) as u64, 0x0403_0201]);
    fixture.map(1, 255, &[0x0005_0008, U8]);
    fixture.receive(frame(0x305, &[9, 8]));
    assert_eq!(fixture.toy.values[0], 8, "behind a gap of eight bits");
}

#[test]
fn a_pdo_of_another_length_is_reported_and_a_short_one_not_used() {
    let mut fixture = NodeFixture::new();
    fixture.map(0, 255, &[U8, I16]);
    started(&mut fixture);
    let reports = fixture.answers(frame(0x205, &[1]));
    assert_eq!(reports, [frame(0x085, &[0x10, 0x82, 0x11, 0, 0, 0, 0, 0])]);
    assert_eq!(fixture.toy.values[0], 0);
    let reports = fixture.answers(frame(0x205, &[1, 2, 0, 9]));
    assert_eq!(reports, [frame(0x085, &[0x20, 0x82, 0x11, 0, 0, 0, 0, 0])]);
    assert_eq!(fixture.toy.values[..2], [1, 2]);
    let mut lenient = NodeFixture::with(Quirks { lenient: true, ..Quirks::STRICT });
    lenient.map(0, 255, &[U8, I16]);
    started(&mut lenient);
    assert_eq!(lenient.answers(frame(0x205, &[1])), []);
    assert_eq!(lenient.toy.values[..2], [1, 0], "whole values alone");
}

#[test]
fn a_synchronous_pdo_waits_for_sync() {
    let mut fixture = NodeFixture::new();
    fixture.map(0, 1, &[U8]);
    started(&mut fixture);
    fixture.receive(frame(0x205, &[1]));
    fixture.receive(frame(0x205, &[2]));
    assert_eq!(fixture.toy.values[0], 0);
    fixture.receive(frame(SYNC, &[]));
    assert_eq!((fixture.toy.values[0], fixture.toy.syncs), (2, 1), "the latest");
    fixture.toy.values[0] = 0;
    fixture.receive(frame(SYNC, &[]));
    assert_eq!(fixture.toy.values[0], 0, "once");
}

#[test]
fn each_nth_sync_is_answered() {
    for every in [1, 2, 240] {
        let mut fixture = NodeFixture::new();
        fixture.map(tpdo(0), every, &[RO, U8]);
        started(&mut fixture);
        for n in 1..=480_u16 {
            fixture.toy.values[usize::from(RO_AT)] = n.into();
            let [low, high] = n.to_le_bytes();
            let expected = [frame(0x185, &[low, high, 0])];
            let due = n % u16::from(every) == 0;
            assert_eq!(
                fixture.answers(frame(SYNC, &[])),
                expected[..usize::from(due)],
                "{every} {n}"
            );
        }
    }
}

#[test]
fn type_0_is_sent_with_sync_after_a_change() {
    let mut fixture = NodeFixture::new();
    fixture.map(tpdo(0), 0, &[RO]);
    started(&mut fixture);
    assert_eq!(fixture.answers(frame(SYNC, &[])), [frame(0x185, &[0, 0])], "once at the start");
    assert_eq!(fixture.answers(frame(SYNC, &[])), []);
    fixture.toy.values[usize::from(RO_AT)] = 3;
    assert_eq!(fixture.advance(5), []);
    assert_eq!(fixture.answers(frame(SYNC, &[])), [frame(0x185, &[3, 0])]);
    assert_eq!(fixture.answers(frame(SYNC, &[])), []);
}

#[test]
fn remote_requests_are_answered_sampled_or_fresh() {
    let mut fixture = NodeFixture::new();
    fixture.map(tpdo(0), 252, &[RO]);
    fixture.map(tpdo(1), 253, &[RO]);
    started(&mut fixture);
    fixture.toy.values[usize::from(RO_AT)] = 1;
    assert_eq!(fixture.answers(frame(SYNC, &[])), []);
    fixture.toy.values[usize::from(RO_AT)] = 2;
    assert_eq!(fixture.answers(remote(0x185)), [frame(0x185, &[1, 0])], "as at the SYNC");
    assert_eq!(fixture.answers(remote(0x285)), [frame(0x285, &[2, 0])]);
    let cob = fixture.read(0x1801, 1).unwrap();
    fixture.write(0x1801, 1, cob | 1 << 30, 4).unwrap();
    assert_eq!(fixture.answers(remote(0x285)), [], "no remote requests");
}

#[test]
fn a_change_is_sent_after_the_inhibit_time() {
    let mut fixture = NodeFixture::new();
    fixture.write(0x1800, 1, 1 << 31 | 0x185, 4).unwrap();
    fixture.write(0x1800, 3, 100, 2).unwrap();
    fixture.map(tpdo(0), 255, &[RO]);
    assert_eq!(started(&mut fixture), [frame(0x185, &[0, 0])]);
    fixture.toy.values[usize::from(RO_AT)] = 1;
    assert_eq!(fixture.advance(9), []);
    fixture.toy.values[usize::from(RO_AT)] = 2;
    assert_eq!(fixture.advance(2), [frame(0x185, &[2, 0])], "10 ms after the one before");
    assert_eq!(fixture.advance(50), []);
    assert_eq!(fixture.write(0x1800, 3, 0, 2), Err(AbortCode::STATE), "not while it exists");
}

#[test]
fn the_event_timer_sends_in_its_unit() {
    let truth =
        Quirks { lenient: true, type_254_by_timer: true, event_unit_us: 125, ..Quirks::STRICT };
    for (options, ms) in [(Quirks::STRICT, 400), (truth, 50)] {
        let mut fixture = NodeFixture::with(options);
        fixture.map(tpdo(0), 254, &[RO]);
        fixture.write(0x1800, 5, 400, 2).unwrap();
        started(&mut fixture);
        let frames = fixture.advance(10 * ms);
        assert_eq!(frames.len(), 10, "{ms}");
        fixture.toy.values[usize::from(RO_AT)] = 1;
        assert_eq!(fixture.advance(1).is_empty(), options.type_254_by_timer, "by time alone");
    }
}

#[test]
fn a_pdo_that_does_not_come_is_missed() {
    let mut fixture = NodeFixture::new();
    fixture.map(0, 255, &[U8]);
    fixture.write(0x1400, 5, 20, 2).unwrap();
    started(&mut fixture);
    assert_eq!(fixture.advance(100), [], "not before the first");
    fixture.receive(frame(0x205, &[1]));
    assert_eq!(fixture.advance(19), []);
    assert_eq!(fixture.advance(2)[0].data[..2], [0x50, 0x82]);
}

#[test]
fn mapping_follows_the_standards_procedure() {
    let mut fixture = NodeFixture::new();
    assert_eq!(fixture.write(0x1600, 0, 0, 1), Err(AbortCode::ACCESS), "while the PDO exists");
    fixture.write(0x1400, 1, 1 << 31 | 0x205, 4).unwrap();
    fixture.write(0x1600, 0, 0, 1).unwrap();
    assert_eq!(fixture.write(0x1600, 1, RO, 4), Err(AbortCode::NOT_MAPPABLE), "read only");
    assert_eq!(fixture.write(0x1600, 1, 0x5000_0008, 4), Err(AbortCode::NO_OBJECT));
    assert_eq!(fixture.write(0x1600, 1, 0x2001_0020, 4), Err(AbortCode::NOT_MAPPABLE), "length");
    assert_eq!(fixture.write(0x1600, 1, 0x2006_0020, 4), Err(AbortCode::NOT_MAPPABLE), "a domain");
    for sub in 1..=3 {
        fixture.write(0x1600, sub, U32, 4).unwrap();
    }
    assert_eq!(fixture.write(0x1600, 0, 3, 1), Err(AbortCode::PDO_LENGTH), "96 bits");
    assert_eq!(fixture.write(0x1600, 0, 9, 1), Err(AbortCode::PDO_LENGTH));
    fixture.write(0x1600, 0, 2, 1).unwrap();
    assert_eq!(fixture.write(0x1600, 1, U8, 4), Err(AbortCode::ACCESS), "while it is on");
    for wrong in [0x00, 0x7F, 0x101, 0x585, 0x605, 0x701, 0x2000_0205] {
        assert_eq!(fixture.write(0x1400, 1, wrong, 4), Err(AbortCode::VALUE), "{wrong:X}");
    }
    fixture.write(0x1400, 1, 0x334, 4).unwrap();
    assert_eq!(fixture.write(0x1400, 1, 0x335, 4), Err(AbortCode::STATE), "moved while it exists");
    assert_eq!(fixture.write(0x1400, 2, 241, 1), Err(AbortCode::VALUE));
    assert_eq!(fixture.write(0x1400, 2, 252, 1), Err(AbortCode::VALUE));
    assert_eq!(fixture.write(0x1800, 2, 252, 1), Ok(()));
    started(&mut fixture);
    fixture.receive(frame(0x334, &[5, 0, 0, 0, 6, 0, 0, 0]));
    assert_eq!(fixture.toy.values[usize::from(U32_AT)], 6);
    let mut lenient = NodeFixture::with(Quirks { lenient: true, ..Quirks::STRICT });
    started(&mut lenient);
    for (sub, value, len) in [(0, 0, 1), (1, U8, 4), (0, 1, 1)] {
        lenient.write(0x1600, sub, value, len).unwrap();
    }
    lenient.receive(frame(0x205, &[3]));
    assert_eq!(lenient.toy.values[0], 3, "in operational, without being switched off");
}

#[test]
fn the_counter_starts_pdos_at_its_value() {
    let mut fixture = NodeFixture::new();
    fixture.write(0x1019, 0, 4, 1).unwrap();
    fixture.write(0x1800, 1, 1 << 31 | 0x185, 4).unwrap();
    fixture.write(0x1800, 6, 3, 1).unwrap();
    fixture.map(tpdo(0), 2, &[RO]);
    started(&mut fixture);
    let sent: Vec<_> = (0..12).map(|n| fixture.answers(frame(SYNC, &[1 + n % 4])).len()).collect();
    assert_eq!(sent, [0, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0]);
    assert_eq!(fixture.answers(frame(SYNC, &[]))[0].data[..2], [0x40, 0x82], "without counter");
}

#[test]
fn bytes_after_the_window_are_dropped() {
    let mut fixture = NodeFixture::new();
    fixture.write(0x1007, 0, 1000, 4).unwrap();
    fixture.map(0, 1, &[U8]);
    fixture.map(tpdo(0), 1, &[RO]);
    started(&mut fixture);
    fixture.receive(frame(SYNC, &[]));
    fixture.now = fixture.now.plus_ms(2);
    assert_eq!(fixture.sent(), [], "the bus was busy for too long");
    fixture.receive(frame(0x205, &[1]));
    fixture.receive(frame(SYNC, &[]));
    assert_eq!(fixture.toy.values[0], 0);
    fixture.receive(frame(0x205, &[1]));
    fixture.receive(frame(SYNC, &[]));
    assert_eq!((fixture.toy.values[0], fixture.sent().len()), (1, 1));
}

#[test]
fn a_node_produces_sync_and_time() {
    let mut fixture = NodeFixture::new();
    fixture.write(0x1019, 0, 3, 1).unwrap();
    fixture.write(0x1006, 0, 10_000, 4).unwrap();
    assert_eq!(fixture.write(0x1019, 0, 0, 1), Err(AbortCode::STATE), "while a period is set");
    fixture.write(0x1005, 0, 1 << 30 | 0x80, 4).unwrap();
    fixture.map(tpdo(0), 1, &[RO]);
    let counters: Vec<_> = fixture.advance(50).iter().map(|sync| sync.data[0]).collect();
    assert_eq!(counters, [1, 2, 3, 1, 2]);
    started(&mut fixture);
    assert_eq!(fixture.advance(10), [frame(SYNC, &[3]), frame(0x185, &[0, 0])], "its own PDOs too");
    let time = TimeOfDay { days: 15_000, ms: 43_200_000 };
    fixture.receive(time.emit());
    assert_eq!(fixture.toy.time, time);
    fixture.write(0x1005, 0, 0x80, 4).unwrap();
    fixture.write(0x1012, 0, 1 << 30 | 0x100, 4).unwrap();
    assert_eq!(fixture.advance(1001), [time.emit()]);
}
