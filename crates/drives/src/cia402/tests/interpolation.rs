//! Interpolated position, offsets of cyclic modes, torque limits and touch probes.

use super::super::interpolation::RECORDS_MAX;
use super::*;
use polepair_core::proto::canopen::device::Quirks;

/// Bits of 60B8h for the first touch probe.
const ENABLED: i64 = 0x01;
const CONTINUOUS: i64 = 0x02;
const INDEX: i64 = 0x04;
const RISING: i64 = 0x10;
const FALLING: i64 = 0x20;

impl DriveFixture {
    /// Interpolated position, active from the present position on.
    fn interpolating() -> Self {
        let mut fixture = Self::enabled(7);
        fixture.control(0x1F);
        fixture
    }
}

#[test]
fn records_are_followed_while_bit_4_is_set() {
    let mut fixture = DriveFixture::enabled(7);
    fixture.write(0x60C2, 1, 100);
    fixture.write(0x60C1, 1, 5_000);
    fixture.advance(50);
    assert_eq!((fixture.position(), fixture.status() & 0x1400), (0, 0), "not active");
    fixture.control(0x1F);
    fixture.advance(50);
    assert_eq!(fixture.status() & 0x1400, 0x1000, "active, and not there");
    let middle = fixture.position();
    assert!((2_000..3_000).contains(&middle), "a straight way within the period: {middle}");
    fixture.wait_for_bit(10, 300);
    fixture.advance(100);
    fixture.is_at(5_000);
    fixture.write(0x60C1, 1, 10_000);
    fixture.advance(40);
    fixture.control(0x0F);
    fixture.advance(300);
    let rest = fixture.position();
    assert!(rest < 9_000 && fixture.status() & 0x1000 == 0, "ended on the way: {rest}");
    fixture.control(0x1F);
    fixture.wait_for_bit(10, 1_000);
    fixture.advance(100);
    fixture.is_at(10_000);
}

#[test]
fn a_halt_holds_the_way_and_its_end_goes_on_without_a_step() {
    let mut fixture = DriveFixture::interpolating();
    fixture.write(0x60C2, 1, 200);
    fixture.write(0x60C1, 1, 20_000);
    fixture.advance(100);
    fixture.control(0x11F);
    fixture.wait_for_bit(10, 500);
    let rest = fixture.position();
    fixture.advance(200);
    fixture.is_at(rest);
    fixture.control(0x01F);
    let mut fastest: f64 = 0.0;
    for _ in 0..400 {
        fixture.advance(1);
        fastest = fastest.max(fixture.turns());
    }
    fixture.is_at(20_000);
    assert!(fastest < 25.0, "the rest of the way within one period: {fastest} turns a second");
}

#[test]
fn a_buffer_is_used_up_record_by_record() {
    let mut fixture = DriveFixture::enabled(7);
    fixture.write(0x60C2, 1, 50);
    fixture.write(0x60C4, 2, 4);
    for record in [1_000, 2_000, 3_000, 4_000] {
        fixture.write(0x60C1, 1, record);
    }
    assert_eq!(fixture.read(0x60C4, 4), 4);
    assert_eq!(fixture.try_write(0x60C1, 1, 5_000), Err(AbortCode::RESOURCE), "no room");
    fixture.control(0x1F);
    fixture.advance(110);
    assert_eq!(fixture.read(0x60C4, 4), 1, "the third is in force");
    // SYNC does not use them up faster: each is for one period.
    for _ in 0..5 {
        fixture.sync();
    }
    assert_eq!(fixture.read(0x60C4, 4), 1);
    fixture.advance(400);
    fixture.is_at(4_000);
    fixture.write(0x60C4, 6, 0);
    assert_eq!(fixture.try_write(0x60C1, 1, 0), Err(AbortCode::STATE), "access is off");
    fixture.write(0x60C4, 6, 1);
    fixture.write(0x60C1, 1, 0);
    fixture.advance(400);
    fixture.is_at(0);
    assert_eq!(fixture.read(0x60C4, 1), RECORDS_MAX as i64);
    let beyond = fixture.try_write(0x60C4, 2, RECORDS_MAX as i64 + 1);
    assert_eq!(beyond, Err(AbortCode::TOO_HIGH));
}

#[test]
fn a_record_is_no_setting_that_is_kept() {
    let mut fixture = DriveFixture::new();
    fixture.write(0x60C1, 1, 70_000);
    fixture.write(0x60B8, 0, ENABLED | RISING);
    let all = ExpeditedData { bits: 0x6576_6173, len: 4 };
    fixture.send(SdoRequest::Write(ObjectIndex::new(0x1010, 1), all).emit(2));
    fixture.advance(2_000);
    fixture.send(Frame::standard(0, &[0x81, 2]));
    fixture.advance(10);
    assert_eq!((fixture.read(0x60C1, 1), fixture.read(0x60B8, 0)), (0, 0));
    assert_eq!(fixture.read(0x60B9, 0), 0);
}

