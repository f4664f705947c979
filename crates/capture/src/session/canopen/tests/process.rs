//! Process data, SYNC, and the meaning of a drive's words.

use super::*;
use crate::session::Quality;

#[test]
fn a_mapping_of_the_capture_names_every_object() {
    let mut bus = CanopenLog::default();
    bus.map(0x185, &[(0x6041, 16), (0x6064, 32), (0x2345, 8)]);
    let report = bus.send(0x185, &[0x37, 0x06, 0xFF, 0xFF, 0xFF, 0xFF, 9]).report();
    report.assert_clean();
    let [notice] = report.signals("Actual/Position")[..] else { panic!("{report:?}") };
    assert_eq!((notice.exact, notice.quality), (Some(-1), Quality::Good));
    assert_eq!(report.signals("0x2345:0")[0].value, 9.0);
    assert_eq!(report.signals("State/Enabled")[0].value, 1.0);
    let line = report.lines.last().expect("a line");
    assert!(line.starts_with("TPDO1: tpdo1 37 06 FF FF FF FF 09 ("), "{line}");
    assert!(line.ends_with(" | position actual = -1 | 0x2345:0 = 9)"), "{line}");
}

#[test]
fn a_mapping_that_is_read_counts_too() {
    let mut bus = CanopenLog::default();
    let velocity = MappingEntry { object: ObjectIndex::new(0x606C, 0), bits: 32 };
    bus.read(ObjectIndex::new(0x1A02, 0), 1, 1).read(
        ObjectIndex::new(0x1A02, 1),
        velocity.into(),
        4,
    );
    let report = bus.send(0x385, &[1, 0, 0, 0]).report();
    report.assert_clean();
    assert_eq!(report.signals("Actual/Velocity")[0].value, 1.0);
}

#[test]
fn a_pdo_that_moved_is_recognised_and_its_old_identifier_is_not() {
    for id in [0x1C0, 0x6F1, 0x001] {
        let mut bus = CanopenLog::default();
        bus.map(id, &[(0x6064, 32)]);
        let report = bus.send(id as u16, &[7, 0, 0, 0]).send(0x185, &[1, 2]).report();
        report.assert_clean();
        let [notice] = report.signals("Actual/Position")[..] else {
            panic!("{id:03X} {report:#?}")
        };
        assert_eq!((notice.axis, notice.value), (5, 7.0));
        assert!(report.lines[report.lines.len() - 2].starts_with("TPDO1: "), "{:#?}", report.lines);
    }
}

#[test]
fn another_length_than_mapped_is_reported_once() {
    let mut bus = CanopenLog::default();
    bus.map(0x185, &[(0x6041, 16), (0x6064, 32)]).send(0x185, &[0x37, 6, 0, 0, 0, 0]);
    bus.send(0x185, &[0x37, 6]).send(0x185, &[0x37, 6]);
    let report = bus.report();
    report.assert_only(AnomalyKind::Length);
    assert_eq!(report.signals("Actual/Position").len(), 1);
}

#[test]
fn unknown_values_are_not_guessed() {
    let mut bus = CanopenLog::default();
    let report = bus.send(0x185, &[1, 2, 3]).send(0x205, &[1, 2]).report();
    report.assert_clean();
    assert!(report.signals("statusword").is_empty());
    // The device type is that of a drive: then the usual mapping is likely.
    let mut bus = CanopenLog::default();
    let report =
        bus.read(ObjectIndex::new(0x1000, 0), 0x0002_0192, 4).send(0x185, &[0x37, 6]).report();
    report.assert_clean();
    assert_eq!(report.signals("statusword")[0].quality, Quality::Inferred);
}

#[test]
fn a_start_makes_what_was_written_doubtful() {
    let mut bus = CanopenLog::default();
    bus.map(0x185, &[(0x6041, 16), (0x6064, 32)]).send(0x000, &[0x81, NODE]);
    bus.send(0x705, &[0]).send(0x185, &[0x37, 6]).report().assert_clean();
}

/// A device that answers with one byte has another object there.
#[test]
fn one_byte_of_a_statusword_is_no_state() {
    let statusword = ObjectIndex::new(0x6041, 0);
    let mut bus = CanopenLog::default();
    assert!(bus.read(statusword, 0x37, 1).report().changes("power").is_empty());
    let mut bus = CanopenLog::default();
    assert_eq!(bus.read(statusword, 0x237, 2).report().changes("power").len(), 1);
}

#[test]
fn the_states_of_a_drive_are_changes() {
    let mut bus = CanopenLog::default();
    bus.map(0x185, &[(0x6041, 16), (0x6061, 8)]);
    for (word, mode) in
        [(0x40, 0), (0x21, 1), (0x23, 1), (0x27, 1), (0x427, 1), (0x08, 1), (0x40, 1)]
    {
        bus.send(0x185, &[(word & 0xFF) as u8, (word >> 8) as u8, mode]);
    }
    let report = bus.report();
    report.assert_clean();
    let power = report.changes("power");
    assert_eq!(power.len(), 6, "{power:?}");
    assert_eq!(power[0], ("", "switch on disabled"));
    assert_eq!(power[4], ("operation enabled", "fault"));
    assert_eq!(report.changes("mode"), [("", "none"), ("none", "profile position")]);
    let gone: Vec<bool> = report.faults().iter().map(|fault| fault.gone).collect();
    assert_eq!(gone, [false, true]);
}

#[test]
fn sync_counts_on() {
    let mut bus = CanopenLog::default();
    for counter in (1..=10).cycle().take(35) {
        bus.send(0x80, &[counter]).wait(9);
    }
    bus.report().assert_clean();
    bus.frames.remove(20);
    let report = bus.report();
    // The gap shows in the counter and in the period.
    assert_eq!(report.anomalies(), [AnomalyKind::Sequence, AnomalyKind::Jitter]);
}

#[test]
fn a_beat_that_was_steady_and_slips_is_reported_once() {
    let mut bus = CanopenLog::default();
    (0..40).for_each(|n| {
        bus.send(0x80, &[]).wait(if n == 30 { 25 } else { 9 });
    });
    bus.report().assert_only(AnomalyKind::Jitter);
}

/// Bit 12 of the same statusword in each mode, read and in process data.
#[test]
fn bits_of_the_statusword_are_named_by_the_mode() {
    let mode = ObjectIndex::new(0x6060, 0);
    let word = [0x37, 0x14];
    for (number, name) in [
        (1, "set-point taken"),
        (8, "drive follows the command value"),
        (3, "speed zero"),
        (6, "homing attained"),
        (2, "bit 12"),
    ] {
        let mut log = CanopenLog::default();
        log.read(WORD, 0x0237, 2).send(0x180 | u16::from(NODE), &word);
        log.write(mode, number, 1).read(WORD, 0x1437, 2).send(0x180 | u16::from(NODE), &word);
        let report = log.report();
        let of_mode = |line: &&String| line.contains(&format!("target reached, {name})"));
        let named: Vec<_> = report.lines.iter().filter(of_mode).collect();
        assert_eq!(named.len(), 2, "{number}: {:#?}", report.lines);
        let unknown = report.lines.iter().filter(|line| line.contains("set-point taken, homing"));
        assert_eq!(unknown.count(), 1, "before the mode is known: {:#?}", report.lines);
    }
}