#[test]
fn offsets_are_added_to_cyclic_targets() {
    let mut fixture = DriveFixture::enabled(8);
    fixture.write(0x60B0, 0, 2_000);
    fixture.write(0x607A, 0, 3_000);
    fixture.advance(500);
    fixture.is_at(5_000);
    let mut fixture = DriveFixture::enabled(9);
    fixture.write(0x60FF, 0, 20_000);
    fixture.write(0x60B1, 0, 10_000);
    fixture.advance(500);
    assert!((fixture.turns() - 3.0).abs() < 0.1, "{}", fixture.turns());
}

#[test]
fn a_torque_offset_carries_a_load_that_is_known() {
    let sag = |offset: i64| {
        let mut fixture = DriveFixture::enabled(8);
        fixture.advance(100);
        fixture.write(0x60B2, 0, offset);
        // Half of the rated torque against the shaft.
        let rated = fixture.read(0x6076, 0) as f64 / 1e3;
        fixture.act(Act::Load(-0.5 * rated));
        let mut lowest = 0;
        for _ in 0..200 {
            fixture.advance(1);
            lowest = lowest.min(fixture.position());
        }
        lowest
    };
    let (alone, helped) = (sag(0), sag(500));
    assert!(alone < -20 && helped > alone / 3, "{alone} without, {helped} with the offset");
}

#[test]
fn torque_limits_hold_in_each_direction_and_mode() {
    let greatest = |direction: i64| {
        let mut fixture = DriveFixture::enabled(1);
        fixture.write(0x60E0, 0, 400);
        fixture.write(0x60E1, 0, 900);
        fixture.write(0x6083, 0, 100_000_000);
        fixture.write(0x6081, 0, 200_000);
        fixture.hand_over_point(direction * 50_000, 0);
        let mut greatest = 0;
        for _ in 0..30 {
            fixture.advance(1);
            greatest = greatest.max(fixture.read(0x6077, 0) * direction);
        }
        greatest
    };
    let (forward, backward) = (greatest(1), greatest(-1));
    assert!((350..=400).contains(&forward), "{forward}");
    assert!((800..=900).contains(&backward), "{backward}");
    let mut fixture = DriveFixture::enabled(4);
    fixture.write(0x60E0, 0, 300);
    fixture.write(0x6071, 0, 700);
    fixture.advance(1_000);
    assert!(fixture.read(0x6074, 0) <= 300);
}

#[test]
fn a_touch_probe_stores_the_position_of_its_edges() {
    let mut fixture = DriveFixture::enabled(3);
    fixture.write(0x60FF, 0, 10_000);
    fixture.advance(300);
    fixture.act(Act::Input(4, true));
    fixture.act(Act::Input(4, false));
    assert_eq!(fixture.read(0x60B9, 0), 0, "not enabled");
    fixture.write(0x60B8, 0, ENABLED | RISING | FALLING);
    assert_eq!(fixture.read(0x60B9, 0), 1);
    fixture.act(Act::Input(4, true));
    let risen = fixture.position();
    assert_eq!(fixture.read(0x60FD, 0) >> 16 & 3, 1);
    fixture.advance(100);
    fixture.act(Act::Input(4, false));
    let fallen = fixture.position();
    assert_eq!(fixture.read(0x60B9, 0), 7);
    assert_eq!((fixture.read(0x60BA, 0), fixture.read(0x60BB, 0)), (risen, fallen));
    assert!(fallen > risen + 500);
    // The first event holds; a probe that is switched off and on takes another one.
    fixture.act(Act::Input(4, true));
    assert_eq!(fixture.read(0x60BA, 0), risen);
    fixture.write(0x60B8, 0, 0);
    assert_eq!(fixture.read(0x60B9, 0), 0);
    fixture.write(0x60B8, 0, (ENABLED | CONTINUOUS | RISING) << 8);
    for _ in 0..2 {
        fixture.advance(50);
        fixture.act(Act::Input(5, true));
        let at = fixture.position();
        fixture.act(Act::Input(5, false));
        assert_eq!((fixture.read(0x60BC, 0), fixture.read(0x60B9, 0)), (at, 0x0300));
    }
    assert_eq!(fixture.read(0x60BD, 0), 0, "no falling edge was asked for");
}

#[test]
fn a_touch_probe_finds_the_index_pulse_exactly() {
    let mut fixture = DriveFixture::enabled(3);
    fixture.write(0x60B8, 0, ENABLED | INDEX | RISING);
    fixture.write(0x60FF, 0, 10_000);
    fixture.advance(1_500);
    assert_eq!((fixture.read(0x60B9, 0), fixture.read(0x60BA, 0)), (3, 10_000), "a whole turn");
}

#[test]
fn a_drive_that_maps_when_pre_operational_refuses_it_later() {
    let mut fixture = DriveFixture::new();
    let quirks = Quirks { maps_pre_operational: true, ..Quirks::STRICT };
    fixture.device = Device::with_quirks(Drive::new(2, 7, 500_000), quirks);
    fixture.send(Frame::standard(0, &[1, 2]));
    assert_eq!(fixture.try_write(0x1800, 5, 50), Err(AbortCode::STATE));
    fixture.send(Frame::standard(0, &[0x80, 2]));
    fixture.write(0x1800, 5, 50);
}
